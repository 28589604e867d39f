"""Measured lips as a dataset folder: recordings, and curves that repeat the lips on the head."""

import csv
import shutil
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import soundfile
import torch
from torch import Tensor

from deitalk.audio.frames import FRAME_RATE, SAMPLE_RATE
from deitalk.audio.load import load_audio
from deitalk.audio.voice_activity import normalise_level, speech_activity
from deitalk.data.clips import MEASURED, SPLITS, Clip, read_clips
from deitalk.data.waveforms import n_clip_frames
from deitalk.data.windows import cut, load_clip
from deitalk.errors import DataError
from deitalk.models.curve_model import DEITalk
from deitalk.research.lips.fit import fit_curves, neutral_reading
from deitalk.research.lips.head_lips import MEASURES, HeadLips
from deitalk.research.lips.measured import LipClip, read_lips
from rig import ControlSet, RigCurves, write_curves
from rig.arrays import Bool, Float32, Float64
from rig.errors import quoted
from rig.face.head import build_head
from rig.files import output_folder
from rig.files.manifest import is_inside

# Transfer of measured lips to other speech: corrected curves of an acted corpus.
#
# The faces of a corpus follow tables (`deitalk.research.corpus`). Its lips are moved towards the
# prediction of a regression on measured lips (below) for the same speech, and
# towards the amplitude of measured lips; contacts, emotional poses and all that is not lips stay.
#
# Letters: T frames at 30 per second, C controls, D features, M measures.

CONTEXT_FRAMES = (-4, -2, -1, 0, 1, 2, 4)
RIDGE = 10_000.0
"""Penalty on squared weights of standardised features; fewer speakers want more."""
SPEAKER_CLIPS = 40
"""A speaker with more recordings counts as so many."""


@dataclass(frozen=True)
class LipRidge:
    """Standardisation and weights.

    Attributes
    ----------
    mean, scale : ndarray [shape=(K,)]
    weights : ndarray [shape=(K, M)]
    constant : ndarray [shape=(M,)]
    """

    mean: Float64
    scale: Float64
    weights: Float64
    constant: Float64

    @classmethod
    def fit(
        cls, recordings: Sequence[tuple[str, Float32, Float32]], *, ridge: float = RIDGE
    ) -> "LipRidge":
        """Fit to recordings of several speakers, who count alike.

        Parameters
        ----------
        recordings : sequence of (str, ndarray [shape=(T, D)], ndarray [shape=(T, M)])
            Speaker, features and measures; frames whose measures are NaN are left out.
        ridge : float
            Penalty on the squared weights.

        Raises
        ------
        DataError
            If all measures are missing.
        """
        clips: dict[str, int] = {}
        for who, _, _ in recordings:
            clips[who] = clips.get(who, 0) + 1
        rows = [in_context(f)[np.isfinite(m).all(axis=1)] for _, f, m in recordings]
        wanted = [m[np.isfinite(m).all(axis=1)].astype(np.float64) for _, _, m in recordings]
        shares = [min(1.0, SPEAKER_CLIPS / clips[who]) for who, _, _ in recordings]
        n = sum(len(row) for row in rows)
        if not n:
            raise DataError("no frame of the training speakers has all lip measures")
        mean = sum(row.sum(axis=0, dtype=np.float64) for row in rows) / n
        square = sum(((row - mean) ** 2).sum(axis=0) for row in rows)
        scale = np.sqrt(square / n) + 1e-5
        weight = sum(share * len(row) for share, row in zip(shares, rows, strict=True))
        constant = (
            sum(share * y.sum(axis=0) for share, y in zip(shares, wanted, strict=True)) / weight
        )
        # One product of many rows: an update of the matrix for every recording takes ten times as
        # long.
        roots = np.concatenate([np.full(len(r), s**0.5) for s, r in zip(shares, rows, strict=True)])
        every = ((np.concatenate(rows) - mean) / scale * roots[:, None]).astype(np.float32)
        errors = (np.concatenate(wanted) - constant) * roots[:, None]
        gram = (every.T @ every).astype(np.float64) + ridge * np.eye(len(mean))
        cross = every.T.astype(np.float64) @ errors
        weights = np.asarray(np.linalg.solve(gram, cross), np.float64)
        return cls(mean, scale, weights, constant)

    def __call__(self, features: Float32) -> Float32:
        """Measures (T, M) of features (T, D)."""
        z = (in_context(features) - self.mean) / self.scale
        return np.asarray(z @ self.weights + self.constant, np.float32)


def in_context(features: Float32) -> Float32:
    """Features of `CONTEXT_FRAMES` around every frame [shape=(T, K)]; held beyond the ends."""
    places = np.arange(len(features))
    rows = [features[np.clip(places + k, 0, len(features) - 1)] for k in CONTEXT_FRAMES]
    return np.concatenate(rows, axis=1)


MIX = 0.7
"""Share of the regression; the rest is the model's own lips at the measured amplitude."""
LARGEST_GAIN = 2.0
"""Of what a mean of predictions lacks in amplitude."""
CONTACT = "lipsTogether"
"""Controls that close the lips, by a part of their names."""
EDGE_FRAMES = 9
"""The correction fades in and out over so many frames at the edges of speech."""


@dataclass(frozen=True)
class LipTransfer:
    """Correction of lips by what was measured.

    Attributes
    ----------
    ridge : LipRidge
        From features to measures.
    gain, offset : ndarray [shape=(M,)]
        What brings the model's lips to the spread and mean of measured ones.
    spread, mean : ndarray [shape=(M,)]
        What brings the mix of both to the spread of measured lips about their mean.
    """

    ridge: LipRidge
    gain: Float32
    offset: Float32
    spread: Float32
    mean: Float32

    @classmethod
    def fit(cls, recordings: Sequence[tuple[str, Float32, Float32, Float32]]) -> "LipTransfer":
        """Fit to measured recordings.

        Parameters
        ----------
        recordings : sequence of (str, (T, D), (T, M), (T, M))
            Speaker, features, the model's own lips, measured lips (NaN where missing), both
            displacements from rest in cm.
        """
        triples = [(who, f, measured) for who, f, _, measured in recordings]
        ridge = LipRidge.fit(triples)
        known = [np.isfinite(m).all(axis=1) for _, _, _, m in recordings]
        own = np.concatenate([o[k] for (_, _, o, _), k in zip(recordings, known, strict=True)])
        real = np.concatenate([m[k] for (_, _, _, m), k in zip(recordings, known, strict=True)])
        gain = real.std(axis=0) / np.maximum(own.std(axis=0), 1e-6)
        offset = real.mean(axis=0) - gain * own.mean(axis=0)
        # The amplitude of a regression on a speaker that it was not fitted to.
        mixed = []
        for left_out in sorted({who for who, _, _, _ in recordings}):
            others = [row for row in triples if row[0] != left_out] or triples
            without = LipRidge.fit(others)
            for (who, f, o, _), k in zip(recordings, known, strict=True):
                if who == left_out:
                    mixed.append((MIX * without(f) + (1 - MIX) * (gain * o + offset))[k])
        every = np.concatenate(mixed)
        spread = np.clip(real.std(axis=0) / np.maximum(every.std(axis=0), 1e-6), 1, LARGEST_GAIN)
        return cls(ridge, gain, offset, spread, real.mean(axis=0))

    def change(self, features: Float32, own: Float32) -> Float32:
        """What to add to the lips of neutral speech [shape=(T, M)], cm.

        Parameters
        ----------
        features : ndarray [shape=(T, D)]
            Speech features.
        own : ndarray [shape=(T, M)]
            Displacements that the model predicts in the neutral emotion.
        """
        amplified = self.gain * own + self.offset
        mixed = MIX * self.ridge(features) + (1 - MIX) * amplified
        wanted = self.mean + self.spread * (mixed - self.mean)
        return np.asarray(wanted - own, np.float32)

    def correct(
        self,
        reading: tuple[Tensor, Tensor],
        lips: HeadLips,
        controls: ControlSet,
        curves: Float32,
        speaking: Bool,
    ) -> Float32:
        """Curves whose lips are corrected.

        Parameters
        ----------
        reading : (Tensor [shape=(T, D)], Tensor [shape=(T, C)])
            Features and neutral curves of the recording (`neutral_reading`).
        lips : HeadLips
            The head.
        controls : ControlSet
            Columns of the curves.
        curves : ndarray [shape=(T, C)]
            Of any emotion.
        speaking : ndarray [shape=(T,)]
            Frames with speech.

        Returns
        -------
        ndarray [shape=(T, C)]
        """
        features, neutral = reading
        own, start = lips.displacements(neutral).numpy(), torch.tensor(curves)
        given = lips.displacements(start).numpy()
        places = [i for i, name in enumerate(controls.names) if CONTACT in name]
        shut = np.clip(np.asarray(curves[:, places].mean(axis=1)), 0, 1)[:, None]
        fade = np.convolve(speaking, np.ones(EDGE_FRAMES) / EDGE_FRAMES, "same")[:, None]
        wanted = given + fade * self.change(features.numpy(), own)
        opening = MEASURES.index("opening")
        wanted[:, opening] = np.maximum(wanted[:, opening], 0) * (1 - shut[:, 0])
        target = torch.from_numpy(wanted).float()
        fitted = fit_curves(start, target, lips, controls, kept=(CONTACT,)).numpy()
        kept = np.where(fade > 0, fitted, curves)
        return np.asarray(kept, np.float32)


HEADER = (
    "clip", "audio", "curves", "emotion", "speaker", "split", "voice", "source", "phones",
    "intensity",
)  # fmt: skip
VALIDATION_SHARE = 0.1
"""Of the corpus clips; they come from its validation speakers."""


def write_lip_dataset(
    folder: Path,
    out: Path,
    model: DEITalk,
    *,
    listener: DEITalk | None = None,
    validation: Sequence[str] = (),
    test: Sequence[str] = (),
    most: int | None = None,
    corpora: Sequence[Path] = (),
    corpus_clips: int = 1000,
    force: bool = False,
    progress: Callable[[float], None] = lambda share: None,
) -> int:
    """Write the dataset folder of a folder of measured lips (docs/dataset.md).

    Parameters
    ----------
    folder : Path
        Measured lips (`deitalk.research.lips.measured`).
    out : Path
        Dataset folder.
    model : DEITalk
        Predicts what the measures leave open: tongue, teeth, cheeks, upper face.
    listener : DEITalk or None
        Model whose speech features the lips of the corpus are predicted from; None: `model`.
    validation, test : sequence of str
        Speakers of these splits; the others train.
    most : int or None
        At most so many recordings of every speaker, the first ones.
    corpora : sequence of Path
        Dataset folders whose clips are added with corrected lips (`LipTransfer`, fitted to the
        training speakers).
    corpus_clips : int
        How many clips of each, evenly spread.
    force : bool
        Replace a dataset folder that this function wrote.
    progress : callable
        Given the share done.

    Returns
    -------
    int
        Clips written.

    Raises
    ------
    DataError
        If the measured lips or the corpus are not as described, or a named speaker is not among
        them.
    rig.errors.TargetError, rig.errors.ExistsError
        If `out` may not be written.
    """
    lips = HeadLips(build_head())
    clips = first_clips(read_lips(folder, lips.eye_distance), most)
    check_speakers(folder, clips, (*validation, *test))
    acted = [clip for corpus in corpora for clip in _spread(corpus, corpus_clips)]
    if acted and {clip.speaker for clip in clips} <= {*validation, *test}:
        raise DataError(f"{folder}: no speaker is left to train on; hold out fewer")
    check_names([*clips, *acted])
    inputs = (folder, *corpora)
    total = len(clips) + len(acted)
    with output_folder(out, kind="dataset", force=force, inputs=inputs) as stage:
        writer = _Writer(stage, model, listener or model, lips)
        for clip in clips:
            split = SPLITS[1 if clip.speaker in validation else 2 if clip.speaker in test else 0]
            writer.measured(clip, split)
            progress(len(writer.rows) / total)
        transfer = LipTransfer.fit(writer.training) if acted else None
        for example in acted:
            assert transfer is not None
            writer.corrected(example, transfer)
            progress(len(writer.rows) / total)
        with (stage / "clips.csv").open("w", encoding="utf-8", newline="") as file:
            table = csv.DictWriter(file, HEADER, lineterminator="\n", restval="")
            table.writeheader()
            table.writerows(writer.rows)
    return total


def check_speakers(folder: Path, clips: Sequence[LipClip], names: Sequence[str]) -> None:
    """Refuse names that no clip's speaker has."""
    speakers = {clip.speaker for clip in clips}
    for name in names:
        if name not in speakers:
            known = ", ".join(sorted(speakers))
            raise DataError(f"{folder}: no speaker {quoted(name)}; has {known}")


def check_names(clips: Sequence[LipClip | Clip]) -> None:
    """Names become file names: plain ones, each once."""
    names = [clip.name for clip in clips]
    for name in names:
        if not is_inside(name) or "/" in name or "\\" in name:
            raise DataError(f"clip {quoted(name)}: its name is no file name; rename the clip")
    for name, count in Counter(names).items():
        if count > 1:
            raise DataError(f"clip {quoted(name)} appears {count} times; names must differ")


def first_clips(clips: Sequence[LipClip], most: int | None) -> list[LipClip]:
    """At most so many clips of every speaker."""
    count: dict[str, int] = {}
    chosen = []
    for clip in clips:
        count[clip.speaker] = count.get(clip.speaker, 0) + 1
        if most is None or count[clip.speaker] <= most:
            chosen.append(clip)
    return chosen


def _spread(corpus: Path, most: int) -> list[Clip]:
    """Clips of a dataset folder, evenly spread, from its training and validation speakers."""
    chosen = []
    for split, share in (("train", 1 - VALIDATION_SHARE), ("validation", VALIDATION_SHARE)):
        clips = read_clips(corpus, split)
        count = min(len(clips), round(share * most))
        chosen += [clips[i] for i in np.linspace(0, len(clips) - 1, count).round().astype(int)]
    return chosen


@dataclass
class _Writer:
    """Writes clips into a stage and keeps their rows."""

    stage: Path
    model: DEITalk
    listener: DEITalk
    lips: HeadLips
    rows: list[dict[str, str]] = field(default_factory=list)
    training: list[tuple[str, Float32, Float32, Float32]] = field(default_factory=list)
    """Speaker, features, own lips and measured lips of the training clips."""

    def measured(self, clip: LipClip, split: str) -> None:
        """Write a recording with curves that repeat its lips."""
        recording = load_audio(clip.sound)
        n = min(recording.n_frames, len(clip.measures))
        sound = torch.tensor(normalise_level(recording.waveform))
        features, prior = neutral_reading(self.model, sound, recording.n_frames, self.listener)
        measures = clip.measures[:n]
        values = fit_curves(prior[:n], torch.tensor(measures), self.lips, self.model.controls)
        if split == SPLITS[0]:
            own = self.lips.displacements(prior[:n]).numpy()
            self.training.append((clip.speaker, features[:n].numpy(), own, measures))
        self._write(
            clip.name,
            recording.waveform,
            values.numpy(),
            emotion="neutral",
            speaker=f"lips:{clip.speaker}",
            split=split,
            source=MEASURED,
        )

    def corrected(self, clip: Clip, transfer: LipTransfer) -> None:
        """Write a clip of a corpus with corrected lips."""
        loaded = load_clip(clip, self.model.controls)
        n_frames = n_clip_frames(len(loaded.waveform))
        sound, curves, _, _ = cut(loaded, 0, n_frames)
        speaking = speech_activity(sound)[:n_frames] > 0
        reading = neutral_reading(self.model, torch.tensor(sound), n_frames, self.listener)
        controls = self.model.controls
        values = transfer.correct(reading, self.lips, controls, curves, speaking)
        copied = {
            kind: self._copy(kind, path, clip.name)
            for kind, path in (("phones", clip.phones), ("intensity", clip.intensity))
            if path is not None
        }
        self._write(
            clip.name,
            load_audio(clip.audio).waveform,
            values,
            emotion=clip.emotion,
            speaker=clip.speaker,
            split=clip.split,
            voice=clip.voice,
            source=clip.source,
            **copied,
        )

    def _copy(self, kind: str, path: Path, name: str) -> str:
        (self.stage / kind).mkdir(exist_ok=True)
        copy = f"{kind}/{name}{path.suffix}"
        shutil.copyfile(path, self.stage / copy)
        return copy

    def _write(self, name: str, waveform: Float32, values: Float32, **columns: str) -> None:
        audio, curves = f"audio/{name}.flac", f"curves/{name}.npz"
        for path in (audio, curves):
            (self.stage / path).parent.mkdir(parents=True, exist_ok=True)
        soundfile.write(self.stage / audio, waveform, SAMPLE_RATE, subtype="PCM_16")
        names = self.model.controls.names
        write_curves(self.stage / curves, RigCurves(values, names, fps=FRAME_RATE))
        self.rows.append({"clip": name, "audio": audio, "curves": curves, **columns})
