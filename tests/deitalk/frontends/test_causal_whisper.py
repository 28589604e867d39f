"""The encoder on a voice that has not ended: any pieces, the masked whole, and its look-ahead."""

import copy
import math

import numpy as np
import pytest
import torch

from deitalk.audio.log_mel import SILENCE
from deitalk.audio.running_level import levelled
from deitalk.config.frontends import CausalWhisperConfig
from deitalk.frontends.causal_whisper import (
    LOOKAHEAD_FRAMES,
    PAST_FRAMES,
    PEAK,
    PERIOD,
    CausalState,
    CausalWhisperFrontend,
)
from deitalk.frontends.whisper import scaled

RATE = 16_000
TINY = {"checkpoint": None, "n_mels": 16, "width": 32, "heads": 4, "intermediate": 48}


@pytest.fixture(scope="module")
def frontend() -> CausalWhisperFrontend:
    torch.manual_seed(1)
    config = CausalWhisperConfig(**TINY, layers=(2, 3))
    made = CausalWhisperFrontend.build(config, pretrained=False).eval()
    for weight in made.encoder.parameters():
        torch.nn.init.normal_(weight, std=0.2)
    made.measure([voice(4.0, seed=9)])
    return made


def voice(seconds: float, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    t = np.arange(round(seconds * RATE)) / RATE
    loud = 0.5 + 0.5 * np.sin(2 * np.pi * 3 * t + seed)
    return (0.1 * loud * rng.standard_normal(len(t))).astype(np.float32)


def windows_of(frontend, sound, n_frames):
    sound = torch.from_numpy(sound)[None]
    return frontend.mel.windows(sound, n_frames * frontend.spectra)


@torch.no_grad()
@pytest.mark.parametrize("pieces", [(1,) * 120, (3, 1, 230, 6), (99, 23, 1)])
def test_any_pieces_give_the_features_of_one(frontend, pieces):
    windows = windows_of(frontend, voice(sum(pieces) / 30), sum(pieces))
    whole, last = frontend.advance(windows, frontend.first_state(1))
    state, parts, done = frontend.first_state(1), [], 0
    for size in pieces:
        piece = windows[:, 3 * done : 3 * (done + size)]
        features, state = frontend.advance(piece, state)
        parts.append(features)
        done += size
    torch.testing.assert_close(torch.cat(parts, dim=1), whole, atol=1e-5, rtol=1e-5)
    for found, expected in zip(state.tensors(), last.tensors(), strict=True):
        torch.testing.assert_close(found, expected, atol=1e-5, rtol=1e-5)


@torch.no_grad()
@pytest.mark.parametrize("n_frames", [50, PERIOD + 150])
def test_equals_the_whole_encoder_under_a_mask(frontend, n_frames):
    """A frame of silence goes before the clip, attended to by nothing but itself."""
    windows = windows_of(frontend, voice(n_frames / 30, seed=3), n_frames)
    state = frontend.first_state(1)
    given, _ = levelled(windows, frontend.spectra, state.level)
    past = state.mel.transpose(1, 2)
    given = torch.cat((past, scaled(frontend.mel.decades(given), PEAK)), dim=2)
    silence = scaled(torch.full((1, 1, 16), math.log10(SILENCE)), PEAK)
    count = torch.arange(n_frames + 1)
    after = count - count[:, None]
    mask = (after <= LOOKAHEAD_FRAMES) & (after >= -PAST_FRAMES)
    mask[1:, 0], mask[0, 1:] = False, False
    places = ((count - 1) % PERIOD)[None]
    states = frontend.encoder(torch.cat((silence, given), dim=2), mask, places)
    expected = frontend.mixed([state[0, 1:] for state in states])[: -frontend.delay]
    found, _ = frontend.advance(windows, frontend.first_state(1))
    torch.testing.assert_close(found[0, frontend.delay :], expected, atol=2e-4, rtol=1e-4)


def test_features_depend_on_135_ms_after_a_frame(frontend):
    frontend = copy.deepcopy(frontend).double()
    sound, frame = voice(3.0).astype(np.float64), 45
    end = frame * RATE / 30 + (3 + 2 / 3) * RATE / 30 + 200
    assert end / RATE - frame / 30 == pytest.approx(0.1347, abs=1e-4)
    before = frontend.encode(torch.from_numpy(sound), 90)[frame]
    for first, is_heard in ((math.ceil(end) + 1, False), (math.ceil(end) - 400, True)):
        changed = sound.copy()
        changed[first:] = voice(3.0, seed=5)[first:]
        after = frontend.encode(torch.from_numpy(changed), 90)[frame]
        assert torch.equal(before, after) is not is_heard


@torch.no_grad()
def test_streams_of_different_age_do_not_change_each_other(frontend):
    old, young = (windows_of(frontend, voice(5.0, seed), 150) for seed in (1, 2))
    _, aged = frontend.advance(old[:, :360], frontend.first_state(1))
    states = aged, frontend.first_state(1)
    pairs = zip(*(state.tensors() for state in states), strict=True)
    both = CausalState.of(tuple(torch.cat(pair) for pair in pairs))
    found, _ = frontend.advance(torch.cat((old[:, 360:], young[:, :90])), both)
    for row, (windows, state) in enumerate(((old[:, 360:], aged), (young[:, :90], states[1]))):
        alone, _ = frontend.advance(windows, state)
        torch.testing.assert_close(found[row], alone[0], atol=1e-5, rtol=1e-5)


def test_level_of_the_recording_is_followed(frontend):
    sound = voice(12.0)
    rows = [frontend.encode(torch.from_numpy(sound * gain), 330)[240:] for gain in (0.1, 1.0, 3.0)]
    spread = rows[1].std()
    for other in (rows[0], rows[2]):
        assert (other - rows[1]).abs().mean() < 0.03 * spread


@pytest.mark.parametrize("changes", [{"rate": 50}, {"layers": (1, 3)}, {"layers": (0,)}])
def test_what_a_stream_cannot_have_is_refused(changes):
    with pytest.raises(ValueError, match=r"rig frame|one layer"):
        CausalWhisperConfig(**TINY | changes)
