"""Emotions in every spelling: equal weights, and one line for every error."""

import json
import re

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from deitalk.emotions import (
    EMOTIONS,
    LABELS,
    EmotionTrack,
    IntensityCurve,
    parse_emotion,
    parse_intensity_curve,
    read_intensity_curve,
    write_intensity_csv,
)
from deitalk.errors import EmotionError
from deitalk.models.protocol import trained_weights
from tests.errors import one_line

KEYS = [
    {"time": 1.0, "emotion": "happy", "strength": 1.0},
    {"time": 3.0, "emotion": "sad", "strength": 0.5},
]


def write_track(path, keys):
    if path.suffix == ".json":
        path.write_text(json.dumps(keys))
    elif path.suffix == ".yaml":
        path.write_text(yaml.safe_dump({"keys": [dict(key) for key in keys]}))
    else:
        names = list(dict.fromkeys(name for key in keys for name in key)) or ["time", "emotion"]
        lines = [",".join(str(key.get(name, "")) for name in names) for key in keys]
        path.write_text("\n".join([",".join(names), *lines]) + "\n")
    return path


def assert_error(emotion, *words):
    with pytest.raises(EmotionError) as error:
        parse_emotion(emotion)
    message = str(error.value)
    assert "\n" not in message
    for word in words:
        assert word in message


def weights(emotion, time=0.0):
    return dict(zip(LABELS, parse_emotion(emotion).at([time])[0].tolist(), strict=True))


@pytest.mark.parametrize("name", LABELS)
def test_label_is_one_hot_at_all_times(name):
    track = parse_emotion(f" {name.upper()} ").at([-1, 0, 1e6])
    assert track.dtype == np.float32
    assert np.array_equal(track, np.tile(np.eye(9)[LABELS.index(name)], (3, 1)))


def test_missing_weight_goes_to_neutral():
    assert weights("happy=0.7") == pytest.approx(
        dict.fromkeys(LABELS, 0) | {"neutral": 0.3, "happy": 0.7}
    )
    assert weights("happy=0.7, Surprised=0.3")["neutral"] == pytest.approx(0, abs=1e-7)
    assert weights({"happy": 0.7}) == weights("happy=0.7")
    assert weights("neutral=0.2,sad=0.2")["neutral"] == pytest.approx(0.8)
    assert weights({})["neutral"] == 1


def test_the_network_reads_a_mood_as_its_mixture_of_the_trained_emotions():
    """Fear is .6 surprised, .25 sad and .15 neutral (`rig.emotions.MOODS`); labels stay one-hot."""
    row = trained_weights(parse_emotion("fear=0.5,sad=0.4").at([0.0]))[0]
    expected = {"neutral": 0.1 + 0.5 * 0.15, "sad": 0.4 + 0.5 * 0.25, "surprised": 0.5 * 0.6}
    assert row.tolist() == pytest.approx([expected.get(name, 0) for name in EMOTIONS])
    labels = trained_weights(np.eye(9, dtype=np.float32))
    assert np.array_equal(labels[:5], np.eye(5))
    np.testing.assert_allclose(labels.sum(axis=1), 1, rtol=1e-6)
    assert np.array_equal(labels[LABELS.index("calm")], np.eye(5)[0])


@given(st.lists(st.floats(0, 1), min_size=9, max_size=9))
def test_weights_are_a_distribution(strengths):
    total = max(sum(strengths), 1.0)
    row = parse_emotion({n: s / total for n, s in zip(LABELS, strengths, strict=True)}).at([0.0])[0]
    assert row.min() >= 0
    assert row.sum() == pytest.approx(1, abs=1e-6)


@pytest.mark.parametrize("suffix", [".csv", ".json", ".yaml"])
def test_keyframes_are_joined_by_lines_and_held_outside(tmp_path, suffix):
    path = write_track(tmp_path / f"track{suffix}", KEYS)
    for spelling in (path, str(path)):
        track = parse_emotion(spelling).at([0.0, 1.0, 1.5, 3.0, 9.0])
        #        neutral angry happy sad surprised
        assert track[:, :5].tolist() == [
            [0, 0, 1, 0, 0],
            [0, 0, 1, 0, 0],
            [0.125, 0, 0.75, 0.125, 0],
            [0.5, 0, 0, 0.5, 0],
            [0.5, 0, 0, 0.5, 0],
        ]


def test_keys_at_one_time_mix(tmp_path):
    keys = [{"time": 0, "emotion": e, "strength": s} for e, s in (("happy", 0.6), ("angry", 0.4))]
    path = write_track(tmp_path / "t.json", keys)
    assert weights(path) == weights("happy=0.6,angry=0.4")


@pytest.mark.parametrize(
    ("emotion", "words"),
    [
        ("furious", ["unknown emotion 'furious'", *LABELS]),
        ("", ["unknown emotion ''", "neutral"]),
        ("joy=0.5", ["unknown emotion 'joy'", "surprised"]),
        ({"joy": 0.5}, ["unknown emotion 'joy'"]),
        ("happy=0.7,sad=0.6", ["sum to 1.3", "intensity"]),
        ("happy=1.5", ["sum to 1.5", "must not exceed 1"]),
        ("happy=-0.2", ["happy is -0.2", "0 to 1"]),
        ("happy=nan", ["'nan'", "finite"]),
        ("happy=loud", ["'loud'", "finite number"]),
        ("happy=0.1,happy=0.2", ["given twice"]),
        ("happy=0.1,sad", ["<emotion>=<strength>"]),
        ({"happy": True}, ["finite number"]),
        ({"happy": None}, ["finite number"]),
        ("missing.csv", ["missing.csv does not exist"]),
    ],
)
def test_parse_emotion_rejects_in_one_line(emotion, words):
    assert_error(emotion, *words)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: EmotionTrack([0], [[0, 0, 2, 0, 0]]), "sum to 1"),
        (lambda: EmotionTrack([0], [[2, -1, 0, 0, 0]]), "0 to 1"),
        (lambda: EmotionTrack([0], [[0, 0, 1]]), "must be (keys, 9)"),
        (lambda: EmotionTrack([0], [[0, 0, np.nan, 0, 0]]), "finite"),
        (lambda: EmotionTrack([1, 0], np.eye(5)[:2]), "rise"),
        (lambda: IntensityCurve([0], [9]), "0 to 4"),
        (lambda: IntensityCurve([0], ["a"]), "finite"),
        (lambda: IntensityCurve([0, 1], [1]), "one for each"),
    ],
)
def test_tracks_of_wrong_numbers_are_refused(make, words):
    with pytest.raises(EmotionError, match=re.escape(words)):
        make()


def test_tracks_take_lists():
    track, curve = (
        EmotionTrack([0, 1], [[0, 0, 1, 0, 0], [1, 0, 0, 0, 0]]),
        IntensityCurve([0], [1]),
    )
    assert parse_emotion(str(track)) == track and parse_intensity_curve(str(curve)) == curve


@pytest.mark.parametrize("suffix", [".csv", ".json", ".yaml"])
@pytest.mark.parametrize("last", [{}, {"strength": 0.5}])
def test_a_key_without_strength_is_full(tmp_path, suffix, last):
    keys = [{"time": 1, "emotion": "happy"}, {"time": 3, "emotion": "sad", **last}]
    shown = parse_emotion(write_track(tmp_path / f"track{suffix}", keys)).at([1.0, 3.0])
    assert shown[0, LABELS.index("happy")] == 1
    assert shown[1, LABELS.index("sad")] == last.get("strength", 1)


@pytest.mark.parametrize("suffix", [".csv", ".json", ".yaml"])
@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ([KEYS[1], KEYS[0]], ["key 2", "time 1 comes after 3", "sort"]),
        ([KEYS[0], KEYS[0]], ["key 2", "'happy' twice"]),
        ([{**KEYS[0], "strength": -0.5}], ["time 1", "happy is -0.5"]),
        ([{**KEYS[0], "strength": 1.5}], ["time 1", "sum to 1.5"]),
        ([{**KEYS[0], "time": float("nan")}], ["track", "finite"]),
        ([KEYS[0], {**KEYS[1], "emotion": "joy"}], ["key 2", "unknown emotion 'joy'", "happy"]),
        ([{"time": 1.0, "emotion": "happy", "weight": 0.5}], ["key 1", "no 'strength'"]),
        ([{"emotion": "sad", "strength": 1}], ["key 1", "no 'time'"]),
        ([{"time": 0, "happy": 0.5, "angri": 0.5}], ["key 1", "'angri'", "no emotion", "contempt"]),
        ([{"time": 0, "happy": 1, "strength": 0.5}], ["key 1", "'strength'"]),
        ([], ["holds no keys"]),
    ],
)
def test_read_emotion_track_rejects_in_one_line(tmp_path, suffix, keys, words):
    path = write_track(tmp_path / f"track{suffix}", keys)
    assert_error(path, *words)


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("t.json", b"{"),
        ("t.json", b"[" * 100_000),
        ("t.json", b"3"),
        ("t.json", b"[1, 2]"),
        ("t.yaml", b"keys: [a: {"),
        ("t.csv", b"time,strength\n0,1\n"),
        ("t.csv", b"\xff\xfe\x00"),
        ("t.csv", b""),
        ("t.txt", b"0 happy"),
    ],
)
def test_read_emotion_track_rejects_other_files(tmp_path, name, content):
    path = tmp_path / name
    path.write_bytes(content)
    assert_error(path, "t.")


def intensity_csv(path, n=90):
    times = np.arange(n) / 30
    write_intensity_csv(
        path,
        times=times,
        weights=parse_emotion("happy=0.7,sad=0.3").at(times),
        saliency=np.full(n, 0.5),
        predicted=np.full(n, 0.9),
        intensity=times,
    )
    return times


def test_written_intensity_is_read_back(tmp_path):
    path = tmp_path / "intensity.csv"
    times = intensity_csv(path)
    header = path.read_text().splitlines()[0]
    assert header == ",".join(("frame", "time", *LABELS, "saliency", "predicted", "intensity"))
    curve = read_intensity_curve(path)
    np.testing.assert_allclose(curve.at(times), times, atol=1e-5)
    np.testing.assert_allclose(curve.at([0.01, 99.0]), [0.01, times[-1]], atol=1e-5)
    assert weights(path, 1.0)["happy"] == pytest.approx(0.7)  # a take's table is a track too


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        ("0,-0.1", "intensity -0.1 must be 0 to 4"),
        ("0,4.1", "intensity 4.1 must be 0 to 4"),
        ("0,nan", "finite"),
        ("0,inf", "finite"),
        ("1,1\n1,1", "time 1 must be after 1"),
        ("0,", "no 'intensity'"),
        ("x,1", "time is 'x'"),
    ],
)
def test_read_intensity_curve_rejects_in_one_line(tmp_path, rows, words):
    path = tmp_path / "i.csv"
    path.write_text("time,intensity\n" + rows + "\n")
    with one_line(EmotionError, match=words):
        read_intensity_curve(path)


def test_unwritable_intensity_leaves_the_old_file(tmp_path):
    path = tmp_path / "intensity.csv"
    intensity_csv(path)
    before = path.read_bytes()
    with pytest.raises(ValueError):
        write_intensity_csv(
            path, times=[0], weights=np.zeros((2, 9)), saliency=[0], predicted=[0], intensity=[0]
        )
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["intensity.csv"]
