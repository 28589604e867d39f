"""`deitalk diff`: takes edited in files of many programs, as layers that give the edits again."""

import json
from dataclasses import replace
from itertools import cycle
from pathlib import Path

import numpy as np
import pytest
import soundfile

from deitalk import animate
from deitalk.config.rules import KeepContacts
from deitalk.data.edited import changes_of_take
from deitalk.errors import DataError
from deitalk.postprocess.control_groups import ControlGroups
from rig import default_controls, read_curves, write_curves
from rig.conversion.arkit import ARKIT_ID, arkit_controls
from rig.conversion.convert import convert
from rig.conversion.raw import RAW_ID
from rig.curves.apply_layers import apply_layers
from rig.curves.edit import clamp
from rig.curves.shift import shift
from tests.command import deitalk, ran, refused
from tests.errors import one_line

SAMPLE = Path(__file__).parents[3] / "docs" / "samples" / "promise.flac"
BOARD = default_controls()
TARGETS = (
    "CTRL_C_jaw.ty", "CTRL_L_brow_raiseOut.ty", "CTRL_R_brow_down.ty", "CTRL_C_mouth.tx",
    "CTRL_L_mouth_cornerPull.ty", "CTRL_R_mouth_upperLipRaise.ty", "CTRL_L_eye_blink.ty",
    "CTRL_L_mouth_lipsTogetherU.ty", "CTRL_L_nose.ty", "CTRL_C_tongue_move.ty",
)  # fmt: skip


@pytest.fixture(scope="module")
def performance():
    return animate(SAMPLE, "happy", seed=3)


@pytest.fixture(scope="module")
def take(performance, tmp_path_factory):
    return performance.save(tmp_path_factory.mktemp("edited") / "take")


@pytest.fixture(scope="module")
def wanted(take):
    return by_hand(read_curves(take / "curves.json"))


def by_hand(base):
    """A take with twenty edits by hand, which end in steps from one frame to the next."""
    values, rng = base.values.copy(), np.random.default_rng(4)
    for k in range(20):
        column, length = BOARD.index(TARGETS[k % len(TARGETS)]), int(rng.integers(4, 25))
        start = int(rng.integers(1, len(base) - length))
        part = values[start : start + length, column]
        part += (0.35 * np.hanning(length), 0.2 - 0.7 * part, 0.5 - part, -0.25)[k % 4]
    return clamp(replace(base, values=values))[0]


def written(wanted, form, folder):
    """The edited curves as a program leaves them."""
    if form == "board.csv":  # of Maya: some columns, in another order and spelling
        names = [name for name in BOARD.names if name in TARGETS or "eye" in name][::-1]
        rows = [",".join(f"{x:.6f}" for x in (k / 30, *row))
                for k, row in enumerate(wanted.select(names).values)]  # fmt: skip
        header = ",".join(
            ["time", *(n.replace(".t", "-translate").replace("eX", "eX") for n in names)]
        )
        header = header.replace("translatex", "translateX").replace("translatey", "translateY")
        path = folder / "board.csv"
        path.write_text("\n".join([header, *rows]) + "\n")
        return path
    path = folder / f"edited{form}"
    curves = convert(wanted, RAW_ID) if form == ".raw.csv" else wanted
    write_curves(path, curves)
    return path


FORMS = (".csv", ".json", ".npz", ".unreal.json", ".raw.csv", ".maya.py", "board.csv")


@pytest.mark.parametrize("form", FORMS)
def test_what_was_edited_comes_back_from_every_program(take, wanted, form, tmp_path):
    path = written(wanted, form, tmp_path)
    ran("diff", path, take, "-o", tmp_path / "fixes.edit.json")
    text = (tmp_path / "fixes.edit.json").read_text()
    layer = json.loads(text)
    n_keys = sum(len(edit["keys"]) for edit in layer["edits"])
    assert len(text.encode()) <= 20_000 and n_keys <= 0.01 * wanted.values.size
    assert layer["name"] == "fixes" and layer["sound"]["seconds"] > 8 and layer["phones"]
    acted = animate(SAMPLE, "happy", seed=3, edit=tmp_path / "fixes.edit.json")
    assert np.abs(acted.curves.values - wanted.values).max() < 0.01
    assert met(acted.curves) >= met(wanted)


def met(curves):
    """Frames in which the lips meet."""
    return int((curves.values[:, ControlGroups(BOARD).together].mean(axis=1) >= 0.9).sum())


def test_another_seed_has_the_same_edits(take, wanted, tmp_path):
    layer = changes_of_take(written(wanted, ".csv", tmp_path), take).layer
    plain, acted = (animate(SAMPLE, "happy", seed=9, edit=edit) for edit in ((), layer))
    asked = wanted.values - read_curves(take / "curves.json").values
    changed = np.abs(acted.curves.values - plain.curves.values)
    free = (np.abs(asked) > 0.05) & (plain.curves.values > 0.05) & (plain.curves.values < 0.95)
    assert (changed[free] > 0.01).mean() > 0.9  # but where a range ends
    assert changed[np.abs(asked) < 1e-6].max() < 1e-5 + 0.01


OPPOSED = ("EyeLook", "EyeWide", "EyeBlink", "JawLeft", "JawRight", "MouthLeft", "MouthRight")
"""Two of them are one control in its two directions: no face shows both."""
POSES = [
    name for name in arkit_controls().names[:52]
    if not name.startswith(OPPOSED) and name != "MouthClose"
]  # fmt: skip


@pytest.mark.parametrize("form", ["livelink", "csv"])
@pytest.mark.parametrize("seed", range(2))
def test_edited_arkit_shapes_come_back_as_shapes(take, form, seed, tmp_path):
    """52 shapes cannot say what 185 controls do: they are compared as shapes, within .01."""
    shapes, rng = convert(read_curves(take / "curves.json"), ARKIT_ID), np.random.default_rng(seed)
    values = shapes.values.copy()
    for k, name in enumerate(rng.choice(POSES, 20)):
        length = int(rng.integers(4, 25))
        start, column = int(rng.integers(1, len(shapes) - length)), shapes.index(name)
        part = values[start : start + length, column]
        part += (0.35 * np.hanning(length), 0.2 - 0.7 * part, 0.5 - part, -0.25)[k % 4]
    values[:, :52] = values[:, :52].clip(0, 1)
    closed, jaw = shapes.index("MouthClose"), shapes.index("JawOpen")
    values[:, closed] = np.minimum(values[:, closed], values[:, jaw])
    path = tmp_path / "edited_take_1.csv"
    write_curves(path, replace(shapes, values=values), format=form)
    found = changes_of_take(path, take)
    assert any("controls are not in the file and stay as they are" in note for note in found.notes)
    assert [note for note in found.notes if "carried back" in note] == []
    assert found.share <= 0.01 and len(found.layer.text.encode()) <= 20_000
    base = read_curves(take / "curves.json")
    rule = ControlGroups(BOARD).closures(KeepContacts())
    again = convert(apply_layers(base, [found.layer], closures=rule)[0], ARKIT_ID).values - values
    assert np.abs(again[:, :52]).max() < 0.01


def test_shapes_that_no_face_has_are_named(take, tmp_path):
    """Lips that are closed further than the jaw is open, and an eye turned without its shapes."""
    shapes = convert(read_curves(take / "curves.json"), ARKIT_ID)
    values = shapes.values.copy()
    values[60:90, shapes.index("MouthClose")] = 0.9
    values[60:90, shapes.index("BrowDownLeft")] = 0.5
    values[60:90, shapes.index("LeftEyeYaw")] += 0.3
    path = tmp_path / "edited_take_1.livelink.csv"
    write_curves(path, replace(shapes, values=values))
    notes = changes_of_take(path, take).notes
    (note,) = [note for note in notes if "carried back" in note]
    assert "these shapes" in note and note.endswith(": MouthClose")
    assert "LeftEyeYaw are not read: the shapes EyeLook… turn the eyes" in notes


SHIFTED = ((3, 0), (2, 8), (-4, 5))


@pytest.mark.parametrize("of_take", [True, False])
@pytest.mark.parametrize(("delay", "handles"), SHIFTED)
def test_delay_and_handles_are_undone(take, delay, handles, of_take, tmp_path):
    """Of a take, by its own record; of a file alone, as they are told."""
    form = {"delay": delay, "handles": handles}
    told = {} if of_take else form
    if of_take:
        take = animate(SAMPLE, "happy", seed=3).save(tmp_path / "shifted", **form)
    curves = read_curves(take / "curves.json")
    late = curves if of_take else shift(curves, **form)
    values, column = late.values.copy(), BOARD.index("CTRL_L_nose.ty")
    values[70:90, column] += 0.4 * np.hanning(20)
    values[:2, BOARD.index("CTRL_R_nose.ty")] += 0.3 if handles else 0.0
    write_curves(tmp_path / "e.csv", replace(late, values=values))
    found = changes_of_take(tmp_path / "e.csv", take, **told)
    (edit,) = found.layer.edits
    first = (70 - handles - delay) / 30
    assert edit.target == "CTRL_L_nose.ty" and edit.span[0] == pytest.approx(first, abs=0.04)
    assert any("left out" in note for note in found.notes) == bool(handles)
    again = animate(SAMPLE, "happy", seed=3, edit=found.layer).save(tmp_path / "again.csv", **form)
    missed = np.abs(read_curves(again).values - values)[2:]
    assert missed.max() < 0.01


FILM = {"delay": 2, "handles": 8}
RATES = [(24, {}), (25, FILM), (29.97, {}), (48, {}), (50, FILM), (60, FILM)]


@pytest.mark.parametrize(("fps", "form"), RATES)
def test_edits_come_back_at_the_rate_of_the_take(performance, fps, form, tmp_path):
    """Every frame but the handles and what a delay holds, steps too: a layer applies at that rate."""
    take = performance.save(tmp_path / "take", fps=fps, **form)
    wanted = by_hand(read_curves(take / "curves.json"))
    write_curves(tmp_path / "edited.csv", wanted)
    layer = changes_of_take(tmp_path / "edited.csv", take).layer
    assert len(layer.text.encode()) <= 20_000
    again = animate(SAMPLE, "happy", seed=3, edit=layer)
    inside = slice(form.get("handles", 0) + 2, -form.get("handles", 0) - 2)
    for target in (tmp_path / "again", tmp_path / "again.json"):
        again.save(target, fps=fps, **form)
        found = read_curves(target / "curves.json" if target.is_dir() else target)
        assert found.fps == wanted.fps
        assert np.abs(found.values - wanted.values)[inside].max() < 0.01


def test_another_rate_is_no_change(take, tmp_path):
    write_curves(tmp_path / "e.csv", read_curves(take / "curves.json"), fps=24)
    told = refused("diff", tmp_path / "e.csv", take, "-o", tmp_path / "x.edit.json")
    assert "no more than noise" in told and not (tmp_path / "x.edit.json").exists()


def test_a_shorter_file_is_compared_as_far_as_it_goes(take, wanted, tmp_path):
    write_curves(tmp_path / "e.csv", wanted[:100])
    found = changes_of_take(tmp_path / "e.csv", take)
    assert any("100 frames" in note for note in found.notes)
    assert max(edit.span[1] for edit in found.layer.edits) <= 100 / 30


def cell(rows, k, value):
    rows[k][rows[0].index("CTRL_L_nose.ty")] = value
    return rows


def later(rows, seconds):
    return [rows[0], *([r[0], f"{float(r[1]) + seconds}", *r[2:]] for r in rows[1:])]


def few(rows):
    return [[row[1], row[rows[0].index("CTRL_L_nose.ty")]] for row in rows]


HANDS = {  # what hands and spreadsheets make of a table, and what is said of it
    "columns in another order": (lambda rows: [row[::-1] for row in rows], ""),
    "time and one column": (few, "184 controls are not in the file"),
    "rows are lost": (lambda rows: rows[:120] + rows[150:], "s without a frame, left out"),
    "the beginning is lost": (lambda rows: rows[:1] + rows[31:], "begin at 1.00 s: it is compared"),
    "the middle alone": (lambda rows: rows[:1] + rows[31:120], "begin at 1.00 s: it is compared"),
    "a program's frame 101": (lambda rows: later(rows, 100 / 30), "its first row is compared with"),
    "times before zero": (lambda rows: later(rows, -1), "its first row is compared with the first"),
    "empty rows": (lambda rows: [*rows, *([""] * len(rows[0]) for _ in range(9))], ""),
}
SHEETS = {  # separator, decimal mark, encoding, first line
    "plain": (",", ".", "utf-8", ""),
    "Excel, German": (";", ",", "utf-8-sig", ""),
    "Excel, sep=": (";", ",", "cp1252", "sep=;\r\n"),
    "Excel, Unicode text": ("\t", ",", "utf-16", ""),
}


def laid_out(rows, path, sheet):
    separator, mark, encoding, first = SHEETS[sheet]
    marked = [rows[0], *([cell.replace(".", mark) for cell in row] for row in rows[1:])]
    lines = "".join(separator.join(row) + "\r\n" for row in marked)
    path.write_bytes((first + lines).encode(encoding))
    return path


@pytest.fixture(scope="module")
def bumped(take, tmp_path_factory):
    """Cells of the take's table with one edit from 2 to 3 s."""
    base = read_curves(take / "curves.json")
    values = base.values.copy()
    values[60:90, BOARD.index("CTRL_L_nose.ty")] += 0.4
    path = tmp_path_factory.mktemp("bumped") / "e.csv"
    write_curves(path, replace(base, values=values))
    return [line.split(",") for line in path.read_text().splitlines()]


@pytest.mark.parametrize(
    ("hands", "sheet"),
    [*zip(HANDS, cycle(SHEETS)), *(("columns in another order", sheet) for sheet in [*SHEETS][1:])],
)
def test_what_hands_make_of_a_table_is_the_same_edit(take, bumped, hands, sheet, tmp_path):
    change, note = HANDS[hands]
    path = laid_out(change([list(row) for row in bumped]), tmp_path / "e.csv", sheet)
    found = changes_of_take(path, take)
    (edit,) = found.layer.edits
    assert edit.target == "CTRL_L_nose.ty" and edit.span == pytest.approx((59 / 30, 3), abs=1e-3)
    assert note in " | ".join(found.notes) and (note or not found.notes)


@pytest.mark.parametrize("value", ["NaN", "", "x", "#NUM!", "inf"])
def test_cells_that_are_no_number_are_named(take, bumped, value, tmp_path):
    path = laid_out(cell([list(row) for row in bumped], 71, value), tmp_path / "e.csv", "plain")
    with one_line(ValueError, "row 71, column 'CTRL_L_nose.ty'"):
        changes_of_take(path, take)


def test_the_layers_of_the_take_come_first(take, wanted, tmp_path):
    path = written(wanted, ".csv", tmp_path)
    ran("diff", path, take, "-o", tmp_path / "one.edit.json")
    second = animate(SAMPLE, "happy", seed=3, edit=tmp_path / "one.edit.json").save(tmp_path / "t2")
    values = read_curves(second / "curves.json").values.copy()
    values[10:30, BOARD.index("CTRL_R_nose.ty")] += 0.2
    more = replace(wanted, values=values)
    write_curves(tmp_path / "more.csv", more)
    done = deitalk("diff", tmp_path / "more.csv", second, "-o", tmp_path / "two.edit.json")
    assert done.code == 0 and "has layers of its own, which come first" in done.err
    acted = animate(SAMPLE, "happy", seed=3, edit=[second, tmp_path / "two.edit.json"])
    assert np.abs(acted.curves.values - values).max() < 0.01


SAID = (
    "Maybe you believe me. But mother, Bob promised everybody a piece of that perfect apple "
    "pie! Well, what a wonderful evening this could become."
)
SPOKEN = {
    "words": {"words": SAID},
    "script": {"script": SAID.replace("But", "[excitedly] But").replace("Well", "[sighs] *Well*")},
    "SSML": {"script": f"<speak>{SAID.replace('Well', '<emphasis>Well</emphasis>')}</speak>"},
    "role": {
        "script": f"1\n00:00:00,000 --> 00:00:08,700\nANNA: [happily] {SAID}\n", "role": "anna"
    },
}  # fmt: skip


@pytest.mark.parametrize("given", SPOKEN)
def test_words_of_the_take_name_the_edits(take, given, tmp_path):
    """And the words by which a layer follows another reading, whatever said what is spoken."""
    pytest.importorskip("espeakng_loader")
    spoken = animate(SAMPLE, **SPOKEN[given]).save(tmp_path / "spoken")
    edited = read_curves(spoken / "curves.json")
    values = edited.values.copy()
    values[60:66, BOARD.index("CTRL_L_nose.ty")] += 0.3
    edited = replace(edited, values=values)
    write_curves(tmp_path / "e.csv", edited)
    layer = changes_of_take(tmp_path / "e.csv", spoken).layer
    (edit,) = layer.edits
    assert edit.target == "CTRL_L_nose.ty"
    assert edit.words and edit.words.split()[0].strip(".,") in SAID
    assert [word.strip(".,!").lower() for word, *_ in layer.words] == [
        word.strip(".,!").lower() for word in SAID.split()
    ]
    again = animate(SAMPLE, **SPOKEN[given], edit=layer).curves
    assert np.abs(again.values - edited.values).max() < 0.01


def test_files_that_are_no_edit_are_refused_in_one_line(take, tmp_path):
    (tmp_path / "a.csv").write_text("time,x\n0,1\n")
    soundfile.write(tmp_path / "a.wav", np.zeros(10), 8000)
    for edited, of, words in (
        (tmp_path / "a.csv", take, ""),
        (take / "curves.csv", tmp_path, "has no curves.json"),
        (tmp_path / "none.csv", take, "none.csv"),
    ):
        with one_line(ValueError, words):
            changes_of_take(edited, of)
    with one_line(DataError, "arkit"):
        write_curves(tmp_path / "shapes.json", convert(read_curves(take / "curves.json"), ARKIT_ID))
        changes_of_take(take / "curves.csv", tmp_path / "shapes.json")
    assert "must be a .json file" in refused(
        "diff", take / "curves.csv", take, "-o", tmp_path / "x.csv"
    )
