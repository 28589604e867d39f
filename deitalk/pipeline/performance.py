"""What `deitalk.animate` returns: curves, tracks and the recording, and how they are saved."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from deitalk.audio.load import Recording
from rig import RigCurves
from rig.arrays import Float32


@dataclass(frozen=True, repr=False)
class Performance:
    """A face acted to a recording.

    All tracks share one time axis: row i is time i / 30 s of the recording.

    Attributes
    ----------
    curves : RigCurves
        The result, with the emotion weights and the applied intensity as tracks.
    neutral : RigCurves
        The neutral reading of the same speech: what intensity 0 gives.
    saliency : array [shape=(T,), range -1 to 1]
        Emotional saliency e_sim (DEITalk Eq. 5).
    predicted : array [shape=(T,), range 0 to 1]
        Intensity heard in the voice.
    recording : Recording
        What it was acted to.
    clipped : int
        Values that had to be clamped to their control's range.
    timings : dict of str to float
        Seconds spent per stage.
    settings : mapping
        What was asked for: emotion, intensity, intensity_curve, idle, seed.
    model : str
        Name or folder of the model; empty for a network that was passed in.
    """

    curves: RigCurves
    neutral: RigCurves
    saliency: Float32
    predicted: Float32
    recording: Recording
    clipped: int
    timings: dict[str, float] = field(default_factory=dict)
    settings: Mapping[str, Any] = field(default_factory=dict)
    model: str = ""

    @property
    def has_emotion(self) -> bool:
        """Whether any frame is other than neutral."""
        emotion = self.curves.emotion
        return emotion is not None and bool((emotion[:, 0] < 1).any())

    @property
    def mean_intensity(self) -> float:
        """Intensity heard in the voice, on average over the frames."""
        return float(self.predicted.mean()) if len(self.predicted) else 0.0

    @property
    def mean_applied_intensity(self) -> float:
        """Intensity of the emotion in the curves, on average over the frames; 0 for neutral."""
        applied = self.curves.intensity
        if applied is None or not len(applied) or not self.has_emotion:
            return 0.0
        return float(applied.mean())

    def save(self, target: str | Path, *, fps: float | None = None, force: bool = False) -> Path:
        """Write a take folder, or one file of curves.

        Parameters
        ----------
        target : str or Path
            A name that ends with a suffix of curves (``.csv``, ``.json``, ``.npz`` …) is a file;
            one without suffix, with a slash at its end, or of an existing folder is a folder (see
            `rig.files.is_folder_name`).
        fps : float, optional
            Rate of the written curves, Hz; 30 by default.
        force : bool
            Replace a file, or the files of a take, that are there.

        Returns
        -------
        Path
            What was written.

        Raises
        ------
        RigError
            If the target must not or cannot be written, or its suffix is unknown.
        """
        from rig.files import is_folder_name
        from rig.formats.table import writable_suffixes

        if is_folder_name(target, writable_suffixes()):
            return self._save_take(Path(target), fps, force)
        from rig.files import check_file
        from rig.formats import write_curves

        check_file(target, force=force, inputs=(self.recording.source,))
        write_curves(target, self.curves, fps=fps)
        return Path(target)

    def _save_take(self, folder: Path, fps: float | None, force: bool) -> Path:
        from deitalk.models.checkpoint import describe_model
        from deitalk.pipeline.take import write_take

        about: dict[str, Any] = {"name": "passed in", "control_set": self.curves.control_set}
        if self.model:
            about = describe_model(self.model)
        settings = dict(self.settings)
        return write_take(folder, self, settings=settings, model=about, fps=fps, force=force)

    def __repr__(self) -> str:
        applied = f", applied intensity {self.mean_applied_intensity:.2f}"
        return (
            f"<Performance of {self.recording.source!r}: {len(self.curves)} frames at "
            f"{self.curves.fps:g} fps, {self.recording.duration:.2f} s, "
            f"{len(self.curves.names)} controls, emotion {self.settings.get('emotion', '?')}"
            f"{applied if self.has_emotion else ''}>"
        )
