"""Open Sound Control 1.0, as far as VMC needs it: messages of int, float and text; bundles."""

import struct
from collections.abc import Iterator, Sequence

BUNDLE = b"#bundle\x00"
IMMEDIATELY = 1
Argument = int | float | str


def message(address: str, *arguments: Argument) -> bytes:
    """Return one message; its arguments are of types i (int32), f (float32) and s (UTF-8)."""
    tags = "".join({int: "i", float: "f", str: "s"}[type(argument)] for argument in arguments)
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


def _padded(text: str) -> bytes:
    """Return text ended by zeros up to a multiple of four bytes."""
    data = text.encode("utf-8")
    return data + b"\x00" * (4 - len(data) % 4)
