"""Results of `deitalk.animate` and `deitalk.animate_mesh`, and how they are saved."""

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from deitalk.acting import Acting
from deitalk.audio.load import Recording
from deitalk.audio.voice_activity import speech_activity
from rig import RigCurves
from rig.arrays import Bool, Float32, Float64

if TYPE_CHECKING:
    from deitalk.pipeline.words.align import WordFit
    from rig.mesh import TriMesh

GLB_TOLERANCE_MM = 0.02
"""Furthest a vertex of a GLB may be from where the model put it."""


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

    @property
    def emotion(self) -> str:
        """The emotion in a few words."""
        track = self.acting.track
        return str(track) if len(track.times) == 1 else f"a track of {len(track.times)} keys"

    @property
    def has_emotion(self) -> bool:
        """Whether any frame is other than neutral."""
        emotion = self.curves.emotion
        return emotion is not None and bool((emotion[:, 0] < 1).any())

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

    @cached_property
    def _speaking(self) -> Bool:
        """Frames of speech [shape=(T,)]."""
        return speech_activity(self.recording.waveform) > 0

    def _while_speaking(self, track: Float32) -> float:
        """Mean of a track (T,) over the frames of speech."""
        return float(track[self._speaking].mean()) if self._speaking.any() else 0.0

    def save(
        self,
        target: str | Path,
        *,
        fps: float | None = None,
        start: float = 0.0,
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
        from rig.files import is_folder_name
        from rig.formats.table import writable_suffixes

        if is_folder_name(target, writable_suffixes()):
            return self._save_take(Path(target), fps, start, force)
        from rig.files import check_file
        from rig.formats import write_curves

        check_file(target, force=force, inputs=(self.recording.source,))
        seconds = self.recording.duration
        write_curves(
            target, self.curves, fps=fps, sound=self.sound_file, seconds=seconds, start=start
        )
        return Path(target)

    def _save_take(self, folder: Path, fps: float | None, start: float, force: bool) -> Path:
        from deitalk.models.folder import describe_model
        from deitalk.pipeline.take import write_take

        about: dict[str, Any] = {"name": "passed in", "control_set": self.curves.control_set}
        if self.model:
            about = describe_model(self.model)
        return write_take(folder, self, model=about, fps=fps, start=start, force=force)

    def __repr__(self) -> str:
        applied = f", applied intensity {self.mean_applied_intensity:.2f}"
        return (
            f"<Performance of {self.recording.source!r}: {len(self.curves)} frames at "
            f"{self.curves.fps:g} fps, {self.recording.duration:.2f} s, "
            f"{len(self.curves.names)} controls, emotion {self.emotion}"
            f"{applied if self.has_emotion else ''}>"
        )


@dataclass(frozen=True, eq=False, repr=False)
class MeshPerformance:
    """A mesh that speaks a recording.

    Parameters
    ----------
    mesh : TriMesh
        The face at rest.
    vertices : array [shape=(T, V, 3)]
        In the mesh's unit; frame i is at i / fps seconds.
    fps : float
        Frames per second.
    unit_mm : float
        Millimetres in the mesh's unit.
    recording : Recording
        Its speech.
    landmarks : mapping of str to int or None
        Named vertices, where they are known: the embedded heads.
    colours : array [shape=(V, 3), range 0 to 1] or None
        Linear vertex colours, where there are any.
    """

    mesh: "TriMesh"
    vertices: Float32
    fps: float
    unit_mm: float
    recording: Recording
    landmarks: Mapping[str, int] | None = None
    colours: Float64 | None = None

    def save(self, target: str | Path, *, force: bool = False) -> Path:
        """Write the sequence: ``.glb``, ``.npz`` (vertices), or a folder of PLY files.

        Parameters, result and errors are those of `Performance.save`. A GLB's vertices are within
        0.02 mm of the model's.
        """
        from rig.files import check_file, check_folder
        from rig.mesh.sequence import check_out, write_sequence

        inputs = (self.recording.source,)
        if check_out(target) == "folder":
            check_folder(target, kind="frames", force=force, inputs=inputs)
        else:
            check_file(target, force=force, inputs=inputs)
        write_sequence(
            target,
            self.mesh,
            self.vertices,
            fps=self.fps,
            tolerance=GLB_TOLERANCE_MM / self.unit_mm,
            unit_metres=self.unit_mm / 1000,
            colours=self.colours,
        )
        return Path(target)

    def __repr__(self) -> str:
        frames, vertices, _ = self.vertices.shape
        return (
            f"<MeshPerformance of {self.recording.source!r}: {frames} frames at {self.fps:g} fps, "
            f"{frames / self.fps:.2f} s, {vertices} vertices>"
        )
