"""Score a mesh model on held-out speech: ``python -m deitalk.research evaluate MODEL --data DIR``.

The ground truth is an embedded head posed by the curves of a dataset folder; the model's input is
the recordings. Errors are distances in mm on a head of known size.

Letters: T frames, V vertices, P facing pairs of the lips' rims.
"""

from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from deitalk.acting import Acting
from deitalk.data.clips import Clip, read_phones
from deitalk.emotions import EMOTIONS
from deitalk.errors import CheckpointError, DataError
from deitalk.models.mesh_head import MeshHead
from deitalk.models.mesh_model import MeshModel
from deitalk.postprocess.lip_seal import seal_lips
from deitalk.postprocess.phones import BILABIALS, CLEAR_SECONDS, NEAR_LIPS, VOWELS, WIDEN_FRAMES
from deitalk.research.meshes.emotion_scores import (
    acted_by_curves,
    expression_probe,
    expression_table,
)
from deitalk.research.meshes.folder import Lips
from deitalk.research.meshes.predict import predict_mesh
from deitalk.research.meshes.sources import act, acted_clips, head_lips
from rig.arrays import Float32, Float64
from rig.face import build_head
from rig.face.identity import IDENTITIES

Phones = Sequence[tuple[float, float, str]]

CLOSED_MM = 1.0
"""Largest gap of closed lips, mm."""
WINDOW_SECONDS = WIDEN_FRAMES / 30
"""Widening of a bilabial's window, seconds; its gap is the smallest within."""
EMOTION = "neutral"
"""The emotion of SDFA, which has no input for emotion."""


def lip_gap(vertices: NDArray[Any], lips: Lips, unit_mm: float) -> Float64:
    """Mean distance of the facing pairs over the middle half of the mouth.

    Parameters
    ----------
    vertices : array [shape=(T, V, 3)]
        In units of `unit_mm`.
    lips : Lips
        Rims, from corner to corner.
    unit_mm : float
        Millimetres in a unit.

    Returns
    -------
    array [shape=(T,), mm]
        0 where the lips meet; lips that intersect have the gap of their distance.
    """
    quarter = len(lips.upper) // 4
    middle = slice(quarter, len(lips.upper) - quarter)
    apart = vertices[:, lips.upper[middle]] - vertices[:, lips.lower[middle]]
    return np.asarray(unit_mm * np.linalg.norm(apart.astype(np.float64), axis=-1).mean(axis=1))


def smallest_gaps(
    gap: Float64, phones: Phones, fps: float
) -> tuple[list[float], list[float], list[float]]:
    """Smallest gap at every bilabial, at every bilabial after an /s/, and in every clear vowel.

    Parameters
    ----------
    gap : array [shape=(T,), mm]
        From `lip_gap`.
    phones : sequence of (start, end, name)
        Seconds and ARPABET names.
    fps : float
        Frames per second of `gap`.

    Returns
    -------
    bilabials, after_s, vowels : list of float, mm
        A vowel is clear if it is 67 ms away from every p b m f v w.
    """
    times = np.arange(len(gap)) / fps
    plain = [(start, end, name.rstrip("012")) for start, end, name in phones]
    busy = [(start, end) for start, end, name in plain if name in NEAR_LIPS]
    bilabials: list[float] = []
    after_s: list[float] = []
    vowels: list[float] = []
    for (_, _, before), (start, end, name) in pairwise([(0.0, 0.0, ""), *plain]):
        slack = WINDOW_SECONDS if name in BILABIALS else 0.0
        window = (times >= start - slack - 1e-9) & (times <= end + slack + 1e-9)
        if not window.any():
            continue
        smallest = float(gap[window].min())
        if name in BILABIALS:
            bilabials.append(smallest)
            if before == "S":
                after_s.append(smallest)
        elif name in VOWELS and all(
            end + CLEAR_SECONDS <= b or start - CLEAR_SECONDS >= e for b, e in busy
        ):
            vowels.append(smallest)
    return bilabials, after_s, vowels


class Tally:
    """Scores collected over the clips of one source, of the model or of the ground truth."""

    def __init__(self) -> None:
        self.clips = 0
        self.errors: dict[str, list[Float64]] = {}
        self.gaps: dict[str, list[float]] = {
            f"{who}_{kind}": []
            for who in ("model", "unsealed", "curves", "truth")
            for kind in ("bilabial", "after_s", "vowel")
        }

    def summary(self) -> dict[str, float]:
        """Means over frames, shares and medians over phones."""
        out: dict[str, float] = {"clips": float(self.clips)}
        out |= {name: float(np.concatenate(rows).mean()) for name, rows in self.errors.items()}
        for name, gaps in self.gaps.items():
            if name.startswith("model"):
                out[f"{name.removeprefix('model_')}s"] = float(len(gaps))
            label = name.removeprefix("model_")
            out[f"{label}_closed"] = (
                float(np.mean(np.array(gaps) <= CLOSED_MM)) if gaps else float("nan")
            )
            out[f"{label}_gap_mm"] = float(np.median(gaps)) if gaps else float("nan")
        return out


def evaluate_mesh(
    model: MeshModel,
    data: Path,
    *,
    split: str = "test",
    most: int | None = None,
    transitions: bool = False,
    progress: Callable[[float], None] = lambda share: None,
) -> dict[str, Any]:
    """Score a model that moves the embedded heads.

    Parameters
    ----------
    model : SDFA or MeshHead
        In evaluation mode.
    data : Path
        Dataset folder; clip i is scored on head i modulo their number. Only neutral clips are used
        if the model has no emotions.
    split : str
        ``validation`` for choices, ``test`` for final scores.
    most : int or None
        Most clips, evenly spread.
    transitions : bool
        Only clips with an /s/ before /m/, /b/ or /p/ (SDFA Fig. 3).
    progress : callable
        Called with the share done, 0 to 1.

    Returns
    -------
    dict
        ``groups``: per source of speech, or per emotion, and over ``all``: `mesh_mm`, `lips_mm`,
        mean distance over all vertices and over the lips' rims; `still_mm`, the error of lips at
        rest; `bilabial_closed`, share of /p b m/ with a gap of at most `CLOSED_MM`;
        `bilabial_gap_mm`, median; `after_s...`, of those that follow an /s/; `vowel...`, of
        clear vowels; `unsealed_...`, the same without the model's seal
        (`deitalk.postprocess.lip_seal`), if it has one; `truth_...`, of the ground truth;
        `curves_...`, for a mesh head, of the rig posed by the curves of the same DEITalk model.
        ``expression``, of a mesh head: `expression_probe`.

    Raises
    ------
    CheckpointError
        If the model was trained on other faces.
    DataError
        If the split has no such clips.
    """
    _check_heads(model)
    lips = head_lips()
    emotions = EMOTIONS if model.has_emotion else (EMOTION,)
    clips = acted_clips(data, split, emotions, None if transitions else most)
    if transitions:
        clips = [clip for clip in clips if _has_transition(clip)][:most]
    if not clips:
        which = " or ".join(emotions)
        raise DataError(f"{data}: no {which} clips in the split {split!r}; name another")
    groups: dict[str, Tally] = {"all": Tally()}
    for i, clip in enumerate(clips):
        group = clip.emotion if model.has_emotion else clip.source
        tallies = groups["all"], groups.setdefault(group, Tally())
        _score(tallies, model, clip, model.speakers[i % len(model.speakers)], lips)
        progress((i + 1) / len(clips))
    report = {
        "kind": "mesh",
        "split": split,
        "motion": model.config.motion,
        "encoder": model.config.frontend.kind,
        "groups": {name: tally.summary() for name, tally in groups.items() if tally.clips},
    }
    if model.has_emotion:
        report["expression"] = expression_probe(
            cast("MeshHead", model), [clip.audio for clip in clips]
        )
    return report


def _check_heads(model: MeshModel) -> None:
    known = {identity.name for identity in IDENTITIES}
    faces = build_head(0).cage.faces
    for speaker, template in model.templates.items():
        if speaker not in known or not np.array_equal(template.faces, faces):
            raise CheckpointError(
                f"speaker {speaker!r} is no embedded head; only models trained on those can be "
                "scored against a dataset folder"
            )


def _has_transition(clip: Clip) -> bool:
    names = [name for _, _, name in read_phones(clip.phones)] if clip.phones else []
    return any(a == "S" and b in BILABIALS for a, b in pairwise(names))


def _score(
    tallies: Sequence[Tally], model: MeshModel, clip: Clip, speaker: str, lips: Lips
) -> None:
    waveform, truth = act(clip, speaker, model.fps)
    seen = _seen(model, clip, waveform, speaker) | {"truth": truth}
    n_frames = min(map(len, seen.values()))
    seen = {who: vertices[:n_frames] for who, vertices in seen.items()}
    rest = model.template(speaker).vertices[lips.both]
    still = model.unit_mm * np.linalg.norm(seen["truth"][:, lips.both] - rest, axis=-1)
    rows = {"still_mm": still.mean(axis=1)}
    for who, label in (("model", ""), ("curves", "curves_")):
        if who in seen:
            error = model.unit_mm * np.linalg.norm(seen[who] - seen["truth"], axis=-1)
            rows[f"{label}mesh_mm"] = error.mean(axis=1)
            rows[f"{label}lips_mm"] = error[:, lips.both].mean(axis=1)
    phones = read_phones(clip.phones) if clip.phones else []
    found = {}
    for who, vertices in seen.items():
        gaps = smallest_gaps(lip_gap(vertices, lips, model.unit_mm), phones, model.fps)
        for kind, values in zip(("bilabial", "after_s", "vowel"), gaps, strict=True):
            found[f"{who}_{kind}"] = values
    for tally in tallies:
        tally.clips += 1
        for name, row in rows.items():
            tally.errors.setdefault(name, []).append(row)
        for name, values in found.items():
            tally.gaps[name] += values


def _seen(model: MeshModel, clip: Clip, waveform: Float32, speaker: str) -> dict[str, Float32]:
    """Vertices (T, V, 3) of the model, of the model before its seal, and of its curves."""
    acting = Acting.of(emotion=clip.emotion) if model.has_emotion else None
    unsealed = predict_mesh(model, waveform, speaker, acting, sealed=False)
    sealed = seal_lips(unsealed, model.config.seal_mm, model.unit_mm)
    seen = {"model": sealed, "unsealed": unsealed}
    if model.has_emotion:
        seen["curves"] = acted_by_curves(cast("MeshHead", model), clip.audio, speaker, clip.emotion)
    return seen


ROWS = {
    "clips": "clips", "lips_mm": "lips, mean error, mm", "still_mm": "lips at rest, mm",
    "curves_lips_mm": "lips, mean error, the rig with the same network's curves, mm",
    "mesh_mm": "all vertices, mean error, mm",
    "curves_mesh_mm": "all vertices, the rig with the curves, mm", "bilabials": "p b m",
    "bilabial_closed": "p b m closed to 1 mm", "bilabial_gap_mm": "p b m, median gap, mm",
    "unsealed_bilabial_closed": "p b m closed, before the seal",
    "unsealed_bilabial_gap_mm": "p b m, median gap before the seal, mm",
    "curves_bilabial_closed": "p b m closed, the rig with the curves",
    "curves_bilabial_gap_mm": "p b m, median gap, the rig with the curves, mm",
    "truth_bilabial_closed": "p b m closed, truth", "after_ss": "p b m after s",
    "after_s_closed": "p b m after s closed", "after_s_gap_mm": "p b m after s, median gap, mm",
    "unsealed_after_s_closed": "p b m after s closed, before the seal",
    "unsealed_after_s_gap_mm": "p b m after s, median gap before the seal, mm",
    "vowels": "vowels", "vowel_closed": "vowels closed",
    "unsealed_vowel_closed": "vowels closed, before the seal",
    "curves_vowel_closed": "vowels closed, the rig with the curves",
    "vowel_gap_mm": "vowels, median gap, mm",
    "truth_vowel_closed": "vowels closed, truth", "truth_vowel_gap_mm": "vowels, median gap, truth",
}  # fmt: skip


def as_markdown(report: dict[str, Any]) -> str:
    """Table of scores in rows and sources in columns, in Markdown."""
    groups = report["groups"]
    lines = [
        f"Split: {report['split']}; encoder {report['encoder']}, {report['motion']}.",
        "",
        "| | " + " | ".join(groups) + " |",
        "|---" * (len(groups) + 1) + "|",
    ]
    for key, label in ROWS.items():
        values = [scores.get(key, float("nan")) for scores in groups.values()]
        if not (key.startswith("curves") and np.isnan(values).all()):
            lines.append(f"| {label} | " + " | ".join(f"{value:.3g}" for value in values) + " |")
    if "expression" in report:
        lines += ["", *expression_table(report["expression"])]
    return "\n".join(lines) + "\n"
