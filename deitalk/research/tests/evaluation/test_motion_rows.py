"""How an expression lives in time."""

import json

import numpy as np
import pytest
import soundfile as sf

from deitalk.research.evaluation.motion_rows import (
    CONTROLS,
    SMILE,
    WANTED,
    apex_rows,
    expression,
    main,
    padded_speech,
)
from deitalk.research.evaluation.prominence import Syllables, find_syllables
from tests.deitalk.audio.test_prosody import voice


class Take:
    """A smile of .5 on one side and raised brows, above a neutral reading of .1 everywhere."""

    def __init__(self):
        neutral, shown = np.full((2, 3, len(CONTROLS)), 0.1, np.float32)
        shown[:, SMILE[0]] += 0.5
        shown[:, CONTROLS.index("CTRL_L_brow_raiseIn.ty")] += 0.3
        shown[:, CONTROLS.index("CTRL_R_brow_raiseIn.ty")] += 0.4
        self.curves, self.neutral = (
            type("C", (), {"values": shown}),
            type("C", (), {"values": neutral}),
        )


def test_expression_is_the_smile_in_joy_else_the_upper_face():
    assert expression(Take(), "happy") == pytest.approx(np.full(3, 0.25), abs=1e-6)
    assert expression(Take(), "sad") == pytest.approx(np.full(3, 0.5), abs=1e-6)


def test_apex_rows_of_equal_and_opposite_poses():
    pose = np.linspace(-1, 1, len(CONTROLS))
    same, other = apex_rows({"a": pose, "b": 2 * pose}), apex_rows({"a": pose, "b": -pose})
    assert same["apex r, upper face"] == pytest.approx(1)
    assert other["apex r, whole face"] == pytest.approx(-1)


def test_accents_on_the_prominent_syllables_have_a_higher_r_than_on_others():
    """Two of four syllables stand out; an event further than .2 s from any is on none."""
    found = Syllables(np.array([0.5, 1.0, 1.5, 2.0]), np.array([2.0, -2.0, 2.0, -2.0]))
    assert found.r(np.array([0.6, 1.45])) == pytest.approx(1)
    assert found.r(np.array([1.0, 2.1])) == pytest.approx(-1)
    assert found.r(np.array([0.5, 1.5, 2.3])) == pytest.approx(1)
    assert found.r(np.array([0.5])) == pytest.approx(1 / np.sqrt(3))


def test_syllables_that_are_louder_longer_and_higher_stand_out():
    """Three tones with pauses; the second one has more of all three."""
    parts = []
    for hz, size, seconds in ((120, 0.1, 0.15), (180, 0.3, 0.3), (120, 0.1, 0.15)):
        times = np.arange(round(16_000 * seconds)) / 16_000
        tone = sum(np.sin(2 * np.pi * hz * k * times) for k in range(1, 12))
        parts += [np.zeros(3200), size * tone * np.hanning(len(times)) / 6]
    found = find_syllables(np.concatenate([*parts, np.zeros(3200)]).astype(np.float32))
    assert found.times == pytest.approx([0.275, 0.7, 1.125], abs=0.03)
    assert found.prominence.argmax() == 1


@pytest.fixture(scope="module")
def table(tmp_path_factory):
    folder = tmp_path_factory.mktemp("acted")
    rows = ["clip,actor,emotion,level"]
    for number, actor in enumerate("ab"):
        for emotion, level in (("HAP", "HI"), ("NEU", "XX")):
            sound = voice(110 + 40 * number, 1.2, seconds=2)
            sf.write(folder / f"{actor}{emotion}.wav", sound / np.abs(sound).max() / 3, 16_000)
            rows.append(f"{actor}{emotion}.wav,{actor},{emotion},{level}")
    (folder / "clips.csv").write_text("\n".join(rows) + "\n")
    return folder / "clips.csv"


def test_speech_has_a_lead_and_an_end(table):
    sound, _ = sf.read(table.parent / "aHAP.wav", dtype="float32")
    padded = padded_speech(sound)
    assert np.abs(padded[: round(0.39 * 16_000)]).max() < 1e-3
    assert np.abs(padded[-round(0.49 * 16_000) :]).max() < 1e-3


def test_rows_of_two_actors(table, tmp_path, capsys):
    """A smile is held in a pause and at the end, is there before the voice, and eyes move."""
    out = tmp_path / "rows.json"
    readers = table.parent / "readers.csv"
    readers.write_text("path,speaker,chapter\naNEU.wav,a,a\nbNEU.wav,b,b\n")
    given = [str(table), "--split", "all", "--readers", str(readers), "--json", str(out)]
    assert main(given) == 0
    printed = capsys.readouterr().out
    assert "| frame 0 over apex | .3 |" in printed
    assert all(row in printed for row in WANTED if not row.startswith("opening range: high over"))
    report = json.loads(out.read_text())
    happy, calm = report["motion"]["happy"], report["motion"]["neutral"]
    assert 0 <= report["readers"]["readers"]["brow peaks in 10 s"] <= 5
    assert calm["labels named by poses"] > 0.4
    assert happy["in a pause of 2 s over speech"] >= 0.6
    assert happy["in a pause of 2 s over speech, constant curve"] >= 0.95
    assert happy["last frame over mean"] >= 0.5
    assert happy[".1 s before the voice over apex"] >= 0.6  # of a voice of tones
    assert happy["frame 0 over apex"] >= 0.3
    assert calm["frozen frames while listening"] <= 0.05
    assert calm["saccades a minute"] >= 45 and calm["longest aversion, s"] <= 2


def test_a_table_that_is_none_is_refused(tmp_path, capsys):
    assert main([str(tmp_path / "none.csv")]) == 1
    assert "none.csv" in capsys.readouterr().err
