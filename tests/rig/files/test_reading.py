"""Reading untrusted files: regular files within limits, or an error of one line without blocking."""

import io
import json
import os
import struct
import threading
import zipfile

import numpy as np
import pytest

from rig import limits
from rig.errors import FormatError
from rig.files.reading import (
    check_expansion,
    check_file,
    json_depth,
    load_json,
    read_bytes,
    read_npz,
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
    reader.join(5)
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


# --- NPZ


ARRAYS = {
    "numbers": np.arange(12, dtype=np.float32).reshape(3, 4),
    "columns": np.asfortranarray(np.arange(6.0).reshape(2, 3)),
    "names": np.array(["jaw", "länger"]),
    "one": np.array(30.0),
    "none": np.zeros((0, 5), np.int16),
    "flags": np.array([True, False]),
    "big": np.array([1, 2], ">i4"),
}


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
def test_archive_equals_what_numpy_saved(tmp_path, save):
    save(tmp_path / "a.npz", **ARRAYS)
    back = read_npz(tmp_path / "a.npz")
    assert set(back) == set(ARRAYS)
    for name, array in ARRAYS.items():
        np.testing.assert_array_equal(back[name], array)
        assert back[name].dtype == array.dtype and not back[name].flags.writeable


def npy(shape, kind="<f4", data=b""):
    stream = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        stream, {"shape": shape, "fortran_order": False, "descr": kind}
    )
    return stream.getvalue() + data


def archive(path, members, compression=zipfile.ZIP_DEFLATED):
    with zipfile.ZipFile(path, "w", compression) as file:
        for name, data in members:
            file.writestr(name, data)
    return path


@pytest.mark.parametrize(
    ("member", "words"),
    [
        (npy((10**9, 10**9)), "has shape"),
        (npy((-1, 3)), "no archive of numpy arrays"),
        (npy((1000,)), "is cut short"),
        (npy((1,), data=b"\0" * 8), "longer than its header"),
        (npy((2,), "|O", b"\0" * 16), "not numbers or text"),
        (npy((2**60,), "<U0"), "not numbers or text"),
        (npy((1,), "<c8", b"\0" * 8), "not numbers or text"),
        (npy((1,), "<U1", b"\0\0\x11\0"), "holds what is no text"),
        (npy((1,), ">U1", b"\xff\0\0\0"), "holds what is no text"),
        (b"\x93NUMPY\x09\x00", "no archive of numpy arrays"),
        (b"", "no archive of numpy arrays"),
    ],
)
def test_archive_rejects(tmp_path, member, words):
    assert words in refused(read_npz, archive(tmp_path / "a.npz", [("a.npy", member)]))


def test_archive_rejects_doubled_names(tmp_path):
    with pytest.warns(UserWarning, match="Duplicate"):
        archive(tmp_path / "a.npz", [("a.npy", npy((0,))), ("a.npy", npy((0,)))])
    assert "'a.npy' twice" in refused(read_npz, tmp_path / "a.npz")


def test_archive_of_most_arrays_is_read_and_one_more_is_not(tmp_path):
    members = [(f"{i}.npy", npy((0,))) for i in range(limits.ARRAYS + 1)]
    assert len(read_npz(archive(tmp_path / "a.npz", members[:-1]))) == 64
    assert "65 arrays; at most 64" in refused(read_npz, archive(tmp_path / "b.npz", members))


def test_archive_that_expands_too_much_is_rejected_before_unpacking(tmp_path):
    """300 MiB of zeros in 300 kB: refused by the sizes that the archive declares."""
    with zipfile.ZipFile(tmp_path / "a.npz", "w", zipfile.ZIP_DEFLATED) as file:
        with file.open("a.npy", "w") as stream:
            stream.write(npy((300 * limits.MIB // 4,)))
            for _ in range(300):
                stream.write(bytes(limits.MIB))
    assert "expands to 300 MiB; at most 256 MiB" in refused(read_npz, tmp_path / "a.npz")


def test_archive_rejects_sizes_beyond_the_limit(tmp_path):
    np.savez(tmp_path / "a.npz", a=np.zeros(1000))
    size = (tmp_path / "a.npz").stat().st_size
    assert read_npz(tmp_path / "a.npz", limit=size)
    assert "at most" in refused(read_npz, tmp_path / "a.npz", limit=size - 1)


@pytest.mark.parametrize("kept", [0.2, 0.5, 0.9, 0.99])
def test_archive_rejects_a_cut_file(tmp_path, kept):
    np.savez_compressed(tmp_path / "a.npz", **ARRAYS)
    data = (tmp_path / "a.npz").read_bytes()
    (tmp_path / "a.npz").write_bytes(data[: int(kept * len(data))])
    assert "no archive of numpy arrays" in refused(read_npz, tmp_path / "a.npz")


def test_archive_rejects_a_wrong_size(tmp_path):
    np.savez(tmp_path / "a.npz", a=np.zeros(4))
    data = bytearray((tmp_path / "a.npz").read_bytes())
    central = data.index(b"PK\x01\x02")
    data[central + 24 : central + 28] = struct.pack("<I", 2**31)  # uncompressed size
    (tmp_path / "a.npz").write_bytes(data)
    assert "unpacks to 2 GiB" in refused(read_npz, tmp_path / "a.npz")


def test_expansion_is_bounded_by_the_file_above_a_floor():
    floor = limits.EXPANDED_BYTES
    check_expansion(floor, 16, "a", error=FormatError)
    check_expansion(100 * 5 * limits.MIB, 5 * limits.MIB, "a", error=FormatError)
    assert "a of 16 bytes expands to" in refused(
        check_expansion, floor + 1, 16, "a", error=FormatError
    )
    with pytest.raises(FormatError, match="of 5 MiB expands"):
        check_expansion(100 * 5 * limits.MIB + 1, 5 * limits.MIB, "a", error=FormatError)
