"""What a linear readout of speech features knows of the lips: a baseline of their scores.

A ridge regression of features within three frames of a frame, standardised and limited, on the
contacts of the training recordings of a dataset folder or on measured lips of other speakers.
Curves that score less than it lose what the features hold. The features are the model's own, and
those of layers of a published encoder where its folder is given.

Letters: T frames at 30 per second, D features, K features in context, M targets.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from deitalk.audio.frames import FRAME_RATE
from deitalk.audio.load import Recording, load_audio
from deitalk.audio.voice_activity import normalise_level
from deitalk.config.frontends import WhisperShape
from deitalk.data.clips import Clip, read_clips, read_phones, spread_clips
from deitalk.errors import DataError
from deitalk.evaluation.validation import closure_scores, summarise_closures
from deitalk.frontends.strided import LARGEST
from deitalk.frontends.whisper import WhisperFrontend
from deitalk.models.curve_model import DEITalk
from deitalk.postprocess.phones import BILABIALS, Phones
from rig.arrays import Float32, Float64

REACH = 3
"""Frames before and after a frame whose features are read."""
PENALTY = 3000.0
"""On squared weights."""
LAYERS = (2, 3, 4)
"""Layers of a published encoder."""
TEACHERS = 240
"""Most recordings that teach contacts."""
WORSE = 0.01
"""Amount by which a score of curves may lie below that of the ridge."""

Rows = tuple[Float32, Float32]
"""Features [shape=(T, D)] and targets [shape=(T, M)]; frames with NaN teach nothing."""


@dataclass(frozen=True)
class Readout:
    """A ridge regression.

    Attributes
    ----------
    mean, scale : array [shape=(D,)]
        Of the features.
    weights : array [shape=(K, M)]
    constant : array [shape=(M,)]
    """

    mean: Float64
    scale: Float64
    weights: Float64
    constant: Float64

    @classmethod
    def fit(
        cls,
        recordings: Sequence[Rows],
        shares: Sequence[float] | None = None,
        penalty: float = PENALTY,
    ) -> "Readout":
        """Fit to recordings, each counted by its share (1 by default).

        Raises
        ------
        DataError
            If no frame has targets.
        """
        shares = [1.0] * len(recordings) if shares is None else shares
        if not any(np.isfinite(targets).all(axis=1).any() for _, targets in recordings):
            raise DataError("no frame teaches the ridge regression; give recordings with phones")
        every = np.concatenate([features for features, _ in recordings])
        mean, spread = every.mean(axis=0, dtype=np.float64), every.std(axis=0, dtype=np.float64)
        scale = np.asarray(spread + 1e-3, np.float64)
        m = (2 * REACH + 1) * every.shape[1]
        size = m + 1 + recordings[0][1].shape[1]
        gram = np.zeros((size, size), np.float32)
        for (features, targets), share in zip(recordings, shares, strict=True):
            known = np.isfinite(targets).all(axis=1)
            x = in_context(_limited(features, mean, scale))[known]
            rows = np.concatenate((x, np.ones((len(x), 1)), targets[known]), axis=1)
            rows = rows.astype(np.float32) * np.float32(share**0.5)
            gram += rows.T @ rows
        left = gram[: m + 1, : m + 1].astype(np.float64)
        left[np.arange(m), np.arange(m)] += penalty
        right = gram[: m + 1, m + 1 :].astype(np.float64)
        solved = np.asarray(np.linalg.solve(left, right), np.float64)
        return cls(mean, scale, solved[:m], solved[m])

    def __call__(self, features: Float32) -> Float32:
        """Targets (T, M) of features (T, D)."""
        x = in_context(_limited(features, self.mean, self.scale))
        return np.asarray(x @ self.weights + self.constant, np.float32)


def _limited(features: Float32, mean: Float64, scale: Float64) -> Float32:
    return np.clip((features - mean) / scale, -LARGEST, LARGEST).astype(np.float32)


def in_context(features: Float32) -> Float32:
    """Features of the frames around every frame [shape=(T, K)]; held beyond the ends."""
    places, last = np.arange(len(features)), len(features) - 1
    rows = [features[np.clip(places + k, 0, last)] for k in range(-REACH, REACH + 1)]
    return np.concatenate(rows, axis=1)


Listener = Callable[[Recording], Float32]
"""Features [shape=(T, D)] of a recording."""


class EncoderLayers(WhisperFrontend):
    """States of layers of a published encoder, side by side."""

    def __init__(self, config: WhisperShape) -> None:
        super().__init__(config)
        self.output_size = config.width * len(config.layers)

    def _features(self, mel: Tensor, mask: Tensor | None = None) -> Tensor:
        states = self.encoder(mel, mask)
        return torch.cat([states[layer] for layer in self.layers], dim=-1)


def listen(
    model: DEITalk, encoder: Path | None = None
) -> Callable[[Recording], dict[str, Float32]]:
    """Function from a recording to features by name: ``own``, and ``layer N`` of an encoder.

    Raises
    ------
    CheckpointError
        If `encoder` is no folder with the weights of a Whisper encoder.
    """
    layers = None
    if encoder is not None:
        shape = WhisperShape(checkpoint=str(encoder), rate=50, layers=LAYERS)
        layers = EncoderLayers.build(shape).eval()

    @torch.no_grad()
    def heard(recording: Recording) -> dict[str, Float32]:
        sound = torch.from_numpy(normalise_level(recording.waveform))
        n_frames = recording.n_frames
        found = {"own": model.frontend.encode(sound, n_frames).float().numpy()}
        if layers is not None:
            states = layers.encode(sound, n_frames).numpy()
            parts = np.split(states, len(LAYERS), axis=1)
            found |= {f"layer {k}": part for k, part in zip(LAYERS, parts, strict=True)}
        return found

    return heard


def contact_targets(phones: Phones, n_frames: int) -> Float32:
    """1 in frames within p, b and m, else 0 [shape=(T, 1)]."""
    times = np.arange(n_frames) / FRAME_RATE
    closed = np.zeros((n_frames, 1), np.float32)
    for start, end, name in phones:
        if name in BILABIALS:
            closed[(times >= start) & (times < end)] = 1
    return closed


class ContactRidge:
    """Readouts of lip contacts, by the name of their features.

    Parameters
    ----------
    model : DEITalk
        Whose features are read.
    clips : sequence of Clip
        Recordings that teach; those with phones, `TEACHERS` at most, evenly spread.
    encoder : Path or None
        Folder of a published Whisper encoder.
    progress : callable
        Called with the share done, 0 to 1.
    """

    def __init__(
        self,
        model: DEITalk,
        clips: Sequence[Clip],
        encoder: Path | None = None,
        progress: Callable[[float], None] = lambda share: None,
    ) -> None:
        self.listen = listen(model, encoder)
        rows: dict[str, list[Rows]] = {}
        for i, clip in enumerate(clips):
            assert clip.phones is not None
            recording = load_audio(clip.audio)
            targets = contact_targets(read_phones(clip.phones), recording.n_frames)
            for name, features in self.listen(recording).items():
                rows.setdefault(name, []).append((features, targets))
            progress((i + 1) / len(clips))
        self.readouts = {name: Readout.fit(taught) for name, taught in rows.items()}

    def __call__(self, recording: Recording) -> dict[str, Float32]:
        """How closed the lips are by every readout [each shape=(T,)]."""
        heard = self.listen(recording)
        return {name: read(heard[name])[:, 0] for name, read in self.readouts.items()}


def teachers(data: Path) -> list[Clip]:
    """Training recordings of a dataset folder that teach contacts, each once."""
    found = {
        clip.audio: clip
        for clip in read_clips(data, "train")
        if clip.phones is not None and clip.source == "recording"
    }
    return spread_clips(list(found.values()), TEACHERS)


class Judged(NamedTuple):
    """A recording and what its phones are."""

    audio: Path
    phones: Phones


def score_contacts(
    ridge: ContactRidge, groups: Mapping[str, Sequence[Judged]]
) -> dict[str, dict[str, dict[str, float]]]:
    """Contact scores of every readout, by its name and group."""
    report: dict[str, dict[str, dict[str, float]]] = {name: {} for name in ridge.readouts}
    for group, clips in groups.items():
        scores: dict[str, list[Any]] = {name: [] for name in ridge.readouts}
        for clip in clips:
            for name, lips in ridge(load_audio(clip.audio)).items():
                scores[name].append(closure_scores(lips, clip.phones))
        for name, values in scores.items():
            found = summarise_closures(values)
            report[name][group] = {
                "bilabial_hits_at_5_percent": found.hit_rate,
                "bilabial_window_auc": found.window_auc,
                "bilabial_frame_auc": found.frame_auc,
            }
    return report


def losses(curves: Mapping[str, Mapping[str, Any]], own: Mapping[str, Mapping[str, Any]]) -> str:
    """Lines on the scores in which curves lie more than `WORSE` below the ridge on own features.

    Parameters
    ----------
    curves, own : mapping of mapping
        Scores by group and name; greater is better.
    """
    lines = [
        f"- {group}, {name}: {curves[group][name]:.3f}, the ridge {value:.3f}"
        for group, scores in own.items()
        for name, value in scores.items()
        if isinstance(curves[group].get(name), float) and curves[group][name] < value - WORSE
    ]
    found = "Curves that are worse than the ridge on the model's own features by more than .01"
    return "\n".join([f"{found}:", "", *lines]) if lines else f"{found}: none."
