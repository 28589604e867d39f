"""Emotion on a mesh: a mesh head compared with the rig posed by the same network's curves.

Letters: T frames, V vertices.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from deitalk.acting import Acting
from deitalk.audio.load import Recording, load_audio
from deitalk.emotions import EMOTIONS
from deitalk.models.mesh_head import MeshHead
from deitalk.pipeline.curves import animate
from deitalk.research.meshes.predict import predict_mesh
from rig.arrays import Float32
from rig.face import build_head

Act = Callable[[str, float], Float32]

INTENSITIES = (0.5, 1.0, 1.5)
MOST = 3
"""Recordings that are animated in every emotion."""
PLACES = {"corners": "mouth_corner", "brows": "brow"}
"""Landmarks, left and right, whose rise is measured."""
ACTORS = ("model", "curves")


def acted_by_curves(
    model: MeshHead,
    audio: Path | Recording,
    speaker: str,
    emotion: str,
    intensity: float = 1.0,
) -> Float32:
    """Skin (T, V, 3) of an embedded head posed by the curves of the mesh head's DEITalk model."""
    performance = animate(
        audio, emotion, model=model.encoder.network, intensity=intensity, life="off"
    )
    head = build_head(speaker)
    return head.pose(performance.curves.values)[:, head.slices["cage"]]


def acted_by_model(
    model: MeshHead, audio: Recording, speaker: str, emotion: str, intensity: float = 1.0
) -> Float32:
    """Skin (T, V, 3) of a mesh head."""
    acting = Acting.of(emotion=emotion, intensity=intensity)
    return predict_mesh(model, audio.waveform, speaker, acting)


def expression_probe(model: MeshHead, recordings: Sequence[Path]) -> dict[str, Any]:
    """Rise of the corners of the mouth and of the brows by emotion, at three intensities.

    Parameters
    ----------
    model : MeshHead
        In evaluation mode; it moves the embedded heads.
    recordings : sequence of Path
        `MOST` of them, evenly spread, are animated in every emotion.

    Returns
    -------
    dict
        ``corners`` and ``brows``: by emotion, ``model`` and ``curves``: mean rise over the neutral
        reading at each of `INTENSITIES`, mm.
    """
    unique = sorted(set(recordings))
    places = np.linspace(0, len(unique) - 1, min(MOST, len(unique))).astype(int)
    found: dict[tuple[str, str, str], list[list[float]]] = {}
    for i, place in enumerate(places):
        recording, speaker = load_audio(unique[place]), model.speakers[i % len(model.speakers)]
        marks = build_head(speaker).landmarks
        for who, way in zip(ACTORS, (acted_by_model, acted_by_curves), strict=True):
            one = partial(way, model, recording, speaker)
            for (where, emotion), rises in _rises(one, marks, model.unit_mm).items():
                found.setdefault((where, emotion, who), []).append(rises)
    means = {key: np.mean(rows, axis=0).tolist() for key, rows in found.items()}
    return {
        where: {e: {who: means[where, e, who] for who in ACTORS} for e in EMOTIONS[1:]}
        for where in PLACES
    }


def _rises(
    act: Act, marks: Mapping[str, int], unit_mm: float
) -> dict[tuple[str, str], list[float]]:
    """Mean rise over the neutral reading by place and emotion, at each intensity, mm."""
    plain = act("neutral", 1.0).mean(axis=0)
    out = {}
    for emotion in EMOTIONS[1:]:
        moved = [act(emotion, amount).mean(axis=0) - plain for amount in INTENSITIES]
        for where, landmark in PLACES.items():
            both = [marks[f"{landmark}_{side}"] for side in ("left", "right")]
            out[where, emotion] = [unit_mm * float(mean[both, 1].mean()) for mean in moved]
    return out


def expression_table(expression: Mapping[str, Any]) -> list[str]:
    """Lines of a Markdown table: rise by landmark, emotion and intensity."""
    amounts = " / ".join(f"{amount:g}" for amount in INTENSITIES)
    lines = [
        f"Mean rise over the neutral reading at intensity {amounts}, mm.",
        "",
        "| | | mesh head | the rig with the curves |",
        "|---|---|---|---|",
    ]
    for where, emotions in expression.items():
        for emotion, rises in emotions.items():
            cells = (" / ".join(f"{mm:.2f}" for mm in rises[who]) for who in ACTORS)
            lines.append(f"| {where} | {emotion} | " + " | ".join(cells) + " |")
    return lines
