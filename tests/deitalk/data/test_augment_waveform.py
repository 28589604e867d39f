"""Augmentation: other voices, rooms and noise at unchanged times."""

from itertools import pairwise

import numpy as np
import pytest
import soundfile

from deitalk.data.augment_waveform import Surroundings, _coloured, _noise, augment, change_speed
from deitalk.errors import DataError
from deitalk.research.training.surroundings import read_surroundings

RATE = 16_000


def burst(seconds: float = 2.0, at: float = 1.0) -> np.ndarray:
    t = np.arange(int(seconds * RATE)) / RATE
    inside = (t >= at) & (t < at + 0.2)
    rng = np.random.default_rng(0)
    return (inside * rng.standard_normal(len(t)) * 0.1).astype(np.float32)


def rooms() -> Surroundings:
    room = np.zeros(4000, np.float32)
    room[700] = 1.0  # the direct sound comes late in the recording
    room[1500] = 0.5
    noise = np.random.default_rng(1).standard_normal(8000).astype(np.float32)
    return Surroundings((noise,), (room,))


@pytest.mark.parametrize("seed", range(25))
def test_augmented_sound_keeps_its_time(seed):
    x = burst()
    y = augment(x, np.random.default_rng(seed), rooms(), [burst(at=0.3)] * 4)
    assert y.shape == x.shape and y.dtype == np.float32 and np.isfinite(y).all()
    lags = np.arange(-480, 481)
    level = np.convolve(np.abs(y), np.ones(160) / 160, "same")
    rise = [level[RATE + lag + 160] - level[RATE + lag - 160] for lag in lags]
    assert abs(lags[int(np.argmax(rise))]) <= 320, "the onset is within 20 ms"
    assert not np.array_equal(y, x)


def test_augmentation_keeps_its_input_and_depends_on_the_generator():
    x = burst()
    before = x.copy()
    first, again, other = (
        augment(x, np.random.default_rng(seed), Surroundings()) for seed in (5, 5, 6)
    )
    np.testing.assert_array_equal(x, before)
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)


@pytest.mark.parametrize("factor", [0.82, 1.0, 1.25])
def test_speed_moves_pitch_and_time_together(factor):
    t = np.arange(RATE) / RATE
    fast = change_speed(np.sin(2 * np.pi * 500 * t).astype(np.float32), factor)
    assert len(fast) == pytest.approx(RATE / factor, abs=2)
    peak = np.abs(np.fft.rfft(fast * np.hanning(len(fast)), 1 << 17)).argmax() * RATE / (1 << 17)
    assert peak == pytest.approx(500 * factor, rel=0.01)


def test_surroundings_are_read_in_fixed_order_and_reject_an_empty_folder(tmp_path):
    for i, name in enumerate(("b.wav", "a.flac", "b.flac")):
        soundfile.write(tmp_path / name, np.full(100 * (i + 1), 0.1, np.float32), RATE)
    (tmp_path / "notes.txt").write_text("no sound")
    read = read_surroundings(str(tmp_path), None)
    assert [len(noise) for noise in read.noises] == [200, 300, 100] and read.rooms == ()
    (empty := tmp_path / "empty").mkdir()
    with pytest.raises(DataError, match=r"empty: holds no \.flac, \.wav, \.ogg"):
        read_surroundings(None, str(empty))


def bands(sound: np.ndarray) -> np.ndarray:
    """Level of eight octaves up to 8 kHz, dB."""
    power = np.abs(np.fft.rfft(sound * np.hanning(len(sound)))) ** 2
    hertz = np.fft.rfftfreq(len(sound), 1 / RATE)
    edges = 8000 / 2.0 ** np.arange(8, -1, -1)
    inside = [(hertz > low) & (hertz <= high) for low, high in pairwise(edges)]
    return 10 * np.log10([power[mask].mean() + 1e-12 for mask in inside])


@pytest.mark.parametrize("seed", range(30))
def test_noise_of_every_kind_has_power_one(seed):
    rng = np.random.default_rng(seed)
    voices = [np.random.default_rng(i).standard_normal(RATE).astype(np.float32) for i in range(4)]
    noise = _noise(RATE + 17, rng, rooms().noises, voices)
    assert noise.shape == (RATE + 17,) and noise.std() == pytest.approx(1, abs=1e-6)


@pytest.mark.parametrize("slope", [-6.0, 0.0, 4.5])
def test_coloured_noise_has_the_given_slope(slope):
    white = np.random.default_rng(1).standard_normal(8 * RATE)
    turned = bands(_coloured(white, slope)) - bands(white)
    # a little more than the slope where octaves are tilted within themselves
    np.testing.assert_allclose(np.diff(turned), slope, atol=0.4)
