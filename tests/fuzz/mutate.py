"""Mutations of bytes, text, JSON trees and containers, all drawn from one random generator."""

import io
import json
import random
import re
import struct
import warnings
import zipfile
from collections.abc import Callable, Sequence

Mutation = Callable[[random.Random, bytes, Sequence[bytes]], bytes]

NUMBERS = (
    b"0", b"-1", b"1e308", b"-1e308", b"1e400", b"1e-320", b"nan", b"inf", b"-inf", b"65536",
    b"2147483647", b"2147483648", b"-2147483649", b"4294967296", b"9223372036854775807",
    b"18446744073709551616", b"1000000", b"99999999", b"0.1", b"-0", b"1e9", b"3.5e38",
    b"10801", b"1_0", b"0x10", b"1,5", b"True", b"9" * 30, b"9" * 400, b"1" * 5000, b"", b"1.2.3",
)  # fmt: skip
WORDS = (
    b'"', b"'", b"[", b"]", b"{", b"}", b",", b";", b"\t", b"\n", b"\r", b"\r\n", b":", b"&a ",
    b"*a", b"\\", b"\x00", b"\xff\xfe", b"\xef\xbb\xbf", b"\xc3", b"<!ENTITY x>", b"null", b"sep=;\n",
    b"[" * 50, b"{" * 50, b"- " * 50, b"x" * 300, b"\xf0\x9f\x98\x80", b"<a>", b"#", b"%", b"!!int ",
    b"time", b"frame", b"happy", b"v ", b"f ", b"property list uchar int x\n", b"element a 5\n",
)  # fmt: skip
INTEGERS = (0, 1, 2, 127, 255, 256, 65535, 65536, 2**24, 2**31 - 1, 2**31, 2**32 - 1)
VALUES = (
    None, True, 0, -1, 1.5, 1e308, 10**20, 10**400, "", "x", "9" * 300, [], {}, [[]], [0] * 50,
    {"a": 1}, 2**31, 5_000_000, 10**9, "POSITION", float("nan"),
)  # fmt: skip
NUMBER = re.compile(rb"[-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")


def mutated(rng: random.Random, data: bytes, corpus: Sequence[bytes]) -> bytes:
    """One to six small changes of a text or binary file."""
    for _ in range(rng.choice((1, 1, 2, 3, 6))):
        data = rng.choice(_CHANGES)(rng, data, corpus)
    return data


def _place(rng: random.Random, data: bytes) -> int:
    return rng.randrange(len(data) + 1)


def _flip(rng: random.Random, data: bytes, corpus: Sequence[bytes]) -> bytes:
    if not data:
        return data
    changed = bytearray(data)
    for _ in range(rng.choice((1, 1, 4, 16))):
        changed[rng.randrange(len(changed))] ^= 1 << rng.randrange(8)
    return bytes(changed)


def _overwrite(rng: random.Random, data: bytes, corpus: Sequence[bytes]) -> bytes:
    order, size = rng.choice("<>"), rng.choice("HIQ")
    value = rng.choice(INTEGERS) & (2 ** (8 * struct.calcsize(size)) - 1)
    number = struct.pack(order + size, value)
    at = _place(rng, data)
    if rng.random() < 0.5:
        at = min(at, 64)  # headers
    return data[:at] + number + data[at + len(number) :]


def _insert(rng: random.Random, data: bytes, corpus: Sequence[bytes]) -> bytes:
    at = _place(rng, data)
    return data[:at] + rng.choice(WORDS + NUMBERS) + data[at:]


def _delete(rng: random.Random, data: bytes, corpus: Sequence[bytes]) -> bytes:
    at = _place(rng, data)
    return data[:at] + data[at + rng.choice((1, 2, 8, 64, 512)) :]


def _repeat(rng: random.Random, data: bytes, corpus: Sequence[bytes]) -> bytes:
    at = _place(rng, data)
    part = data[at : at + rng.choice((1, 4, 32, 256))]
    return data[:at] + part * rng.choice((2, 5, 100)) + data[at:]


def _cut(rng: random.Random, data: bytes, corpus: Sequence[bytes]) -> bytes:
    return data[: _place(rng, data)]


def _splice(rng: random.Random, data: bytes, corpus: Sequence[bytes]) -> bytes:
    other = rng.choice(corpus)
    return data[: _place(rng, data)] + other[_place(rng, other) :]


def _number(rng: random.Random, data: bytes, corpus: Sequence[bytes]) -> bytes:
    found = list(NUMBER.finditer(data[:20_000]))
    if not found:
        return _insert(rng, data, corpus)
    match = rng.choice(found)
    return data[: match.start()] + rng.choice(NUMBERS) + data[match.end() :]


def _line(rng: random.Random, data: bytes, corpus: Sequence[bytes]) -> bytes:
    lines = data.splitlines(keepends=True)
    if len(lines) < 2:
        return _flip(rng, data, corpus)
    a, b = rng.randrange(len(lines)), rng.randrange(len(lines))
    lines[a], lines[b] = lines[b], lines[a] if rng.random() < 0.5 else b""
    return b"".join(lines)


def _encoding(rng: random.Random, data: bytes, corpus: Sequence[bytes]) -> bytes:
    return data.decode("latin-1").encode(rng.choice(("utf-16", "utf-8-sig", "utf-16-le")))


_CHANGES: tuple[Mutation, ...] = (
    _flip, _overwrite, _insert, _delete, _repeat, _cut, _splice, _number, _number, _number, _line,
    _line, _encoding,
)  # fmt: skip


def mutated_json(rng: random.Random, data: bytes, corpus: Sequence[bytes]) -> bytes:
    """Change values of a JSON tree, or sometimes its text."""
    if rng.random() < 0.3:
        return mutated(rng, data, corpus)
    try:
        tree = json.loads(data)
    except ValueError:
        return mutated(rng, data, corpus)
    for _ in range(rng.choice((1, 1, 2, 4))):
        tree = _changed(rng, tree)
    return json.dumps(tree, allow_nan=True).encode()


def _changed(rng: random.Random, tree: object) -> object:
    """One value of a tree replaced, doubled or removed."""
    if isinstance(tree, list) and tree and rng.random() < 0.8:
        i = rng.randrange(len(tree))
        way = rng.random()
        if way < 0.1:
            return tree[:i] + tree[i + 1 :]
        if way < 0.2:
            return tree[:i] + [tree[i]] * rng.choice((2, 50)) + tree[i:]
        return [*tree[:i], _changed(rng, tree[i]), *tree[i + 1 :]]
    if isinstance(tree, dict) and tree and rng.random() < 0.9:
        key = rng.choice(list(tree))
        if rng.random() < 0.1:
            return {k: v for k, v in tree.items() if k != key}
        return {**tree, key: _changed(rng, tree[key])}
    return rng.choice(VALUES)


def mutated_npz(rng: random.Random, data: bytes, corpus: Sequence[bytes]) -> bytes:
    """Change an array's header or numbers inside a valid archive, or the archive."""
    if rng.random() < 0.25:
        return mutated(rng, data, corpus)
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = [(entry.filename, archive.read(entry)) for entry in archive.infolist()]
    for _ in range(rng.choice((1, 1, 2))):
        i = rng.randrange(len(members))
        name, content = members[i]
        way = rng.random()
        if way < 0.1:
            members.pop(i)
        elif way < 0.2:
            members.append((name if rng.random() < 0.5 else f"{name}2.npy", content))
        elif way < 0.6:
            members[i] = (name, _npy_header(rng, content))
        else:
            members[i] = (name, mutated(rng, content, [content]))
        if not members:
            break
    stream = io.BytesIO()
    kind = rng.choice((zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED))
    with zipfile.ZipFile(stream, "w", kind) as archive, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of duplicate names
        for name, content in members:
            archive.writestr(name, content)
    return stream.getvalue()


def _npy_header(rng: random.Random, content: bytes) -> bytes:
    """Another shape or type in the header of an array, with a correct header length."""
    end = content.find(b"\n") + 1
    header = content[10:end]
    shape = ",".join(str(rng.choice((0, 1, 2, 3, 1000, 10**6, 10**9, 10**18, -1))) for _ in range(rng.randrange(4)))  # fmt: skip
    kind = rng.choice(("<f4", "<f8", ">f4", "<f2", "|O", "<i8", "|b1", "<U5", "<U1000000", "<c8",
                       "|V8", "<M8[s]", "|S3", "<f16", "<U0", "<u8"))  # fmt: skip
    if rng.random() < 0.6:
        header = re.sub(rb"'shape': \([^)]*\)", f"'shape': ({shape},)".encode(), header)
    else:
        header = re.sub(rb"'descr': '[^']*'", f"'descr': '{kind}'".encode(), header)
    if rng.random() < 0.1:
        header = mutated(rng, header, [header])
    return content[:8] + struct.pack("<H", len(header) & 0xFFFF) + header + content[end:]


def mutated_glb(rng: random.Random, data: bytes, corpus: Sequence[bytes]) -> bytes:
    """Change the JSON of a GLB with valid chunks, or its bytes."""
    if rng.random() < 0.3 or len(data) < 20:
        return mutated(rng, data, corpus)
    (length,) = struct.unpack_from("<I", data, 12)
    text = mutated_json(rng, data[20 : 20 + length], [b"{}"])
    text += b" " * (-len(text) % 4)
    rest = data[20 + length :]
    head = struct.pack("<III", 0x46546C67, 2, 20 + len(text) + len(rest))
    return head + struct.pack("<II", len(text), 0x4E4F534A) + text + rest


def mutated_safetensors(rng: random.Random, data: bytes, corpus: Sequence[bytes]) -> bytes:
    """Change the header of a weight file, with a correct header length, or its bytes."""
    if rng.random() < 0.3 or len(data) < 8:
        return mutated(rng, data, corpus)
    length = int.from_bytes(data[:8], "little")
    header = mutated_json(rng, data[8 : 8 + length], [b"{}"])
    return len(header).to_bytes(8, "little") + header + data[8 + length :]
