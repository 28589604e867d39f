"""Vertices of a whole recording, as a mesh model moves them."""

from typing import Any

import numpy as np

from deitalk.acting import Acting
from deitalk.models.mesh_model import MeshModel
from deitalk.pipeline.mesh import mesh_frames
from rig.arrays import Float32
from rig.mesh.trimesh import TriMesh


def predict_mesh(
    model: MeshModel,
    waveform: Any,
    speaker: str | int = 0,
    acting: Acting | None = None,
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
    acting : Acting, optional
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
        If the model has no emotion and the acting is not neutral.
    """
    frames = mesh_frames(model, waveform, speaker, acting, template, sealed=sealed)
    return np.concatenate(list(frames))
