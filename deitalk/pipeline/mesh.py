"""Speech to a moving mesh, by any kind of model: ``deitalk animate --vertices``.

::

    DEITalk   speech, emotion -> 185 curves -> the embedded head, or a user's mesh -> vertices
    SDFA      speech, speaker -> deformation gradients -> the speaker's template   -> vertices
    mesh head speech, emotion, speaker -> DEITalk's features -> gradients -> template -> vertices

Deviation: neither paper gives emotion to a mesh. With curves the mesh moves as the rig would, and
emotion, intensity and the closed lips reach it as they reach the rig; a mesh head
(`deitalk.models.mesh_model`) learns emotion from any captured mesh.
"""

from collections.abc import Callable, Iterator, Mapping
from math import ceil
from pathlib import Path
from typing import Any, TypeAlias, cast

import numpy as np
import torch

from deitalk.acting import Acting, acted_as
from deitalk.acting_fields import AUTO
from deitalk.audio.arrays import Audio, recording_of
from deitalk.audio.choice import AudioChoice
from deitalk.audio.frames import FRAME_RATE
from deitalk.audio.load import Recording
from deitalk.emotions import EmotionTrack
from deitalk.errors import CheckpointError, DeitalkError, EmotionError
from deitalk.models.checkpoint import Model, load_model, require_model
from deitalk.models.curve_model import DEITalk
from deitalk.models.deformation_decoder import Coefficients
from deitalk.models.mesh_head import MeshHead
from deitalk.models.mesh_model import SDFA, MeshModel
from deitalk.models.protocol import neutral_and_acted, trained_weights
from deitalk.pipeline.curves import animate, check_progress
from deitalk.pipeline.mesh_performance import GLB_TOLERANCE_MM, MeshPerformance
from deitalk.pipeline.speech import Speech, measure_intensities
from deitalk.postprocess.lip_seal import known_skin, seal_lips
from rig.arrays import Float32
from rig.controls import DEFAULT_ID
from rig.curves import snap_fps
from rig.face import build_head
from rig.face.head import UNIT_MM
from rig.face.identity import Identity
from rig.limits import PREDICTED_BYTES
from rig.mesh import TriMesh
from rig.mesh.trimesh import check_length
from rig.retarget.morph_head import painted_colours
from rig.retarget.retarget_files import RetargetReport, retarget_curves, retarget_sequence

Progress: TypeAlias = Callable[[float], None]

NO_EMOTION = (
    "an SDFA model has no emotion and no intensity; leave them out, or use a DEITalk model such as "
    "default"
)
TO_MESH_MODELS = ("emotion", "intensity", "intensity_curve", "voice")
"""Fields of an acting that a mesh head takes."""


def animate_mesh(
    audio: Audio,
    emotion: str | Path | Mapping[str, float] | EmotionTrack = "neutral",
    *,
    acting: Acting | None = None,
    model: str | Path | Model = "default",
    sample_rate: float | None = None,
    track: int | None = None,
    channel: str | int | None = None,
    raw: str | None = None,
    speaker: str | int | Identity = 0,
    fps: float | None = None,
    device: str = "cpu",
    progress: Progress = lambda share: None,
    **fields: Any,
) -> MeshPerformance:
    """Animate a mesh from speech.

    Parameters
    ----------
    audio, sample_rate, track, channel, raw
        As for `deitalk.animate`.
    emotion, acting, fields
        As for `deitalk.animate`. An SDFA model takes none; a mesh head takes emotion, intensity,
        intensity_curve and voice.
    model : str, Path, DEITalk, SDFA or MeshHead
        Name, folder or loaded model.
    speaker : str, int or Identity
        Name or number: an embedded head for DEITalk, a style for the others. A head of your own
        for DEITalk is the `rig.face.Identity` of its file.
    fps : float, optional
        Rate of the frames: 30 by default for DEITalk; the others have one rate only.
    device : str
        ``cpu``, ``cuda``, ``cuda:N`` or ``mps``; for a model given by name or folder.
    progress : callable
        Called with the share of the work that is done, 0 to 1.

    Returns
    -------
    MeshPerformance

    Raises
    ------
    DeitalkError, RigError
        One line each: the value, the rule and the way out.
    """
    check_progress(progress)
    acted = acted_as(emotion, acting, fields, animate_mesh)
    if fps is not None:
        fps = snap_fps(fps)
    recording = recording_of(audio, sample_rate, AudioChoice.of(track, channel, raw))
    network = load_model(model, device=device) if isinstance(model, str | Path) else model
    if getattr(network, "product", None) == "mesh":
        others = [name for name in acted.settings if name not in TO_MESH_MODELS]
        if others or acted.emotion == AUTO:
            raise CheckpointError(
                f"{', '.join(others) or 'emotion auto'}: a mesh model takes "
                f"{', '.join(TO_MESH_MODELS)} alone; leave the others out, or use a DEITalk model "
                "such as default"
            )
        if isinstance(speaker, Identity):
            raise CheckpointError(
                f"{speaker.file or speaker.name} is a head for curves, and this model moves faces "
                "of its own; leave out the identity or the model, or move a mesh of yours"
            )
        mesh_model = require_model(network, MeshModel)
        if fps not in (None, mesh_model.fps):
            raise CheckpointError(
                f"fps={fps:g}: this SDFA model makes {mesh_model.fps:g} frames a second; leave it "
                "out"
            )
        return _by_gradients(mesh_model, recording, speaker, acted, progress)
    # A head in the poses of the curves.
    curve_model, rate = require_model(network, DEITalk), float(fps or FRAME_RATE)
    if curve_model.controls.id != DEFAULT_ID:
        raise CheckpointError(
            f"the model is of the rig {curve_model.controls.id}, which has no head here; `deitalk "
            "retarget` moves your own face by its take"
        )
    head = build_head(speaker)
    check_length(ceil(recording.duration * rate), len(head.mesh.vertices), most=PREDICTED_BYTES)
    performance = animate(recording, acting=acted, model=curve_model, progress=progress)
    return MeshPerformance(
        TriMesh(head.mesh.vertices, head.mesh.faces),
        head.pose(performance.at(fps)[0].values),
        rate,
        UNIT_MM,
        performance.recording,
        head.landmarks or None,
        painted_colours(head),
    )


def mesh_frames(
    model: MeshModel,
    waveform: Any,
    speaker: str | int = 0,
    acting: Acting | None = None,
    template: TriMesh | None = None,
    *,
    sealed: bool = True,
) -> Iterator[Float32]:
    """Predict as `predict_mesh` does, some frames at a time [shape=(T, V, 3)]."""
    mesh = model.template(speaker) if template is None else template
    reach_mm = model.config.seal_mm if sealed else 0.0
    for motion in model.expand(mesh_coefficients(model, waveform, speaker, acting)):
        yield seal_lips(model.vertices(motion, mesh), reach_mm, model.unit_mm)


@torch.no_grad()
def mesh_coefficients(
    model: MeshModel,
    waveform: Any,
    speaker: str | int = 0,
    acting: Acting | None = None,
) -> Iterator[Coefficients]:
    """Coefficients (T, K) of a recording, some frames at a time; arguments as `predict_mesh`."""
    acting, speech = acting or Acting(), Speech.of(waveform)
    if not model.has_emotion:
        if acting.settings.keys() & {*TO_MESH_MODELS}:
            raise EmotionError(NO_EMOTION)
        return cast("SDFA", model).coefficients(torch.from_numpy(speech.sound), speaker)
    head = cast("MeshHead", model)
    network = head.encoder.network
    analysis = network.analyse(torch.from_numpy(speech.sound), speech.n_frames)
    weights = np.stack(neutral_and_acted(trained_weights(acting.emotion_track.at(speech.times))))
    described = network.describe(analysis, torch.from_numpy(weights).to(network.device))
    scale = measure_intensities(speech, analysis.tracks, acting).scale
    share = torch.from_numpy(speech.share(0.0))  # of the whole face, the mouth as well
    readings = described[0], described[-1]
    return head.coefficients(*readings, torch.from_numpy(scale), share, speaker)


def _by_gradients(
    network: MeshModel,
    recording: Recording,
    speaker: str | int,
    acting: Acting,
    progress: Progress,
) -> MeshPerformance:
    """A speaker's template, moved by a mesh model."""
    mesh = network.template(speaker)
    skin = known_skin(mesh)
    n_frames = ceil(recording.duration * network.fps)
    check_length(n_frames, len(mesh.vertices), most=PREDICTED_BYTES)
    parts: list[Float32] = []
    for vertices in mesh_frames(network, recording.waveform, speaker, acting):
        parts.append(vertices)
        progress(min(sum(map(len, parts)) / max(n_frames, 1), 1.0))
    return MeshPerformance(
        mesh,
        np.concatenate(parts),
        network.fps,
        network.unit_mm,
        recording,
        None if skin is None else skin.landmarks,
    )


def retarget_speech(
    audio: Audio,
    mesh: Path,
    out: str | Path,
    emotion: str | Path | Mapping[str, float] | EmotionTrack = "neutral",
    *,
    acting: Acting | None = None,
    landmarks: Path | None = None,
    track: int | None = None,
    channel: str | int | None = None,
    raw: str | None = None,
    model: str | Path = "default",
    speaker: str | int | Identity = 0,
    fps: float | None = None,
    device: str = "cpu",
    progress: Progress = lambda share: None,
    **fields: Any,
) -> tuple[RetargetReport, float, tuple[str, ...]]:
    """Animate a user's mesh from speech and write it.

    Curves drive the mesh's own shapes, or shapes made for it; a mesh model's sequence is carried
    to it vertex by vertex.

    Parameters
    ----------
    audio, emotion, acting, track, channel, raw, model, speaker, fps, device, progress, fields
        As for `animate_mesh`.
    mesh, out, landmarks
        As for `rig.retarget.retarget_files.retarget_curves`.

    Returns
    -------
    report : RetargetReport
    fps : float
        Frames per second written.
    notes : tuple of str
        Of the recording and of the retargeting.
    """
    acted = acted_as(emotion, acting, fields, retarget_speech)
    audio = recording_of(audio, choice=AudioChoice.of(track, channel, raw))
    network = load_model(model, device=device)
    if network.product == "mesh":
        moved = animate_mesh(
            audio, acting=acted, model=network, speaker=speaker, fps=fps, progress=progress
        )
        report = retarget_sequence(
            moved.mesh,
            moved.vertices,
            mesh,
            out,
            fps=moved.fps,
            tolerance=GLB_TOLERANCE_MM / moved.unit_mm,
            source_landmarks=moved.landmarks,
            landmarks=landmarks,
        )
        return report, moved.fps, (*moved.recording.warnings, *report.notes)
    if speaker:
        raise DeitalkError(
            f"identity {getattr(speaker, 'name', speaker)} is a head of ours, and a mesh of your "
            "own is moved; leave one out"
        )
    performance = animate(
        audio, acting=acted, model=require_model(network, DEITalk), progress=progress
    )
    curves, _ = performance.at(fps)
    report = retarget_curves(curves, mesh, out, landmarks=landmarks)
    return report, curves.fps, (*performance.recording.warnings, *report.notes)
