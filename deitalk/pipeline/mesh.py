"""Speech to a moving mesh, by any kind of model: ``deitalk mesh``.

::

    DEITalk   speech, emotion -> 185 curves -> the embedded head, or a user's mesh -> vertices
    SDFA      speech, speaker -> deformation gradients -> the speaker's template   -> vertices
    mesh head speech, emotion, speaker -> DEITalk's features -> gradients -> template -> vertices

Deviation: neither paper gives emotion to a mesh. With curves the mesh moves as the rig would, and
emotion, intensity and the closed lips reach it as they reach the rig; a mesh head
(`deitalk.models.mesh_head`) learns emotion from any captured mesh.
"""

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from math import ceil
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import torch

from deitalk.audio.arrays import Audio, recording_of
from deitalk.audio.frames import FRAME_RATE
from deitalk.audio.load import Recording
from deitalk.emotions import Direction, EmotionTrack
from deitalk.errors import CheckpointError, EmotionError
from deitalk.models.checkpoint import Model, load_model, require_model
from deitalk.models.curve_model import DEITalk
from deitalk.models.deformation_decoder import Coefficients
from deitalk.models.mesh_head import MeshHead
from deitalk.models.mesh_model import SDFA, MeshModel
from deitalk.models.network import neutral_and_acted
from deitalk.pipeline.arguments import check_progress, whole_seed
from deitalk.pipeline.curves import animate
from deitalk.pipeline.performance import GLB_TOLERANCE_MM, MeshPerformance, Performance
from deitalk.pipeline.speech import Speech, measure_intensities
from deitalk.postprocess.lip_seal import seal_lips
from rig.arrays import Float32
from rig.curves import snap_fps
from rig.face import build_head
from rig.face.head import UNIT_MM
from rig.face.identity import IDENTITIES
from rig.limits import PREDICTED_BYTES
from rig.mesh import TriMesh
from rig.mesh.trimesh import check_length
from rig.retarget.morph_head import srgb_to_linear
from rig.retarget.retarget_files import RetargetReport, retarget_curves, retarget_sequence
from rig.retarget.source_head import head_landmarks

Progress: TypeAlias = Callable[[float], None]

NO_EMOTION = (
    "an SDFA model has no emotion and no intensity; leave them out, or use a DEITalk model such as "
    "default"
)
NO_WORDS = "words move the curves of a DEITalk model such as default; a mesh model takes none"


def animate_mesh(
    audio: Audio,
    emotion: str | Path | Mapping[str, float] | EmotionTrack = "neutral",
    *,
    model: str | Path | Model = "default",
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
    model : str, Path, DEITalk, SDFA or MeshHead
        Name, folder or loaded model.
    speaker : str or int
        Name or number: an embedded head for DEITalk, a style for the others.
    fps : float, optional
        Rate of the frames: 30 by default for DEITalk; the others have one rate only.
    device : str
        ``cpu``, ``cuda``, ``cuda:N`` or ``mps``; for a model given by name or folder.
    progress : callable
        Called with the share of the work that is done, 0 to 1.
    **options
        More of `deitalk.animate`'s: intensity_curve, voice, idle, life, look_at, listen, gain,
        seed, transcript, phones, language.

    Returns
    -------
    MeshPerformance

    Raises
    ------
    DeitalkError, RigError
        One line each: the value, the rule and the way out.
    """
    direction = Direction.of(
        emotion, intensity, options.get("intensity_curve"), options.get("voice")
    )
    whole_seed(options.get("seed", 0))
    check_progress(progress)
    if fps is not None:
        fps = snap_fps(fps)
    recording = recording_of(audio, sample_rate)
    network = load_model(model, device=device) if isinstance(model, str | Path) else model
    if isinstance(network, MeshModel):
        if options.get("transcript") is not None or options.get("phones") is not None:
            raise CheckpointError(NO_WORDS)
        return _by_gradients(network.eval(), recording, speaker, fps, direction, progress)
    act = partial(animate, recording, emotion, intensity=intensity, progress=progress, **options)
    return _by_curves(require_model(network, DEITalk), act, recording, speaker, fps)


def predict_mesh(
    model: MeshModel,
    waveform: Any,
    speaker: str | int = 0,
    direction: Direction | None = None,
    template: TriMesh | None = None,
    *,
    sealed: bool = True,
) -> Float32:
    """Vertices of a whole recording, as a mesh model moves them.

    Parameters
    ----------
    model : SDFA or MeshHead
        In evaluation mode.
    waveform : array [shape=(S,)]
        16 kHz, any level.
    speaker : str or int
        Style, by name or number.
    direction : Direction, optional
        Emotion and intensity, for a mesh head only; neutral if not given.
    template : TriMesh, optional
        Face to move; it must have the templates' triangles. The speaker's own if not given.
    sealed : bool
        Close lips that nearly meet, if the model's `seal_mm` is not 0.

    Returns
    -------
    array [shape=(T, V, 3)]
        In the template's unit; frame i is at i / fps seconds, T = ceil(fps S / 16000).

    Raises
    ------
    AudioError
        If the waveform is not one row of finite samples.
    EmotionError
        If the model has no emotion and the direction is not neutral.
    """
    frames = mesh_frames(model, waveform, speaker, direction, template, sealed=sealed)
    return np.concatenate(list(frames))


def mesh_frames(
    model: MeshModel,
    waveform: Any,
    speaker: str | int = 0,
    direction: Direction | None = None,
    template: TriMesh | None = None,
    *,
    sealed: bool = True,
) -> Iterator[Float32]:
    """As `predict_mesh`, some frames at a time [shape=(T, V, 3)]."""
    mesh = model.template(speaker) if template is None else template
    reach_mm = model.config.seal_mm if sealed else 0.0
    for motion in model.expand(mesh_coefficients(model, waveform, speaker, direction)):
        yield seal_lips(model.vertices(motion, mesh), reach_mm, model.unit_mm)


@torch.no_grad()
def mesh_coefficients(
    model: MeshModel,
    waveform: Any,
    speaker: str | int = 0,
    direction: Direction | None = None,
) -> Iterator[Coefficients]:
    """Coefficients (T, K) of a recording, some frames at a time; arguments as `predict_mesh`."""
    direction, speech = direction or Direction.of(), Speech.of(waveform)
    if isinstance(model, MeshHead):
        return _head_coefficients(model, speech, speaker, direction)
    if not direction.is_neutral:
        raise EmotionError(NO_EMOTION)
    assert isinstance(model, SDFA)
    return model.coefficients(torch.from_numpy(speech.sound), speaker)


def _head_coefficients(
    model: MeshHead, speech: Speech, speaker: str | int, direction: Direction
) -> Iterator[Coefficients]:
    network = model.encoder.network
    analysis = network.analyse(torch.from_numpy(speech.sound), speech.n_frames)
    weights = np.stack(neutral_and_acted(direction.emotion.at(speech.times)))
    described = network.describe(analysis, torch.from_numpy(weights).to(network.device))
    scale = measure_intensities(speech, analysis.tracks, direction).scale
    readings = described[0], described[-1]
    return model.coefficients(
        *readings, torch.from_numpy(scale), torch.from_numpy(speech.shown), speaker
    )


def _by_curves(
    network: DEITalk,
    act: Callable[..., Performance],
    recording: Recording,
    speaker: str | int,
    fps: float | None,
) -> MeshPerformance:
    """An embedded head in the poses of the curves."""
    rate = float(FRAME_RATE) if fps is None else fps
    head = build_head(speaker)
    check_length(ceil(recording.duration * rate), len(head.mesh.vertices), most=PREDICTED_BYTES)
    acted = act(model=network)
    curves = acted.curves
    return MeshPerformance(
        TriMesh(head.mesh.vertices, head.mesh.faces),
        head.pose((curves if fps is None else curves.resample(fps)).values),
        rate,
        UNIT_MM,
        acted.recording,
        head_landmarks(head),
        srgb_to_linear(head.mesh.colors),
    )


def _by_gradients(
    network: MeshModel,
    recording: Recording,
    speaker: str | int,
    fps: float | None,
    direction: Direction,
    progress: Progress,
) -> MeshPerformance:
    """A speaker's template, moved by a mesh model."""
    if fps is not None and fps != network.fps:
        raise CheckpointError(
            f"fps={fps:g}: this SDFA model makes {network.fps:g} frames a second; leave it out"
        )
    mesh = network.template(speaker)
    n_frames = ceil(recording.duration * network.fps)
    check_length(n_frames, len(mesh.vertices), most=PREDICTED_BYTES)
    parts: list[Float32] = []
    for vertices in mesh_frames(network, recording.waveform, speaker, direction):
        parts.append(vertices)
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
    """Landmarks of a template that is an embedded head's skin; None for any other."""
    if name not in {person.name for person in IDENTITIES}:
        return None
    head = build_head(name)
    same = np.array_equal(head.skin.faces, mesh.faces)
    return head_landmarks(head) if same else None


def retarget_speech(
    audio: Audio,
    mesh: Path,
    out: str | Path,
    emotion: str | Path | Mapping[str, float] | EmotionTrack = "neutral",
    *,
    landmarks: Path | None = None,
    model: str | Path = "default",
    fps: float | None = None,
    device: str = "cpu",
    progress: Progress = lambda share: None,
    **options: Any,
) -> tuple[RetargetReport, float, tuple[str, ...]]:
    """Animate a user's mesh from speech and write it.

    Curves drive the mesh's own shapes, or shapes made for it; a mesh model's sequence is carried
    to it vertex by vertex.

    Parameters
    ----------
    audio, emotion, model, fps, device, progress
        As for `animate_mesh`.
    mesh, out, landmarks
        As for `rig.retarget.retarget_files.retarget_curves`.
    **options
        More of `animate_mesh`'s: speaker, intensity, intensity_curve, idle,
        life, look_at, listen, seed, transcript, phones, language.

    Returns
    -------
    report : RetargetReport
    fps : float
        Frames per second written.
    notes : tuple of str
        Of the recording and of the retargeting.
    """
    network = load_model(model, device=device)
    if isinstance(network, MeshModel):
        moved = animate_mesh(audio, emotion, model=network, fps=fps, progress=progress, **options)
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
    options.pop("speaker", None)
    acted = animate(audio, emotion, model=network, progress=progress, **options)
    curves = acted.curves if fps is None else acted.curves.resample(fps)
    report = retarget_curves(curves, mesh, out, landmarks=landmarks)
    return report, curves.fps, (*acted.recording.warnings, *report.notes)
