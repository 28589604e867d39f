import itertools
import json

import numpy as np
import pytest

from rig import read_curves, write_curves
from rig.conversion.visemes import (
    GESTURES,
    OCULUS,
    RHUBARB,
    Cue,
    cues,
    cues_to_curves,
    gestures,
    names,
    posed,
    weights,
)
from rig.errors import FormatError


def frames(**amounts):
    row = np.zeros((1, len(GESTURES)), np.float32)
    for name, amount in amounts.items():
        row[0, list(GESTURES).index(name)] = amount
    return posed(row, 30)


def strongest(curves, viseme_set):
    return names(viseme_set)[int(weights(curves, viseme_set)[0].argmax())]


def test_sets_have_the_documented_names():
    assert names(OCULUS) == tuple("sil PP FF TH DD kk CH SS nn RR aa E ih oh ou".split())
    assert names(RHUBARB) == tuple("ABCDEFGHX")


@pytest.mark.parametrize(
    ("amounts", "oculus", "rhubarb"),
    [
        ({}, "sil", "X"),
        ({"together": 1, "jaw": 0.1}, "PP", "A"),
        ({"together": 1, "jaw": 0.5}, "PP", "A"),
        ({"bite": 0.9, "jaw": 0.1}, "FF", "G"),
        ({"jaw": 0.95}, "aa", "D"),
        ({"jaw": 0.2, "purse": 0.9, "funnel": 0.3}, "ou", "F"),
        ({"jaw": 0.6, "funnel": 0.5, "purse": 0.25}, "oh", "E"),
        ({"jaw": 0.2, "spread": 0.7}, "ih", "B"),
        ({"jaw": 0.5, "spread": 0.4}, "E", "C"),
        ({"jaw": 0.2, "tip": 0.5, "out": 0.9}, "TH", None),
        ({"jaw": 0.4, "tip": 1.0}, "nn", "H"),
        ({"jaw": 0.1, "spread": 0.3, "tip": 0.5, "hiss": 1}, "SS", "B"),
    ],
)
def test_known_mouths_get_their_viseme(amounts, oculus, rhubarb):
    assert strongest(frames(**amounts), OCULUS) == oculus
    assert rhubarb is None or strongest(frames(**amounts), RHUBARB) == rhubarb


def test_weights_are_shares_that_sum_to_one(rng):
    curves = posed(rng.random((50, 10)).astype(np.float32), 30)
    for viseme_set in (OCULUS, RHUBARB):
        share = weights(curves, viseme_set)
        assert share.sum(axis=1) == pytest.approx(1, abs=1e-5)
        assert (share >= 0).all()


def test_gestures_are_recovered_from_poses(rng):
    amounts = rng.random((20, 10)).astype(np.float32)
    assert gestures(posed(amounts, 30)) == pytest.approx(amounts, abs=1e-6)


def speech():
    """Rest, m, a, f, u, rest; 200 ms each."""
    given = [Cue(i / 5, (i + 1) / 5, shape) for i, shape in enumerate("XADGFX")]
    return given, cues_to_curves(given)


def test_cues_are_recovered_from_posed_curves():
    curves = speech()[1]
    found = cues(curves)
    order = "".join(cue.shape for cue in found)
    assert [shape for shape in order if shape in "XADGF"] == list("XADGFX")
    assert found[0].start == 0 and found[-1].end == pytest.approx(1.2)
    for one, other in itertools.pairwise(found):
        assert one.end == other.start and one.shape != other.shape


def test_lips_shut_in_a_short_closure_are_kept():
    curves = cues_to_curves([Cue(0, 0.4, "D"), Cue(0.4, 0.5, "A"), Cue(0.5, 1, "D")])
    assert "A" in [cue.shape for cue in cues(curves)]


def test_rhubarb_json_has_the_documented_schema(tmp_path):
    write_curves(tmp_path / "c.rhubarb.json", speech()[1])
    data = json.loads((tmp_path / "c.rhubarb.json").read_text())
    assert set(data) == {"metadata", "mouthCues"}
    assert set(data["metadata"]) == {"soundFile", "duration"}
    assert data["metadata"]["duration"] == 1.2
    assert data["mouthCues"][0]["start"] == 0 and data["mouthCues"][-1]["end"] == 1.2
    for cue in data["mouthCues"]:
        assert set(cue) == {"start", "end", "value"} and cue["value"] in "ABCDEFGHX"


@pytest.mark.parametrize("suffix", ["tsv", "rhubarb.json"])
def test_cues_read_back_to_the_same_mouth(tmp_path, suffix):
    _, curves = speech()
    write_curves(tmp_path / f"c.{suffix}", curves)
    back = read_curves(tmp_path / f"c.{suffix}")
    assert len(back) == len(curves)
    assert np.abs(gestures(back) - gestures(curves)).mean() < 0.05


def test_visemes_json_has_the_documented_schema(tmp_path):
    write_curves(tmp_path / "c.visemes.json", speech()[1])
    data = json.loads((tmp_path / "c.visemes.json").read_text())
    assert data["schema"] == "deitalk.visemes/1" and data["n_frames"] == len(data["values"]) == 36
    assert data["names"] == list(names(OCULUS))
    assert np.sum(data["values"], axis=1) == pytest.approx(1, abs=1e-3)


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("c.tsv", "0.00 X\n", "a time, a tab and a shape"),
        ("c.tsv", "zero\tX\n", "'zero' is no time"),
        ("c.tsv", "0\tQ\n1\tX\n", "cue 1 is 'Q'; known: A, B"),
        ("c.tsv", "1\tA\n0\tX\n", "out of order"),
        ("c.tsv", "inf\tA\n", "inf s must be from 0"),
        ("c.tsv", "999999\tA\n", "must be from 0"),
        ("c.rhubarb.json", "{}", "no list 'mouthCues'"),
        ("c.rhubarb.json", '{"mouthCues": [7]}', "cue 1 must have start"),
        ("c.rhubarb.json", '{"mouthCues": []}', "holds no cues"),
        ("c.rhubarb.json", '{"mouthCues": [{"start": 0}]}', "end: None is no time"),
    ],
)
def test_read_curves_rejects_invalid_cues(tmp_path, name, text, message):
    (tmp_path / name).write_text(text)
    with pytest.raises(FormatError, match=message):
        read_curves(tmp_path / name)


def test_visemes_written_are_read_with_the_same_mouth_in_every_frame(tmp_path):
    write_curves(tmp_path / "c.visemes.json", speech()[1])
    shares = np.array(json.loads((tmp_path / "c.visemes.json").read_text())["values"])
    curves = read_curves(tmp_path / "c.visemes.json")
    is_clear = shares.max(axis=1) > 0.9
    again = weights(curves, OCULUS).argmax(axis=1)
    assert is_clear.any()
    np.testing.assert_array_equal(again[is_clear], shares.argmax(axis=1)[is_clear])
