"""Breath through the mouth before phrases."""

import numpy as np
import pytest
import torch

from deitalk import animate
from deitalk.audio.load import load_audio
from deitalk.postprocess.life.breath import HEIGHTS, LEAD, PER_WIDTH, breath_jaw, draw_breaths
from deitalk.postprocess.life.voice import Phrase, Voice
from deitalk.research.lips.head_lips import MEASURES, HeadLips
from rig import default_controls
from rig.face.head import build_head

CONTROLS = default_controls()
JAW = CONTROLS.index("CTRL_C_jaw.ty")
TOGETHER = [k for k, name in enumerate(CONTROLS.names) if "lipsTogether" in name]
START = 60
PEAK = START - round(LEAD * 30)
LOW, HIGH = (PER_WIDTH * height for height in HEIGHTS)


def voice_of(*phrases, n_frames=150):
    made = tuple(Phrase(start, stop, False) for start, stop in phrases)
    return Voice(n_frames, np.zeros(n_frames, np.float32), (), made)


def closed_at(*frames, n_frames=150):
    together = np.zeros(n_frames, np.float32)
    together[list(frames)] = 1
    return together


CASES = {
    "before the first phrase": (voice_of((START, 120)), closed_at(), True),
    "after a pause of half a second": (voice_of((5, 45), (START, 120)), closed_at(), True),
    "not after a shorter one": (voice_of((5, 50), (START, 120)), closed_at(), False),
    "not where it begins with p, b or m": (voice_of((START, 120)), closed_at(START), False),
    "nor where that closes before it is heard": (
        voice_of((START, 90)),
        closed_at(START - 3),
        False,
    ),
    "a later m matters not": (voice_of((START, 120)), closed_at(START + 20), True),
    "not at the end": (voice_of((0, 20), n_frames=START), closed_at(n_frames=START), False),
    "not without speech": (voice_of(), closed_at(), False),
}


@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_the_mouth_opens_before_phrases(case):
    voice, together, opens = case
    for key in (1, 2**63 + 5):
        jaw = breath_jaw(voice, together, key)
        assert bool(jaw.any()) == opens
        if opens:
            assert LOW - 0.01 <= jaw.max() <= HIGH and abs(int(jaw.argmax()) - PEAK) <= 1
            assert jaw[START - 3] < 0.01 and not jaw[START:].any()


def test_breaths_differ_and_a_seed_draws_them_alike():
    voice, together = voice_of((START, 80), (120, 140)), closed_at()
    first, again, other = (breath_jaw(voice, together, key) for key in (7, 7, 8))
    assert np.array_equal(first, again) and not np.array_equal(first, other)
    assert first[:START].max() != pytest.approx(first[START:].max(), rel=1e-3)


def test_lips_part_by_the_share_of_the_mouth_and_the_gain():
    voice, lips = voice_of((START, 120)), HeadLips(build_head())
    found = {}
    for gain in (1.0, 0.5):
        neutral, shown = np.tile(CONTROLS.rest, (2, 150, 1)).astype(np.float32)
        gains = np.full(len(CONTROLS), gain, np.float32)
        draw_breaths(CONTROLS, neutral, shown, voice, 3, gains)
        np.testing.assert_array_equal(neutral, shown)
        assert set(np.flatnonzero((neutral != CONTROLS.rest).any(axis=0))) == {JAW}
        found[gain] = lips.displacements(torch.from_numpy(neutral)).numpy()
    width = lips(lips.rest)[MEASURES.index("width")].item()
    opening = found[1.0][:, MEASURES.index("opening")].max() / width
    assert HEIGHTS[0] - 0.005 <= opening <= HEIGHTS[1] + 0.005
    half = found[0.5][:, MEASURES.index("opening")].max() / width
    assert half == pytest.approx(opening / 2, rel=0.05)


def test_a_take_breathes_where_the_head_moves():
    sound = load_audio("docs/samples/amiable.flac").waveform
    sound = np.concatenate((np.zeros(16_000, np.float32), sound))
    jaws = {
        life: animate(sound, sample_rate=16_000, life=life).curves.values[:26, JAW]
        for life in ("on", "head=0", "off")
    }
    assert jaws["on"].max() > 0.05
    assert jaws["head=0"].max() < 0.01 and jaws["off"].max() < 0.01
