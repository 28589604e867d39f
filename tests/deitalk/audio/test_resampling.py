"""Samples of any rate to 16 kHz as they come."""

import numpy as np
import pytest

from deitalk.audio.resampling import RunningResampler

RATES = (8_000, 22_050, 44_100, 48_000, 44_101)


def tone(hertz, rate, seconds=0.5):
    return np.sin(2 * np.pi * hertz * np.arange(round(rate * seconds)) / rate).astype(np.float32)


def whole(sound, rate):
    return RunningResampler(rate).feed(sound, last=True)


@pytest.mark.parametrize("rate", RATES)
def test_tone_keeps_height_and_place(rate):
    resampled = whole(tone(1000, rate), rate)
    assert len(resampled) == 8000
    error = resampled - tone(1000, 16_000)
    assert np.abs(error[200:-200]).max() < 2e-4


def test_what_16_khz_cannot_hold_is_left_out():
    assert np.abs(whole(tone(9000, 48_000), 48_000)[200:-200]).max() < 3e-4
    kept = whole(tone(7200, 48_000), 48_000)[200:-200]
    assert np.abs(kept).max() == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize("rate", RATES)
def test_pieces_give_what_the_whole_gives_4_ms_later(rate, rng):
    sound = rng.standard_normal(rate // 4).astype(np.float32)
    resampler, given, at, lags = RunningResampler(rate), [], 0, []
    while at < len(sound):
        size = int(rng.integers(1, rate // 50))
        given.append(resampler.feed(sound[at : at + size]))
        at = min(at + size, len(sound))
        lags.append(at / rate - sum(map(len, given)) / 16_000)
    given.append(resampler.feed(sound[:0], last=True))
    assert np.array_equal(np.concatenate(given), whole(sound, rate))
    assert max(lags) < (0.0043 if rate >= 16_000 else 0.0086)
    assert len(resampler.samples) <= 2 * resampler.reach + rate // 50
