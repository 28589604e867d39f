"""Reading untrusted files: regular files within limits, or an error of one line without blocking."""

import json
import os
import threading

import pytest

from rig import limits
from rig.errors import FormatError
from rig.files.reading import (
    check_file,
    json_depth,
    load_json,
    read_bytes,
    read_text,
)
from tests.errors import one_line


def refused(read, *arguments, **options):
    with one_line(FormatError) as caught:
        read(*arguments, **options)
    return str(caught.value)


def test_file_at_the_limit_is_read_and_above_is_not(tmp_path):
    (tmp_path / "a").write_bytes(b"x" * 10)
    assert check_file(tmp_path / "a", 10) == 10
    assert read_bytes(tmp_path / "a", 10) == b"x" * 10
    assert "has 10 bytes; at most 9 bytes" in refused(read_bytes, tmp_path / "a", 9)


def test_size_is_checked_before_reading(tmp_path):
    with (tmp_path / "a").open("wb") as file:
        file.truncate(3 * limits.GIB)
    assert "has 3 GiB; at most 512 MiB" in refused(read_bytes, tmp_path / "a", limits.MESH_BYTES)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no named pipes")
def test_named_pipe_never_blocks(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    messages = []
    reader = threading.Thread(
        target=lambda: messages.append(refused(read_bytes, tmp_path / "pipe", 99)), daemon=True
    )
    reader.start()
    reader.join(60)
    assert messages and "pipe is a named pipe, not a file" in messages[0]


@pytest.mark.parametrize(
    ("name", "words"),
    [("absent", "does not exist"), (".", "is a folder"), ("empty", "is empty"), ("a\0b", "cannot read")],
)  # fmt: skip
def test_read_bytes_rejects(tmp_path, name, words):
    (tmp_path / "empty").touch()
    assert words in refused(read_bytes, tmp_path / name, 99)


@pytest.mark.skipif(not os.path.exists("/dev/zero"), reason="this system has no /dev/zero")
def test_read_bytes_rejects_devices():
    from pathlib import Path

    assert "is a device" in refused(read_bytes, Path("/dev/zero"), 99)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be"])
def test_text_is_read_in_every_encoding_with_a_mark(tmp_path, encoding):
    mark = {"utf-16-le": b"\xff\xfe", "utf-16-be": b"\xfe\xff"}.get(encoding, b"")
    (tmp_path / "a").write_bytes(mark + "time; Zürich €".encode(encoding))
    assert read_text(tmp_path / "a", 99) == "time; Zürich €"


def test_text_rejects_bytes_that_are_no_text(tmp_path):
    (tmp_path / "a").write_bytes(b"caf\xe9")
    assert "no UTF-8 text (byte 3" in refused(read_text, tmp_path / "a", 99)
    (tmp_path / "a").write_bytes(b"RIFF\xe9\0")  # of another program, which no encoding mends
    assert refused(read_text, tmp_path / "a", 99).endswith("a is no text")
    (tmp_path / "a").write_bytes(b"\xff\xfea")
    assert "no UTF-16 text" in refused(read_text, tmp_path / "a", 99)


def nested(depth):
    return "[" * depth + "1" + "]" * depth


def test_json_at_the_nesting_limit_is_read_and_above_is_not():
    assert load_json(nested(limits.NESTING), "a")
    assert "nests 33 levels; at most 32" in refused(load_json, nested(limits.NESTING + 1), "a")
    assert "nests 100000 levels" in refused(load_json, "[" * 100_000, "a")


@pytest.mark.parametrize(
    ("value", "depth"),
    [(1, 0), ([], 1), ({"a": [1, {"b": []}]}, 4), (["[[[", {"]": '"[['}, "\\"], 2), (['\\"[[[', []], 2)],
)  # fmt: skip
def test_depth_counts_brackets_outside_strings(value, depth):
    assert json_depth(json.dumps(value).encode()) == depth
    assert load_json(json.dumps(value), "a") == value


@pytest.mark.parametrize("text", ["NaN", '{"a": -Infinity}', "{", "1" * 5000, "", "\x00"])
def test_json_rejects(text):
    assert refused(load_json, text, "it.json").startswith("it.json is no JSON: ")


def test_json_is_read_with_a_mark():
    assert load_json("é".join(['\ufeff{"', '": 1}']).encode(), "a") == {"é": 1}
    assert load_json("[1]".encode("utf-16"), "a") == [1]
