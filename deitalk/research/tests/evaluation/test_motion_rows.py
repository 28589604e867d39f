"""How an expression lives in time."""

import json

import numpy as np
import pytest
import soundfile as sf

from deitalk.research.evaluation.motion_rows import (
    CONTROLS,
    SMILE,
    apex_rows,
    expression,
    main,
    padded_speech,
)
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
    assert main([str(table), "--split", "all", "--json", str(out)]) == 0
    assert "frame 0 over apex" in capsys.readouterr().out
    report = json.loads(out.read_text())
    happy, calm = report["happy"], report["neutral"]
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
