"""Training of the strength of a voice on planted laws, and its scores by hand."""

from pathlib import Path

import numpy as np
import pytest

from deitalk.audio.prosody import BANDS
from deitalk.audio.vocal_strength import FEATURES, IS_VOICED, PITCH
from deitalk.errors import DataError
from deitalk.research.evaluation.strength import (
    MeasuredClip,
    acted_order,
    as_markdown,
    score_strength,
)
from deitalk.research.evaluation.strength_clips import (
    ACTORS,
    LEVELS,
    NEUTRAL,
    READERS,
    StrengthClip,
)
from deitalk.research.training.vocal_strength import main, train


def planted(rng, kind, speaker, group, strength, emotion="", level=""):
    """A clip whose pitch and level rise with its strength, by the speaker's own offset."""
    frames = rng.normal(0, 0.1, (90, FEATURES)).astype(np.float32)
    offset = hash_offset(speaker)
    frames[:, :BANDS] += 0.3 * strength + offset  # powers of ten: 3 dB for each unit
    frames[:, PITCH] += 0.3 * strength
    frames[:, IS_VOICED], frames[:, -1] = 1, 1
    clip = StrengthClip(kind, Path("x"), speaker, group, emotion, level)
    return MeasuredClip(clip, frames, 3 * strength + 10 * offset)


def hash_offset(speaker):
    return (int(speaker) * 37 % 11) / 5


@pytest.fixture(scope="module")
def clips():
    rng = np.random.default_rng(0)
    out = []
    for reader in range(8):
        for strength in rng.normal(0, 1, 12):
            out.append(planted(rng, READERS, str(reader), f"{reader}-1", strength))
    for actor in range(8):
        out.append(planted(rng, ACTORS, str(actor), str(actor), 0.0, NEUTRAL, "XX"))
        for emotion in ("ANG", "HAP"):
            for strength, level in enumerate(LEVELS):
                out.append(planted(rng, ACTORS, str(actor), str(actor), strength, emotion, level))
    return out


def test_training_finds_a_planted_law_on_unread_speakers(clips):
    held = [clip for clip in clips if clip.clip.speaker in "67"]
    network = train([clip for clip in clips if clip.clip.speaker not in "67"], steps=40, members=1)
    scores = score_strength(network, held)["strength"]
    assert scores["anger and joy: high above low"] == 1
    assert scores["anger and joy: rank correlation"] > 0.9
    assert scores["level within a chapter, r"] > 0.8
    usual = [network.measure(c.frames) for c in held if c.clip.emotion == NEUTRAL]
    assert np.abs(usual).max() < 2, "neutral takes are near 0 dB"


def test_level_and_pitch_are_scored_beside_the_network(clips):
    network = train(clips, steps=1, members=2)
    scores = score_strength(network, clips)
    assert scores["level at a fixed gain"]["level within a chapter, r"] == pytest.approx(1)
    assert scores["median pitch"]["anger and joy: high above low"] == 1
    table = as_markdown(scores)
    assert table.splitlines()[0] == "| | strength | level at a fixed gain | median pitch |"


def test_acted_order_of_three_actors():
    values = {
        ("a", "ANG", "LO"): 1.0, ("a", "ANG", "MD"): 2.0, ("a", "ANG", "HI"): 3.0,
        ("b", "ANG", "LO"): 3.0, ("b", "ANG", "MD"): 2.0, ("b", "ANG", "HI"): 1.0,
        ("c", "ANG", "LO"): 1.0, ("c", "ANG", "MD"): 0.0, ("c", "ANG", "HI"): 2.0,
        ("d", "ANG", "LO"): 1.0, ("d", "ANG", "HI"): 2.0,  # of two strengths
        ("e", "ANG", "LO"): 1.0, ("e", "ANG", "MD"): 2.0,  # the strongest is missing
    }  # fmt: skip
    order = acted_order(values, ("ANG", "HAP"))
    assert order["high above low"] == pytest.approx(3 / 4)
    assert order["rank correlation"] == pytest.approx((1 - 1 + 0.5 + 1) / 4)
    assert order["actors and emotions"] == 4
    assert np.isnan(acted_order({}, ("ANG",))["high above low"])


def test_train_rejects_too_few_speakers(clips):
    with pytest.raises(DataError, match="at least 4 and 3 are needed"):
        train([clip for clip in clips if clip.clip.speaker in "01"])


def test_command_rejects_a_missing_table_in_one_line(tmp_path, capsys):
    table = str(tmp_path / "none.csv")
    assert main(["--readers", table, "--actors", table]) == 1
    error = capsys.readouterr().err
    assert "none.csv" in error and error.count("\n") == 1
