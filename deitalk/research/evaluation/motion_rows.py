"""How an expression lives in time: ``python -m deitalk.research.evaluation.motion_rows TABLE``.

The table is that of ``evaluate --acted``: actors in emotions. Every measure is of takes as
`deitalk.animate` makes them:

- two takes of an actor with two seconds of silence between: the expression in the middle second of
  the pause over that in speech, as predicted and with a constant intensity curve;
- a take of which .5 s follow the last word: the expression of its last frame over the mean, .1 s
  before the voice and in frame 0 over the 90th percentile, and p5 over p95 inside;
- lips at double intensity: of the contacts of the neutral reading, the share that is kept in all
  emotions, by the gap of the lips of an embedded head;
- the mean pose of the strongest third of the frames, of actors with a voice of their own: r between
  every two, the mean and the highest, of the upper face and of the whole;
- calm takes: peaks of the brows over .1 in 10 s, saccades a minute, the longest aversion;
- 20 s of listening: the share of frames in which no control moves by .06 a second.

The expression is the smile in joy, else the distance of brows, eyes, nose and cheeks from the
neutral reading.

Letters: T frames, C controls.
"""

import argparse
import sys
from collections.abc import Mapping, Sequence
from itertools import combinations
from pathlib import Path

import numpy as np
import torch
from scipy.signal import find_peaks

from deitalk.audio.frames import FRAME_RATE, SAMPLE_RATE
from deitalk.audio.load import load_audio
from deitalk.audio.voice_activity import speech_activity
from deitalk.emotions import EMOTIONS, MOODS, IntensityCurve
from deitalk.emotions.actor import ActorReference
from deitalk.errors import DeitalkError
from deitalk.evaluation.report import table
from deitalk.pipeline.curves import animate
from deitalk.pipeline.performance import Performance
from deitalk.postprocess.life.eyes import SIDE_DEGREES
from deitalk.research.arguments import new_file
from deitalk.research.evaluation.acted import (
    EMOTIONS as ASKED,
)
from deitalk.research.evaluation.report import write_json
from deitalk.research.evaluation.strength_clips import (
    ACTORS,
    NEUTRAL,
    StrengthClip,
    read_strength_clips,
)
from deitalk.research.lips.head_lips import HeadLips
from rig import default_controls
from rig.arrays import Bool, Float32, Float64
from rig.face.head import build_head

CONTROLS = default_controls()
UPPER = [k for k, n in enumerate(CONTROLS.names) if any(p in n for p in ("brow", "eye_", "nose"))]
FACE = [k for k, n in enumerate(CONTROLS.names) if "eye_blink" not in n and "tongue" not in n]
SMILE = [CONTROLS.index(f"CTRL_{side}_mouth_cornerPull.ty") for side in "LR"]
BROWS = [[CONTROLS.index(f"CTRL_{s}_brow_{n}.ty") for s in "LR"] for n in ("raiseIn", "down")]
SEALS = [k for k, name in enumerate(CONTROLS.names) if "lipsTogether" in name]
PAUSE_SECONDS, LAST_SECONDS, LEAD_SECONDS = 2.0, 0.5, 0.4
CONSTANT = IntensityCurve(np.array([0.0, 60.0]), np.array([0.8, 0.8]))
MET, GAP = 0.75, 0.02
"""Contact of lips that meet, and the gap that met lips may have, of the eyes' distance."""
FROZEN = 0.06 / FRAME_RATE
Rows = dict[str, float]


def padded_speech(sound: Float32) -> Float32:
    """The speech of a sound, `LEAD_SECONDS` of silence before it and `LAST_SECONDS` after it."""
    active = np.flatnonzero(speech_activity(sound) > 0)
    first, stop = (round(k * SAMPLE_RATE / FRAME_RATE) for k in (active[0], active[-1] + 1))
    return np.concatenate((silence(LEAD_SECONDS), sound[first:stop], silence(LAST_SECONDS)))


def silence(seconds: float) -> Float32:
    """Samples of faint noise, as no room is silent."""
    rng = np.random.default_rng(0)
    return (1e-4 * rng.standard_normal(round(seconds * SAMPLE_RATE))).astype(np.float32)


def expression(take: Performance, emotion: str) -> Float64:
    """Size of what is shown at every frame [shape=(T,)]."""
    shown = np.asarray(take.curves.values - take.neutral.values, np.float64)
    if emotion == "happy":
        return np.asarray(shown[:, SMILE].mean(axis=1))
    return np.asarray(np.linalg.norm(shown[:, UPPER], axis=1))


def pause_rows(sound: Float32, emotion: str) -> Rows:
    """Expression in a pause over that in speech."""
    joined = np.concatenate((sound, silence(PAUSE_SECONDS), sound))
    middle = round((len(sound) / SAMPLE_RATE + PAUSE_SECONDS / 2) * FRAME_RATE)
    inside = slice(middle - FRAME_RATE // 2, middle + FRAME_RATE // 2)
    found = {}
    for name, curve in (("", None), (", constant curve", CONSTANT)):
        take = animate(joined, emotion, sample_rate=SAMPLE_RATE, intensity_curve=curve)
        size, speaking = expression(take, emotion), take.recording.activity > 0
        found[f"in a pause of 2 s over speech{name}"] = size[inside].mean() / size[speaking].mean()
    return found


def edge_rows(sound: Float32, emotion: str) -> Rows:
    """Expression at the ends of a take over its own, and its evenness."""
    take = animate(sound, emotion, sample_rate=SAMPLE_RATE)
    size, speaking = expression(take, emotion), take.recording.activity > 0
    first, apex = int(np.argmax(speaking)), float(np.percentile(size[speaking], 90))
    low, high = np.percentile(size[speaking], (5, 95))
    return {
        ".1 s before the voice over apex": size[max(first - 3, 0)] / apex,
        "frame 0 over apex": size[0] / apex,
        "last frame over mean": size[-1] / size[speaking].mean(),
        "p5 over p95 in speech": low / high,
    }


def kept_closures(sounds: Sequence[Float32], lips: HeadLips) -> Rows:
    """Contacts of the neutral reading that emotions at double intensity keep."""
    kept, count = 0, 0
    for sound in sounds:
        takes = [
            animate(sound, name, sample_rate=SAMPLE_RATE, intensity=2.0)
            for name in (*EMOTIONS, *MOODS)
            if name != "neutral"
        ]
        with torch.no_grad():
            gaps = [lips(torch.from_numpy(take.curves.values.copy()))[:, 0] for take in takes]
        shut: Bool = np.logical_and.reduce([gap.numpy() < GAP for gap in gaps])
        met = takes[0].neutral.values[:, SEALS].mean(axis=1) >= MET
        edges = np.flatnonzero(np.diff(np.pad(met.astype(int), 1)))
        speaking = takes[0].recording.activity > 0
        for start, stop in edges.reshape(-1, 2):
            if speaking[start:stop].all():
                count += 1
                kept += bool(shut[start:stop].any())
    return {"closures": count, "closures kept in all emotions, intensity 2": kept / max(count, 1)}


def apex(sound: Float32, emotion: str, actor: str) -> Float64:
    """Mean expression of the strongest third of the frames of speech [shape=(C,)]."""
    own = {"own": 1.0, "side": 0.25 * np.sin(sum(map(ord, actor)))}
    voice = ActorReference(0.0, 1, 10.0, traits=own)
    take = animate(sound, emotion, sample_rate=SAMPLE_RATE, voice=voice)
    shown = (take.curves.values - take.neutral.values)[take.recording.activity > 0]
    size = np.linalg.norm(shown[:, UPPER], axis=1)
    pose: Float64 = shown[size >= np.quantile(size, 2 / 3)].mean(axis=0, dtype=np.float64)
    return pose


def apex_rows(poses: Mapping[str, Float64]) -> Rows:
    """R of the poses of every two actors."""
    rows: Rows = {}
    for name, columns in (("upper face", UPPER), ("whole face", FACE)):
        pairs = [
            float(np.corrcoef(a[columns], b[columns])[0, 1])
            for a, b in combinations(poses.values(), 2)
        ]
        rows[f"apex r, {name}"] = float(np.mean(pairs))
        rows[f"apex r, {name}, p90"] = float(np.quantile(pairs, 0.9))
    return rows


def calm_rows(sound: Float32) -> Rows:
    """Brows and eyes of a calm take, and a listener's frozen frames."""
    take = animate(sound, sample_rate=SAMPLE_RATE)
    values, seconds = take.curves.values, len(sound) / SAMPLE_RATE
    brows = np.sum([values[:, columns].mean(axis=1) for columns in BROWS], axis=0)
    sides = [CONTROLS.index(f"CTRL_{s}_eye.{axis}") for s in "LR" for axis in ("tx", "ty")]
    left_x, left_y, right_x, right_y = values[:, sides].T * SIDE_DEGREES
    looks = np.stack(((left_x + right_x) / 2, (left_y + right_y) / 2), axis=1)
    fast = np.linalg.norm(np.diff(looks, axis=0), axis=1) * FRAME_RATE > 20
    away = np.abs(looks[:, 0] - np.median(looks[:, 0])) > 4
    heard = animate(silence(1), sample_rate=SAMPLE_RATE, listen=20).curves.values
    return {
        "brow peaks in 10 s": len(find_peaks(brows, prominence=0.1)[0]) * 10 / seconds,
        "saccades a minute": 60 * _runs(fast)[1] / seconds,
        "longest aversion, s": _runs(away)[0] / FRAME_RATE,
        "frozen frames while listening": float(
            (np.abs(np.diff(heard, axis=0)).max(axis=1) < FROZEN).mean()
        ),
    }


def _runs(flags: Bool) -> tuple[int, int]:
    """Length of the longest run of true frames, and how many runs there are."""
    edges = np.flatnonzero(np.diff(np.pad(flags.astype(int), 1))).reshape(-1, 2)
    lengths = edges[:, 1] - edges[:, 0]
    return int(lengths.max(initial=0)), len(edges)


def measure(clips: Sequence[StrengthClip]) -> dict[str, Rows]:
    """All rows, by emotion; ``neutral`` has those of calm takes."""
    report: dict[str, Rows] = {}
    for code, emotion in ASKED.items():
        own = {clip.speaker: clip for clip in clips if clip.emotion == code}  # one of an actor
        sounds = {actor: load_audio(clip.path).waveform for actor, clip in own.items()}
        heard = {a: padded_speech(s) for a, s in sounds.items() if speech_activity(s).any()}
        if len(heard) < 2:
            continue
        rows = [pause_rows(sound, emotion) | edge_rows(sound, emotion) for sound in heard.values()]
        report[emotion] = {name: float(np.median([row[name] for row in rows])) for name in rows[0]}
        poses = {actor: apex(sound, emotion, actor) for actor, sound in heard.items()}
        report[emotion] |= apex_rows(poses)
    calm = [load_audio(clip.path).waveform for clip in clips if clip.emotion == NEUTRAL]
    if calm:
        lips = HeadLips(build_head("0"))
        report["neutral"] = calm_rows(np.concatenate(calm)) | kept_closures(calm, lips)
    return report


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("table", type=Path, help="recordings of actors")
    parser.add_argument("--split", default="validation", help="actors; all of another corpus")
    parser.add_argument("--most", type=int, default=12, help="actors at most")
    parser.add_argument("--json", type=new_file, help="also write the measures to this file")
    options = parser.parse_args(arguments)
    try:
        clips = read_strength_clips(options.table, ACTORS)
        clips = [clip for clip in clips if options.split in (clip.split, "all")]
        some = sorted({clip.speaker for clip in clips})[: max(options.most, 2)]
        report = measure([clip for clip in clips if clip.speaker in some])
    except DeitalkError as error:
        sys.stderr.write(f"deitalk: {error}\n")
        return 1
    sys.stdout.write("\n".join(table("", report)) + "\n")
    write_json(options.json, report)
    return 0


if __name__ == "__main__":
    sys.exit(main())
