"""Order of acted strengths in the face."""

import numpy as np
import pytest
import soundfile as sf

from deitalk.errors import DataError
from deitalk.models.checkpoint import require_model
from deitalk.models.curve_model import DEITalk
from deitalk.research.evaluation.acted import PARTS, as_markdown, evaluate
from deitalk.research.evaluation.strength_clips import ACTORS, StrengthClip
from tests.deitalk.audio.test_prosody import voice


@pytest.fixture(scope="module")
def table(tmp_path_factory):
    """One test actor whose strengths are voices of rising pitch and brightness."""
    folder = tmp_path_factory.mktemp("acted")
    names = (str(i) for i in range(99))
    actor = next(n for n in names if StrengthClip(ACTORS, folder, n, n).split == "test")
    rows = ["clip,actor,emotion,level"]
    for number, level in enumerate(("LO", "MD", "HI")):
        for emotion in ("ANG", "HAP"):
            name = f"{emotion}_{level}.wav"
            sound = voice(110 + 60 * number, 1.6 - 0.35 * number, seconds=2)
            sf.write(folder / name, sound / np.abs(sound).max() / 3, 16_000)
            rows.append(f"{name},{actor},{emotion},{level}")
    rows.append(f"ANG_LO.wav,{actor},NEU,XX")
    (folder / "clips.csv").write_text("\n".join(rows) + "\n")
    return folder / "clips.csv"


def test_rising_voices_have_rising_intensity_and_faces(table):
    report = evaluate(require_model("default", DEITalk), table)
    scores = report["anger and joy"]
    assert scores["actors and emotions"] == 2
    for measure in ("intensity", "whole face", *PARTS):
        assert scores[f"{measure}: high above low"] == 1, measure
    assert scores["intensity: rank correlation"] == 1
    for name in ("joined", "joined at one level"):
        assert scores[f"{name}, intensity: high above low"] == 1
        assert scores[f"{name}, intensity: step"] > 0.1
    assert 0.05 < scores["intensity: range inside takes"] < 0.6
    # Of syllables, the louder; the encoder heard no such tones; the model card has that of actors.
    assert scores["intensity: r with level inside takes"] > 0.2
    assert "sadness" not in report, "of which there is none"
    assert scores["opening range: high over neutral, angry"] > 1
    assert "whole face: high above low" in as_markdown(report)


def test_evaluate_acted_rejects_a_split_without_actors(table):
    with pytest.raises(DataError, match="no actor of the train split"):
        evaluate(require_model("default", DEITalk), table, split="train")
