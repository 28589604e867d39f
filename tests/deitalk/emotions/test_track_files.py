"""Keys from any spreadsheet: separators, decimals, encodings; and files that must not block."""

import codecs
import time

import numpy as np
import pytest

from deitalk.emotions import parse_emotion, read_intensity_curve
from deitalk.errors import EmotionError
from tests.errors import one_line


def written(path, text, encoding="utf-8"):
    mark = {"utf-16-le": codecs.BOM_UTF16_LE, "utf-16-be": codecs.BOM_UTF16_BE}.get(encoding, b"")
    path.write_bytes(mark + text.encode(encoding))
    return path


def curve(path):
    read = read_intensity_curve(path)
    return list(zip(read.times.tolist(), read.values.tolist(), strict=True))


def refused(read, path):
    with one_line(EmotionError) as caught:
        read(path)
    return str(caught.value)


KEYS = [(0.0, 0.45), (1.5, 1.25)]


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be"])
@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize(
    "text",
    [
        "time,intensity\n0,0.45\n1.5,1.25\n",
        "time;intensity\n0;0.45\n1.5;1.25\n",
        "time;intensity\n0;0,45\n1,5;1,25\n",
        "time\tintensity\n0\t0,45\n1,5\t1,25\n",
        "time\tintensity\n0\t0.45\n1,5\t1.25\n",
        '"time","intensity"\n"0","0,45"\n"1,5","1,25"\n',
        'sep=;\ntime;intensity\n0;0,45\n1,5;1,25\n',
        '"sep=\t"\ntime\tintensity\n0\t,45\n1,5\t1,25\n',
        "\n\n  TIME ; Intensity  ;\n0;,45;\n1,5;1,25;\n;;\n",
        ",,\n , \ntime,intensity\n0,0.45\n1.5,1.25\n",
        ';;\n"sep=;"\n;\ntime;intensity\n0;0,45\n1,5;1,25\n',
        "note;time;intensity\n;0;0,45\n;;\nlouder, please;1,5;1,25\n\n",
        "time,intensity\n 0 , 0.45 \n1.5, 1.25",
        'time;"a;b";intensity\n0;"x\ny";0,45\n1,5;z;1,25\n',
    ],
)  # fmt: skip
def test_any_spreadsheet_gives_the_same_keys(tmp_path, text, end, encoding):
    path = written(tmp_path / "i.csv", text.replace("\n", end), encoding)
    assert curve(path) == KEYS


def test_weights_in_columns_are_read_with_decimal_commas(tmp_path):
    path = written(tmp_path / "t.tsv", "Time\tHappy\tnote\n0\t0,5\tx\n1\t1\t\n")
    expected = np.array([[0.5, 0, 0.5, 0, 0], [0, 0, 1, 0, 0]])
    assert np.array_equal(parse_emotion(path).weights[:, :5], expected)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("time;intensity\n0;1,2,3\n", "key 1: intensity is '1,2,3'"),
        ("time;intensity\n0;1\n1;1.234,5\n", "key 2: intensity is '1.234,5'"),
        ("time;intensity\n0;1\n;\n2;\n", "key 3: no 'intensity'"),
        ("time;intensity\n;;\n", "holds no keys"),
        ("time;intensity", "holds no keys"),
        ("0;1\n1;0,5\n", "its first line must name the columns, such as time,emotion"),
        ("sep=|\ntime|intensity\n0|1\n", "none of comma, semicolon and tab"),
        ("time,Time,intensity\n0,0,1\n", "'time' comes twice"),
        ("time,intensity\n0,1\n1,5,0,45\n", "key 2: more cells than the 2"),
        ("time,intensity\n10801,1\n", "time 10801 s is beyond 10800 s"),
        ("time,intensity\n0,1\n1e308,1\n", "key 2: time 1e+308 s is beyond"),
        ("time,intensity\n0," + "9" * 100_000 + "\n", "key 1"),
        ("time,intensity\n0," + "x" * 100_000 + "\n", "key 1: intensity is 'xxx"),
        ("time,intensity\n0,True\n", "key 1: intensity is 'True'"),
        ('time,intensity\n0,"1\n', "i.csv"),
        ("x" * 3_000_000, "cannot be parsed"),
        ("x" * 100_000, "no 'time'"),
        (",".join(map(str, range(257))) + "\n", "257 columns; at most 256"),
    ],
)
def test_spreadsheet_rejects(tmp_path, text, words):
    assert words in refused(read_intensity_curve, written(tmp_path / "i.csv", text))


@pytest.mark.parametrize(("most", "fits"), [(3, True), (2, False)])
def test_keys_are_counted(tmp_path, monkeypatch, most, fits):
    monkeypatch.setattr("rig.limits.KEYS", most)
    rows = [(0.0, 1.0), (1.0, 1.0), (2.0, 1.0)]
    sheet = "time,intensity\n" + "\n".join(f"{t},{v}" for t, v in rows) + "\n\n"
    keys = "[" + ",".join(f'{{"time": {t}, "intensity": {v}}}' for t, v in rows) + "]"
    for path in (written(tmp_path / "i.csv", sheet), written(tmp_path / "i.json", keys)):
        if fits:
            assert curve(path) == rows
        elif path.suffix == ".json":
            assert "3 keys; at most 2" in refused(read_intensity_curve, path)
        else:
            assert "5 lines; at most 2 keys" in refused(read_intensity_curve, path)


def test_a_long_table_is_read_in_seconds(tmp_path):
    """A twelfth of the largest: 2.7 MB of keys in half a second of CPU, however decimals are written."""
    times = np.arange(100_000) / 30
    rows = "\n".join(f"{t:.6f};{t % 4:.6f}" for t in times).replace(".", ",")
    path = written(tmp_path / "i.csv", f"time;intensity\n{rows}\n")
    read_intensity_curve(written(tmp_path / "warm.csv", "time,intensity\n0,1\n"))
    start = time.process_time()
    assert len(read_intensity_curve(path).times) == 100_000
    assert time.process_time() - start < 1.2
