"""Layers of edits: hand-worked values, closures, ranges, files, other times."""

import json
from dataclasses import replace

import numpy as np
import pytest

from rig import RigCurves, default_controls
from rig.curves.apply_layers import Closures, apply_layers, retimed
from rig.curves.layer_files import parse_layers, read_layers
from rig.curves.layers import Edit, Layer, Sound
from rig.errors import ControlError, CurveError
from tests.errors import one_line

BOARD = default_controls()
JAW, BROW, NOSE = "CTRL_C_jaw.ty", "CTRL_L_brow_raiseOut.ty", "CTRL_L_nose.ty"
TOGETHER = tuple(k for k, name in enumerate(BOARD.names) if "lipsTogether" in name)
CLOSURES = Closures((TOGETHER,), (BOARD.index(JAW),), 0.25, 0.75)
FLAT = ((0.0, 0.5, 0.0, 0.0),)


def curves(frames=31, fps=30.0, head=None, **values):
    rows = np.tile(BOARD.rest, (frames, 1)).astype(np.float32)
    for name, value in values.items():
        rows[:, BOARD.index({"jaw": JAW, "brow": BROW}[name])] = value
    return RigCurves(rows, BOARD.names, fps, head=head)


def applied(given, *edits, closures=None):
    return apply_layers(given, [Layer(edits)], closures=closures)[0]


@pytest.mark.parametrize(
    ("mode", "before", "wanted"),
    [("offset", 0.2, 0.7), ("scale", 0.2, 0.1), ("own", 0.2, 0.5), ("offset", 0.9, 1.0)],
)
def test_modes_within_the_span_and_nothing_outside(mode, before, wanted):
    found = applied(curves(brow=before), Edit(BROW, FLAT, mode, (0.2, 0.4)))[BROW]
    np.testing.assert_allclose(found[6:13], wanted, atol=1e-6)  # 0.2 to 0.4 s
    np.testing.assert_allclose(np.delete(found, range(6, 13)), before, atol=1e-6)


def test_ease_is_a_smooth_rise_and_fall_within_the_span():
    found = applied(curves(), Edit(BROW, FLAT, "offset", (0.0, 1.0), (0.2, 0.4)))[BROW]
    share = np.array([0, 0.5, 1.0])  # at 0, 0.1 and 0.2 s
    np.testing.assert_allclose(found[[0, 3, 6]], 0.5 * share**2 * (3 - 2 * share), atol=1e-6)
    assert found[18] == pytest.approx(0.5) and found[24] == pytest.approx(0.25)
    assert found[30] == pytest.approx(0, abs=1e-6)


def test_keys_are_cubic_with_a_slope_on_either_side():
    keys = (0.0, 0.0, 0.0, 1.0), (0.5, 0.5, 1.0, -1.0), (1.0, 0.0, -1.0, 0.0)
    found = applied(curves(), Edit(BROW, keys, "offset", (0, 1)))[BROW]
    time = np.arange(31) / 30
    np.testing.assert_allclose(found, 0.5 - np.abs(time - 0.5), atol=1e-6)


def test_a_region_moves_all_its_members_and_the_head_its_own_track():
    head = np.zeros((31, 6), np.float32)
    given = curves(head=head)
    found = applied(
        given, Edit("brow", FLAT, "offset", (0, 1)), Edit("head.pitch", FLAT, "own", (0, 1))
    )
    moved = np.flatnonzero((found.values != given.values).any(axis=0))
    assert set(moved) == set(BOARD.subset("brow"))
    np.testing.assert_allclose(found.head, 0.5 * np.eye(6)[1] * np.ones((31, 1)))
    assert applied(curves(), Edit("head.pitch", FLAT, "own", (0, 1))).head is None


def test_muted_layers_and_none_change_nothing():
    given = curves(brow=0.3)
    loud = Layer((Edit(BROW, FLAT, "own", (0, 1)),), muted=True)
    for layers in ([], [loud]):
        assert np.array_equal(apply_layers(given, layers)[0].values, given.values)


def closed_face():
    """Lips that meet in frames 10 to 20."""
    given = curves(jaw=0.1)
    values = given.values.copy()
    values[10:21, list(TOGETHER)] = 1
    return replace(given, values=values)


@pytest.mark.parametrize(
    ("name", "edit", "wanted"),
    [
        ("jaw", Edit(JAW, FLAT, "offset", (0, 1)), 0.1),
        ("seal", Edit(BOARD.names[TOGETHER[0]], ((0.0, -0.8, 0, 0),), "offset", (0, 1)), 1.0),
        ("scaled seal", Edit(BOARD.names[TOGETHER[0]], ((0.0, 0.1, 0, 0),), "scale", (0, 1)), 1.0),
        ("owned jaw", Edit(JAW, FLAT, "offset", (0, 1), owns=True), 0.6),
        ("own jaw", Edit(JAW, FLAT, "own", (0, 1)), 0.5),
        ("brow", Edit(BROW, FLAT, "offset", (0, 1)), 0.5),
    ],
)
def test_lips_that_met_meet_again_unless_the_edit_owns_them(name, edit, wanted):
    found, notes = apply_layers(closed_face(), [Layer((edit,))], closures=CLOSURES)
    assert found[edit.target][15] == pytest.approx(wanted, abs=1e-6)
    taken_back = name in ("jaw", "seal", "scaled seal")
    assert any("taken back, as lips meet there" in note for note in notes) == taken_back
    if name == "jaw":  # it opens elsewhere
        assert found[JAW][5] == pytest.approx(0.6)


def test_values_beyond_a_range_are_brought_into_it_and_said():
    found, (note,) = apply_layers(
        curves(), [Layer((Edit(BROW, ((0, 3.0, 0, 0),), "own", (0, 1)),))]
    )
    assert found[BROW].max() == 1
    assert f"31 edited values of {BROW} were brought into their ranges" in note


def test_a_file_holds_all_of_a_layer(tmp_path):
    sound = Sound.of(np.random.default_rng(0).normal(size=8000).astype(np.float32), 16_000)
    edits = (
        Edit(JAW, ((0.25, 0.1, 0.0, 1.5), (0.5, -0.2, -1.0, 0.0)), "scale", (0.25, 0.5), (0.1, 0)),
        Edit("brow", ((0.0, 0.4, 0.0, 0.0),), "own", (0.0, 2.0), owns=True, words="a map"),
    )
    layer = Layer(edits, "fixes", True, sound, (("a", 0.1, 0.2), ("map", 0.2, 0.5)), (("M", 4),))
    path = tmp_path / "x.edit.json"
    path.write_text(layer.text)
    assert read_layers(path) == read_layers(tmp_path) == parse_layers(layer.text) == (layer,)
    assert parse_layers(f"[{layer.text}, {layer.text}]") == (layer, layer)


def test_a_short_file_written_by_hand_has_defaults():
    (layer,) = parse_layers(
        '{"schema": "deitalk.edit/1", "edits": [{"target": "jaw", "keys": [[1, 0], [2, 0.4]]}]}'
    )
    (edit,) = layer.edits
    assert edit == Edit("jaw", ((1, 0, 0, 0), (2, 0.4, 0, 0)), "offset", (1, 2))


def tree(**edit):
    whole = {"target": JAW, "keys": [[0, 1]]} | edit
    return {"schema": "deitalk.edit/1", "edits": [whole]}


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ("{", "is no JSON"),
        ({"edits": []}, "schema must be deitalk.edit/1"),
        ({"schema": "deitalk.edit/1", "edit": []}, "no field 'edit'"),
        ({"schema": "deitalk.edit/1"}, "edits must be a list"),
        ({"schema": "deitalk.edit/1", "edits": [3]}, "edit 1 is 3"),
        (tree(target=""), "has no target"),
        (tree(mode="add"), "mode 'add' must be offset, scale, own"),
        (tree(keys=[]), "has no keys"),
        (tree(keys=[[1]]), "must be [time, value]"),
        (tree(keys=[[1, 2], [1, 3]]), "sort them"),
        (tree(keys=[[-1, 2]]), "within 0 to"),
        (tree(keys=[[1, float("inf")]]), "must be a finite number"),
        (tree(keys=[[1, True]]), "must be a finite number"),
        (tree(span=[2, 1]), "must rise"),
        (tree(span=[1]), "must be 2 numbers"),
        (tree(ease=[-1, 0]), "must be 0 or more"),
        (tree(owns=1), "must be true or false"),
        (tree() | {"words": [["a", 1]]}, "must be [text, start, end]"),
        (tree() | {"phones": "M x"}, "each with a whole number"),
        (tree() | {"sound": {"seconds": 1, "levels": "é"}}, "letters and digits"),
        (tree() | {"muted": "no"}, "must be true or false"),
    ],
)
def test_what_is_no_layer_is_refused_in_one_line(given, words):
    with one_line(CurveError, words):
        parse_layers(given if isinstance(given, str) else json.loads(json.dumps(given)))


def test_an_unknown_target_is_named():
    with one_line(ControlError, "CTRL_C_jaw.tz"):
        applied(curves(), Edit("CTRL_C_jaw.tz", FLAT, "own", (0, 1)))


def test_a_folder_without_layers_is_refused(tmp_path):
    with one_line(CurveError, "holds no layers"):
        read_layers(tmp_path)


NO_WORDS = np.zeros((2, 2), bool)


def test_retimed_edits_keep_their_values_at_the_new_times():
    keys = (1.0, 0.0, 0.0, 0.2), (1.5, 0.3, 0.4, 0.4), (2.0, 0.0, -0.2, 0.0)
    layer = Layer((Edit(BROW, keys, "offset", (1.0, 2.0), (0.1, 0.1)),))
    (edit,) = retimed(layer, np.array([1.0, 2.0]), np.array([3.0, 5.0]), *NO_WORDS).edits
    assert edit.span == (3.0, 5.0) and edit.ease == pytest.approx((0.2, 0.2))
    times = np.linspace(1, 2, 20)
    np.testing.assert_allclose(
        edit.curve(3 + 2 * (times - 1)), layer.edits[0].curve(times), atol=1e-9
    )
    before = retimed(layer, np.array([2.5, 3.0]), np.array([0.2, 1.0]), *NO_WORDS).edits[0]
    assert before.span == pytest.approx((-1.3, -0.3))  # shifted before the recording
    assert np.array_equal(applied(curves(), before).values, curves().values)


STEPS = {  # first and last second of an edit that has a step at both ends, and where they are then
    "word before the pause": ((1.0, 2.0), (1.0, 2.0)),
    "ends a frame late": ((1.0, 2.033), (1.0, 2.033)),
    "ends two frames early": ((1.0, 1.933), (1.0, 1.933)),
    "word after the pause": ((2.0, 3.0), (4.0, 5.0)),
    "begins a frame early": ((1.967, 3.0), (3.967, 5.0)),
    "begins two frames late": ((2.067, 3.0), (4.067, 5.0)),
    "across": ((1.5, 2.5), (1.5, 4.5)),
    "shorter than the margins": ((1.967, 2.0), (1.967, 2.0)),
    "beside a phone that is longer now": ((1.5, 3.0), (1.5, 5.0)),
}


@pytest.mark.parametrize("case", STEPS)
@pytest.mark.parametrize("gap", [0.0, 1e-3])
def test_an_edit_of_a_word_stays_at_it_where_a_pause_is_new_beside_it(case, gap):
    """Two words from 1 to 3 s, then 2 s between them; a third from 3.02 s is ten times as long."""
    frame, ((start, end), wanted) = 1 / 30, STEPS[case]
    keys = [(start - frame, 0.0), (start, 0.4), (end, 0.4), (end + frame, 0.0)]
    span = (start - frame, end + frame)
    layer = Layer((Edit(BROW, tuple((t, v, 0.0, 0.0) for t, v in keys), "offset", span),))
    old, new = np.array([1, 2, 2 + gap, 3, 3.02]), np.array([1.0, 2.0, 4.0, 5.0, 5.2])
    begins, ends = np.array([[1, 0, 1, 1, 0], [0, 1, 0, 1, 1]], bool)
    (edit,) = retimed(layer, old, new, begins, ends).edits
    found = [key[0] for key in edit.keys]
    assert found[1:3] == pytest.approx(wanted, abs=2 * frame)
    assert found[1] - found[0] == pytest.approx(frame) == found[3] - found[2]
    assert edit.span == (found[0], found[3])


@pytest.mark.parametrize(
    ("change", "is_same"),
    [
        (lambda x: np.round(x * 32767) / 32767, True),
        (lambda x: 0.5 * x, True),
        (lambda x: np.concatenate((x, np.zeros(16_000))), True),
        (lambda x: np.concatenate((np.zeros(8_000), x)), False),
        (lambda x: x[::-1], False),
        (lambda x: np.concatenate((x, x)), False),
    ],
)
def test_a_recording_is_known_by_its_levels(change, is_same):
    rng, t = np.random.default_rng(1), np.arange(48_000) / 16_000
    loud = (0.02 + np.clip(np.sin(5 * t + t**2), 0, 1)) * rng.normal(size=len(t)) * 0.1
    first = Sound.of(loud.astype(np.float32), 16_000)
    assert first.is_same(Sound.of(change(loud).astype(np.float32), 16_000)) == is_same
