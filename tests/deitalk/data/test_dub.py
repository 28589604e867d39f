"""`deitalk dub`: the face of a performance, the mouth of another recording."""

import json
from pathlib import Path

import numpy as np
import pytest
import soundfile
import soxr

from deitalk import Acting, animate
from deitalk.audio.load import load_audio
from deitalk.config.rules import KeepContacts
from deitalk.data.captures.columns import read_mapping
from deitalk.data.captures.take import read_capture
from deitalk.data.dub import CORNERS, STRETCH, dub, paired_phrases, phrases
from deitalk.errors import DataError
from deitalk.postprocess.control_groups import ControlGroups
from rig import default_controls, read_curves, write_curves
from rig.curves.layers import Edit, Layer
from rig.validation.files import validate
from tests.command import ran, refused
from tests.errors import one_line
from tests.takes import write_live_link

SAMPLES = Path(__file__).parents[3] / "docs" / "samples"
PROMISE = SAMPLES / "promise.flac"
BOARD = default_controls()
GROUPS = ControlGroups(BOARD)
LIPS = [
    k for k in BOARD.subset("lip") if not any(part in BOARD.names[k] for part in CORNERS)
]  # fmt: skip
FACEGOOD = {
    "CTRL_L_brow_down.ty": "brow_lower_l", "CTRL_R_brow_down.ty": "brow_lower_r",
    "CTRL_L_brow_raiseOut.ty": "brow_raise_l", "CTRL_R_brow_raiseOut.ty": "brow_raise_r",
    "CTRL_L_eye_blink.ty": "eye_blink2_l", "CTRL_R_eye_blink.ty": "eye_blink2_r",
    "CTRL_L_eye_cheekRaise.ty": "cheek_raise_l", "CTRL_R_eye_cheekRaise.ty": "cheek_raise_r",
    "CTRL_L_nose.ty": "nose_wrinkle_l", "CTRL_R_nose.ty": "nose_wrinkle_r",
    "CTRL_C_jaw.ty": "mouth_stretch_c", "CTRL_L_mouth_cornerPull.ty": "mouth_lipCornerPull_l",
    "CTRL_R_mouth_cornerPull.ty": "mouth_lipCornerPull_r",
}  # fmt: skip


@pytest.fixture(scope="module")
def take(tmp_path_factory):
    folder = tmp_path_factory.mktemp("dub") / "take"
    return animate(PROMISE, "surprised", seed=2).save(folder)


@pytest.fixture(scope="module")
def alone():
    """What `animate` gives of the sample alone."""
    return animate(PROMISE).curves


def sample():
    return load_audio(PROMISE).waveform


def retake():
    """The sample with a pause in its middle and a second half that is 9 % quicker."""
    sound, half = sample(), 4 * 16_000 + 3_200
    second = soxr.resample(sound[half:], 16_000, 16_000 / 1.09).astype(np.float32)
    return np.concatenate((sound[:half], np.zeros(9_600, np.float32), second))


def check(found, face, alone, limit=STRETCH):
    """What must hold of every dub."""
    values, places = found.performance.curves.values, BOARD.indices(found.kept)
    rows = {row.tobytes() for row in face.values[:, places]}
    assert all(row.tobytes() in rows for row in values[found.exact][:, places])
    assert np.corrcoef(values[:, LIPS].ravel(), alone[:, LIPS].ravel())[0, 1] >= 0.95
    closures = GROUPS.closures(KeepContacts())
    closed, still = (closures.closed(v) > 0.999 for v in (alone, values))
    assert not (closed & ~still).any()
    parting = np.array(GROUPS.lively)
    assert (values[closed][:, parting] <= alone[closed][:, parting] + 2e-3).all()
    assert (values >= BOARD.minimum - 1e-6).all() and (values <= BOARD.maximum + 1e-6).all()
    assert all(1 / limit - 1e-6 <= piece.rate <= limit + 1e-6 for piece in found.pieces)
    starts = [piece.start for piece in found.pieces]
    assert starts == sorted(starts) and starts[0] == 0
    assert found.pieces[-1].end == pytest.approx(len(values) / 30)


def test_the_same_recording_leaves_the_face_as_it_is(take, alone):
    found, face = dub(take, PROMISE), read_curves(take / "curves.json")
    check(found, face, alone.values)
    assert found.exact.all() and "8.7 of 8.7 s of the face are unchanged" in found.line
    places = BOARD.indices(found.kept)
    np.testing.assert_array_equal(
        found.performance.curves.values[:, places], face.values[:, places]
    )
    np.testing.assert_array_equal(found.performance.curves.head, face.head)
    assert {"CTRL_L_brow_raiseIn.ty", "CTRL_L_eye_blink.ty", "CTRL_C_eye.tx"} <= set(found.kept)


def test_a_retake_is_followed_phrase_by_phrase(take):
    found, face = dub(take, retake(), sample_rate=16_000), read_curves(take / "curves.json")
    check(found, face, animate(retake(), sample_rate=16_000).curves.values)
    assert 0 < found.exact.sum() < len(found.exact) or any(p.rate != 1 for p in found.pieces)
    steps = np.abs(np.diff(found.performance.curves["CTRL_L_brow_raiseIn.ty"])).max()
    assert steps <= 1.5 * STRETCH * np.abs(np.diff(face["CTRL_L_brow_raiseIn.ty"])).max()


def test_corners_keep_the_emotion_and_the_mouth_its_amplitude(take, alone, tmp_path):
    found = dub(take, PROMISE)
    smile = "CTRL_L_mouth_cornerPull.ty"
    mean = read_curves(take / "curves.json")[smile].mean()
    assert found.performance.curves[smile].mean() == pytest.approx(mean, abs=0.03)
    loud = animate(PROMISE, gain="jaw=1.5,mouth=1.5").curves
    write_curves(tmp_path / "a.csv", loud)
    opened = dub(tmp_path / "a.csv", PROMISE, sound=PROMISE).amplitude
    wanted = np.quantile(loud["CTRL_C_jaw.ty"], 0.95) / np.quantile(alone["CTRL_C_jaw.ty"], 0.95)
    assert opened == pytest.approx(wanted, abs=0.1)


@pytest.fixture(scope="module")
def synthetic(tmp_path_factory):
    """A German sentence by a synthetic voice, and what `animate` gives of it alone."""
    from deitalk.research.corpus.engines import espeak

    if espeak.missing():
        pytest.skip("needs espeak-ng")
    text = "Guten Morgen! Heute bauen wir eine Brücke, und abends feiern wir im Park mit Musik."
    spoken = espeak.synthesise(text, voice="de", language="de")
    path = tmp_path_factory.mktemp("spoken") / "german.wav"
    soundfile.write(path, spoken.waveform, 16_000)
    return path, animate(path).curves.values


CAPTURES = (
    "livelink/alex_rom_3", "livelink/alexdjulin_S07-001", "livelink/alexdjulin_S88-001",
    "livelink/alexdjulin_apfel", "livelink/alexdjulin_facial", "livelink/alexdjulin_rom_4",
    "livelink/jmtech_MySlate_3", "metahuman/arkittest_mha",
)  # fmt: skip


@pytest.mark.parametrize("name", CAPTURES)
def test_captures_without_a_sound_speak_a_synthetic_voice(shared, synthetic, name):
    """Takes of Live Link and MetaHuman Animator, ranges of motion with a wide open jaw too."""
    sound, alone = synthetic
    path = shared / "data/curves" / f"{name}.csv"
    check(dub(path, sound), read_capture(path).curves.resample(30), alone)


@pytest.mark.parametrize(
    ("performance", "speech"),
    [("2_01", "2_02"), ("2_03", "promise"), ("2_02", "promise"), ("2_04", "promise"),
     ("2_05", "promise")],
)  # fmt: skip
def test_captured_takes_with_sound_speak_another_recording(
    shared, alone, tmp_path, performance, speech
):
    folder = shared / "data/curves/facegood"
    rows = "".join(f"{target},{source}\n" for target, source in FACEGOOD.items())
    (tmp_path / "map.csv").write_text("target,source\n" + rows)
    mapping = read_mapping(tmp_path / "map.csv")
    sound = PROMISE if speech == "promise" else folder / f"{speech}.opus"
    found = dub(folder / f"{performance}.csv", sound, mapping=mapping, fps=30)
    face = read_capture(folder / f"{performance}.csv", mapping=mapping, fps=30).curves
    spoken = alone if sound == PROMISE else animate(sound).curves
    check(found, face, spoken.values)
    assert found.exact.mean() > 0.4


def test_a_live_link_take_without_a_sound_has_the_phrases_of_its_mouth(alone, tmp_path):
    path = write_live_link(tmp_path / "a_take.csv", 9.0)
    path.with_suffix(".wav").unlink()
    found = dub(path, PROMISE)
    check(found, read_capture(path).curves, alone.values)
    assert any("by its mouth: it has no sound" in note for note in found.notes)
    assert any("controls of the face are not in the performance" in note for note in found.notes)


def test_the_command_writes_a_take_with_a_report(take, tmp_path):
    ran("dub", take, SAMPLES / "amiable.flac", "-o", tmp_path / "out", "--stretch", 1.2)
    report = json.loads((tmp_path / "out/dub.json").read_text())
    assert report["schema"] == "deitalk.dub/1" and report["stretch_limit"] == 1.2
    assert {
        "start",
        "end",
        "source_start",
        "source_end",
        "rate",
        "joined",
        "turned",
        "kind",
    } == set(report["pieces"][0])
    about = json.loads((tmp_path / "out/take.json").read_text())
    assert "dub.json" in about["files"]
    assert validate(tmp_path / "out").ok
    assert "exists" in refused("dub", take, SAMPLES / "amiable.flac", "-o", tmp_path / "out")


def test_edits_come_after_the_dub(take):
    edit = Edit("CTRL_L_brow_raiseIn.ty", ((0.0, 0.8, 0, 0),), "own", (1.0, 2.0))
    found = dub(take, PROMISE)
    edited = dub(take, PROMISE, acting=Acting.of(edit=Layer((edit,))))
    change = edited.performance.curves.values - found.performance.curves.values
    column = BOARD.index(edit.target)
    assert edited.performance.curves.values[45, column] == pytest.approx(0.8)
    assert not np.delete(change, column, axis=1).any()
    assert len(edited.performance.acting.edit) == 1


@pytest.mark.parametrize(
    ("old", "new", "wanted"),
    [
        ([(0, 30), (60, 90)], [(0, 33), (70, 95)], [(0, 0), (1, 1)]),
        ([(0, 30), (40, 70)], [(0, 68)], "all"),
        ([(0, 70)], [(0, 30), (40, 72)], "all"),
        ([], [(0, 10)], []),
        ([(0, 10)], [], []),
    ],
)
def test_phrases_are_paired_in_their_order(old, new, wanted):
    found = paired_phrases(old, new)
    if wanted == "all":
        assert found == [((old[0][0], old[-1][1]), (new[0][0], new[-1][1]))]
    else:
        assert found == [(old[i], new[j]) for i, j in wanted]


def test_of_a_much_longer_performance_its_beginning_is_shown():
    old = [(40 * k, 40 * k + 25) for k in range(60)]
    assert paired_phrases(old, [(5, 225)]) == [((0, 220), (5, 225))]
    pairs = paired_phrases(old, [(40 * k, 40 * k + 25) for k in range(9)])
    assert [first for first, _ in pairs] == old[:9]


def test_short_pauses_are_of_one_phrase():
    speaking = np.zeros(100, bool)
    speaking[10:30] = speaking[35:50] = speaking[70:80] = True
    assert phrases(speaking, 75) == [(10, 50), (70, 75)]


def test_what_cannot_be_dubbed_is_refused_in_one_line(take, tmp_path):
    (tmp_path / "a.csv").write_text("time,x\n0,1\n0.04,2\n")
    soundfile.write(tmp_path / "a.wav", np.zeros(10), 8000)
    with one_line(DataError, "stretch 5 must be 1 to 3"):
        dub(take, PROMISE, stretch=5)
    with one_line(DataError, "has no curves.json"):
        dub(tmp_path, PROMISE)
    with one_line(DataError, "no controls"):
        dub(tmp_path / "a.csv", PROMISE)
