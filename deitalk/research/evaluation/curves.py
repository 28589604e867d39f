"""Score a model on a dataset folder: ``python -m deitalk.research evaluate MODEL --data DIR``.

Every recording is animated by `deitalk.pipeline.curves.animate` without blinks, with the rules of
the model and by its network alone; then lips, errors, correlations, emotions and silence are
measured. The loudness of the recording is scored in the same way as a baseline. Correlation with
procedural targets measures phone recognition and timing, not realism.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from deitalk.audio.load import load_audio
from deitalk.data.clips import Clip, read_clips, read_phones
from deitalk.errors import DataError
from deitalk.evaluation.scores import correlation
from deitalk.evaluation.smoothness import lips_together, load_example
from deitalk.evaluation.validation import JAW, closure_scores, summarise_closures
from deitalk.models.curve_model import DEITalk
from deitalk.pipeline.curves import animate
from deitalk.research.evaluation.clip_scores import (
    ClipToScore,
    Scores,
    Tally,
    captured_smoothness,
    score_clip,
)
from deitalk.research.evaluation.contour_scores import contours_report
from deitalk.research.evaluation.gestures import shut_table
from deitalk.research.evaluation.noise import SNRS_DB, mix, read_noises
from deitalk.research.evaluation.ridge import ContactRidge, Judged, score_contacts, teachers
from deitalk.research.evaluation.styles import styles_report
from rig.arrays import Float32

PROBES = 6
ADULT_YEARS = 16
"""Least age of the group of adults, years."""


def evaluate(
    model: DEITalk,
    data: Path,
    *,
    split: str = "test",
    most: int | None = None,
    probes: int = PROBES,
    noise: str | None = None,
    captured: Path | None = None,
    encoder: Path | None = None,
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
        Recordings of every English source that are also animated in all emotions, and modified.
    noise : str or None
        Noise for further scores: a folder of recordings, or ``pink``.
    captured : Path or None
        Captured curves whose smoothness is reported for comparison.
    encoder : Path or None
        Folder of a published Whisper encoder whose layers are read by a ridge too.
    progress : callable
        Called with the share done, 0 to 1.

    Returns
    -------
    dict
        ``groups``: scores per source (speakers' prefix), languages but English apart, and
        children apart from adults where ``clips.csv`` has ages; ``network``: the same without the
        model's rules; ``ridge``: contact scores of ridge regressions by their features and source
        (`deitalk.research.evaluation.ridge`), which the training recordings teach; ``phones``: per
        group, gesture and phone; ``shut``: per group and phone, of the lips on sounds without
        contact; ``styles``, ``contours``, ``noise``: the experiments (of styles,
        `prosody_response`, noise); the sets LPE and EPE used.

    Raises
    ------
    DataError
        If the split is empty, there is no such noise, or there is one but no probe.
    """
    if noise and not probes:
        raise DataError("probes=0: noise is added to the probed recordings; set 1 or more")
    noises = read_noises(noise) if noise else []
    beside = None if captured is None else captured_smoothness(captured, model.controls)
    chosen = {name: _spread(group, most) for name, group in _groups(data, split).items()}
    probed = {k: _spread(v, probes) for k, v in chosen.items() if " " not in k} if probes else {}
    some = [clip.neutral for group in probed.values() for clip in group]
    recorded = [clip for clip in some if clip.source == "recording"] or some
    advance = _Advance(sum(map(len, chosen.values())) + 5 * len(some), progress)
    report: dict[str, Any] = {
        "split": split,
        "lpe_set": f"lip ({len(model.controls.subset('lip'))} controls of {model.controls.id})",
        "epe_set": f"upper_face ({len(model.controls.subset('upper_face'))} controls)",
        "groups": {},
        "network": {},
        "phones": {},
        "shut": {},
    }
    for name, group in chosen.items():
        scores = Scores(Tally(), Tally())
        for clip in group:
            score_clip(scores, model, clip)
            advance()
        report["groups"][name] = scores.animated.summary()
        report["network"][name] = scores.network.summary()
        report["phones"][name] = scores.animated.phones()
        report["shut"][name] = shut_table(scores.animated.shut)
    if taught := teachers(data):
        judged = {
            name: [
                Judged(clip.neutral.audio, read_phones(clip.neutral.phones))
                for clip in group
                if clip.neutral.phones is not None
            ]
            for name, group in chosen.items()
        }
        report["ridge"] = score_contacts(ContactRidge(model, taught, encoder), judged)
    report |= _probe(model, probed, advance)
    if noises and recorded:
        report["noise"] = noise_report(model, recorded, noises)
    if beside is not None:
        report["captured"] = beside
    progress(1.0)
    return report


def _probe(
    model: DEITalk, probed: dict[str, list[ClipToScore]], advance: "_Advance"
) -> dict[str, Any]:
    out: dict[str, Any] = {}
    for name, group in probed.items():
        recordings = [load_audio(clip.neutral.audio) for clip in group]
        out.setdefault("styles", {})[name] = styles_report(model, recordings)
        advance(3 * len(group))
        out.setdefault("contours", {})[name] = contours_report(model, recordings)
        advance(2 * len(group))
    return out


class _Advance:
    """Counter of finished recordings."""

    def __init__(self, total: int, progress: Callable[[float], None]) -> None:
        self.total, self.done, self.progress = total, 0, progress

    def __call__(self, pieces: int = 1) -> None:
        self.done += pieces
        self.progress(self.done / self.total)


def _groups(data: Path, split: str) -> dict[str, list[ClipToScore]]:
    clips = _by_recording(read_clips(data, split))
    if not clips:
        raise DataError(f"{data}: no clips in the split {split!r}; splits are made by speaker")
    table = pd.read_csv(data / "clips.csv", dtype=str, keep_default_na=False)
    rows = dict(zip(table["clip"], table.to_dict("records"), strict=True))
    groups: dict[str, list[ClipToScore]] = {}
    for clip in clips:
        group = _group(clip.neutral, rows[clip.neutral.name])
        groups.setdefault(group, []).append(clip)
    return dict(sorted(groups.items()))


def _group(clip: Clip, row: dict[Any, str]) -> str:
    """Name of a clip's group; a name with a space is of another language than English."""
    name, age, language = clip.speaker.split(":")[0], row.get("age", ""), row.get("language", "")
    if age.isdecimal():
        name += "-adults" if int(age) >= ADULT_YEARS else "-children"
    return f"{name} {language}" if language and not language.startswith("en") else name


def _by_recording(clips: Sequence[Clip]) -> list[ClipToScore]:
    """Neutral clip and first acted one of every recording; each may be the other too."""
    by_audio: dict[Path, list[Clip]] = {}
    for clip in clips:
        by_audio.setdefault(clip.audio, []).append(clip)
    found = []
    for group in by_audio.values():
        neutral = next((clip for clip in group if clip.emotion == "neutral"), group[0])
        acted = next((clip for clip in group if clip.emotion != "neutral"), group[0])
        found.append(ClipToScore(neutral, acted))
    return found


def _spread(clips: list[ClipToScore], most: int | None) -> list[ClipToScore]:
    if most is None or len(clips) <= most:
        return clips
    return [clips[i] for i in np.linspace(0, len(clips) - 1, most).round().astype(int)]


def noise_report(
    model: DEITalk, clips: Sequence[Clip], noises: Sequence[Float32]
) -> dict[str, dict[str, float]]:
    """Bilabials and jaw, clean and in noise; keys are ``clean`` and decibels."""
    steps: tuple[float | None, ...] = (None, *SNRS_DB)
    examples = [(load_audio(clip.audio), load_example(clip, model.controls)) for clip in clips]
    report = {}
    for snr in steps:
        scores, jaws = [], []
        for i, (recording, example) in enumerate(examples):
            mixture = recording
            if snr is not None:
                noisy = mix(recording.waveform, noises[i % len(noises)], snr)
                mixture = replace(recording, waveform=noisy)
            take = animate(mixture, example.emotion, model=model, life="off")
            curves = take.curves.values[: len(example.curves)]
            scores.append(closure_scores(lips_together(curves, model.controls), example.phones))
            place = model.controls.index(JAW)
            jaws.append(correlation(example.curves[: len(curves), place], curves[:, place]))
        found = summarise_closures(scores)
        report["clean" if snr is None else f"{snr:g} dB"] = {
            "bilabial_window_auc": found.window_auc,
            "bilabial_hits_at_5_percent": found.hit_rate,
            "jaw_r": float(np.nanmean(jaws)) if np.isfinite(jaws).any() else float("nan"),
        }
    return report
