"""`import_captures`: whole takes to a dataset folder; every fault is one line."""

import csv
from dataclasses import replace
from functools import partial

import numpy as np
import pandas as pd
import pytest
import soundfile
from typer.testing import CliRunner

from deitalk.audio.load import load_audio
from deitalk.config.rig_file import read_controls, rig_of_dataset
from deitalk.data.captures import imported
from deitalk.data.captures.rig_of import rig_of_takes
from deitalk.data.clips import read_clips, read_known
from deitalk.errors import DataError
from rig import default_controls, read_curves, rest_curves
from rig.errors import UserError
from rig.formats.livelink_csv import read_take, write_take
from tests.command import ran
from tests.errors import one_line
from tests.media import write_sound
from tests.takes import bursts, is_open, write_live_link

CONTROLS = default_controls()
JAW = "CTRL_C_jaw.ty"
LIPS = "CTRL_L_mouth_lipsTogetherU.ty"
ANNA = dict(actor="anna", emotion="happy")

import_captures = partial(imported.import_captures, split_by="none")
"""Of short takes, whose division `test_splits` tests."""


def rows_of(folder):
    with (folder / "clips.csv").open(encoding="utf-8") as file:
        return list(csv.DictReader(file))


def test_take_of_the_app_becomes_clips_with_the_controls_it_can_know(tmp_path):
    csv_path = write_live_link(tmp_path / "takes" / "S_1" / "S_1_iPhone.csv", 20)
    samples, rate = soundfile.read(csv_path.with_suffix(".wav"))
    csv_path.with_suffix(".wav").unlink()
    write_sound(csv_path.with_suffix(".mov"), samples[:, None], rate, picture=True)
    (csv_path.parent / "take.json").write_text("{}")
    (csv_path.parent / "frame_log.csv").write_text("V,1,2\n")
    result = import_captures([tmp_path / "takes"], tmp_path / "data", **ANNA)
    clips = read_clips(tmp_path / "data")
    assert len(clips) == result.n_clips >= 2
    assert {(c.speaker, c.emotion, c.source) for c in clips} == {("anna", "happy", "recording")}
    known = read_known(clips[0].known, CONTROLS)
    assert known.sum() == 73  # all that the 61 columns reach
    assert known[CONTROLS.index(JAW)] and known[CONTROLS.index(LIPS)]
    assert not known[[CONTROLS.index(n) for n in CONTROLS.names if "lipBite" in n]].any()
    assert not known[CONTROLS.index("CTRL_C_tongue_tip.ty")]


def test_curves_and_sound_of_a_clip_are_the_takes(tmp_path):
    write_live_link(tmp_path / "t" / "a.csv", 40)
    import_captures([tmp_path / "t"], tmp_path / "data", **ANNA)
    whole = load_audio(tmp_path / "t" / "a.wav").waveform
    for row in rows_of(tmp_path / "data"):
        sound = load_audio(tmp_path / "data" / row["audio"]).waveform
        curves = read_curves(tmp_path / "data" / row["curves"])
        start = round(30 * float(row["start_s"])) / 30
        cut = whole[round(start * 16000) :][: len(sound)]
        np.testing.assert_allclose(sound - sound.mean(), cut - cut.mean(), atol=1e-3)
        seconds, first = len(sound) / 16000, start + float(row["offset_s"])
        assert seconds <= 15
        assert first == pytest.approx(max(start - 0.6, 0), abs=1e-3)
        assert curves.duration == pytest.approx(min(start + seconds + 0.6, 40) - first, abs=0.04)
        opens = is_open(first + curves.times).astype(float)
        assert np.corrcoef(opens, curves[JAW])[0, 1] > 0.99


def test_lips_of_a_face_at_rest_are_not_together(tmp_path):
    path = write_live_link(tmp_path / "t" / "a.csv", 8)
    take = read_take(path)
    values = take.values.copy()
    jaw, close = (take.names.index(n) for n in ("JawOpen", "MouthClose"))
    values[:, jaw], values[:, close] = 0.01, 0.012  # noise of a closed mouth
    values[60:90, jaw], values[60:90, close] = 0.2, 0.19  # b with an open jaw
    write_take(path, type(take)(take.ticks, values, take.names))
    import_captures([tmp_path / "t"], tmp_path / "data", **ANNA)
    (row, *_) = rows_of(tmp_path / "data")
    lips = read_curves(tmp_path / "data" / row["curves"])[LIPS]
    first = round((float(row["start_s"]) + float(row["offset_s"])) * 30)
    inside = np.zeros(len(lips), bool)
    inside[60 - first : 90 - first] = True
    assert lips[inside].min() > 0.9 and lips[~inside].max() < 0.25


def test_board_table_without_some_controls_leaves_them_unknown(tmp_path):
    (tmp_path / "t").mkdir()
    curves = rest_curves(180, fps=30).select(CONTROLS.names[10:])
    frame = pd.DataFrame(curves.values, columns=curves.names)
    frame.insert(0, "time", curves.times)
    frame.to_csv(tmp_path / "t" / "a.csv", index=False)
    soundfile.write(tmp_path / "t" / "a.wav", bursts(6), 16000)
    result = import_captures([tmp_path / "t"], tmp_path / "data", **ANNA)
    known = read_known(read_clips(tmp_path / "data")[0].known, CONTROLS)
    assert list(known) == [False] * 10 + [True] * (len(CONTROLS) - 10)
    assert "lacks 10 columns" in result.takes[0].notes[0]


def test_foreign_rig_is_imported_by_a_map(tmp_path):
    (tmp_path / "t").mkdir()
    n = 180
    frame = pd.DataFrame({"frame": range(n), "open": 0.5, "lip_l": 0.1, "lip_r": 0.4, "x": 1.0})
    frame.to_csv(tmp_path / "t" / "a.csv", index=False)
    soundfile.write(tmp_path / "t" / "a.wav", bursts(6), 16000)
    table = tmp_path / "map.csv"
    table.write_text("target,source,weight,offset\nCTRL_C_jaw.ty,open,0.8,0.1\n"
                     "CTRL_L_mouth_funnelU.ty,lip_l|lip_r,0.5,\n")  # fmt: skip
    result = import_captures([tmp_path / "t"], tmp_path / "data", mapping=table, fps=30, **ANNA)
    curves = read_curves(next((tmp_path / "data" / "curves").iterdir()))
    np.testing.assert_allclose(curves[JAW], 0.5 * 0.8 + 0.1, rtol=1e-6)
    np.testing.assert_allclose(curves["CTRL_L_mouth_funnelU.ty"], 0.2, rtol=1e-6)
    known = read_known(read_clips(tmp_path / "data")[0].known, CONTROLS)
    assert known.sum() == 2
    assert "1 columns are in no row of the map: 'x'" in result.takes[0].notes[0]


def test_import_is_repeatable_with_force_and_refused_without(tmp_path):
    write_live_link(tmp_path / "t" / "a.csv", 6)
    import_captures([tmp_path / "t"], tmp_path / "data", **ANNA)
    before = {p: p.read_bytes() for p in (tmp_path / "data").rglob("*.*")}
    with pytest.raises(UserError, match="exists"):
        import_captures([tmp_path / "t"], tmp_path / "data", **ANNA)
    import_captures([tmp_path / "t"], tmp_path / "data", **ANNA, force=True)
    assert {p: p.read_bytes() for p in (tmp_path / "data").rglob("*.*")} == before


def _no_sound(path):
    path.with_suffix(".wav").unlink()


def _nan(path):
    text = path.read_text().splitlines()
    text[3] = text[3].replace(text[3].split(",")[2], "nan", 1)
    path.write_text("\n".join(text) + "\n")


def _renamed(path):
    path.write_text(path.read_text().replace("JawOpen", "jaw_opening"))


def _silent(path):
    soundfile.write(path.with_suffix(".wav"), 1e-5 * np.ones(16000 * 6), 16000)


def _short(path):
    soundfile.write(path.with_suffix(".wav"), bursts(0.3), 16000)


@pytest.mark.parametrize(
    ("spoil", "expected"),
    [
        (_no_sound, "no audio beside the take"),
        (_nan, "data row 3"),
        (_renamed, "column 'jaw_opening' is unknown and 'JawOpen' is missing"),
        (_silent, "holds no speech"),
        (_short, "both must last 0.5 s"),
    ],
)
def test_fault_of_a_take_is_one_line_and_nothing_is_written(tmp_path, spoil, expected):
    spoil(write_live_link(tmp_path / "t" / "a.csv", 6))
    with one_line(UserError, match=expected):
        import_captures([tmp_path / "t"], tmp_path / "data", **ANNA)
    assert not (tmp_path / "data").exists()
    assert [p.name for p in tmp_path.iterdir() if p.name != "t"] == []


def test_rig_is_made_of_the_columns_of_takes(tmp_path):
    """Ranges around what is shown; pairs, mouth and upper face by the names."""
    folder = tmp_path / "my-mocap"
    folder.mkdir()
    names = ("jaw_open", "Smile_L", "Smile_R", "eyeBlinkLeft", "eyeBlinkRight", "spin")
    values = np.full((180, 6), 0.5, np.float32)
    values[9] = (0.2, 0, 0, 0, 0, -1.5)
    np.savez(folder / "a.npz", names=np.array(names), values=values, fps=30)
    np.savez(folder / "b.npz", names=np.array(["jaw_open", "tail"]), values=values[:, :2], fps=30)
    soundfile.write(folder / "a.wav", bursts(6), 16000)
    rig = rig_of_takes([folder])
    assert rig.id == "my_mocap@1" and rig.names == (*names, "tail")
    assert (rig["spin"].minimum, rig["spin"].maximum, rig["spin"].rest) == (-2, 1, 0)
    assert {c.name: c.mirror for c in rig.controls if c.mirror} == {
        "Smile_L": "Smile_R",
        "Smile_R": "Smile_L",
        "eyeBlinkLeft": "eyeBlinkRight",
        "eyeBlinkRight": "eyeBlinkLeft",
    }
    assert {c.name: set(c.sets) for c in rig.controls if c.sets} == {
        "jaw_open": {"lip"},
        "eyeBlinkLeft": {"upper_face"},
        "eyeBlinkRight": {"upper_face"},
    }
    (folder / "b.npz").unlink()
    command = ["data", "import", str(folder), "--rig-from", str(folder), "-o", f"{tmp_path}/data"]
    ran(*command, "--actor", "anna", "--split-by", "none")
    own = rig_of_dataset(tmp_path / "data")
    assert own is not None and read_controls(own).names == names
    assert rig_of_dataset(tmp_path / "data", "other.yaml") == "other.yaml"
    assert rig_of_dataset(folder) is None


def test_a_rig_is_found_in_any_spelling_of_its_controls(tmp_path):
    """ARKit's shapes as Apple spells them."""
    (tmp_path / "t").mkdir()
    pd.DataFrame({"eyeBlinkLeft": np.linspace(0, 1, 240), "jawOpen": 0.5}).to_csv(
        tmp_path / "t/a.csv", index=False
    )
    soundfile.write(tmp_path / "t/a.wav", bursts(8), 16000)
    result = import_captures([tmp_path / "t"], tmp_path / "d", rig=read_controls("arkit"), fps=30)
    assert "no actor given, taken as one" in result.takes[0].notes
    (clip, *_) = read_clips(tmp_path / "d")
    known = read_known(clip.known, read_controls("arkit"))
    assert known.sum() == 2 and known[read_controls("arkit").index("JawOpen")]


def test_takes_of_which_no_rig_can_be_made_are_refused_with_the_reason(tmp_path):
    (tmp_path / "a.csv").write_text("frame,jaw\n0,0.5\n1,0.5\n")
    with one_line(DataError, match=r"to make a rig of .*a\.csv: holds no times and no rate; give"):
        rig_of_takes([tmp_path])
    assert rig_of_takes([tmp_path], 30.0).names == ("jaw",)


def test_rows_of_a_table_find_takes_of_one_name_or_are_refused(tmp_path):
    """Two folders have a `shapes.csv`: the second is `shapes-2` in the dataset and in the table."""
    for name in ("one", "two"):
        write_live_link(tmp_path / "t" / name / "shapes.csv", 6)
    table = tmp_path / "table.csv"
    table.write_text("take,actor\nshapes,anna\nshapes-2,ben\n")
    import_captures([tmp_path / "t"], tmp_path / "data", table=table)
    actors = {(row["take"], row["speaker"]) for row in rows_of(tmp_path / "data")}
    assert actors == {("shapes", "anna"), ("shapes-2", "ben")}
    table.write_text("take,actor\nshapes,anna\nshapes-3,ben\n")
    with pytest.raises(DataError, match="'shapes-3' is not among the takes shapes, shapes-2;"):
        import_captures([tmp_path / "t"], tmp_path / "other", table=table)
    assert not (tmp_path / "other").exists()


def test_command_prints_takes_and_the_dataset_passes_the_check(tmp_path):
    for number in range(4):
        write_live_link(tmp_path / "t" / f"joy_{number}.csv", 8 + number / 10)
    out = str(tmp_path / "data")
    done = ran("data", "import", tmp_path / "t", "--actor", "anna", "--split-by", "time", "-o", out)
    assert "joy_0  livelink anna       happy" in done.stdout
    assert "no actor given" not in done.stdout
    assert "(2 train, 1 validation, 1 test)" in done.stdout
    checked = ran("data", "check", out)
    assert "warning  speakers" in checked.stdout


def test_curves_of_another_rig_stay_as_they_are(tmp_path, rng):
    from deitalk.cli.data import app
    from deitalk.config.rig_file import read_controls

    (tmp_path / "rig.yaml").write_text(
        "id: puppet@1\ncontrols:\n  jaw: {}\n  wide: {minimum: -1}\n  hat: {}\n  brow: {}\n"
    )
    (tmp_path / "t").mkdir()
    values = {n: np.clip(rng.normal(0.4, 0.2, 240), 0, 1) for n in ("wide", "jaw", "brow", "tail")}
    frame = pd.DataFrame({"frame": range(240), **values})
    frame.to_csv(tmp_path / "t" / "a.csv", index=False)
    soundfile.write(tmp_path / "t" / "a.wav", bursts(8), 16000)
    rig = read_controls(str(tmp_path / "rig.yaml"))
    out = tmp_path / "data"
    result = import_captures([tmp_path / "t"], out, rig=rig, fps=30, **ANNA)
    notes = " ".join(result.takes[0].notes)
    assert "lacks 1 controls, not known: 'hat'" in notes and "left out: 'tail'" in notes
    (clip, *_) = read_clips(out)
    curves = read_curves(clip.curves, controls=rig)
    assert curves.names == ("jaw", "wide", "hat", "brow")
    start = round((clip.span[0] + clip.offset_seconds) * 30)
    np.testing.assert_allclose(curves["jaw"], values["jaw"][start:][: len(curves)], atol=1e-6)
    assert list(read_known(clip.known, rig)) == [True, True, False, True]
    checked = CliRunner().invoke(app, ["check", str(out), "--rig", str(tmp_path / "rig.yaml")])
    errors = [row for row in checked.stdout.splitlines() if row.startswith("error")]
    assert not errors
    assert checked.exit_code == 0 and "warning  jittering" in checked.stdout


def test_takes_of_one_name_are_told_apart_and_a_copy_is_left_out(tmp_path):
    first = write_live_link(tmp_path / "t" / "a" / "x.csv", 6)
    write_live_link(tmp_path / "t" / "b" / "x.csv", 7)
    write_live_link(tmp_path / "t" / "c" / "x-2.csv", 8)
    for suffix in (".csv", ".wav"):
        copy = tmp_path / "t" / "d" / f"copy{suffix}"
        copy.parent.mkdir(exist_ok=True)
        copy.write_bytes(first.with_suffix(suffix).read_bytes())
    result = import_captures([tmp_path / "t"], tmp_path / "data", **ANNA)
    assert [take.take for take in result.takes] == ["x", "x-2", "x-2-2", "copy"]
    assert "a copy of x, left out" in result.takes[-1].notes
    assert {clip.take for clip in read_clips(tmp_path / "data")} == {"x", "x-2", "x-2-2"}


def test_time_without_a_frame_is_in_no_clip(tmp_path):
    path = write_live_link(tmp_path / "t" / "a.csv", 20)
    whole = read_take(path)
    kept = np.r_[:240, 360:600]  # nothing from 8 to 12 s
    write_take(path, replace(whole, ticks=whole.ticks[kept], values=whole.values[kept]))
    result = import_captures([path], tmp_path / "data", **ANNA)
    assert "4.0 s without a frame, left out" in result.takes[0].notes
    spans = [clip.span for clip in read_clips(tmp_path / "data")]
    assert all(stop <= 8.1 or start >= 11.9 for start, stop in spans)
    assert any(stop > 7 for _, stop in spans) and any(start >= 11.9 for start, _ in spans)


def test_speech_beyond_the_curves_does_not_count(tmp_path):
    path = write_live_link(tmp_path / "t" / "a.csv", 20)
    whole = read_take(path)
    write_take(path, replace(whole, ticks=whole.ticks[:180], values=whole.values[:180]))
    (take,) = import_captures([path], tmp_path / "data", **ANNA).takes
    assert 0 < take.speech_seconds <= 6


def test_actors_of_whom_nothing_is_learnt_are_told(tmp_path):
    for seconds, actor in ((12, "anna"), (11, "ben"), (10, "carl")):
        write_live_link(tmp_path / "t" / f"{actor}_happy.csv", seconds)
    result = imported.import_captures(
        [tmp_path / "t"], tmp_path / "data", pattern="(?P<actor>[a-z]+)_", split_by="actor"
    )
    assert any(line.startswith("ben, carl only validate and test") for line in result.warnings)
