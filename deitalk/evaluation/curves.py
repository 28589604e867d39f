"""Score a model on a dataset folder: ``deitalk evaluate MODEL --data DIR``.

Every clip is animated by `deitalk.pipeline.curves.animate` without blinks; then lips, errors,
correlations, emotions and silence are measured. The loudness of the recording is scored in the same
way as a baseline. Correlation with procedural targets measures phone recognition and timing, not
realism.
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from deitalk.audio.frames import frame_centres
from deitalk.audio.load import load_audio
from deitalk.audio.noise import read_noises
from deitalk.audio.prosody import level_db
from deitalk.data.clips import Clip, read_clips
from deitalk.errors import DataError
from deitalk.evaluation.curve_statistics import captured_smoothness, smoothness
from deitalk.evaluation.experiments import emotion_report, follow, lively_report, noise_report
from deitalk.evaluation.lip_closures import (
    ClosureScores,
    closure_scores,
    held_closures,
    summarise_closures,
)
from deitalk.evaluation.opening import JAW, mouth_opening, opening_in_silence
from deitalk.evaluation.phone_gestures import (
    GESTURES,
    Peaks,
    gesture_curve,
    gesture_peaks,
    global_lag_ms,
    jaw_in_contact,
    lag_scores,
    phone_table,
)
from deitalk.evaluation.report import as_markdown
from deitalk.evaluation.validation import (
    ARTICULATION,
    Example,
    articulation,
    knows_contact,
    lips_together,
    load_example,
)
from deitalk.metrics import correlation, emotion_parameter_error, lip_parameter_error
from deitalk.models.curve_model import DEITalk
from deitalk.pipeline.curves import animate
from rig.arrays import Bool, Float32, Float64

__all__ = ["as_markdown", "evaluate", "loudness", "mouth_opening"]

PROBES = 6
ADULT_YEARS = 16
"""Least age of the group of adults, years."""


def loudness(waveform: Float32, n_frames: int) -> Float32:
    """Level of the recording on a scale of 40 dB [shape=(T,), range 0 to 1]: the baseline."""
    level = level_db(waveform, frame_centres(np.arange(n_frames)))
    top = np.percentile(level, 95)
    scaled: Float32 = np.clip(1 + (level - top) / 40, 0, 1).astype(np.float32)
    return scaled


class Tally:
    """Scores collected over the clips of one group."""

    def __init__(self) -> None:
        self.rows: list[dict[str, float]] = []
        self.closures: list[ClosureScores] = []
        self.baseline: list[ClosureScores] = []
        self.held: list[bool] = []
        self.lags: dict[str, list[Float64]] = {"jaw": [], "lips": []}
        self.peaks: dict[str, list[Peaks]] = {name: [] for name in GESTURES}

    def summary(self) -> dict[str, Any]:
        """Means over clips, and pooled closures."""
        names = sorted({name for row in self.rows for name in row})
        out: dict[str, Any] = {"clips": len(self.rows)}
        for name in names:
            values = np.array(
                [row[name] for row in self.rows if np.isfinite(row.get(name, np.nan))]
            )
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
            "jaw_lag_ms": global_lag_ms(self.lags["jaw"]),
            "lips_lag_ms": global_lag_ms(self.lags["lips"]),
        }

    def phones(self) -> dict[str, dict[str, dict[str, float]]]:
        """Per gesture and phone: number, hits and AUC."""
        return {name: phone_table(self.peaks[name], g) for name, g in GESTURES.items()}


def evaluate(
    model: DEITalk,
    data: Path,
    *,
    split: str = "test",
    most: int | None = None,
    probes: int = PROBES,
    noise: str | None = None,
    captured: Path | None = None,
    progress: Callable[[float], None] = lambda share: None,
) -> dict[str, Any]:
    """Score a model.

    Parameters
    ----------
    model : DEITalk
        In evaluation mode.
    data : Path
        Dataset folder.
    split : str
        ``validation`` for choices, ``test`` for final scores.
    most : int or None
        Most recordings of every source, evenly spread.
    probes : int
        Recordings of every English source that are also animated in all emotions and modified.
    noise : str or None
        Noise for further scores: a folder of recordings, or ``pink``.
    captured : Path or None
        Captured curves whose smoothness is reported for comparison.
    progress : callable
        Called with the share done, 0 to 1.

    Returns
    -------
    dict
        ``groups``: scores per source (speakers' prefix), languages but English apart, and
        children apart from adults where ``clips.csv`` has ages;
        ``phones``: per group, gesture and phone; ``emotions``, ``lively``, ``noise``: the
        experiments of `deitalk.evaluation.experiments`; the sets LPE and EPE used.

    Raises
    ------
    DataError
        If the split is empty, or there is no such noise.
    """
    noises = read_noises(noise) if noise else []
    beside = None if captured is None else captured_smoothness(captured, model.controls)
    chosen = {name: _spread(group, most) for name, group in _groups(data, split).items()}
    probed = {k: _spread(v, probes) for k, v in chosen.items() if " " not in k} if probes else {}
    some = [clip for group in probed.values() for clip in group]
    recorded = [clip for clip in some if clip.source == "recording"] or some
    advance = _Advance(sum(map(len, chosen.values())) + 16 * len(some), progress)
    report: dict[str, Any] = {
        "split": split,
        "lpe_set": f"lip ({len(model.controls.subset('lip'))} controls of {model.controls.id})",
        "epe_set": f"upper_face ({len(model.controls.subset('upper_face'))} controls)",
        "groups": {},
        "phones": {},
    }
    for name, group in chosen.items():
        tally = Tally()
        for clip in group:
            _score(tally, model, clip)
            advance()
        report["groups"][name] = tally.summary()
        report["phones"][name] = tally.phones()
    report |= _probe(model, probed, advance)
    if noises and recorded:
        report["noise"] = noise_report(model, recorded, noises)
    if beside is not None:
        report["captured"] = beside
    progress(1.0)
    return report


def _probe(model: DEITalk, probed: dict[str, list[Clip]], advance: "_Advance") -> dict[str, Any]:
    out: dict[str, Any] = {}
    for name, group in probed.items():
        recordings = [load_audio(clip.audio) for clip in group]
        out.setdefault("emotions", {})[name] = emotion_report(model, recordings)
        advance(10 * len(group))
        out.setdefault("lively", {})[name] = lively_report(model, recordings)
        advance(6 * len(group))
    return out


class _Advance:
    """Counter of finished recordings."""

    def __init__(self, total: int, progress: Callable[[float], None]) -> None:
        self.total, self.done, self.progress = total, 0, progress

    def __call__(self, pieces: int = 1) -> None:
        self.done += pieces
        self.progress(self.done / self.total)


def _groups(data: Path, split: str) -> dict[str, list[Clip]]:
    clips = _one_per_recording(read_clips(data, split))
    if not clips:
        raise DataError(f"{data}: no clips in the split {split!r}; splits are made by speaker")
    table = pd.read_csv(data / "clips.csv", dtype=str, keep_default_na=False)
    rows = dict(zip(table["clip"], table.to_dict("records"), strict=True))
    groups: dict[str, list[Clip]] = {}
    for clip in clips:
        groups.setdefault(_group(clip, rows[clip.name]), []).append(clip)
    return dict(sorted(groups.items()))


def _group(clip: Clip, row: dict[Any, str]) -> str:
    """Name of a clip's group; a name with a space is of another language than English."""
    name, age, language = clip.speaker.split(":")[0], row.get("age", ""), row.get("language", "")
    if age.isdecimal():
        name += "-adults" if int(age) >= ADULT_YEARS else "-children"
    return f"{name} {language}" if language and not language.startswith("en") else name


def _one_per_recording(clips: Sequence[Clip]) -> list[Clip]:
    """The neutral clip of every recording, or else its first."""
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
    """Animate one clip and collect its scores."""
    recording = load_audio(clip.audio)
    performance = animate(recording, clip.emotion, model=model, idle=False)
    example = load_example(clip, model.controls)
    n_frames = min(len(performance.curves.values), len(example.curves))
    predicted = performance.curves.values[:n_frames]
    target = example.curves[:n_frames]
    controls = model.controls
    level = loudness(recording.waveform, n_frames)
    row = _errors(target, predicted, example.known, model) | smoothness(predicted)
    jaw = controls.index(JAW)
    if example.known[jaw]:
        row["loudness_jaw_r"] = correlation(target[:, jaw], level)
    opening = mouth_opening(performance.curves.values, controls)
    row["opening_in_silence"] = opening_in_silence(opening, recording.waveform, example.phones)
    if np.isfinite(example.intensity).all():
        row["intensity_r"] = correlation(
            example.intensity[:n_frames], performance.predicted[:n_frames]
        )
        row |= follow(performance, example.intensity)
    _contacts(tally, row, example, predicted, target, model)
    tally.baseline.append(closure_scores(1 - level, example.phones))
    tally.rows.append(row)


def _errors(target: Float32, predicted: Float32, known: Bool, model: DEITalk) -> dict[str, float]:
    """The paper's errors, and r of every articulation channel, where they are known."""
    controls = model.controls
    rs = articulation(target, predicted, known, controls)
    finite = [r for r in rs if np.isfinite(r)]
    channels = {f"r {n.removeprefix('CTRL_')}": r for n, r in zip(ARTICULATION, rs, strict=True)}
    return channels | {
        "jaw_r": rs[0],
        "articulation_r": float(np.mean(finite)) if finite else float("nan"),
        "lpe": lip_parameter_error(target, predicted, controls, known),
        "epe": emotion_parameter_error(target, predicted, controls, known),
    }


def _contacts(
    tally: Tally,
    row: dict[str, float],
    example: Example,
    predicted: Float32,
    target: Float32,
    model: DEITalk,
) -> None:
    """Closures, gestures of single phones, and their timing."""
    controls = model.controls
    lips, aim = lips_together(predicted, controls), lips_together(target, controls)
    jaw = controls.index(JAW)
    row["jaw_in_contact"] = jaw_in_contact(lips, predicted[:, jaw])
    tally.closures.append(closure_scores(lips, example.phones))
    tally.held += held_closures(lips, example.phones)
    if example.known[jaw]:
        tally.lags["jaw"].append(lag_scores(target[:, jaw], predicted[:, jaw]))
    if knows_contact(example.known, controls):
        tally.lags["lips"].append(lag_scores(aim, lips))
    for name, gesture in GESTURES.items():
        curve = gesture_curve(predicted, controls, gesture)
        tally.peaks[name].append(gesture_peaks(curve, example.phones, gesture))
