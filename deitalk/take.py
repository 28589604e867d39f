"""The take folder: everything one performance leaves behind.

::

    take/
      take.json        source, model and its hash, control set, settings, timings, files
      curves.csv       frame, time, 185 controls
      curves.json      the same with emotion and intensity (schema deitalk.curves/1)
      neutral.npz      the neutral reading: what intensity 0 gives
      intensity.csv    time, emotion weights, saliency, predicted and applied intensity: edit it
      audio.wav        the recording, 16 kHz mono, in time with the curves
      <Slate>_1_deitalk.csv    Live Link Face, for Unreal's importer
      <Slate>.unreal.json      for the script that runs inside Unreal
"""

import json
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deitalk import __version__
from deitalk.audio import frame_times, write_wav
from deitalk.emotions import write_intensity_csv
from deitalk.errors import DeitalkError
from deitalk.pipeline import Performance
from rig import write_curves
from rig.exchange import write_exchange_files
from rig.files import atomic_write

SCHEMA = "deitalk.take/1"
FILES = {
    "curves.csv": "185 control curves: frame, time, one column per control",
    "curves.json": "the same curves with emotion and intensity, schema deitalk.curves/1",
    "neutral.npz": "the neutral reading of the same speech, what intensity 0 gives",
    "intensity.csv": "emotion weights, saliency, predicted and applied intensity; edit the last "
    "column and give it back with --intensity-curve",
    "audio.wav": "the recording as 16 kHz mono, in time with the curves",
    "take.json": "this file",
}

Extra = Callable[[Path, Performance], dict[str, str]]
"""Writes more files into the folder; returns their names and descriptions."""


class TakeError(DeitalkError):
    """A take that cannot be written where it was asked for."""


def write_take(
    folder: Path,
    performance: Performance,
    *,
    settings: dict[str, Any],
    model: dict[str, Any],
    fps: float | None = None,
    force: bool = False,
    extras: tuple[Extra, ...] = (),
) -> Path:
    """Write a take folder, whole or not at all.

    Parameters
    ----------
    folder : Path
        Must not exist unless `force`; its parent is made.
    performance : Performance
        What `deitalk.pipeline.animate` gave.
    settings : dict
        What was asked for, for ``take.json``.
    model : dict
        What `deitalk.checkpoint.describe_model` says of the model.
    fps : float, optional
        Rate of the curves; 30 by default.
    force : bool
        Replace an existing take. A folder that is no take is never replaced.
    extras : tuple of callables
        Further writers, such as Live Link or a preview.

    Returns
    -------
    Path
        The folder.

    Raises
    ------
    TakeError
        If the folder exists, or cannot be written.
    """
    check_target(folder, force=force)
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        with atomic_write(folder) as beside:
            beside.mkdir()
            _fill(beside, performance, settings, model, fps, extras)
    except OSError as error:
        reason = error.strerror or str(error)
        raise TakeError(
            f"cannot write {folder}: {reason}; free space or name another folder"
        ) from None
    return folder


def check_target(folder: Path, *, force: bool) -> None:
    """Refuse to overwrite before any work is done."""
    if not folder.exists():
        return
    if not force:
        raise TakeError(f"{folder} exists; add --force to replace it, or name another folder")
    is_take = (folder / "take.json").is_file()
    if folder.is_dir() and not is_take and any(folder.iterdir()):
        raise TakeError(f"{folder} holds something else than a take; name another folder")
    if folder.is_file():
        raise TakeError(f"{folder} is a file; a take is a folder, name another")


def _fill(
    folder: Path,
    performance: Performance,
    settings: dict[str, Any],
    model: dict[str, Any],
    fps: float | None,
    extras: tuple[Extra, ...],
) -> None:
    curves = performance.curves if fps is None else performance.curves.resample(fps)
    neutral = performance.neutral if fps is None else performance.neutral.resample(fps)
    write_curves(folder / "curves.csv", curves)
    write_curves(folder / "curves.json", curves)
    write_curves(folder / "neutral.npz", neutral)
    times = frame_times(len(performance.curves))
    write_intensity_csv(
        folder / "intensity.csv",
        times=times,
        weights=_track(performance.curves.emotion),
        saliency=performance.saliency,
        predicted=performance.predicted,
        intensity=_track(performance.curves.intensity),
    )
    write_wav(folder / "audio.wav", performance.recording.waveform)
    slate = Path(performance.recording.source).stem
    files = FILES | write_exchange_files(folder, curves, slate=slate)
    for extra in extras:
        files |= extra(folder, performance)
    about = {
        "schema": SCHEMA,
        "deitalk": __version__,
        "written": datetime.now(UTC).isoformat(timespec="seconds"),
        "source": _source(performance),
        "model": model,
        "control_set": curves.control_set,
        "fps": curves.fps,
        "frames": len(curves),
        "settings": settings,
        "clipped_values": performance.clipped,
        "timings_seconds": {name: round(lap, 4) for name, lap in performance.timings.items()},
        "files": files,
    }
    (folder / "take.json").write_text(json.dumps(about, indent=1) + "\n", encoding="utf-8")


def _track(values: NDArray[np.float32] | None) -> NDArray[np.float32]:
    """A track every performance has."""
    assert values is not None, "a performance carries its emotion and intensity"
    return values


def _source(performance: Performance) -> dict[str, Any]:
    recording = performance.recording
    return {
        "name": recording.source,
        "seconds": round(recording.duration, 4),
        "sample_rate": recording.source_rate,
        "channels": recording.channels,
        "clipped_fraction": recording.clipped_fraction,
        "warnings": list(recording.warnings),
    }
