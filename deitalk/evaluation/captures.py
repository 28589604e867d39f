"""Report of a tuning: captured curves, and those of a model before and after, beside two baselines.

The baselines need no network: the mean pose of the training captures, and loudness, from which
each control is predicted by a line fitted on them. All curves are those of the network alone,
before any rule.
"""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import soundfile

from deitalk.audio.frames import FRAME_RATE, SAMPLE_RATE
from deitalk.data.clips import Clip, spread_clips
from deitalk.evaluation.comparison import CaptureSet
from deitalk.evaluation.figures import can_draw, drawing
from deitalk.evaluation.report import as_json, table, turned
from deitalk.evaluation.scores import (
    correlation,
    emotion_parameter_error,
    lip_parameter_error,
    mean_of_finite,
)
from deitalk.evaluation.smoothness import (
    Example,
    knows_contact,
    lips_together,
    load_example,
    loudness,
    predict,
    smoothness,
    speaking_frames,
)
from deitalk.evaluation.validation import JAW, closure_scores, summarise_closures
from deitalk.models.curve_model import DEITalk
from rig import RigCurves, write_curves
from rig.arrays import Float32
from rig.files import atomic_write

SHOWN_SECONDS = 8.0
"""Length that is shown of a clip, from its beginning."""
COLOURS = {"before": "C0", "after": "C3"}


class Shown(NamedTuple):
    """One clip: a column of the picture."""

    captured: dict[str, Float32]
    """By control [shape=(T,)]."""
    predicted: dict[str, dict[str, Float32]]
    """By ``before`` and ``after``, then by control."""


def draw_before_after(
    path: Path,
    clips: Sequence[Shown],
    errors: Mapping[str, float],
    course: Mapping[str, Sequence[float]],
) -> None:
    """Draw clips side by side, a row for each control, and below them the errors of all systems.

    Parameters
    ----------
    path : Path
        .png, .svg or .pdf; its folder must exist.
    clips : sequence of Shown
        At least one; all of the same controls.
    errors : mapping of str to float
        By system.
    course : mapping of str to sequence of float
        ``step`` and ``error_of_mean_pose`` of validation clips; empty without steps.

    Raises
    ------
    MissingError
        If matplotlib is not installed.
    """
    names = list(clips[0].captured)
    with drawing(path, (7 * len(clips), 1.9 * (len(names) + 1))) as figure:
        above, below = figure.subfigures(2, 1, height_ratios=(len(names), 1))
        grid = above.subplots(len(names), len(clips), sharex="col", squeeze=False)
        for column, clip in zip(grid.T, clips, strict=True):
            for axis, name in zip(column, names, strict=True):
                times = np.arange(len(clip.captured[name])) / FRAME_RATE
                axis.fill_between(times, 0, clip.captured[name], color="0.8", lw=0, label="capture")
                for system, curves in clip.predicted.items():
                    axis.plot(times, curves[name], color=COLOURS[system], lw=1.1, label=system)
                axis.set_title(name, loc="left", fontsize=9)
            column[0].legend(loc="upper right", fontsize=7, ncols=3, frameon=False)
            column[-1].set_xlabel("seconds")
            column[-1].set_xlim(0, min(times[-1] + 1 / FRAME_RATE, SHOWN_SECONDS))
        axes = below.subplots(1, 2 if course else 1, squeeze=False)[0]
        axes[0].barh(list(errors), list(errors.values()), color="0.6")
        axes[0].invert_yaxis()
        axes[0].set_title("error_of_mean_pose", loc="left", fontsize=9)
        if course:
            axes[1].plot(course["step"], course["error_of_mean_pose"], color="C3", marker=".")
            axes[1].set_title("error_of_mean_pose of validation clips", loc="left", fontsize=9)
            axes[1].set_xlabel("step")


System = Callable[[Example], tuple[Float32, Float32 | None]]
"""An example to its curves [shape=(T, C)], and the intensity [shape=(T,)] if it predicts one."""
MODELS = ("before", "ridge", "after")
"""The base, or what is carried of it to the rig; the start of the steps, a ridge regression on its
features; the result."""
COMPARED = "compare"
"""Folder of the clip whose captured curves are played beside those before and after."""
N_SHOWN = 2
"""Clips in the picture."""


def write_comparison(
    folder: Path,
    systems: Mapping[str, System],
    captures: CaptureSet,
    train: Sequence[Clip],
    *,
    held: str,
    about: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Write ``report.md``, ``report.json`` and, if it can be drawn, ``report.png``.

    The folder ``compare`` gets the recording of the first held-out clip and its curves: those
    captured, before and after, for a page that plays them side by side.

    Parameters
    ----------
    folder : Path
        Exists.
    systems : mapping of str to System
        Of `MODELS`, and others.
    captures : CaptureSet
        Held-out clips.
    train : sequence of Clip
        The clips that the baselines are fitted on.
    held : str
        What part the clips had in the training, to follow "held-out clips,".
    about : mapping or None
        What the report is to state about the run.

    Returns
    -------
    dict
        The scores of each system.
    """
    low, high = captures.controls.minimum, captures.controls.maximum
    found = {name: [run(e) for e in captures.examples] for name, run in systems.items()}
    curves = {name: [np.clip(c, low, high) for c, _ in rows] for name, rows in found.items()}
    curves |= _baselines(captures, train)
    scores = {name: _scores(rows, captures) for name, rows in curves.items()}
    for name, rows in found.items():
        scores[name] |= _intensity([strength for _, strength in rows], captures)
    scores["capture"] = _own(captures)
    report = {
        **(about or {}),
        "clips": len(captures.examples),
        "held": held,
        "moving_controls": int(captures.pose.moving.sum()),
        "scores": scores,
        "controls": _controls(curves, captures),
    }
    with atomic_write(folder / "report.json") as beside:
        beside.write_text(as_json(report))
    with atomic_write(folder / "report.md") as beside:
        beside.write_text(_markdown(report))
    # The first held-out clip: sound, captured curves, before and after.
    example, controls, compared = captures.examples[0], captures.controls, folder / COMPARED
    compared.mkdir(exist_ok=True)
    played = {"capture": example.curves}
    played |= {name: curves[name][0] for name in ("before", "after") if name in curves}
    for name, values in played.items():
        clip = RigCurves(values, controls.names, fps=FRAME_RATE, control_set=controls.id)
        write_curves(compared / f"{name}.npz", clip)
    with atomic_write(compared / "audio.wav") as beside:
        soundfile.write(beside, example.waveform, SAMPLE_RATE, format="WAV", subtype="PCM_16")
    if can_draw():
        errors = {name: found["error_of_mean_pose"] for name, found in scores.items()}
        course = report.get("learning", {})
        draw_before_after(folder / "report.png", _shown(captures, curves), errors, course)
    return scores


def by_model(model: DEITalk) -> System:
    """The system of a model in evaluation mode."""
    return lambda example: predict(model, example)


def _baselines(captures: CaptureSet, train: Sequence[Clip]) -> dict[str, list[Float32]]:
    """Curves of the mean pose and of loudness."""
    slope, offset = _loudness_line(captures, spread_clips(list(train), LOUDNESS_CLIPS))
    still, loud = [], []
    for example in captures.examples:
        still.append(np.tile(captures.pose.values, (len(example.curves), 1)))
        level = loudness(example.waveform, len(example.curves))
        loud.append(np.asarray(level[:, None] * slope + offset, np.float32))
    return {"mean pose": still, "loudness": loud}


LOUDNESS_CLIPS = 2000
"""Most clips that the line is fitted on, evenly spread."""


def _loudness_line(captures: CaptureSet, clips: Sequence[Clip]) -> tuple[Float32, Float32]:
    """Slope and offset of every control over loudness, by least squares on known frames."""
    n = len(captures.controls)
    sums = np.zeros((5, n))
    for clip in clips:
        example = load_example(clip, captures.controls)
        x = loudness(example.waveform, len(example.curves)).astype(np.float64)[:, None]
        y, known = example.curves.astype(np.float64), example.known
        parts = (np.ones_like(y), x + 0 * y, y, x * x + 0 * y, x * y)
        sums += np.stack([part.sum(axis=0) * known for part in parts])
    count, x, y, xx, xy = sums
    spread = count * xx - x * x
    slope = np.where(spread > 1e-9, (count * xy - x * y) / np.maximum(spread, 1e-9), 0)
    offset = captures.pose.values - slope * x / np.maximum(count, 1)
    return slope.astype(np.float32), offset.astype(np.float32)


def _scores(curves: Sequence[Float32], captures: CaptureSet) -> dict[str, float]:
    """Scores of one system; those of jaw, lips and upper face where the rig is the board."""
    scores = captures.score_curves(curves)
    del scores["score"]
    rows = [
        _row(example, values, captures)
        for example, values in zip(captures.examples, curves, strict=True)
    ]
    for name in dict.fromkeys(name for row in rows for name in row):
        scores[name] = mean_of_finite(row.get(name, np.nan) for row in rows)
    return scores | _closures(curves, captures)


def _row(example: Example, values: Float32, captures: CaptureSet) -> dict[str, float]:
    controls, known, target = captures.controls, example.known, example.curves
    row = {
        "lpe": lip_parameter_error(target, values, controls, known),
        "epe": emotion_parameter_error(target, values, controls, known),
    } | _steps(values[:, captures.pose.moving])
    upper = [i for i in controls.subset("upper_face") if known[i] and captures.pose.moving[i]]
    row["upper_face_r"] = mean_of_finite([correlation(target[:, i], values[:, i]) for i in upper])
    if JAW in controls.names and known[controls.index(JAW)]:
        jaw = controls.index(JAW)
        row["jaw_r"] = correlation(target[:, jaw], values[:, jaw])
    if _has_lips(example, captures):
        lips = (lips_together(c, controls) for c in (target, values))
        row["lips_together_r"] = correlation(*lips)
    return row


def _intensity(strengths: Sequence[Float32 | None], captures: CaptureSet) -> dict[str, float]:
    """Pearson's r of the predicted intensity with the captured expressions' strength in speech."""
    rs = []
    for strength, example in zip(strengths, captures.examples, strict=True):
        if strength is None or not np.isfinite(example.intensity).any():
            continue
        known = np.isfinite(example.intensity) & speaking_frames(example)
        if known.any():
            rs.append(correlation(example.intensity[known], strength[known]))
    return {"intensity_r": mean_of_finite(rs)} if np.isfinite(rs).any() else {}


def _own(captures: CaptureSet) -> dict[str, float]:
    """Scores of the captures themselves, where they are defined."""
    rows = [_steps(example.curves[:, captures.pose.moving]) for example in captures.examples]
    own = {
        name: mean_of_finite([row[name] for row in rows if name in row])
        for name in list(dict.fromkeys(name for row in rows for name in row))
    }
    curves = [example.curves for example in captures.examples]
    still = {"error_of_mean_pose": 0.0, "error_at_best_gain": 0.0}
    return {**still, "range": 1.0, **own, **_closures(curves, captures)}


def _controls(curves: dict[str, list[Float32]], captures: CaptureSet) -> dict[str, Any]:
    """Each control that moves, most first: spread, and r and error before and after."""
    rows = {}
    for place in np.flatnonzero(captures.pose.moving):
        places = [i for i, example in enumerate(captures.examples) if example.known[place]]
        if not places:
            continue
        target = np.concatenate([captures.examples[i].curves[:, place] for i in places])
        still = np.square(target - captures.pose.values[place]).mean()
        row = {"captured_sd": float(target.std())}
        for name in MODELS:
            if name in curves:
                given = np.concatenate([curves[name][i][:, place] for i in places])
                row[f"{name}_r"] = correlation(target, given)
                row[f"{name}_error_of_mean_pose"] = float(np.square(target - given).mean() / still)
        rows[captures.controls.names[place]] = row
    return dict(sorted(rows.items(), key=lambda item: -item[1]["captured_sd"]))


def _steps(values: Float32) -> dict[str, float]:
    found = smoothness(values)
    return {name: found[name] for name in ("largest_step", "jerk_per_speed") if name in found}


def _closures(curves: Sequence[Float32], captures: CaptureSet) -> dict[str, float]:
    """Bilabials found, where clips have phones and contacts."""
    scored = [
        closure_scores(lips_together(values, captures.controls), example.phones)
        for example, values in zip(captures.examples, curves, strict=True)
        if example.phones and _has_lips(example, captures)
    ]
    if not scored:
        return {}
    found = summarise_closures(scored)
    return {"bilabial_window_auc": found.window_auc, "bilabial_hits": found.hit_rate}


def _has_lips(example: Example, captures: CaptureSet) -> bool:
    names = captures.controls.names
    is_there = any("lipsTogether" in name for name in names)
    return is_there and knows_contact(example.known, captures.controls)


def _markdown(report: dict[str, Any]) -> str:
    lines = [
        "# Before and after",
        "",
        f"{report['clips']} held-out clips, {report['held']}; {report['moving_controls']} "
        "controls move in the captures and are scored. Curves of the network alone, without rules.",
        "",
        *_course(report),
        *(f"{line}\n" for line in warnings_of(report["scores"])),
        *table("", report["scores"]),
        "",
        "`error_of_mean_pose`: squared error over that of the mean pose of the training captures "
        "(1: as good as a still face). `error_at_best_gain`: the same with each control scaled and "
        "shifted at best: what timing and shape leave. `mean_r`: Pearson's r, mean over clips and "
        "moving controls. "
        "`range`: standard deviation over the captured one, median. `lpe`, `epe`: squared control "
        "units, lips and upper face. `jerk_per_speed`: 1/s².",
        "",
        *_learning(report.get("learning", {})),
        "Controls, those that move most first:",
        "",
        *table("", turned(report["controls"])),
        "",
    ]
    return "\n".join(lines)


def warnings_of(scores: Mapping[str, Mapping[str, float]]) -> list[str]:
    """Lines on a tuned model that is no better than the base, or than loudness."""
    names = ("before", "after", "loudness")
    before, after, loud = (
        scores.get(name, {}).get("error_of_mean_pose", float("nan")) for name in names
    )
    lines = []
    if before < after:
        lines.append(
            f"The base is nearer to the held-out clips than the tuned model (error_of_mean_pose "
            f"{before:.3g} against {after:.3g}): keep the base, capture more, or take a share of "
            "the change (deitalk model mix)."
        )
    if not beats_loudness(scores):
        lines.append(
            f"The tuned model is no better than a line over loudness (error_of_mean_pose "
            f"{after:.3g} against {loud:.3g}): check offsets, emotions and names of the captures "
            "(deitalk data check)."
        )
    return lines


def errs_less(scores: Mapping[str, Mapping[str, float]], one: str, other: str) -> bool:
    """Whether a system errs less than another."""
    return scores[one]["error_of_mean_pose"] < scores[other]["error_of_mean_pose"]


def beats_loudness(scores: Mapping[str, Mapping[str, float]]) -> bool:
    """Whether the tuned model errs less than a line over loudness; true where nothing is known."""
    after, loud = (scores[name]["error_of_mean_pose"] for name in ("after", "loudness"))
    return not after >= loud


def _course(report: dict[str, Any]) -> list[str]:
    """Lines on the result, the styles, and the takes that share a convention."""
    lines = []
    if report.get("delivered"):
        lines += [f"The result is {report['delivered']}.", ""]
    if report.get("conventions"):
        shared = [f"{name}: {', '.join(takes)}" for name, takes in report["conventions"].items()]
        lines += ["Takes by convention, each with a style:", ""]
        lines += [*(f"- {line}" for line in shared), ""]
    if report.get("actors"):
        actors = ", ".join(report["actors"])
        lines += [f"Styles: {actors}. Where none is named the face is their mean.", ""]
    return lines


def _learning(course: Mapping[str, Sequence[float]]) -> list[str]:
    """Scores on the validation clips by step."""
    if not course:
        return []
    steps = [f"step {step:g}" for step in course["step"]]
    columns = {
        name: dict(zip(steps, course[name], strict=True))
        for name in ("error_of_mean_pose", "mean_r")
        if name in course
    }
    return ["Validation clips:", "", *table("", columns), ""]


def _shown(captures: CaptureSet, curves: dict[str, list[Float32]]) -> list[Shown]:
    """The first clips, with the three controls that move most over all of them."""
    examples = captures.examples[:N_SHOWN]
    spread = np.mean([example.curves.std(axis=0) for example in captures.examples], axis=0)
    places = np.argsort(-spread * captures.pose.moving, kind="stable")[:3]
    return [
        Shown(
            {captures.controls.names[k]: example.curves[:, k] for k in places},
            {
                name: {captures.controls.names[k]: curves[name][i][:, k] for k in places}
                for name in ("before", "after")
                if name in curves
            },
        )
        for i, example in enumerate(examples)
    ]
