"""Speech to a moving mesh, by either kind of model: ``deitalk mesh``.

::

    DEITalk   speech, emotion -> 185 curves -> the embedded head, or a user's mesh -> vertices
    SDFA      speech, speaker -> deformation gradients -> the speaker's template   -> vertices
    mesh head speech, emotion, speaker -> DEITalk's features -> gradients -> template -> vertices

Deviation: neither paper gives emotion to a mesh. With curves the mesh follows what the rig would
do, and emotion, intensity and the seal of the lips reach it as they reach the rig; a mesh head
(`deitalk.models.mesh_head`) learns it, and takes the way that any captured mesh could be learnt.

Letters: T frames, V vertices.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import ceil
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from deitalk.audio.arrays import Audio, recording_of
from deitalk.audio.load import Recording
from deitalk.errors import CheckpointError, EmotionError
from deitalk.models.checkpoint import model_folder, read_about
from deitalk.pipeline.arguments import (
    applied_curve,
    check_progress,
    emotion_track,
    intensity_factor,
    whole_seed,
)
from deitalk.pipeline.curves import animate
from rig.arrays import Float32, Float64
from rig.curves import snap_fps
from rig.errors import quoted
from rig.face import build_head
from rig.face.identity import IDENTITIES
from rig.limits import PREDICTED_BYTES
from rig.mesh import TriMesh
from rig.mesh.sequence import check_out, write_sequence
from rig.mesh.trimesh import check_length
from rig.retarget.morph_head import srgb_to_linear
from rig.retarget.source_head import head_landmarks

if TYPE_CHECKING:
    from deitalk.emotions import EmotionTrack
    from deitalk.models.curve_model import DEITalk
    from deitalk.models.mesh_head import Direction
    from deitalk.models.mesh_model import SDFA

Progress = Callable[[float], None]

GLB_TOLERANCE_MM = 0.02
"""Furthest a vertex of a GLB may be from where the model put it."""
HEAD_UNIT_MM = 10.0
"""The embedded head is in centimetres."""


@dataclass(frozen=True, eq=False, repr=False)
class MeshPerformance:
    """A mesh acted to a recording.

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
        What it was acted to.
    landmarks : mapping of str to int or None
        Named vertices, where they are known: the embedded heads.
    colours : array [shape=(V, 3), range 0 to 1] or None
        Linear vertex colours, where there are any.
    """

    mesh: TriMesh
    vertices: Float32
    fps: float
    unit_mm: float
    recording: Recording
    landmarks: Mapping[str, int] | None = None
    colours: Float64 | None = None

    def save(self, target: str | Path, *, force: bool = False) -> Path:
        """Write the sequence: ``.glb``, ``.npz`` (vertices), or a folder of PLY files.

        Parameters
        ----------
        target : str or Path
            A folder is a name without suffix, with a slash at its end, or an existing folder (see
            `rig.files.is_folder_name`). A GLB's vertices are within 0.02 mm of the model's.
        force : bool
            Replace a file, or the frames of a sequence, that are there.

        Returns
        -------
        Path
            What was written.

        Raises
        ------
        RigError
            If the target must not or cannot be written, or its suffix is unknown.
        """
        from rig.files import check_file, check_folder

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


def is_sdfa(model: str | Path) -> bool:
    """Whether a model folder's model moves meshes rather than curves; imports no torch."""
    return read_about(model_folder(model)).get("kind") == "sdfa"


def animate_mesh(
    audio: Audio,
    emotion: "str | Path | Mapping[str, float] | EmotionTrack" = "neutral",
    *,
    model: "str | Path | DEITalk | SDFA" = "default",
    sample_rate: float | None = None,
    speaker: str | int = 0,
    intensity: float = 1.0,
    fps: float | None = None,
    device: str = "cpu",
    progress: Progress = lambda share: None,
    **options: Any,
) -> MeshPerformance:
    """Animate a mesh from speech.

    Parameters
    ----------
    audio, sample_rate
        As for `deitalk.animate`.
    emotion, intensity
        As for `deitalk.animate`. An SDFA model has no input for them, a mesh head has.
    model : str, Path, DEITalk or SDFA
        Name, folder or loaded model of either kind.
    speaker : str or int
        Name or number: an embedded head for DEITalk, a style for SDFA.
    fps : float, optional
        Rate of the frames: 30 for DEITalk, the model's own for SDFA, which has no other.
    device : str
        ``cpu``, ``cuda``, ``cuda:N`` or ``mps``; for a model that is not loaded yet.
    progress : callable
        Told the share of the work that is done, 0 to 1.
    **options
        More of `deitalk.animate`'s: intensity_curve, idle, seed.

    Returns
    -------
    MeshPerformance

    Raises
    ------
    DeitalkError, RigError
        One line each: the value, the rule and the way out.
    """
    emotion_track(emotion)
    intensity_factor(intensity)
    applied_curve(options.get("intensity_curve"))
    whole_seed(options.get("seed", 0))
    check_progress(progress)
    if fps is not None:
        fps = snap_fps(fps)
    recording = recording_of(audio, sample_rate)
    network = _loaded(model, device)
    if hasattr(network, "predict_mesh"):
        curve = options.get("intensity_curve")
        direction = _direction(network, emotion, intensity, curve)
        return _by_gradients(network, recording, speaker, fps, direction, progress)
    rate = 30.0 if fps is None else fps
    head = build_head(speaker)
    check_length(ceil(recording.duration * rate), len(head.mesh.vertices), most=PREDICTED_BYTES)
    performance = animate(
        recording, emotion, model=network, intensity=intensity, progress=progress, **options
    )
    curves = performance.curves if fps is None else performance.curves.resample(fps)
    return MeshPerformance(
        TriMesh(head.mesh.vertices, head.mesh.faces),
        head.pose(curves.values),
        rate,
        HEAD_UNIT_MM,
        recording,
        head_landmarks(head),
        srgb_to_linear(head.mesh.colors),
    )


def _loaded(model: Any, device: str) -> Any:
    if not isinstance(model, str | Path):
        if not hasattr(model, "eval"):
            raise CheckpointError(
                f"model {quoted(model)} is a {type(model).__name__}; give a name, a folder or a "
                "loaded model"
            )
        return model.eval()
    if is_sdfa(model):
        from deitalk.models.mesh_checkpoint import load_sdfa

        return load_sdfa(model, device=device)
    from deitalk.models.checkpoint import load_model

    return load_model(model, device=device)


def _direction(network: "SDFA", emotion: Any, intensity: float, curve: Any) -> "Direction | None":
    """What is asked of a mesh head; None of another model, of which nothing may be asked."""
    from deitalk.models.mesh_head import Direction, MeshHead
    from deitalk.models.mesh_model import NO_EMOTION

    if isinstance(network, MeshHead):
        return Direction.of(emotion, intensity, curve)
    if emotion != "neutral" or intensity != 1 or curve is not None:
        raise EmotionError(NO_EMOTION)
    return None


def _by_gradients(
    network: "SDFA",
    recording: Recording,
    speaker: str | int,
    fps: float | None,
    direction: "Direction | None",
    progress: Progress,
) -> MeshPerformance:
    if fps is not None and fps != network.fps:
        raise CheckpointError(
            f"fps={fps:g}: this SDFA model makes {network.fps:g} frames a second; leave it out"
        )
    mesh = network.template(speaker)
    n_frames = ceil(recording.duration * network.fps)
    check_length(n_frames, len(mesh.vertices), most=PREDICTED_BYTES)
    parts: list[Float32] = []
    for motion in network.pieces(recording.waveform, speaker, direction):
        parts.append(network.vertices(motion, mesh))
        progress(min(sum(map(len, parts)) / max(n_frames, 1), 1.0))
    name = speaker if isinstance(speaker, str) else network.speakers[speaker]
    return MeshPerformance(
        mesh,
        np.concatenate(parts),
        network.fps,
        network.unit_mm,
        recording,
        _known_landmarks(mesh, name),
    )


def _known_landmarks(mesh: TriMesh, name: str) -> Mapping[str, int] | None:
    """Landmarks of a template that is an embedded head's skin; None of another."""
    if name not in {person.name for person in IDENTITIES}:
        return None
    head = build_head(name)
    same = np.array_equal(head.skin.faces, mesh.faces)
    return head_landmarks(head) if same else None
