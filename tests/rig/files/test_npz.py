"""Archives of arrays of strangers, read without more memory than their file."""

import io
import struct
import zipfile

import numpy as np
import pytest

from rig import limits
from rig.errors import FormatError
from rig.files.reading import check_expansion, read_npz
from tests.rig.files.test_reading import refused

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
