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

from deitalk.audio.frames import FRAME_RATE, SAMPLE_RATE
from deitalk.audio.load import load_audio
from deitalk.audio.voice_activity import normalise_level, speech_activity
from deitalk.data.clips import MEASURED, SPLITS, Clip, read_clips
from deitalk.data.waveforms import n_clip_frames
from deitalk.data.windows import cut, load_clip
from deitalk.errors import DataError
from deitalk.models.curve_model import DEITalk
from deitalk.research.lips.fit import fit_curves, neutral_reading
from deitalk.research.lips.head_lips import HeadLips
from deitalk.research.lips.measured import LipClip, read_lips
from deitalk.research.lips.transfer import LipTransfer
from rig import RigCurves, write_curves
from rig.arrays import Float32
from rig.errors import quoted
from rig.face.head import build_head
from rig.files import output_folder
from rig.files.manifest import is_inside

HEADER = (
    "clip", "audio", "curves", "emotion", "speaker", "split", "voice", "source", "phones",
    "intensity",
)  # fmt: skip
VALIDATION_SHARE = 0.1
"""Share of the corpus clips that are for validation, from its validation speakers."""


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
