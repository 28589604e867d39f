"""Open Sound Control 1.0, the part that VMC needs: messages of i, f and s, and bundles of them."""

import struct
from collections.abc import Iterator, Sequence

from rig.errors import FormatError

BUNDLE = b"#bundle\x00"
IMMEDIATELY = 1
MAX_DEPTH = 4
Argument = int | float | str
Message = tuple[str, tuple[Argument, ...]]


def message(address: str, *arguments: Argument) -> bytes:
    """Return one message; bool is not an argument type here."""
    tags = "".join(_tag(argument) for argument in arguments)
    parts = [_padded(address), _padded("," + tags)]
    for tag, argument in zip(tags, arguments, strict=True):
        parts.append(_padded(str(argument)) if tag == "s" else struct.pack(f"!{tag}", argument))
    return b"".join(parts)


def bundles(messages: Sequence[bytes], *, max_bytes: int) -> Iterator[bytes]:
    """Yield bundles of messages, none larger than `max_bytes` unless one message alone is."""
    head = BUNDLE + struct.pack("!Q", IMMEDIATELY)
    body: list[bytes] = []
    size = len(head)
    for data in messages:
        if body and size + 4 + len(data) > max_bytes:
            yield head + b"".join(body)
            body, size = [], len(head)
        body.append(struct.pack("!i", len(data)) + data)
        size += 4 + len(data)
    if body:
        yield head + b"".join(body)


def parse(data: bytes, *, depth: int = 0) -> list[Message]:
    """Return the messages of a datagram.

    Raises
    ------
    FormatError
        If it is no OSC, or bundles are nested too deep.
    """
    if not data.startswith(BUNDLE):
        return [_parse_message(data)]
    if depth >= MAX_DEPTH or len(data) < 16:
        raise FormatError("OSC bundle is nested too deep or cut short")
    messages: list[Message] = []
    offset = 16
    while offset < len(data):
        size = _unpack("!i", data, offset)
        offset += 4
        if not 0 < size <= len(data) - offset:
            raise FormatError(f"OSC bundle element of {size} bytes does not fit the datagram")
        messages += parse(data[offset : offset + size], depth=depth + 1)
        offset += size
    return messages


def _parse_message(data: bytes) -> Message:
    address, offset = _text(data, 0)
    tags, offset = _text(data, offset)
    if not address.startswith("/") or not tags.startswith(","):
        raise FormatError(f"OSC message begins with {address[:20]!r}; an address begins with '/'")
    arguments: list[Argument] = []
    for tag in tags[1:]:
        if tag == "s":
            text, offset = _text(data, offset)
            arguments.append(text)
        elif tag in "if":
            arguments.append(_unpack(f"!{tag}", data, offset))
            offset += 4
        else:
            raise FormatError(f"OSC argument of type {tag!r}; this reads i, f and s")
    return address, tuple(arguments)


def _unpack(kind: str, data: bytes, offset: int) -> int:
    try:
        (number,) = struct.unpack_from(kind, data, offset)
    except struct.error as error:
        raise FormatError(f"OSC message of {len(data)} bytes is cut short") from error
    return int(number) if kind == "!i" else number


def _text(data: bytes, offset: int) -> tuple[str, int]:
    end = data.find(b"\x00", offset)
    if end < 0:
        raise FormatError("OSC text has no end")
    try:
        text = data[offset:end].decode("utf-8")
    except UnicodeDecodeError as error:
        raise FormatError(f"OSC text is no UTF-8: {error.reason}") from error
    return text, end + 4 - end % 4


def _tag(argument: Argument) -> str:
    return {int: "i", float: "f", str: "s"}[type(argument)]


def _padded(text: str) -> bytes:
    """Return text ended by zeros up to a multiple of four bytes."""
    data = text.encode("utf-8")
    return data + b"\x00" * (4 - len(data) % 4)
