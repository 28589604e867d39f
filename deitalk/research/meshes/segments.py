"""Mesh sequences to batches of adjacent frames, augmented as SDFA §4.3.

Letters: T frames of a segment, C channels and F bins of a spectrum, L spectra, K components,
P speakers. The paper draws pairs: T = 2.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import torch
from scipy import signal
from torch import Tensor
from torch.nn import functional as F

from deitalk.audio.frames import SAMPLE_RATE
from deitalk.audio.mel import FLOOR, derivative
from deitalk.audio.prosody import rms_db
from deitalk.audio.voice_activity import normalise_level
from deitalk.data.seeded_batches import SeededBatches, Share
from deitalk.errors import DataError
from deitalk.frontends.base import Encoder
from deitalk.research.evaluation.noise import mix_at_level, pink_noise
from deitalk.research.meshes.folder import MOTION, MeshClip
from rig.arrays import Float32, Float64

# Augmentations of SDFA §4.3: of the frame's time, of the audio, of the mel spectrogram.
#
# Letters: W spectra of the piece around a window. Mel values are those of
# `deitalk.audio.mel.MelSpectrogram`, the logarithm of power; its derivatives are taken afterwards.
# Every function takes a Generator; none changes its input.
#
# Paper silent: every range and probability below, and whether zeros and the sine curve apply to the
# power or to its logarithm. Here zeros are zeros of the power (silence, `SILENCE` in the
# logarithm), and the curve is a gain in decibels.

LEVEL_SPREAD = 3.5
"""Nepers of power per unit of `MelSpectrogram`'s scale, whose zero is at -6.5."""
SILENCE = (math.log(FLOOR) + 6.5) / LEVEL_SPREAD
"""Mel value of zero power."""
SHIFT_FRAMES = 0.5
"""Largest shift of a frame (§4.3 i)."""
PRE_EMPHASIS = (0.0, 0.95)
"""Range of the coefficient (§4.3 ii)."""
SNR_DB = (5.0, 40.0)
PADDED_SHARE = 0.12
"""Largest share of bins that are padded below or above."""
STRETCH = (0.8, 1.25)
"""Range of the factor of time; below 1 the speech is compressed."""
ZEROED_SHARE = 0.12
"""Largest share of bins set to zero."""
SINE_DB = 6.0
"""Largest amplitude of the gain over the bins."""
SINE_PERIODS = (0.25, 3.0)
PROBABILITY = 0.5
"""Of every augmentation of audio and mel, independently."""


def frame_shift(rng: np.random.Generator) -> float:
    """Shift in frames, within half a frame; one for both frames of a pair (§4.3 i)."""
    return float(rng.uniform(-SHIFT_FRAMES, SHIFT_FRAMES))


def augment_audio(waveform: Float32, rng: np.random.Generator) -> Float32:
    """Noise, then pre-emphasis, each with probability one half (§4.3 ii) [shape=(S,)]."""
    x = waveform
    if rng.random() < PROBABILITY:
        x = add_noise(x, rng.uniform(*SNR_DB), rng, pink=bool(rng.random() < 0.5))
    if rng.random() < PROBABILITY:
        x = pre_emphasise(x, rng.uniform(*PRE_EMPHASIS))
    return x


def add_noise(
    waveform: Float32, snr_db: float, rng: np.random.Generator, *, pink: bool = False
) -> Float32:
    """Add white noise, or pink: its power falls by 3 dB an octave.

    Parameters
    ----------
    waveform : ndarray [shape=(S,)]
        Speech.
    snr_db : float
        Power of the waveform over that of the noise. Silence gets no noise.
    rng : numpy.random.Generator
        Source of the noise.
    pink : bool
        Pink instead of white.
    """
    n = len(waveform)
    noise = pink_noise(n, rng) if pink else rng.standard_normal(n)
    return mix_at_level(waveform, noise, rms_db(waveform) - snr_db)


def pre_emphasise(waveform: Float32, coefficient: float) -> Float32:
    """y_i = x_i - coefficient x_(i-1) [shape=(S,)]; 0 changes nothing."""
    filtered: Float32 = signal.lfilter([1.0, -coefficient], [1.0], waveform).astype(np.float32)
    return filtered


@dataclass(frozen=True)
class MelWarp:
    """Mel augmentations shared by the two frames of a pair (§4.3 iii).

    Parameters
    ----------
    padded : int
        Bins of silence below the lowest (positive) or above the highest (negative).
    stretch : float
        Factor of time; 1.25 takes L / 1.25 spectra to L.
    zeroed : tuple of int
        Bins set to silence.
    sine : (float, float, float)
        Amplitude in decibels, periods over the bins, phase in radians.
    """

    padded: int = 0
    stretch: float = 1.0
    zeroed: tuple[int, ...] = ()
    sine: tuple[float, float, float] = (0.0, 1.0, 0.0)

    @classmethod
    def draw(cls, n_mels: int, rng: np.random.Generator) -> "MelWarp":
        """Choose each of the four with probability one half."""
        chosen = rng.random(4) < PROBABILITY
        most = int(PADDED_SHARE * n_mels)
        padded = int(rng.integers(1, most + 1)) if most else 0
        padded = padded if rng.random() < 0.5 else -padded
        stretch = float(np.exp(rng.uniform(*np.log(STRETCH))))
        zeroed = rng.choice(n_mels, int(rng.integers(1, int(ZEROED_SHARE * n_mels) + 2)), False)
        sine = (
            float(rng.uniform(0, SINE_DB)),
            float(rng.uniform(*SINE_PERIODS)),
            float(rng.uniform(0, 2 * np.pi)),
        )
        nothing = cls()
        return cls(
            padded if chosen[0] else nothing.padded,
            stretch if chosen[1] else nothing.stretch,
            tuple(sorted(int(b) for b in zeroed)) if chosen[2] else nothing.zeroed,
            sine if chosen[3] else nothing.sine,
        )

    def __call__(self, mel: Tensor, n_spectra: int) -> Tensor:
        """Warp a piece of spectrogram and cut the window from its middle.

        Parameters
        ----------
        mel : Tensor [shape=(F, W)]
            W at least `n_spectra`, and 1 / stretch as many where time is compressed; beyond its
            ends the last spectrum holds.
        n_spectra : int
            L. The middle, spectrum W // 2, becomes spectrum L // 2.

        Returns
        -------
        Tensor [shape=(F, L)]
        """
        mel = pad_bins(mel, self.padded)
        mel = stretch_time(mel, self.stretch, n_spectra)
        mel = scale_bins(mel, *self.sine)
        return zero_bins(mel, self.zeroed)


def pad_bins(mel: Tensor, count: int) -> Tensor:
    """Pad silence below the lowest bin (count > 0) or above the highest (< 0), then resize to F.

    Parameters
    ----------
    mel : Tensor [shape=(F, L)]
        Log-power.
    count : int
        Bins before the resizing, which is linear.
    """
    if count == 0:
        return mel
    padded = F.pad(mel, (0, 0, max(count, 0), max(-count, 0)), value=SILENCE)
    resized = F.interpolate(padded.T.unsqueeze(0), size=len(mel), mode="linear", align_corners=True)
    return resized[0].T


def stretch_time(mel: Tensor, factor: float, n_spectra: int) -> Tensor:
    """Play slower (factor > 1) or faster about the middle [shape=(F, W)] -> [shape=(F, L)]."""
    width = mel.shape[1]
    place = width // 2 + (torch.arange(n_spectra) - n_spectra // 2) / factor
    place = place.clamp(0, width - 1)
    below = place.floor().long().clamp(max=max(width - 2, 0))
    above = (below + 1).clamp(max=width - 1)
    return torch.lerp(mel[:, below], mel[:, above], (place - below).to(mel.dtype))


def zero_bins(mel: Tensor, bins: tuple[int, ...]) -> Tensor:
    """Silence some bins [shape=(F, L)]."""
    out = mel.clone()
    out[list(bins)] = SILENCE
    return out


def scale_bins(mel: Tensor, amplitude_db: float, periods: float, phase: float) -> Tensor:
    """Gain of amplitude_db sin(2 pi periods f / F + phase) decibels at bin f [shape=(F, L)]."""
    place = torch.arange(len(mel), dtype=mel.dtype) / len(mel)
    gain_db = amplitude_db * torch.sin(2 * math.pi * periods * place + phase)
    return mel + (gain_db * math.log(10) / 10 / LEVEL_SPREAD).unsqueeze(1)


_EDGE = 2
"""Spectra on either side that two derivatives need."""


class Segment(NamedTuple):
    """Adjacent frames and the speech features around them; a batch has a leading axis B."""

    features: Tensor
    """[shape=(C, F, L)]; frame j is at spectrum `Segments.places` [j]."""
    stretch: Tensor
    """Coefficients [shape=(T, Ks)]."""
    rotation: Tensor
    offsets: Tensor
    lips: Tensor
    """Offsets of the lips' rims [shape=(T, 2 P, 3)], the templates' unit; empty if unknown."""
    speaker: Tensor
    """One-hot [shape=(P,)]."""


class Spectra:
    """Cut pieces of a recording's features about moments.

    Parameters
    ----------
    encoder : Encoder
        Whose features.
    n_spectra : int
        L.
    """

    def __init__(self, encoder: Encoder, n_spectra: int) -> None:
        self.encoder, self.n_spectra = encoder, n_spectra
        self.hop = SAMPLE_RATE / encoder.frame_rate
        self.n_wide = int(np.ceil((n_spectra + 2 * _EDGE) / STRETCH[0])) + 2
        """Spectra that every warp finds what it needs in."""
        self.n_before = int(np.ceil(SAMPLE_RATE * 0.05 / self.hop))
        """Spectra before the first one, so that its own window is inside the piece."""

    def __call__(self, waveform: Float32, time: float, warp: MelWarp) -> Tensor:
        """Features whose spectrum L // 2 is centred at `time`, in seconds [shape=(C, F, L)].

        Where the encoder's features are no mel spectrogram, only the warp's stretch is kept to.
        """
        piece = torch.from_numpy(self._piece(waveform, time)).unsqueeze(0)
        wide = self.encoder.features(piece, self.n_wide, self.n_before)[0]  # (C, F, W)
        if not self.encoder.warps:
            middle = self.n_wide // 2 - self.n_spectra // 2
            return wide[..., middle : middle + self.n_spectra]
        mel = warp(wide[0], self.n_spectra + 2 * _EDGE)
        slope = derivative(mel)
        return torch.stack((mel, slope, derivative(slope)))[..., _EDGE:-_EDGE]

    def _piece(self, waveform: Float32, time: float) -> Float32:
        """Samples for `n_wide` spectra about a time; silence outside the recording."""
        middle = self.n_before + self.n_wide // 2
        start = round(time * SAMPLE_RATE - middle * self.hop)
        length = round((2 * self.n_before + self.n_wide) * self.hop)
        inside = waveform[max(start, 0) : max(start + length, 0)]
        before = min(max(-start, 0), length)
        return np.pad(inside, (before, length - before - len(inside))).astype(np.float32)


class ClipInMemory(NamedTuple):
    """A clip in memory."""

    speech: Float32
    """Waveform (S,), or features (T, D)."""
    motion: dict[str, Float32]
    speaker: int


class SegmentBatches(SeededBatches[Segment]):
    """Endless batches of random segments of adjacent frames, each as likely as another.

    Parameters
    ----------
    clips : sequence of ClipInMemory
        Those of one split.
    n_speakers : int
        P.
    n_frames : int
        Frames T of a segment.
    seed, batch_size, share
        As for `SeededBatches`; an item is a segment.

    Attributes
    ----------
    places : Tensor [shape=(T,)]
        Where in a segment's features each frame is.

    Raises
    ------
    DataError
        If there are no clips.
    """

    places: Tensor

    def __init__(
        self,
        clips: Sequence[ClipInMemory],
        n_speakers: int,
        *,
        n_frames: int,
        seed: int,
        batch_size: int,
        share: Share = Share(),
    ) -> None:
        if not clips:
            raise DataError("no mesh sequences to train on; the data has none in this split")
        super().__init__(seed, batch_size, share)
        self.clips, self.n_speakers, self.n_frames = list(clips), n_speakers, n_frames
        counts = [max(len(c.motion["stretch"]) - n_frames, 0) + 1 for c in self.clips]
        self.starts_before = np.cumsum([0, *counts])

    @property
    def n_frames_total(self) -> int:
        """Frames of all clips: those of an epoch."""
        return sum(len(clip.motion["stretch"]) for clip in self.clips)

    def draw(self, rng: np.random.Generator) -> tuple[ClipInMemory, int]:
        """Draw a clip and the first frame of a segment in it."""
        drawn = int(rng.integers(self.starts_before[-1]))
        which = int(np.searchsorted(self.starts_before, drawn, side="right")) - 1
        return self.clips[which], drawn - int(self.starts_before[which])

    def with_targets(self, features: Tensor, clip: ClipInMemory, frames: Float64) -> Segment:
        """Make the segment of features whose frames are at fractional frame numbers of a clip."""
        empty = np.zeros((len(clip.motion["stretch"]), 0, 3), np.float32)
        targets = {
            name: torch.from_numpy(between_frames(clip.motion.get(name, empty), frames))
            for name in MOTION
        }
        label = torch.zeros(self.n_speakers)
        label[clip.speaker] = 1
        return Segment(features=features, **targets, speaker=label)


class Segments(SegmentBatches):
    """Segments of spectra.

    All frames of a segment get one shift, one choice of noise and pre-emphasis and one warp of the
    spectrogram (§4.3, §4.4).

    Deviation: where time is squeezed or stretched, so is the motion, about the segment's middle;
    the paper keeps the frame and changes the sound about it, which for a pair is nearly the same.

    Parameters
    ----------
    clips : sequence of MeshClip
        Those of one split; all are kept in memory (some 3 MB a minute).
    speakers : tuple of str
        Places of the one-hot label.
    fps : float
        Frames per second.
    encoder : Encoder
        Whose features are cut; its weights are not used.
    augment : bool
        All of §4.3, or nothing.
    **drawing
        As for `SegmentBatches`.
    """

    def __init__(
        self,
        clips: Sequence[MeshClip],
        speakers: tuple[str, ...],
        fps: float,
        encoder: Encoder,
        *,
        augment: bool,
        **drawing: Any,
    ) -> None:
        in_memory = [
            ClipInMemory(normalise_level(c.waveform()), c.motion(), speakers.index(c.speaker))
            for c in clips
        ]
        super().__init__(in_memory, len(speakers), **drawing)
        self.fps, self.augment = fps, augment
        after = torch.arange(self.n_frames, dtype=torch.float64) - (self.n_frames - 1) / 2
        around = torch.round(after / fps * encoder.frame_rate).long()
        reach = encoder.reach + round(encoder.context_seconds / 4 * encoder.frame_rate)
        half = int(around[-1]) + reach + 1
        self.spectra = Spectra(encoder, 2 * half)
        self.places = around + half

    def item(self, number: int) -> Segment:
        """Cut the segment of a number."""
        rng = self.rng(number)
        clip, first = self.draw(rng)
        frames = first + np.arange(self.n_frames, dtype=np.float64)
        waveform, warp, start = clip.speech, MelWarp(), 0.0
        if self.augment:
            frames = frames + frame_shift(rng)
            waveform, start = self._surroundings(waveform, float(frames.mean()) / self.fps)
            waveform = augment_audio(waveform, rng)
            if self.spectra.encoder.warps:
                warp = MelWarp.draw(int(self._bins), rng)
        middle = float(frames.mean())
        features = self.spectra(waveform, middle / self.fps - start, warp)
        return self.with_targets(features, clip, middle + (frames - middle) / warp.stretch)

    @property
    def _bins(self) -> Any:
        return self.spectra.encoder.config.n_mels  # type: ignore[union-attr]

    def _surroundings(self, waveform: Float32, time: float) -> tuple[Float32, float]:
        """Cut the waveform around a time, with the second at which the piece begins."""
        reach = round(self.spectra.n_wide * self.spectra.hop)
        start = max(round(time * SAMPLE_RATE) - reach, 0)
        stop = max(round(time * SAMPLE_RATE) + reach, 1)
        return waveform[start:stop], start / SAMPLE_RATE


def between_frames(rows: Float32, places: Float64) -> Float32:
    """Float32 at fractional places, linear, held beyond the ends.

    Parameters
    ----------
    rows : array [shape=(T, ...)]
        Numbers of every frame.
    places : array [shape=(K,)]
        Frame numbers.

    Returns
    -------
    array [shape=(K, ...)]
    """
    place = np.clip(places, 0, len(rows) - 1)
    below = np.minimum(place.astype(np.int64), len(rows) - 2)
    share = (place - below).astype(np.float32).reshape(-1, *[1] * (rows.ndim - 1))
    out: Float32 = rows[below] * (1 - share) + rows[below + 1] * share
    return out
