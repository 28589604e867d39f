"""Clips of a study: takes of every system drawn with one face, or videos as they are."""

import shutil
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import soxr

from deitalk.audio.frames import FRAME_RATE, SAMPLE_RATE, frame_times
from deitalk.errors import DataError
from deitalk.evaluation.smoothness import loudness
from deitalk.evaluation.validation import JAW
from deitalk.preview.mp4 import write_mp4
from deitalk.preview.source import PreviewSource, load_source
from rig import RigCurves
from rig.arrays import Float32
from rig.face import build_head
from rig.face.accents import accents
from rig.face.identity import Identity
from rig.face.render import VIEWS
from rig.face.render.picture import Picture
from rig.formats.table import FORMATS

VIDEO = ".mp4"
SIZE = (480, 540)
"""Width and height of a drawn clip."""
BATCH = 32
LOUDNESS = "loudness"
"""Name of the system whose jaw follows the level of the recording and nothing else."""
DIFFERENCE_SECONDS = 0.25
"""Most by which two clips of one item may differ in length."""


@dataclass(frozen=True)
class System:
    """Clips of one system: take folders, files of curves or videos by the name of their item."""

    name: str
    items: dict[str, Path]


def read_system(folder: Path) -> System:
    """Find the clips of a system.

    Raises
    ------
    DataError
        If the folder has none, or two of one name.
    """
    if not folder.is_dir():
        raise DataError(f"{folder} is no folder; give a folder of takes, curves or videos a system")
    items: dict[str, Path] = {}
    for path in sorted(folder.iterdir()):
        name = _item_name(path)
        if name is None:
            continue
        if name in items:
            raise DataError(f"{folder}: {path.name} and {items[name].name} are of one name")
        items[name] = path
    if not items:
        raise DataError(f"{folder} has no takes, files of curves or {VIDEO} videos")
    return System(folder.resolve().name, items)


def _item_name(path: Path) -> str | None:
    """Name of the item that a path is a clip of, or None."""
    if path.name.startswith("."):
        return None
    if path.is_dir():
        return path.name if (path / "curves.json").is_file() else None
    suffixes = sorted((s for f in FORMATS if f.read for s in f.suffixes), key=len, reverse=True)
    ending = next((s for s in (VIDEO, *suffixes) if path.name.endswith(s)), None)
    return None if ending is None else path.name.removesuffix(ending)


def common_items(systems: Sequence[System]) -> list[str]:
    """Items that every system has, in order.

    Raises
    ------
    DataError
        If there is none, or two systems have one name.
    """
    names = [system.name for system in systems]
    doubled = next((name for name in names if names.count(name) > 1), None)
    if doubled is not None:
        raise DataError(f"two systems are named {doubled!r}; rename one folder")
    common = sorted(set.intersection(*(set(system.items) for system in systems)))
    if not common:
        raise DataError(f"{', '.join(names)} have no item in common; takes are matched by name")
    return common


@dataclass(frozen=True)
class Clip:
    """A clip to draw, or a video to copy."""

    path: Path | None
    source: PreviewSource | None

    def write(self, out: Path, identity: int | str | Identity) -> None:
        """Write the clip as an MP4 without any title."""
        if self.path is not None:
            shutil.copyfile(self.path, out)
            return
        assert self.source is not None
        write_mp4(
            out,
            _pictures(self.source.curves.values, identity),
            fps=self.source.curves.fps,
            size=SIZE,
            samples=self.source.samples,
            sample_rate=self.source.sample_rate,
        )

    @property
    def seconds(self) -> float:
        """Length of the picture."""
        if self.source is not None:
            return len(self.source.curves) / self.source.curves.fps
        import av

        with av.open(str(self.path)) as container:
            return float((container.duration or 0) / av.time_base)


def read_clip(path: Path, audio: Path | None) -> Clip:
    """A clip of a system; `audio` is the recording of curves that have none."""
    if path.name.endswith(VIDEO):
        return Clip(path, None)
    source = load_source(path) if path.is_dir() else load_source(path, audio)
    if not source.sample_rate:
        raise DataError(f"{path} has no recording: one system must have a take folder of that name")
    return Clip(None, source)


def still_clip(clip: Clip) -> Clip | None:
    """The clip with a face that does not move; None for a video."""
    if clip.source is None:
        return None
    values = clip.source.curves.values
    return _with_curves(clip.source, np.repeat(values[:1], len(values), axis=0))


def loudness_clip(clip: Clip) -> Clip | None:
    """The clip with a jaw that follows the level, as far as the take's jaw moves; None for a video.

    All other controls rest: the weakest opponent that moves in time with the speech.
    """
    source = clip.source
    if source is None:
        return None
    sound = np.asarray(soxr.resample(source.samples, source.sample_rate, SAMPLE_RATE), np.float32)
    times = frame_times(len(sound) * FRAME_RATE // SAMPLE_RATE)
    at = np.arange(len(source.curves)) / source.curves.fps
    level = np.interp(at, times, loudness(sound, len(times)))
    values = np.zeros_like(source.curves.values)
    jaw = source.curves.names.index(JAW)
    values[:, jaw] = level * np.percentile(source.curves.values[:, jaw], 95)
    return _with_curves(source, values)


def _with_curves(source: PreviewSource, values: Float32) -> Clip:
    curves = RigCurves(
        values, source.curves.names, fps=source.curves.fps, control_set=source.curves.control_set
    )
    return Clip(None, replace(source, curves=curves, neutral=None))


def _pictures(values: Float32, identity: int | str | Identity) -> Iterator[Picture]:
    """The face alone, frame by frame."""
    from rig.face.render.software import Renderer

    head = build_head(identity)
    renderer = Renderer(head.mesh, SIZE, VIEWS["face"], many=True)
    for start in range(0, len(values), BATCH):
        shown = values[start : start + BATCH]
        poses = head.pose(shown)
        for pose, accent in zip(poses, accents(head, shown, poses), strict=True):
            yield renderer.render(pose, accents=accent)
