"""What a tuning left of its base, and what it moves: ``python -m deitalk.research tuned MODEL``.

Curves are those of the network alone, without rules. Of recordings of calm speech: how each emotion
changes the curves, against how it changes those of the base, and the range of the jaw. Of captures
in no emotion that were not learnt from: the error where another emotion is asked for, and how much
of it is the expression, which neutral captures lack. Of recordings with phones: contacts of the
lips. Of actors at two strengths: the order of the faces.
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

from deitalk.audio.load import load_audio
from deitalk.data.captures.columns import RigMapping
from deitalk.data.clips import Clip
from deitalk.emotions import EMOTIONS
from deitalk.errors import DataError
from deitalk.evaluation.comparison import CaptureSet, mean_pose
from deitalk.evaluation.report import table
from deitalk.evaluation.scores import correlation
from deitalk.evaluation.smoothness import MOVING, lips_together, predict
from deitalk.evaluation.validation import JAW
from deitalk.models.curve_model import DEITalk
from deitalk.research.evaluation import acted
from deitalk.research.evaluation.clip_scores import animated
from deitalk.research.evaluation.contacts import contact_scores, read_table
from deitalk.training.tuning.carry import carry_matrix
from deitalk.training.tuning.recipe import learnt_controls
from rig.arrays import Float32, Float64

OPEN, SHUT = 95, 5
"""Percentiles between which the range of the jaw lies."""
ORDERS = ("intensity: high above low", "whole face: high above low")
"""Scores of `acted`: strength that is predicted, and that of the face."""
OVER_NEUTRAL = {
    "error over neutral": "error_of_mean_pose",
    "error at best gain over neutral": "error_at_best_gain",
}
ALONE = "error over neutral by the expression alone"


def emotions_of(
    model: DEITalk,
    base: DEITalk,
    sounds: Sequence[Path],
    carry: Float64 | None,
    progress: Callable[[float], None],
) -> dict[str, dict[str, float]]:
    """Scores of each emotion but neutral.

    Parameters
    ----------
    model, base : DEITalk
        After and before the tuning.
    sounds : sequence of Path
        Calm speech.
    carry : array or None
        Of `carry_matrix`, from the base to the model's rig.
    progress : callable
        Called with the share done.

    Returns
    -------
    dict
        By emotion: ``jaw range over neutral``, and that of the base; ``change r with base``,
        Pearson's r of the changes by the emotion of all frames and of all controls that the base's
        change moves, where anything carries it to the rig, within the ranges of its controls.
    """
    low, high = model.controls.minimum, model.controls.maximum
    changes: dict[str, list[list[Float32]]] = {name: [[], []] for name in EMOTIONS}
    ranges: dict[str, list[list[float]]] = {name: [[], []] for name in EMOTIONS}
    for done, sound in enumerate(sounds, 1):
        recording = load_audio(sound)
        own, of_base = (
            [animated(recording, name, network, raw=True).curves.values for name in EMOTIONS]
            for network in (model, base)
        )
        for name, mine, theirs in zip(EMOTIONS, own, of_base, strict=True):
            for place, (curves, network) in enumerate(((mine, model), (theirs, base))):
                ends = np.percentile(curves[:, _jaw(network)], (SHUT, OPEN))
                ranges[name][place].append(float(np.ptp(ends)))
            changes[name][0].append(mine - own[0])
            if carry is not None:
                given = own[0] + (theirs - of_base[0]) @ carry.T.astype(np.float32)
                changes[name][1].append(np.clip(given, low, high) - own[0])
        progress(done / len(sounds))
    rows = {}
    for name in EMOTIONS[1:]:
        row = {
            system: float(np.sum(ranges[name][place]) / np.sum(ranges[EMOTIONS[0]][place]))
            for place, system in enumerate(("jaw range over neutral", "that of the base"))
        }
        if carry is not None:
            mine, given = (np.concatenate(part) for part in changes[name])
            moved = given.std(axis=0) > MOVING
            row["change r with base"] = correlation(mine[:, moved].ravel(), given[:, moved].ravel())
        rows[name] = row
    return rows


def _jaw(model: DEITalk) -> int:
    """Place of the control that opens the jaw: the board's, else that which is named so."""
    names = model.controls.names
    if JAW in names:
        return names.index(JAW)
    spoken = [i for i, n in enumerate(names) if "jaw" in n.lower() and "open" in n.lower()]
    stretch = [i for i, n in enumerate(names) if "mouth_stretch_c" in n.lower()]
    return (spoken or stretch or [0])[0]


@torch.no_grad()
def labelled_errors(
    model: DEITalk, base: DEITalk, clips: Sequence[Clip], carry: Float64 | None
) -> dict[str, dict[str, float]]:
    """Errors of neutral captures where each other emotion is asked for.

    No neutral capture smiles, so that `error_of_mean_pose` grows with any expression.

    Returns
    -------
    dict
        By emotion: those of `OVER_NEUTRAL`, of which a constant expression changes the first
        alone, and a mouth that follows the speech less both; and `ALONE`, the first of a face that
        errs as the neutral one and has the base's change besides, of the size that it has in the
        model and unrelated to its errors, where anything carries it to the rig.
    """
    calm = [clip for clip in clips if clip.emotion == EMOTIONS[0]]
    if not calm:
        raise DataError(f"none of the {len(clips)} clips is {EMOTIONS[0]}; give captures that are")
    learnt = learnt_controls(model.rules, model.controls)
    captures = CaptureSet.of(calm, model.controls, mean_pose(calm, model.controls, learnt), learnt)

    def curves(network: DEITalk, emotion: str) -> list[Float32]:
        return [predict(network, each._replace(emotion=emotion))[0] for each in captures.examples]

    calm_curves, before = curves(model, EMOTIONS[0]), curves(base, EMOTIONS[0])
    plain, rows = captures.score_curves(calm_curves), {}
    for name in EMOTIONS[1:]:
        acted = curves(model, name)
        found = captures.score_curves(acted)
        rows[name] = {text: found[of] / plain[of] for text, of in OVER_NEUTRAL.items()}
        if carry is not None:
            own, of_base = (
                [after - still for after, still in zip(*pair, strict=True)]
                for pair in ((acted, calm_curves), (curves(base, name), before))
            )
            given = [change @ carry.T.astype(np.float32) for change in of_base]
            size = _size(own, given)
            shown = [
                example.curves + np.float32(size) * change
                for example, change in zip(captures.examples, given, strict=True)
            ]
            alone = captures.score_curves(shown)["error_of_mean_pose"]
            rows[name][ALONE] = 1 + alone / plain["error_of_mean_pose"]
    return rows


def _size(own: Sequence[Float32], given: Sequence[Float32]) -> float:
    """Factor with which changes are nearest to others, by least squares."""
    x, y = np.concatenate(given), np.concatenate(own)
    return float((x * y).sum() / max(np.square(x).sum(), 1e-12))


def evaluate(
    models: dict[str, DEITalk],
    *,
    sounds: Sequence[Path] = (),
    clips: Sequence[Clip] = (),
    contacts: Path | None = None,
    strengths: Path | None = None,
    mapping: RigMapping | None = None,
    progress: Callable[[float], None] = lambda share: None,
) -> dict[str, Any]:
    """Score a tuned model and its base.

    Parameters
    ----------
    models : dict
        ``after`` and ``before``.
    sounds : sequence of Path
        Recordings of calm speech.
    clips : sequence of Clip
        Captures of the model's rig that it did not learn from.
    contacts : Path or None
        Table of phones of `deitalk.research.evaluation.contacts`; for models of the board.
    strengths : Path or None
        Table of actors of `deitalk.research.evaluation.strength_clips`; for models of the board.
    mapping : RigMapping or None
        From curves of the model's own rig to a known one, as it was tuned with.
    progress : callable
        Called with the share of `sounds` done.

    Returns
    -------
    dict
        ``emotions`` by emotion, ``contacts`` and ``strength`` by model.
    """
    after, before = models["after"], models["before"]
    report: dict[str, Any] = {}
    carry = carry_matrix(before.controls, after.controls, mapping)
    if sounds:
        report["emotions"] = emotions_of(after, before, sounds, carry, progress)
    if clips:
        for name, row in labelled_errors(after, before, clips, carry).items():
            report.setdefault("emotions", {}).setdefault(name, {}).update(row)
    for name, model in models.items():
        if contacts is not None:
            scored = []
            for clip in read_table(contacts):
                take = animated(load_audio(clip.audio), EMOTIONS[0], model, raw=False)
                scored.append((lips_together(take.curves.values, model.controls), clip))
            report.setdefault("contacts", {})[name] = contact_scores(scored)
        if strengths is not None:
            groups = list(acted.evaluate(model, strengths, split="all").values())
            sizes = [group["actors and emotions"] for group in groups]
            report.setdefault("strength", {})[name] = {
                order: float(np.average([group[order] for group in groups], weights=sizes))
                for order in ORDERS
            }
    return report


def as_markdown(report: dict[str, Any]) -> str:
    """Markdown tables."""
    lines = []
    if "emotions" in report:
        lines += ["Emotions, of the network alone:", "", *table("", report["emotions"]), ""]
    if "contacts" in report:
        lines += ["Contacts of the lips, with rules:", "", *table("", report["contacts"]), ""]
    if "strength" in report:
        lines += ["Acted strengths, share of pairs:", "", *table("", report["strength"]), ""]
    return "\n".join(lines)
