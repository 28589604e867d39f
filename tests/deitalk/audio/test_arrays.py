"""Arrays as recordings: equal to files of the same samples."""

import numpy as np
import pytest
import soundfile
import torch

from deitalk import animate
from deitalk.audio.arrays import recording_from_array, recording_of
from deitalk.audio.load import load_audio
from deitalk.errors import AudioError
from deitalk.research.evaluation.benchmark_curves import speechlike

RATE = 44_100


@pytest.fixture
def stereo():
    """Speech-like sound [shape=(S, 2), 16-bit steps] at 44.1 kHz."""
    sound = np.repeat(speechlike(1.0), 3)[: RATE // 2]
    both = np.stack([0.5 * sound, 0.3 * sound], axis=1)
    return (both * 2**15).round().astype(np.int16)


def test_array_equals_its_file(tmp_path, stereo):
    soundfile.write(tmp_path / "a.wav", stereo, RATE, subtype="PCM_16")
    read, made = load_audio(tmp_path / "a.wav"), recording_from_array(stereo, RATE)
    np.testing.assert_array_equal(made.waveform, read.waveform)
    assert (made.source_rate, made.channels, made.warnings) == (RATE, 2, read.warnings)
    assert made.source == "<array>"


@pytest.mark.parametrize(
    "change",
    [
        lambda x: x / 2.0**15,
        lambda x: (x / 2.0**15).astype(np.float32),
        lambda x: x.astype(np.int32) * 2**16,
        lambda x: torch.from_numpy(x / 2.0**15).float(),
        lambda x: torch.from_numpy(x),
        lambda x: torch.from_numpy(x / 2.0**15).requires_grad_(),
    ],
)
def test_sample_types_give_the_same_waveform(stereo, change):
    expected = recording_from_array(stereo, RATE).waveform
    given = recording_from_array(change(stereo), float(RATE)).waveform
    np.testing.assert_allclose(given, expected, atol=1e-6)


@pytest.mark.parametrize(
    ("samples", "rate", "message"),
    [
        (np.zeros((2, 48_000)), 48_000, r"shape \(2, 48000\).*transpose"),
        (np.zeros((4, 4, 4)), 48_000, "shape"),
        (np.float64(1.0), 48_000, r"shape \(\)"),
        (np.zeros((10, 0)), 48_000, "shape"),
        (np.zeros(0), 48_000, "0 samples"),
        (np.zeros(100, np.int64), 48_000, "int64 have no known full scale"),
        (np.zeros(100, complex), 48_000, "complex128"),
        (np.zeros(100, bool), 48_000, "bool"),
        (np.array(["a"]), 48_000, "no known full scale"),
        (np.full(100, np.nan), 48_000, "finite"),
        (np.full(100, np.inf, np.float32), 48_000, "finite"),
        (np.zeros(100), 100, "100 Hz"),
        (np.zeros(100), 44_100.5, "whole number"),
        (np.zeros(100), float("nan"), "whole number"),
        (np.zeros(100), float("inf"), "whole number"),
        (np.zeros(100), "48000", "whole number"),
        (np.zeros(100), True, "whole number"),
        (np.zeros(100), None, "whole number"),
    ],
)
def test_arrays_reject_other_shapes_types_and_rates(samples, rate, message):
    with pytest.raises(AudioError, match=message):
        recording_from_array(samples, rate)


def test_sample_rate_is_required_for_arrays_and_rejected_for_files(stereo, tmp_path):
    with pytest.raises(AudioError, match="pass sample_rate in Hz with the ndarray"):
        animate(stereo)
    with pytest.raises(AudioError, match="sample_rate=16000 belongs to an array"):
        recording_of(tmp_path / "a.wav", 16_000)
    with pytest.raises(AudioError, match=r"a list .* numpy\.asarray"):
        recording_of([0.0], 16_000)
