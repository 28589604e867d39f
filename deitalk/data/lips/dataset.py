"""Measured lips as a dataset folder: recordings, and curves that repeat the lips on the head."""

import csv
from collections.abc import Callable, Sequence
from pathlib import Path

import soundfile
import torch

from deitalk.audio.load import FRAME_RATE, SAMPLE_RATE, load_audio
from deitalk.data.clips import SPLITS
from deitalk.data.lips.fit import fit_curves, network_curves
from deitalk.data.lips.head import HeadLips
from deitalk.data.lips.measured import LipClip, read_lips
from deitalk.errors import DataError
from deitalk.models.curve_model import DEITalk
from rig import RigCurves, write_curves
from rig.errors import quoted
from rig.face.head import build_head
from rig.files import output_folder

HEADER = ("clip", "audio", "curves", "emotion", "speaker", "split", "source")


def write_lip_dataset(
    folder: Path,
    out: Path,
    model: DEITalk,
    *,
    validation: Sequence[str] = (),
    test: Sequence[str] = (),
    most: int | None = None,
    force: bool = False,
    progress: Callable[[float], None] = lambda share: None,
) -> int:
    """Write the dataset folder of a folder of measured lips (docs/dataset.md).

    Parameters
    ----------
    folder : Path
        Measured lips (`deitalk.data.lips.measured`).
    out : Path
        Dataset folder.
    model : DEITalk
        Predicts what the measures leave open: tongue, teeth, cheeks, upper face.
    validation, test : sequence of str
        Speakers of these splits; the others train.
    most : int or None
        At most so many recordings of every speaker, the first ones.
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
        If the measured lips are not as described, or a named speaker is not among them.
    rig.errors.TargetError, rig.errors.ExistsError
        If `out` may not be written.
    """
    lips = HeadLips(build_head())
    clips = _first(read_lips(folder, lips.eye_distance), most)
    speakers = {clip.speaker for clip in clips}
    for name in (*validation, *test):
        if name not in speakers:
            known = ", ".join(sorted(speakers))
            raise DataError(f"{folder}: no speaker {quoted(name)}; has {known}")
    with output_folder(out, kind="dataset", force=force, inputs=(folder,)) as stage:
        for name in ("audio", "curves"):
            (stage / name).mkdir()
        rows = []
        for i, clip in enumerate(clips):
            split = SPLITS[1 if clip.speaker in validation else 2 if clip.speaker in test else 0]
            rows.append(_write(stage, clip, split, model, lips))
            progress((i + 1) / len(clips))
        with (stage / "clips.csv").open("w", encoding="utf-8", newline="") as file:
            csv.writer(file, lineterminator="\n").writerows([HEADER, *rows])
    return len(clips)


def _first(clips: Sequence[LipClip], most: int | None) -> list[LipClip]:
    """At most so many clips of every speaker."""
    count: dict[str, int] = {}
    chosen = []
    for clip in clips:
        count[clip.speaker] = count.get(clip.speaker, 0) + 1
        if most is None or count[clip.speaker] <= most:
            chosen.append(clip)
    return chosen


def _write(
    stage: Path, clip: LipClip, split: str, model: DEITalk, lips: HeadLips
) -> tuple[str, ...]:
    """Write sound and curves of one clip; returns its row."""
    recording = load_audio(clip.sound)
    prior = network_curves(model, recording)
    n = min(len(prior), len(clip.measures))
    values = fit_curves(prior[:n], torch.from_numpy(clip.measures[:n]), lips, model.controls)
    audio, curves = f"audio/{clip.name}.flac", f"curves/{clip.name}.npz"
    soundfile.write(stage / audio, recording.waveform, SAMPLE_RATE, subtype="PCM_16")
    write_curves(stage / curves, RigCurves(values.numpy(), model.controls.names, fps=FRAME_RATE))
    return clip.name, audio, curves, "neutral", f"lips:{clip.speaker}", split, "recording"
