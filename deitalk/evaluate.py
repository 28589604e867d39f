"""Score a model on a dataset folder: ``deitalk evaluate MODEL --data DIR``.

Every clip is animated as a user would animate it, blinks left out; then lips, errors,
correlations, emotions and silence are measured, and the loudness of the recording is scored
beside the network as the baseline any model has to beat. Correlation with procedural targets
measures phone recognition and timing, not realism.
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deitalk.activity import speech_activity
from deitalk.animate import Performance, animate
from deitalk.audio import Recording, load_audio
from deitalk.closures import (
    ClosureScores,
    Phones,
    best_lag,
    closure_scores,
    held_closures,
    summarise_closures,
)
from deitalk.data.folder import Clip, read_clips, read_phones
from deitalk.development import ARTICULATION, lips_together, load_example
from deitalk.emotions import EMOTIONS
from deitalk.errors import DataError
from deitalk.metrics import correlation, emotion_parameter_error, lip_parameter_error
from deitalk.models import DEITalk
from rig import ControlSet

Floats = NDArray[np.float32]
JAW = "CTRL_C_jaw.ty"
OPENING = (JAW, "CTRL_L_mouth_upperLipRaise.ty", "CTRL_R_mouth_upperLipRaise.ty",
           "CTRL_L_mouth_lowerLipDepress.ty", "CTRL_R_mouth_lowerLipDepress.ty")  # fmt: skip
"""Mean of these is the mouth's opening."""


def loudness(waveform: Floats, n_frames: int) -> Floats:
    """Level of the recording on a scale of 40 dB [shape=(T,), range 0 to 1]: the baseline."""
    centres = np.round(np.arange(n_frames) * 16_000 / 30).astype(int)
    padded = np.pad(waveform.astype(np.float64), (400, 800))
    frames = padded[centres[:, None] + np.arange(800)]
    level = 10 * np.log10((frames**2).mean(axis=1) + 1e-10)
    top = np.percentile(level, 95)
    scaled: Floats = np.clip(1 + (level - top) / 40, 0, 1).astype(np.float32)
    return scaled


def mouth_opening(curves: Floats, controls: ControlSet) -> Floats:
    """Mean of jaw, upper-lip and lower-lip opening [shape=(T,)]."""
    mean: Floats = curves[:, [controls.index(name) for name in OPENING]].mean(axis=1)
    return mean


class Tally:
    """What is collected clip by clip, for one group of clips."""

    def __init__(self) -> None:
        self.rows: list[dict[str, float]] = []
        self.closures: list[ClosureScores] = []
        self.baseline: list[ClosureScores] = []
        self.held: list[bool] = []

    def summary(self) -> dict[str, Any]:
        """Means over clips, and pooled closures."""
        names = sorted({name for row in self.rows for name in row})
        out: dict[str, Any] = {"clips": len(self.rows)}
        for name in names:
            values = np.array([row[name] for row in self.rows if np.isfinite(row.get(name, np.nan))])
            out[name] = float(values.mean()) if len(values) else float("nan")
        found = summarise_closures(self.closures, self.held)
        baseline = summarise_closures(self.baseline)
        return out | {
            "bilabial_window_auc": found.window_auc,
            "bilabial_frame_auc": found.frame_auc,
            "bilabial_hits_at_5_percent": found.hit_rate,
            "found_bilabials_held_at_0.9": found.reached,
            "bilabials": found.n_closures,
            "vowels": found.n_vowels,
            "loudness_bilabial_window_auc": baseline.window_auc,
        }


def evaluate(
    model: DEITalk,
    data: Path,
    *,
    split: str = "test",
    most: int | None = None,
    progress: Callable[[float], None] = lambda share: None,
) -> dict[str, Any]:
    """Score a model.

    Parameters
    ----------
    model : DEITalk
    data : Path
        Dataset folder.
    split : str
        ``validation`` for choices, ``test`` once.
    most : int or None
        At most so many recordings of every source, evenly spread.
    progress : callable
        Told the share done.

    Returns
    -------
    dict
        ``groups``: scores per source (speakers' prefix); ``emotions``: separation of the five
        emotions on the first recordings; the sets LPE and EPE used.
    """
    clips = _one_per_recording(read_clips(data, split))
    if not clips:
        raise DataError(f"{data}: no clips in the split {split!r}; splits are made by speaker")
    groups: dict[str, list[Clip]] = {}
    for clip in clips:
        groups.setdefault(clip.speaker.split(":")[0], []).append(clip)
    chosen = {name: _spread(group, most) for name, group in groups.items()}
    total, done = sum(map(len, chosen.values())), 0
    report: dict[str, Any] = {
        "split": split,
        "lpe_set": f"lip ({len(model.controls.subset('lip'))} controls of {model.controls.id})",
        "epe_set": f"upper_face ({len(model.controls.subset('upper_face'))} controls)",
        "groups": {},
    }
    for name, group in chosen.items():
        tally = Tally()
        for clip in group:
            _score(tally, model, clip)
            done += 1
            progress(done / total)
        report["groups"][name] = tally.summary()
    first = [clip for group in chosen.values() for clip in group[:3]]
    report["emotions"] = emotion_distances(model, [load_audio(clip.audio) for clip in first])
    return report


def _one_per_recording(clips: Sequence[Clip]) -> list[Clip]:
    """The clip of every recording whose emotion is neutral, or else its first."""
    by_audio: dict[Path, Clip] = {}
    for clip in clips:
        if clip.audio not in by_audio or clip.emotion == "neutral":
            by_audio[clip.audio] = clip
    return list(by_audio.values())


def _spread(clips: list[Clip], most: int | None) -> list[Clip]:
    if most is None or len(clips) <= most:
        return clips
    return [clips[i] for i in np.linspace(0, len(clips) - 1, most).round().astype(int)]


def _score(tally: Tally, model: DEITalk, clip: Clip) -> None:
    recording = load_audio(clip.audio)
    performance = animate(recording, clip.emotion, model=model, idle=False)
    predicted = performance.curves.values
    example = load_example(clip, model.controls)
    target = example.curves[: len(predicted)]
    predicted = predicted[: len(target)]
    controls = model.controls
    level = loudness(recording.waveform, len(target))
    lips = lips_together(predicted, controls)
    places = [controls.index(name) for name in ARTICULATION]
    rs = [correlation(target[:, i], predicted[:, i]) for i in places]
    finite = [r for r in rs if np.isfinite(r)]
    row = {
        "jaw_r": rs[0],
        "articulation_r": float(np.mean(finite)) if finite else float("nan"),
        "loudness_jaw_r": correlation(target[:, places[0]], level),
        "lpe": lip_parameter_error(target, predicted, controls),
        "epe": emotion_parameter_error(target, predicted, controls),
        "lag_frames": float(best_lag(target[:, places[0]], predicted[:, places[0]])),
        "largest_step": float(np.abs(np.diff(predicted, axis=0)).max(initial=0)),
    }
    row |= _silence(performance, recording, example.phones, controls)
    heard = performance.predicted[: len(target)]
    if np.isfinite(example.intensity).all():
        row["intensity_r"] = correlation(example.intensity, heard)
    tally.rows.append(row)
    tally.closures.append(closure_scores(lips, example.phones))
    tally.baseline.append(closure_scores(1 - level, example.phones))
    tally.held += held_closures(lips, example.phones)


def _silence(
    performance: Performance, recording: Recording, phones: Phones, controls: ControlSet
) -> dict[str, float]:
    """Mouth opening in silence against its 95th percentile in speech."""
    opening = mouth_opening(performance.curves.values, controls)
    speaking = speech_activity(recording.waveform) > 0
    times = np.arange(len(opening)) / 30
    silent = np.zeros(len(opening), bool)
    for start, end, name in phones:
        if name == "SIL" and end - start > 0.6:
            silent |= (times > start + 0.25) & (times < end - 0.15)
    silent &= ~speaking
    if not silent.any() or not speaking.any():
        return {}
    return {
        "opening_in_silence": float(
            opening[silent].mean() / (np.percentile(opening[speaking], 95) + 1e-9)
        )
    }


def emotion_distances(model: DEITalk, recordings: Sequence[Recording]) -> dict[str, float]:
    """How far the faces of every two emotions are apart on the same recordings.

    Euclidean distance over the controls, averaged over frames and recordings: control units.
    """
    faces = {
        emotion: [animate(r, emotion, model=model, idle=False).curves.values for r in recordings]
        for emotion in EMOTIONS
    }
    out = {}
    for i, first in enumerate(EMOTIONS):
        for second in EMOTIONS[i + 1 :]:
            distances = [
                np.sqrt(np.square(a - b).sum(axis=1)).mean()
                for a, b in zip(faces[first], faces[second], strict=True)
            ]
            out[f"{first}-{second}"] = float(np.mean(distances))
    return out


def as_markdown(report: dict[str, Any]) -> str:
    """A table of scores per group, and of the emotions' distances."""
    names = sorted({name for group in report["groups"].values() for name in group})
    groups = list(report["groups"])
    lines = [
        f"Split: {report['split']}. LPE over {report['lpe_set']}; EPE over {report['epe_set']}; "
        "both in squared control units.",
        "",
        "| | " + " | ".join(groups) + " |",
        "|---|" + "---|" * len(groups),
    ]
    for name in names:
        cells = [report["groups"][group].get(name) for group in groups]
        shown = ["–" if cell is None else f"{cell:.4g}" for cell in cells]
        lines.append(f"| {name} | " + " | ".join(shown) + " |")
    lines += ["", "Distance of the faces of two emotions (control units):", ""]
    lines += [f"- {pair}: {value:.3f}" for pair, value in report["emotions"].items()]
    return "\n".join(lines) + "\n"
