"""Scores of predicted lips against measured lips: ``evaluate MODEL --lips FOLDER``.

Every recording is animated in the neutral emotion; the lip measures of the embedded head
(`deitalk.research.lips`) are compared with those of the speaker during speech. Predictions are the
network alone, the curves of `deitalk.animate`, and two baselines: the level of the recording, and a
ridge regression of speech features on the lips of the other speakers of the folder
(`deitalk.research.evaluation.ridge`).

Letters: T frames at 30 per second, M measures.
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

from deitalk.audio.load import load_audio
from deitalk.errors import DataError
from deitalk.evaluation.report import table
from deitalk.evaluation.scores import correlation
from deitalk.evaluation.smoothness import loudness
from deitalk.models.curve_model import DEITalk
from deitalk.pipeline.curves import animate
from deitalk.research.evaluation.ridge import Readout, Rows, listen, losses
from deitalk.research.lips.head_lips import MEASURES, HeadLips
from deitalk.research.lips.measured import LipClip, read_lips
from rig.arrays import Float32, Float64
from rig.face.head import build_head

LOW, HIGH = 5, 95
"""Percentiles of a range."""
SPEAKER_CLIPS = 40
"""Most recordings of a speaker that teach the ridge."""


def evaluate(
    model: DEITalk,
    folder: Path,
    *,
    speakers: Sequence[str] = (),
    most: int | None = None,
    encoder: Path | None = None,
    progress: Callable[[float], None] = lambda share: None,
) -> dict[str, Any]:
    """Score a model on measured lips.

    Parameters
    ----------
    model : DEITalk
        In evaluation mode.
    folder : Path
        Measured lips (`deitalk.research.lips.measured`).
    speakers : sequence of str
        Speakers to score; all if empty.
    most : int or None
        Most recordings of every speaker, evenly spread.
    encoder : Path or None
        Folder of a published Whisper encoder whose layers are read by a ridge too.
    progress : callable
        Called with the share done, 0 to 1.

    Returns
    -------
    dict
        By prediction, and speaker or ``mean`` (over speakers): ``r`` of each measure
        (mean over recordings), and for predicted curves ``range`` (5th to 95th percentile),
        ``speed`` (mean absolute velocity) and ``jerk`` (RMS of the third derivative over RMS of the
        first) over those measured. The ridge regressions are ``ridge: own`` and
        ``ridge: layer N``; there is none in a folder of one speaker.

    Raises
    ------
    DataError
        If the folder is not as described, or a speaker is not in it.
    """
    lips = HeadLips(build_head())
    every = read_lips(folder, lips.eye_distance)
    groups = _spread(every, speakers, most, folder)
    ridge = LipRidges(model, _spread(every, (), SPEAKER_CLIPS, folder), encoder)
    total = sum(map(len, groups.values()))
    report: dict[str, Any] = {}
    done = 0
    for speaker, clips in groups.items():
        pairs: dict[str, list[tuple[Float32, Float32]]] = {}
        readouts = ridge.without(speaker)
        for clip in clips:
            known = clip.speaking & np.isfinite(clip.measures).all(axis=1)
            predicted = _predictions(model, lips, clip) | ridge.predictions(readouts, clip)
            for name, given in predicted.items():
                n = min(len(given), len(known))
                pairs.setdefault(name, []).append(
                    (given[:n][known[:n]], clip.measures[:n][known[:n]])
                )
            done += 1
            progress(done / total)
        for name, found in pairs.items():
            scores = _scores(found, ranges=name != "loudness")
            report.setdefault(name, {})[speaker] = scores
    for rows in report.values():
        rows["mean"] = _mean(list(rows.values()))
    return report


class LipRidges:
    """Ridge regressions on the lips of all speakers but one.

    Parameters
    ----------
    model : DEITalk
        Whose features are read.
    clips : dict
        Recordings that teach, by speaker.
    encoder : Path or None
        As for `evaluate`.
    """

    def __init__(
        self, model: DEITalk, clips: dict[str, list[LipClip]], encoder: Path | None
    ) -> None:
        self.listen = listen(model, encoder)
        self.rows: dict[str, dict[str, list[Rows]]] = {}
        for speaker, group in clips.items():
            for clip in group if len(clips) > 1 else ():
                for name, features in self.listen(load_audio(clip.sound)).items():
                    n = min(len(features), len(clip.measures))
                    by_speaker = self.rows.setdefault(name, {})
                    by_speaker.setdefault(speaker, []).append((features[:n], clip.measures[:n]))

    def without(self, speaker: str) -> dict[str, Readout]:
        """Readouts taught by all others, by the name of their features."""
        return {
            name: Readout.fit(
                [row for other, rows in groups.items() if other != speaker for row in rows]
            )
            for name, groups in self.rows.items()
        }

    def predictions(self, readouts: dict[str, Readout], clip: LipClip) -> dict[str, Float32]:
        """Measures [shape=(T, M)] by every readout."""
        if not readouts:
            return {}
        heard = self.listen(load_audio(clip.sound))
        return {f"ridge: {name}": read(heard[name]) for name, read in readouts.items()}


def _spread(
    clips: Sequence[LipClip], speakers: Sequence[str], most: int | None, folder: Path
) -> dict[str, list[LipClip]]:
    """Recordings of every chosen speaker."""
    groups: dict[str, list[LipClip]] = {}
    for clip in clips:
        groups.setdefault(clip.speaker, []).append(clip)
    unknown = [name for name in speakers if name not in groups]
    if unknown:
        raise DataError(f"{folder}: no speaker {unknown[0]!r}; has {', '.join(sorted(groups))}")
    for name, group in groups.items():
        count = len(group) if most is None else min(most, len(group))
        groups[name] = [group[i] for i in np.linspace(0, len(group) - 1, count).round().astype(int)]
    return {name: groups[name] for name in speakers or sorted(groups)}


@torch.no_grad()
def _predictions(model: DEITalk, lips: HeadLips, clip: LipClip) -> dict[str, Float32]:
    """Measures [shape=(T, M)] by every prediction."""
    recording = load_audio(clip.sound)
    level = loudness(recording.waveform, recording.n_frames)
    animated, alone = (
        animate(recording, "neutral", model=model, life="off", rules=rules).curves.values
        for rules in (True, False)
    )
    return {
        "network": lips(torch.tensor(alone)).numpy(),
        "animated": lips(torch.tensor(animated)).numpy(),
        "loudness": np.repeat(level[:, None], len(MEASURES), axis=1),
    }


def _scores(pairs: Sequence[tuple[Float32, Float32]], *, ranges: bool) -> dict[str, Any]:
    """Scores of one speaker."""
    out: dict[str, Any] = {"clips": len(pairs)}
    for i, name in enumerate(MEASURES):
        each = [correlation(a[:, i], b[:, i]) for a, b in pairs]
        finite = [r for r in each if np.isfinite(r)]
        out[f"{name} r"] = float(np.mean(finite)) if finite else float("nan")
    if ranges:
        given, wanted = (np.concatenate([pair[i] for pair in pairs]) for i in range(2))
        reach = [np.subtract(*np.percentile(x, (HIGH, LOW), axis=0)) for x in (given, wanted)]
        speed = [
            np.mean([np.abs(np.diff(pair[i], axis=0)).mean(axis=0) for pair in pairs], axis=0)
            for i in range(2)
        ]
        (step, jerk), (steps, jerks) = ([_rms(pairs, i, k) for k in (1, 3)] for i in range(2))
        for i, name in enumerate(MEASURES):
            out[f"{name} range"] = _ratio(reach[0][i], reach[1][i])
            out[f"{name} speed"] = _ratio(speed[0][i], speed[1][i])
            out[f"{name} jerk"] = _ratio(jerk[i] * steps[i], step[i] * jerks[i])
    return out


def _rms(pairs: Sequence[tuple[Float32, Float32]], which: int, order: int) -> Float64:
    """RMS of differences of an order of the measures of all recordings [shape=(M,)]."""
    steps = np.concatenate([np.diff(pair[which], order, axis=0) for pair in pairs])
    return np.asarray(np.sqrt(np.square(steps, dtype=np.float64).mean(axis=0)))


def _ratio(given: float, measured: float) -> float:
    """`given` over `measured`; NaN if the measured lips are constant."""
    return float(given / measured) if measured > 0 else float("nan")


def _mean(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Means over speakers; the number of recordings is added up."""
    out: dict[str, Any] = {name: float(np.mean([row[name] for row in rows])) for name in rows[0]}
    return out | {"clips": sum(row["clips"] for row in rows)}


def as_markdown(report: dict[str, Any]) -> str:
    """A Markdown table per prediction; columns are speakers."""
    parts: list[str] = []
    known = {name: rows for name, rows in report.items() if isinstance(rows, dict)}
    for name, rows in known.items():
        parts += [f"Measured lips, {name}:", "", *table("", rows), ""]
    if "ridge: own" in known:
        own = {
            speaker: {name: value for name, value in scores.items() if name.endswith(" r")}
            for speaker, scores in known["ridge: own"].items()
        }
        parts += [losses(known["animated"], own), ""]
    return "\n".join(parts)
