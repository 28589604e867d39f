"""Examples in noise and music, operating points, and the tables of a comparison.

Letters: S samples at 16 kHz, T rig frames at 30 Hz.
"""

from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np

from deitalk.audio.frames import SAMPLE_RATE, frame_count
from deitalk.audio.load import load_audio
from deitalk.audio.noise import mix, named_noises, pink_noise
from deitalk.data.clips import Clip, read_clips, read_phones
from deitalk.errors import DataError
from deitalk.evaluation.voice_activity.detectors import Detector, Setting, decide, make_detector
from deitalk.evaluation.voice_activity.scores import (
    Counts,
    Labels,
    label_frames,
    score_activity,
    share,
)
from rig.arrays import Float32

SNRS_DB = (20, 15, 10, 5, 0)
CHOICE_SNRS_DB = (10, 0)
"""Levels at which operating points are chosen."""
CLEAN_SNR_DB = 50
"""Level of pink noise under clean speech: the padding of a dataset and the pauses of speech engines
are digital silence, which does not occur in recordings."""

Condition = tuple[str, int]
"""Name of the noise and speech-to-noise ratio in dB."""
CLEAN: Condition = ("clean", CLEAN_SNR_DB)


@dataclass(frozen=True)
class Example:
    """A clip of speech with its labels."""

    waveform: Float32
    labels: Labels
    group: str
    """Source of the speech: ``espeak``, ``librispeech``, ..."""

    def mixed(self, condition: Condition, noises: dict[str, Float32], seed: int) -> Float32:
        """The speech in noise from a random position of the noise's recording [shape=(S,)]."""
        name, snr_db = condition
        noise = noises[name]
        start = np.random.default_rng(seed).integers(len(noise))
        return mix(self.waveform, np.roll(noise, -start), snr_db, self.labels.speech)


def read_examples(folder: Path, splits: Sequence[str], per_group: int) -> list[Example]:
    """Clips with phones, up to `per_group` of each source of speech, spread over its speakers.

    Raises
    ------
    DataError
        If no clip of the splits has phones.
    """
    groups: dict[str, dict[Path, Clip]] = defaultdict(dict)
    for clip in read_clips(folder):
        if clip.split in splits and clip.phones is not None:
            groups[clip.speaker.partition(":")[0]].setdefault(clip.audio, clip)
    chosen = [
        (group, clip)
        for group, clips in sorted(groups.items())
        for clip in list(clips.values())[:: max(1, len(clips) // per_group)][:per_group]
    ]
    if not chosen:
        raise DataError(
            f"{folder}: no clip of {' or '.join(splits)} has phones; make more with "
            "`deitalk corpus build`"
        )
    return [_example(clip, group) for group, clip in chosen]


def _example(clip: Clip, group: str) -> Example:
    assert clip.phones is not None
    waveform = load_audio(clip.audio).waveform
    return Example(
        waveform, label_frames(read_phones(clip.phones), frame_count(len(waveform))), group
    )


Results = dict[tuple[str, Condition, str], Counts]
"""Counts by name of the detector, condition and group of clips."""


def choose_setting(
    detector: Detector,
    examples: Sequence[Example],
    conditions: Sequence[Condition],
    noises: dict[str, Float32],
) -> Setting:
    """Operating point with the highest mean `Counts.suitability` over `conditions`."""
    if len(detector.settings) == 1:
        return detector.settings[0]
    counts: dict[tuple[Setting, Condition], Counts] = defaultdict(Counts)
    for waveform, condition, example in _mixture(examples, conditions, noises):
        modes = {setting.mode for setting in detector.settings}
        evidence = {mode: detector.evidence(waveform, mode) for mode in modes}
        for setting in detector.settings:
            active = decide(evidence[setting.mode], setting)
            counts[setting, condition] += score_activity(active, example.labels)

    def suitability(setting: Setting) -> float:
        return float(np.nanmean([counts[setting, c].suitability for c in conditions]))

    return max(detector.settings, key=suitability)


def compare(
    detectors: dict[Detector, Setting],
    examples: Sequence[Example],
    conditions: Sequence[Condition],
    noises: dict[str, Float32],
) -> Results:
    """Score detectors at their operating points on the same mixtures."""
    results: Results = defaultdict(Counts)
    for waveform, condition, example in _mixture(examples, conditions, noises):
        for detector, setting in detectors.items():
            begun = process_time()
            active = decide(detector.evidence(waveform, setting.mode), setting)
            spent = Counts(
                cpu_seconds=process_time() - begun, audio_seconds=len(waveform) / SAMPLE_RATE
            )
            counts = score_activity(active, example.labels) + spent
            results[detector.name, condition, example.group] += counts
    return dict(results)


def _mixture(
    examples: Sequence[Example], conditions: Sequence[Condition], noises: dict[str, Float32]
) -> Iterator[tuple[Float32, Condition, Example]]:
    for seed, example in enumerate(examples):
        for condition in conditions:
            yield example.mixed(condition, noises, seed), condition, example


CPU = "CPU ms per s"
MEASURES: dict[str, Callable[[Counts], float]] = {
    "hits": lambda c: c.hit_rate,
    "false alarms": lambda c: c.false_alarm_rate,
    "balanced accuracy": lambda c: c.balanced_accuracy,
    "missed onsets": lambda c: c.missed_onset_rate,
    "speech, mouth shut": lambda c: share(c.shut, c.speech),
    "pause, mouth open": lambda c: share(c.open, c.settled),
    CPU: lambda c: 1000 * share(c.cpu_seconds, c.audio_seconds),
}
"""Shares, but for the last."""
Scores = dict[str, dict[str, dict[str, float]]]
"""Of each label, detector and measure."""


def level_scores(results: Results, music: Sequence[str]) -> Scores:
    """Every measure by level and detector, all noises pooled and all music pooled."""
    pooled: dict[tuple[str, str], Counts] = defaultdict(Counts)
    for (detector, (name, snr_db), _), counts in results.items():
        kind = "music" if name in music else "noise"
        label = "clean" if (name, snr_db) == CLEAN else f"{kind} {snr_db} dB"
        pooled[label, detector] += counts
    return _scores(pooled)


def condition_scores(results: Results) -> Scores:
    """Every measure by condition, and by source of speech, and detector."""
    pooled: dict[tuple[str, str], Counts] = defaultdict(Counts)
    sources: dict[tuple[str, str], Counts] = defaultdict(Counts)
    for (detector, (name, snr_db), group), counts in results.items():
        label = "clean" if (name, snr_db) == CLEAN else f"{name} {snr_db} dB"
        pooled[label, detector] += counts
        sources[f"all conditions, {group}", detector] += counts
    return _scores({**pooled, **sources})


def _scores(pooled: dict[tuple[str, str], Counts]) -> Scores:
    scores: Scores = defaultdict(dict)
    for (label, detector), counts in pooled.items():
        scores[label][detector] = {name: measure(counts) for name, measure in MEASURES.items()}
    return dict(scores)


def level_table(levels: Scores) -> str:
    """A row for each level and detector (Markdown)."""
    rows = [
        [label, detector, *(f"{v:.1f}" if n == CPU else f"{v:.1%}" for n, v in found.items())]
        for label, detectors in levels.items()
        for detector, found in detectors.items()
    ]
    return _markdown(["condition", "detector", *MEASURES], rows)


def condition_table(conditions: Scores) -> str:
    """Balanced accuracy, a row for each condition, a column for each detector (Markdown)."""
    names = list(next(iter(conditions.values())))
    rows = [
        [label, *(f"{found[name]['balanced accuracy']:.1%}" for name in names)]
        for label, found in conditions.items()
    ]
    return _markdown(["condition", *names], rows)


def _markdown(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def run(
    folder: Path, noise: str, music: str, names: Sequence[str], per_group: int
) -> dict[str, Any]:
    """Choose the operating points of detectors, and compare them.

    Parameters
    ----------
    folder : Path
        Dataset folder whose clips have phones.
    noise, music : str
        As for `deitalk.audio.noise.named_noises`.
    names : sequence of str
        Names of detectors.
    per_group : int
        Most clips of each source of speech, for choosing and for scoring.

    Returns
    -------
    dict
        ``clips`` and ``seconds`` of speech that were scored, ``settings`` by detector, and the
        scores ``levels`` and ``conditions``.

    Raises
    ------
    DataError, MissingError
        If an input cannot be used or a detector's package is not installed.
    """
    found = [make_detector(name) for name in names]
    noises = named_noises(noise)
    tuning = read_examples(folder, ("train",), per_group)
    examples = read_examples(folder, ("validation", "test"), per_group)
    pieces = named_noises(music)
    sounds = {"clean": pink_noise(30 * SAMPLE_RATE), **noises, **pieces}
    scored, choice = (
        [CLEAN, *((name, snr) for name in (*noises, *pieces) for snr in levels)]
        for levels in (SNRS_DB, CHOICE_SNRS_DB)
    )
    detectors = {d: choose_setting(d, tuning, choice, sounds) for d in found}
    results = compare(detectors, examples, scored, sounds)
    return {
        "clips": len(examples),
        "seconds": sum(len(clip.waveform) for clip in examples) / SAMPLE_RATE,
        "settings": {detector.name: asdict(setting) for detector, setting in detectors.items()},
        "levels": level_scores(results, list(pieces)),
        "conditions": condition_scores(results),
    }


def as_markdown(report: dict[str, Any]) -> str:
    """The clips, the operating points and both tables."""
    settings = [f"{name}: {setting}" for name, setting in report["settings"].items()]
    lines = [f"scored on {report['clips']} clips, {report['seconds']:.0f} s", *settings, ""]
    lines += [level_table(report["levels"]), "", condition_table(report["conditions"])]
    return "\n".join(lines) + "\n"
