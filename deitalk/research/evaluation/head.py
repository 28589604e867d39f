"""Motion of the head against measured readers: ``python -m deitalk.research.evaluation.head DIR``.

The folder holds measured lips with a pose (`deitalk.research.lips.measured`). Every speaker's
recordings are joined and their sound moves the head of `deitalk.postprocess.life.head`, neutral.
Range and speed are compared recording by recording; what lies within the fades of a take's ends is
left out. The exit code is 1 if a ratio lies beyond `TOLERANCE`.

The correlation is that of the head's pitch with the level of the voice, both without their trend,
averaged over a speaker's recordings at each lag of up to a third of a second: the largest of those
means, whatever its sign (people nod early or late, down or up). Beside it stands that with the
level reversed in time, the chance level. Where the folder states the words, the same is done with
the stressed syllables (`deitalk.research.evaluation.stress`). A tracker also takes a moving chin
for a nod, so that the readers' is an upper bound.

How regular the nods are is that of `deitalk.research.evaluation.nods`.

Letters: T frames at 30 per second, n measures at 25.
"""

import argparse
import sys
from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np

from deitalk.audio.frames import FRAME_RATE
from deitalk.audio.load import load_audio
from deitalk.emotions import LABELS
from deitalk.evaluation.report import table
from deitalk.pipeline.speech import Speech
from deitalk.postprocess.life.character import Seeds, Traits
from deitalk.postprocess.life.motion import plan_motion
from deitalk.postprocess.life.voice import Accent, Phrase, Voice, measure_voice
from deitalk.research.arguments import new_file, one_line_errors
from deitalk.research.evaluation.nods import MEASURES as NODS
from deitalk.research.evaluation.nods import measure_nods
from deitalk.research.evaluation.report import write_json
from deitalk.research.evaluation.stress import stress_track
from deitalk.research.lips.measured import RATE, PoseClip, read_poses
from rig.arrays import Float64
from rig.curves.filters import gaussian_smooth

TOLERANCE = 0.2
SMOOTH_SECONDS = 0.06
"""Sigma of the Gaussian before range and speed are taken, against the noise of the tracker."""
LAG_SECONDS, TREND_SECONDS, LEVEL_SECONDS = 0.33, 0.6, 0.07
FADED_SECONDS = 1.5
DRAWINGS = 3
AXES = ("yaw", "pitch", "roll")
SOUNDS = ("level", "level reversed", "stressed syllables", "stressed syllables reversed")
Mover = Callable[[Voice, int], Float64]


class Reader(NamedTuple):
    """A speaker: measured heads, and events, level and stress of each recording's voice."""

    clips: list[PoseClip]
    voices: list[Voice]
    levels: list[Float64]
    """Without what lies 40 dB below the loudest."""
    stresses: list[Float64]
    """Empty where the words are not known."""


def move_head(voice: Voice, drawing: int) -> Float64:
    """Yaw, pitch and roll of a neutral head [shape=(T, 3)], degrees."""
    calm = np.zeros((voice.n_frames, len(LABELS)), np.float32)
    motion = plan_motion(voice, calm, Seeds((0, 0, drawing)), traits=Traits())
    assert motion.head is not None
    return motion.head[:, :3].astype(np.float64)


def evaluate_head(folder: Path, most: int = 24, mover: Mover = move_head) -> dict[str, list[float]]:
    """Range and speed of heads, and their correlation with the voice.

    Parameters
    ----------
    folder : Path
        Measured lips with poses.
    most : int
        Most recordings of a speaker.
    mover : callable
        Maps a voice and a number to degrees [shape=(T, 3)].

    Returns
    -------
    dict
        ``measured range``, ``range``, ``measured speed`` and ``speed``: degrees (5th to 95th
        percentile) and degrees per second (root mean square) of yaw, pitch and roll, median over
        recordings, mean over speakers; ``measured nods``, ``nods``: of all recordings of a
        speaker, mean over speakers; ``measured correlation``, ``correlation``: of pitch with
        each of `SOUNDS`, NaN where the words are not known.

    Raises
    ------
    DataError
        If the folder is not as described.
    """
    rows: dict[str, list[Float64]] = {}
    for clips in read_poses(folder, most).values():
        reader = _reader(clips)
        heads = [clip.degrees for clip in clips]
        ours = [part for k in range(DRAWINGS) for part in _moved(reader.voices, mover, k)]
        for label, found, rate in (("measured ", heads, RATE), ("", [h for _, h in ours], 30.0)):
            measures = np.median([_measures(head, rate) for head in found], axis=0)
            rows.setdefault(f"{label}range", []).append(measures[:3])
            rows.setdefault(f"{label}speed", []).append(measures[3:])
            nods = measure_nods([head[:, 1] for head in found], rate)
            rows.setdefault(f"{label}nods", []).append(nods)
        pairs = list(enumerate(heads))
        rows.setdefault("measured correlation", []).append(_correlations(pairs, RATE, reader))
        rows.setdefault("correlation", []).append(_correlations(ours, 30.0, reader))
    return {name: np.mean(found, axis=0).tolist() for name, found in rows.items()}


def _reader(clips: list[PoseClip]) -> Reader:
    speeches = [Speech.of(load_audio(clip.sound).waveform) for clip in clips]
    voices = [measure_voice(speech.activity, speech.prosody) for speech in speeches]
    levels = [speech.prosody.level for speech in speeches]
    levels = [np.maximum(level, level.max() - 40) for level in levels]
    pairs = zip(speeches, clips, strict=True)
    stresses = [stress_track(speech, clip.words) for speech, clip in pairs if clip.words]
    return Reader(clips, voices, levels, stresses if len(stresses) == len(clips) else [])


def joined(voices: Sequence[Voice]) -> Voice:
    """One voice of several, one after the other."""
    starts = np.cumsum([0, *(voice.n_frames for voice in voices)]).tolist()
    pairs = list(zip(starts, voices, strict=False))
    accents, stresses = (
        tuple(Accent(a.frame + start, a.strength) for start, v in pairs for a in getattr(v, name))
        for name in ("accents", "stresses")
    )
    phrases = [
        Phrase(p.start + start, p.stop + start, p.is_question)
        for start, v in pairs
        for p in v.phrases
    ]
    prominence = np.concatenate([voice.prominence for voice in voices])
    return Voice(starts[-1], prominence, accents, tuple(phrases), stresses)


def _moved(voices: Sequence[Voice], mover: Mover, drawing: int) -> list[tuple[int, Float64]]:
    """Number and degrees of each recording that lies within no fade of the joined take."""
    head = mover(joined(voices), drawing)
    edges = np.cumsum([0, *(voice.n_frames for voice in voices)])
    faded = FADED_SECONDS * FRAME_RATE
    spans = enumerate(pairwise(edges))
    return [
        (i, head[start:stop])
        for i, (start, stop) in spans
        if start >= faded and stop <= len(head) - faded
    ]


def _measures(degrees: Float64, rate: float) -> Float64:
    """Range and speed of yaw, pitch and roll [shape=(6,)]."""
    smooth = np.stack([gaussian_smooth(d, SMOOTH_SECONDS * rate, "mirror") for d in degrees.T])
    low, high = np.percentile(smooth, (5, 95), axis=1)
    speed = np.sqrt(np.square(np.gradient(smooth, axis=1) * rate).mean(axis=1))
    return np.concatenate([high - low, speed])


def _correlations(heads: Sequence[tuple[int, Float64]], rate: float, reader: Reader) -> Float64:
    """Correlation of pitch with each of `SOUNDS` [shape=(4,)]."""
    found = np.full(len(SOUNDS), np.nan)
    for place, sounds in ((0, reader.levels), (2, reader.stresses)):
        if not sounds:
            continue
        profiles = []
        for i, head in heads:
            offset = 0.5 / RATE if rate == RATE else 0.0
            times = np.arange(len(head)) / rate + offset
            pitch = np.interp(np.arange(0, times[-1], 1 / FRAME_RATE), times, head[:, 1])
            profiles.append([_profile(pitch, sound) for sound in (sounds[i], sounds[i][::-1])])
        found[place : place + 2] = np.abs(np.mean(profiles, axis=0)).max(axis=1)
    return found


def _profile(pitch: Float64, sound: Float64) -> list[float]:
    """Correlation at each lag, both without their trend."""
    count = min(len(pitch), len(sound))
    sound = gaussian_smooth(sound[:count], LEVEL_SECONDS * FRAME_RATE, "mirror")
    trend = TREND_SECONDS * FRAME_RATE
    a, b = (x - gaussian_smooth(x, trend, "mirror") for x in (pitch[:count], sound))
    most = int(LAG_SECONDS * FRAME_RATE)
    inner = b[most : count - most]
    shifted = (a[most + lag : count - most + lag] for lag in range(-most, most + 1))
    return [float(np.corrcoef(x, inner)[0, 1]) for x in shifted]


def as_markdown(report: dict[str, list[float]]) -> str:
    """The report as three tables."""
    columns: dict[str, dict[str, str]] = {"readers": {}, "here": {}, "ratio": {}}
    for what, unit in (("range", "°"), ("speed", "°/s")):
        pairs = zip(AXES, report[f"measured {what}"], report[what], strict=True)
        for axis, theirs, ours in pairs:
            for column, value in zip(columns.values(), (theirs, ours, ours / theirs), strict=True):
                column[f"{what} of {axis}, {unit}"] = f"{value:.2f}"
    regular = {
        who: {n: f"{v:.2f}" for n, v in zip(NODS, report[name], strict=True)}
        for who, name in (("readers", "measured nods"), ("here", "nods"))
    }
    shares = {
        who: {s: f"{v:.2f}" for s, v in zip(SOUNDS, report[name], strict=True) if np.isfinite(v)}
        for who, name in (("readers", "measured correlation"), ("here", "correlation"))
    }
    lines = [*table("head", columns), "", *table("nods", regular)]
    lines += ["", *table("pitch of the head and", shares)]
    return "\n".join(lines) + "\n"


def ratios(report: dict[str, list[float]]) -> Float64:
    """Ours over the readers', of ranges and speeds [shape=(6,)]."""
    ours = np.array([*report["range"], *report["speed"]])
    share: Float64 = ours / np.array([*report["measured range"], *report["measured speed"]])
    return share


@one_line_errors
def main(arguments: Sequence[str] | None = None) -> int:
    """Print the report; 0 if all ratios are within the tolerance, else 1."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("folder", type=Path, help="measured lips with poses")
    parser.add_argument("--json", type=new_file, help="also write the report to this file")
    options = parser.parse_args(arguments)
    report = evaluate_head(options.folder)
    sys.stdout.write(as_markdown(report))
    write_json(options.json, {**report, "ratios": ratios(report).tolist()})
    return int((np.abs(ratios(report) - 1) > TOLERANCE).any())


if __name__ == "__main__":
    sys.exit(main())
