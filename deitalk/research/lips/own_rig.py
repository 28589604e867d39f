"""Measured lips as captures of a rig of six controls, the measures themselves.

What the embedded head would need to repeat them is left open, unlike in
`deitalk.research.lips.dataset`: a model tuned on this folder (``deitalk finetune --rig``) predicts
the measures, and its scores compare with a regression of them.

::

    rig.yaml     the controls: opening, jaw, width, upper_lip, lower_lip, corner; cm from rest
    clips.csv    a speaker is an actor, and their recordings a take
"""

import csv
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import soundfile
import yaml

from deitalk.audio.frames import FRAME_RATE, SAMPLE_RATE
from deitalk.audio.load import load_audio
from deitalk.data.clips import SPLITS
from deitalk.errors import DataError
from deitalk.research.lips.dataset import check_names, check_speakers, first_clips
from deitalk.research.lips.head_lips import MEASURES, HeadLips
from deitalk.research.lips.measured import LipClip, read_lips
from rig import RigCurves, write_curves
from rig.arrays import Bool, Float32
from rig.face.head import build_head
from rig.files import output_folder

RIG_ID = "measured-lips@1"
LARGEST_CM = 8.0
"""Displacement from rest that no mouth reaches; ends of the controls' ranges."""
LEAST_KNOWN = 0.9
"""Share of frames with all measures below which a recording is left out."""
APART_SECONDS = 60.0
"""Between the starts of recordings in their speaker's take: they are no neighbours."""
HEADER = (
    "clip", "audio", "curves", "emotion", "speaker", "split", "take", "start_s", "stop_s"
)  # fmt: skip


def write_measure_dataset(
    folder: Path,
    out: Path,
    *,
    validation: Sequence[str] = (),
    test: Sequence[str] = (),
    most: int | None = None,
    force: bool = False,
    progress: Callable[[float], None] = lambda share: None,
) -> int:
    """Write measured lips as a dataset folder of a rig of its own, with its ``rig.yaml``.

    Parameters
    ----------
    folder, out, validation, test, most, force, progress
        As for `deitalk.research.lips.dataset.write_lip_dataset`.

    Returns
    -------
    int
        Clips written. Recordings in which a tenth of the frames lacks a measure are left out, and
        shorter gaps are bridged by a line.

    Raises
    ------
    DataError
        If the measured lips are not as described, or no recording is left.
    rig.errors.TargetError, rig.errors.ExistsError
        If `out` may not be written.
    """
    clips = first_clips(read_lips(folder, HeadLips(build_head()).eye_distance), most)
    check_speakers(folder, clips, (*validation, *test))
    check_names(clips)
    clips = [clip for clip in clips if _known(clip).mean() >= LEAST_KNOWN]
    if not clips:
        raise DataError(f"{folder}: no recording has all measures in {LEAST_KNOWN:.0%} of frames")
    with output_folder(out, kind="dataset", force=force, inputs=(folder,)) as stage:
        for name in ("audio", "curves"):
            (stage / name).mkdir()
        (stage / "rig.yaml").write_text(_rig(), encoding="utf-8")
        places: dict[str, int] = {}
        with (stage / "clips.csv").open("w", encoding="utf-8", newline="") as file:
            table = csv.DictWriter(file, HEADER, lineterminator="\n")
            table.writeheader()
            for done, clip in enumerate(clips):
                place = places[clip.speaker] = places.get(clip.speaker, -1) + 1
                split = 1 if clip.speaker in validation else 2 if clip.speaker in test else 0
                row = _write(stage, clip, place * APART_SECONDS)
                table.writerow(row | {"split": SPLITS[split]})
                progress((done + 1) / len(clips))
    return len(clips)


def _rig() -> str:
    """The rig file of the measures."""
    tree = {
        "id": RIG_ID,
        "controls": {name: {"minimum": -LARGEST_CM, "maximum": LARGEST_CM} for name in MEASURES},
        "lip": list(MEASURES),
    }
    text: str = yaml.safe_dump(tree, sort_keys=False)
    return text


def _write(stage: Path, clip: LipClip, start: float) -> dict[str, str]:
    """Write sound and curves of a clip; return its row."""
    recording = load_audio(clip.sound)
    values = _bridged(clip)[: recording.n_frames]
    audio, curves = f"audio/{clip.name}.flac", f"curves/{clip.name}.npz"
    soundfile.write(stage / audio, recording.waveform, SAMPLE_RATE, subtype="PCM_16")
    write_curves(stage / curves, RigCurves(values, MEASURES, fps=FRAME_RATE, control_set=RIG_ID))
    return {
        "clip": clip.name, "audio": audio, "curves": curves, "emotion": "neutral",
        "speaker": clip.speaker, "take": clip.speaker, "start_s": f"{start:.4f}",
        "stop_s": f"{start + recording.duration:.4f}",
    }  # fmt: skip


def _known(clip: LipClip) -> Bool:
    """Frames with all measures [shape=(T,)]."""
    return np.asarray(np.isfinite(clip.measures).all(axis=1), bool)


def _bridged(clip: LipClip) -> Float32:
    """Measures with lines over gaps [shape=(T, M)], held beyond the ends."""
    known, frames = _known(clip), np.arange(len(clip.measures))
    columns = [np.interp(frames, frames[known], column[known]) for column in clip.measures.T]
    values = np.clip(np.stack(columns, axis=1), -LARGEST_CM, LARGEST_CM)
    return np.asarray(values, np.float32)
