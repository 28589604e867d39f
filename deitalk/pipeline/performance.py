"""Result of `deitalk.animate`, and its take folder.

::

    take/
      take.json        source, model and its hash, control set, settings, timings, files
      curves.csv       frame, time, 185 controls
      curves.json      the same with emotion and intensity (schema deitalk.curves/1)
      neutral.npz      the neutral reading: what intensity 0 gives
      intensity.csv    time, emotion weights, saliency, predicted and applied intensity: edit it
      audio.wav        the recording, 16 kHz mono, in time with the curves
      audio_48k.wav    the recording at 48 kHz with its channels, if it has more than 16 kHz
      layer-001.edit.json …  the layers of edits that it was made with
      <Slate>_take_1_deitalk.csv  Live Link Face, for Unreal's importer
      <Slate>.unreal.json      for the script that runs inside Unreal
"""

import json
import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from deitalk.acting import Acting
from deitalk.audio.frames import frame_times
from deitalk.audio.load import Recording, write_wav
from deitalk.audio.original import write_original
from deitalk.emotions import EMOTIONS, MOODS, write_intensity_csv
from deitalk.errors import AudioError
from deitalk.installed import __version__
from deitalk.pipeline.exchange_files import exchange_names, write_exchange_files
from deitalk.postprocess.edges import HANDLES, QUIET, quiet_seconds
from rig.arrays import Bool, Float32
from rig.controls import DEFAULT_ID
from rig.curves import RigCurves
from rig.curves.layers import SUFFIX
from rig.curves.shift import checked_shift, shift, start_with_handles
from rig.errors import TargetError, decodable_values
from rig.files import check_folder, output_folder
from rig.formats import write_curves

if TYPE_CHECKING:
    from deitalk.pipeline.layers import Edited
    from deitalk.pipeline.words.align import WordFit
    from deitalk.pipeline.words.marks import TimedMark


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

KIND = "take"
DELAY = "delay_frames"
"""Entry of ``take.json``: frames by which the face is late."""
ORIGINAL = "audio_48k.wav"
PREVIEW_FILES = ("preview.html", "preview.mp4")


@dataclass(frozen=True, repr=False)
class Performance:
    """Curves of a face that speaks a recording.

    All tracks share one time axis: row i is time i / 30 s of the recording.

    Attributes
    ----------
    curves : RigCurves
        The result, with the emotion weights, the applied intensity and the head as tracks.
    neutral : RigCurves
        The neutral reading of the same speech: what intensity 0 gives.
    saliency : array [shape=(T,), range -1 to 1]
        Emotional saliency e_sim (DEITalk Eq. 5).
    predicted : array [shape=(T,), range 0 to 1]
        Intensity predicted from the voice.
    recording : Recording
        Its speech.
    clipped : int
        Values that had to be clamped to their control's range.
    timings : dict of str to float
        Seconds spent per stage.
    acting : Acting
        How it is acted; `deitalk.acting.Acting.settings` is its JSON.
    model : str
        Name or folder of the model; empty for a loaded model.
    words : WordFit or None
        Times of the words and phones that were given, and how well the sound fits them.
    suggestion : mapping of str to float, or None
        Probabilities of the emotions that the voice suggests, of the emotion ``auto``.
    traits : mapping of str to float
        Of the character (`deitalk.postprocess.life.character.Traits`); takes that follow keep them.
    marks : tuple of TimedMark
        What a script says of the words, with their times: emotions, accents, sounds.
    edited : deitalk.pipeline.layers.Edited or None
        The layers of edits that are in the curves.
    """

    curves: RigCurves
    neutral: RigCurves
    saliency: Float32
    predicted: Float32
    recording: Recording
    clipped: int
    timings: dict[str, float] = field(default_factory=dict)
    acting: Acting = field(default_factory=Acting)
    model: str = ""
    words: "WordFit | None" = None
    suggestion: Mapping[str, float] | None = None
    traits: Mapping[str, float] = field(default_factory=dict)
    marks: "tuple[TimedMark, ...]" = ()
    edited: "Edited | None" = field(default=None, repr=False, compare=False)

    def at(self, fps: float | None) -> tuple[RigCurves, RigCurves]:
        """The curves and their neutral reading at a rate, Hz; None: their own.

        Layers of edits are applied at that rate.
        """
        curves, neutral = self.curves, self.neutral
        if fps is None or fps == curves.fps:
            return curves, neutral
        if self.edited is not None and self.edited.readings == (curves, neutral):
            return self.edited.at(fps)
        return curves.resample(fps), neutral.resample(fps)

    @property
    def emotion(self) -> str:
        """The emotion in a few words."""
        track = self.acting.emotion_track
        given = str(track) if len(track.times) == 1 else f"a track of {len(track.times)} keys"
        tags = sum(mark.kind in ("emotion", "sound") for mark in self.marks)
        return f"{given} and {tags} of the script" if tags else given

    @property
    def has_emotion(self) -> bool:
        """Whether any frame is other than neutral."""
        emotion = self.curves.emotion
        return emotion is not None and bool((emotion[:, 0] < 1).any())

    @property
    def moods(self) -> list[str]:
        """Procedural emotions that are shown: no capture taught them."""
        emotion = self.curves.emotion
        if emotion is None:
            return []
        return [name for k, name in enumerate(MOODS, len(EMOTIONS)) if emotion[:, k].any()]

    @property
    def summary(self) -> str:
        """The emotion, and how intense it is, in one line."""
        if not self.has_emotion:
            return f"emotion {self.emotion}: the neutral reading"
        moods = f" ({', '.join(self.moods)}: procedural)" if self.moods else ""
        return (
            f"emotion {self.emotion}{moods}, applied intensity {self.mean_applied_intensity:.2f} "
            f"on average ({self.mean_intensity:.2f} predicted from the voice)"
        )

    @property
    def sound_file(self) -> str:
        """Path of the recording; empty if it was no file."""
        return self.recording.source if os.path.isfile(self.recording.source) else ""

    @property
    def head(self) -> Float32 | None:
        """Turn and shift of the head [shape=(T, 6)], see `rig.curves.HEAD`; None if it is off."""
        return self.curves.head

    @property
    def mean_intensity(self) -> float:
        """Mean over the frames of speech of the intensity predicted from the voice; 0 of none."""
        return self._while_speaking(self.predicted)

    @property
    def mean_applied_intensity(self) -> float:
        """Mean over the frames of speech of the curves' intensity; 0 for neutral."""
        applied = self.curves.intensity
        return 0.0 if applied is None or not self.has_emotion else self._while_speaking(applied)

    def quiet(self, *, last: bool) -> float:
        """Time without speech at the end, or at the start, seconds."""
        return quiet_seconds(self.recording.activity, last=last)

    @cached_property
    def _speaking(self) -> Bool:
        """Frames of speech [shape=(T,)]."""
        return self.recording.activity > 0

    def _while_speaking(self, track: Float32) -> float:
        """Mean of a track (T,) over the frames of speech."""
        return float(track[self._speaking].mean()) if self._speaking.any() else 0.0

    def save(
        self,
        target: str | Path,
        *,
        fps: float | None = None,
        start: float = 0.0,
        delay: int = 0,
        handles: int = 0,
        force: bool = False,
    ) -> Path:
        """Write a take folder, or one file of curves.

        Parameters
        ----------
        target : str or Path
            A name with a suffix of curves (``.csv``, ``.json``, ``.npz`` …) is a file, any other
            a folder (see `rig.files.is_folder_name`).
        fps : float, optional
            Rate of the written curves, Hz; 30 by default.
        start : float
            Time of day of the first frame, seconds, for files with time codes; see
            `recording.start`.
        delay : int
            Frames of the written rate by which the face is late against the sound; early if
            negative.
        handles : int
            Frames that are added before and after; `start` is that of the frame after the first
            ones.
        force : bool
            Replace a file, or the files of a take, that are there.

        Returns
        -------
        Path
            The file or folder.

        Raises
        ------
        RigError
            If the target must not or cannot be written, or its suffix is unknown.
        """
        from rig.files import check_file, is_folder_name
        from rig.formats.table import writable_suffixes

        form: dict[str, Any] = {"fps": fps, "start": start, "delay": delay, "handles": handles}
        if is_folder_name(target, writable_suffixes()):
            folder = Path(target)
            from deitalk.models.folder import describe_model

            about: dict[str, Any] = {"name": "passed in", "control_set": self.curves.control_set}
            if self.model:
                about = describe_model(self.model)
            return write_take(folder, self, model=about, force=force, **form)
        check_file(target, force=force, inputs=(self.recording.source,))
        spoken: dict[str, Any] = {"sound": self.sound_file, "seconds": self.recording.duration}
        write_curves(target, self.at(fps)[0], **spoken, **form)
        return Path(target)

    def __repr__(self) -> str:
        applied = f", applied intensity {self.mean_applied_intensity:.2f}"
        return (
            f"<Performance of {self.recording.source!r}: {len(self.curves)} frames at "
            f"{self.curves.fps:g} fps, {self.recording.duration:.2f} s, "
            f"{len(self.curves.names)} controls, emotion {self.emotion}"
            f"{applied if self.has_emotion else ''}>"
        )


Extra = Callable[[Path, Performance], dict[str, str]]
"""Writes more files into the folder; returns their names and descriptions."""


def write_take(
    folder: Path,
    performance: Performance,
    *,
    model: dict[str, Any],
    fps: float | None = None,
    digits: int | None = None,
    start: float = 0.0,
    delay: int = 0,
    handles: int = 0,
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
    delay, handles : int
        As for `Performance.save`; the sounds have silence for the handles.
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
    checked_shift(delay, handles)
    inputs = (performance.recording.source,)
    try:
        with output_folder(folder, kind=KIND, force=force, inputs=inputs) as stage:
            curves, neutral = (shift(own, delay, handles) for own in performance.at(fps))
            lead = handles / curves.fps
            start = start_with_handles(start, handles, curves.fps)
            pad = round(lead * performance.recording.sample_rate)
            waveform = np.pad(performance.recording.waveform, pad)
            write_curves(stage / "curves.csv", curves, digits=digits)
            write_curves(stage / "curves.json", curves, digits=digits)
            write_curves(stage / "neutral.npz", neutral)
            emotion, intensity = performance.curves.emotion, performance.curves.intensity
            assert emotion is not None and intensity is not None, "a performance carries both"
            write_intensity_csv(
                stage / "intensity.csv",
                times=frame_times(len(performance.curves)),
                weights=emotion,
                saliency=performance.saliency,
                predicted=performance.predicted,
                intensity=intensity,
            )
            write_wav(stage / "audio.wav", waveform, start=start)
            files = FILES | _original(stage, performance, start, lead)
            slate = Path(performance.recording.source).stem
            if curves.control_set == DEFAULT_ID:
                files |= write_exchange_files(
                    stage, curves, slate=slate, digits=digits, start=start
                )
            acting, layers = _with_layers(stage, performance)
            files |= layers
            shown, recording = performance, performance.recording
            if delay or handles:
                moved = replace(recording, waveform=waveform)
                shown = replace(performance, curves=curves, neutral=neutral, recording=moved)
            for extra in extras:
                files |= extra(stage, shown)
            about = {
                "schema": SCHEMA,
                "deitalk": __version__,
                "written": datetime.now(UTC).isoformat(timespec="seconds"),
                "source": {
                    "name": recording.source,
                    "seconds": round(recording.duration, 4),
                    "sample_rate": recording.source_rate,
                    "channels": recording.channels,
                    "clipped_fraction": recording.clipped_fraction,
                    "warnings": list(recording.warnings),
                    **recording.choice.settings,
                },
                "model": model,
                "control_set": curves.control_set,
                "fps": curves.fps,
                "start_seconds": start,
                DELAY: delay,
                HANDLES: handles,
                "marks": [
                    {**mark._asdict(), "start": round(mark.start, 3), "end": round(mark.end, 3)}
                    for mark in performance.marks
                ],
                "frames": len(curves),
                "settings": acting.settings,
                "procedural_emotions": performance.moods,
                "traits": {name: round(value, 6) for name, value in performance.traits.items()},
                QUIET: [round(performance.quiet(last=last), 5) for last in (False, True)],
                "clipped_values": performance.clipped,
                "timings_seconds": {
                    name: round(lap, 4) for name, lap in performance.timings.items()
                },
                "files": files,
            }
            (stage / "take.json").write_text(
                json.dumps(decodable_values(about), indent=1) + "\n", encoding="utf-8"
            )
    except OSError as error:
        reason = error.strerror or str(error)
        raise TargetError(f"cannot write {folder}: {reason}; name another folder") from None
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


def _with_layers(folder: Path, performance: Performance) -> tuple[Acting, dict[str, str]]:
    """Write the layers of edits, which know their recording now; the acting with them."""
    acting = performance.acting
    if not acting.edit:
        return acting, {}
    from deitalk.pipeline.layer_sounds import with_recording
    from deitalk.pipeline.speech import Speech

    speech = Speech.of_recording(performance.recording)
    layers, files = with_recording(acting.edit, speech, performance.words), {}
    for number, layer in enumerate(layers, 1):
        name = f"layer-{number:03}{SUFFIX}"
        (folder / name).write_text(layer.text, encoding="utf-8")
        files[name] = f"edits by hand{f', {layer.name}' if layer.name else ''}; give it as an edit"
    return Acting.of(acting, edit=layers), files


def _original(folder: Path, performance: Performance, start: float, lead: float) -> dict[str, str]:
    """Write the recording at 48 kHz, if it has more than the 16 kHz of ``audio.wav``.

    A file that was removed or changed since it was read is left out.
    """
    recording = performance.recording
    if not performance.sound_file or recording.source_rate <= recording.sample_rate:
        return {}
    seconds, choice = recording.duration, recording.choice
    try:
        write_original(
            folder / ORIGINAL, recording.source, seconds=seconds, start=start, choice=choice,
            lead=lead,
        )  # fmt: skip
    except AudioError:
        return {}
    track = "" if choice.track is None else f", track {choice.track}"
    signal = "all its channels" if choice.is_mix else f"channel {choice.channel} alone"
    return {ORIGINAL: f"the recording at 48 kHz{track}, {signal}, in time with the curves"}
