"""The take folder: all files of one performance.

::

    take/
      take.json        source, model and its hash, control set, settings, timings, files
      curves.csv       frame, time, 185 controls
      curves.json      the same with emotion and intensity (schema deitalk.curves/1)
      neutral.npz      the neutral reading: what intensity 0 gives
      intensity.csv    time, emotion weights, saliency, predicted and applied intensity: edit it
      audio.wav        the recording, 16 kHz mono, in time with the curves
      audio_48k.wav    the recording at 48 kHz with its channels, if it has more than 16 kHz
      <Slate>_take_1_deitalk.csv  Live Link Face, for Unreal's importer
      <Slate>.unreal.json      for the script that runs inside Unreal
"""

import json
from collections.abc import Callable, Iterable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from deitalk import __version__
from deitalk.audio.frames import frame_times
from deitalk.audio.load import write_wav
from deitalk.audio.original import write_original
from deitalk.emotions import write_intensity_csv
from deitalk.errors import AudioError
from deitalk.pipeline.performance import Performance
from rig import write_curves
from rig.arrays import Float32
from rig.controls import DEFAULT_ID
from rig.errors import TargetError, decodable_values
from rig.files import check_folder, output_folder
from rig.formats.exchange import exchange_names, write_exchange_files

SCHEMA = "deitalk.pipeline.take/1"
FILES = {
    "curves.csv": "control curves: frame, time, one column per control",
    "curves.json": "the same curves with emotion and intensity, schema deitalk.curves/1",
    "neutral.npz": "the neutral reading of the same speech, what intensity 0 gives",
    "intensity.csv": "emotion weights, saliency, predicted and applied intensity; edit the last "
    "column and give it back as the intensity curve",
    "audio.wav": "the recording as 16 kHz mono, in time with the curves",
    "take.json": "this file",
}

Extra = Callable[[Path, Performance], dict[str, str]]
"""Writes more files into the folder; returns their names and descriptions."""


KIND = "take"
ORIGINAL = "audio_48k.wav"
PREVIEW_FILES = ("preview.html", "preview.mp4")


def write_take(
    folder: Path,
    performance: Performance,
    *,
    model: dict[str, Any],
    fps: float | None = None,
    digits: int | None = None,
    start: float = 0.0,
    force: bool = False,
    extras: tuple[Extra, ...] = (),
) -> Path:
    """Write a take folder: all of its files or none.

    Parameters
    ----------
    folder : Path
        New or empty, or a take if `force` is set; missing folders above are made.
    performance : Performance
        From `deitalk.pipeline.curves.animate`.
    model : dict
        From `deitalk.models.folder.describe_model`.
    fps : float, optional
        Rate of the curves; 30 by default.
    digits : int, range 2 to 6, optional
        Digits after the point of the curves as text; see `rig.write_curves`.
    start : float
        Time of day of the first frame, seconds: time code of the Live Link Face CSV, the file for
        Unreal and the sounds.
    force : bool
        Replace the files of an existing take; other files in its folder stay.
    extras : tuple of callables
        Further writers, such as Live Link or a preview.

    Returns
    -------
    Path
        The folder.

    Raises
    ------
    rig.errors.ExistsError
        If a take is there and `force` is not set.
    rig.errors.TargetError
        If the folder holds something else, a file of the take was edited, or writing fails.
    """
    inputs = (performance.recording.source,)
    try:
        with output_folder(folder, kind=KIND, force=force, inputs=inputs) as stage:
            _fill(stage, performance, model, fps, digits, start, extras)
    except OSError as error:
        reason = error.strerror or str(error)
        raise TargetError(
            f"cannot write {folder}: {reason}; free space or name another folder"
        ) from None
    return folder


def check_take(
    folder: Path, *, source: str, force: bool, inputs: Iterable[Path | str | None] = ()
) -> None:
    """Refuse a folder that no take can be written to, before a recording is animated.

    Parameters
    ----------
    folder : Path
        See `write_take`.
    source : str
        Path of the recording, after which files are named.
    force : bool
        Whether a take that is there may be replaced.
    inputs : iterable of path or None
        Other files that are read.

    Raises
    ------
    rig.errors.TargetError
        As `write_take`.
    """
    names = (*FILES, ORIGINAL, *PREVIEW_FILES, *exchange_names(Path(source).stem))
    check_folder(folder, kind=KIND, force=force, inputs=(source, *inputs), names=names)


def _fill(
    folder: Path,
    performance: Performance,
    model: dict[str, Any],
    fps: float | None,
    digits: int | None,
    start: float,
    extras: tuple[Extra, ...],
) -> None:
    curves = performance.curves if fps is None else performance.curves.resample(fps)
    neutral = performance.neutral if fps is None else performance.neutral.resample(fps)
    write_curves(folder / "curves.csv", curves, digits=digits)
    write_curves(folder / "curves.json", curves, digits=digits)
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
    write_wav(folder / "audio.wav", performance.recording.waveform, start=start)
    files = FILES | _original(folder, performance, start)
    slate = Path(performance.recording.source).stem
    if curves.control_set == DEFAULT_ID:
        files |= write_exchange_files(folder, curves, slate=slate, digits=digits, start=start)
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
        "start_seconds": start,
        "frames": len(curves),
        "settings": performance.acting.settings,
        "clipped_values": performance.clipped,
        "timings_seconds": {name: round(lap, 4) for name, lap in performance.timings.items()},
        "files": files,
    }
    (folder / "take.json").write_text(
        json.dumps(decodable_values(about), indent=1) + "\n", encoding="utf-8"
    )


def _original(folder: Path, performance: Performance, start: float) -> dict[str, str]:
    """Write the recording at 48 kHz, if it has more than the 16 kHz of ``audio.wav``.

    A file that was removed or changed since it was read is left out.
    """
    recording = performance.recording
    if not performance.sound_file or recording.source_rate <= recording.sample_rate:
        return {}
    seconds = recording.duration
    try:
        write_original(folder / ORIGINAL, recording.source, seconds=seconds, start=start)
    except AudioError:
        return {}
    return {ORIGINAL: "the recording at 48 kHz with its channels, in time with the curves"}


def _track(values: Float32 | None) -> Float32:
    """A track that every performance has."""
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
