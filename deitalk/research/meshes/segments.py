"""Mesh sequences to batches of adjacent frames, augmented as SDFA §4.3.

Letters: T frames of a segment, C channels and F bins of a spectrum, L spectra, K components,
P speakers. The paper draws pairs: T = 2.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from deitalk.audio.frames import SAMPLE_RATE
from deitalk.audio.mel import derivative
from deitalk.audio.voice_activity import normalise_level
from deitalk.data.seeded_batches import SeededBatches, Share
from deitalk.errors import DataError
from deitalk.frontends.base import Encoder
from deitalk.research.meshes.augmentation import STRETCH, MelWarp, augment_audio, frame_shift
from deitalk.research.meshes.folder import MOTION, MeshClip
from rig.arrays import Float32, Float64

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
