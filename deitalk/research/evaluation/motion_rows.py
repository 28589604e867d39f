r"""How an expression lives in time and with the voice, on actors and readers: one table each.

::

    python -m deitalk.research.evaluation.motion_rows ACTORS.csv --split validation \
        --readers LIBRISPEECH.tsv --readers SPEECHOCEAN.tsv

The first table is that of ``evaluate --acted``, the others have columns ``path, speaker``. All is
measured on takes as `deitalk.animate` makes them.

``strength``: order of acted strengths, from `deitalk.research.evaluation.acted`.

``motion``, by emotion, medians of actors:

- two takes of an actor with two seconds of silence between: the expression in the middle second of
  the pause over that in speech, as predicted and with a constant intensity curve;
- a take of which .5 s follow the last word: the expression of its last frame over the mean, .1 s
  before the voice and in frame 0 over the 90th percentile, and p5 over p95 inside;
- lips at double intensity: of the contacts of the neutral reading, the share that is kept in all
  emotions, by the gap of the lips of an embedded head;
- the mean pose of the strongest third of the frames, of actors with a voice of their own: r between
  every two, the mean and the highest, of the upper face and of the whole; and the share of all
  labels, each shown on the calm take of every actor, whose mean pose is nearest to those of the
  same label of the other actors: what numbers tell apart, which people need not;
- calm takes: peaks of the brows over .1 in 10 s, ranges (95th less 5th percentile) in shapes of
  ARKit, saccades a minute, the longest aversion;
- 20 s of listening: the share of frames in which no control moves by .06 a second.

``readers``, by table: the same peaks of the brows, and the correlation over syllables of there
being an accent, or a peak of the brows, with the prominence that
`deitalk.research.evaluation.prominence` measures.

``auto``: recall of the emotion that the voice suggests, and its mean; neutral of readers.

The expression is the smile in joy, else the distance of brows, eyes, nose and cheeks from the
neutral reading.

Letters: T frames, C controls.
"""

import argparse
import sys
from collections.abc import Mapping, Sequence
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import torch
from scipy.signal import find_peaks

from deitalk.audio.frames import FRAME_RATE, SAMPLE_RATE
from deitalk.audio.load import load_audio
from deitalk.audio.voice_activity import speech_activity
from deitalk.emotions import EMOTIONS, LABELS, MOODS, IntensityCurve
from deitalk.emotions.actor import ActorReference
from deitalk.evaluation.report import table
from deitalk.evaluation.scores import mean_of_finite
from deitalk.models.checkpoint import require_model
from deitalk.models.curve_model import DEITalk
from deitalk.pipeline.curves import animate
from deitalk.pipeline.performance import Performance
from deitalk.pipeline.speech import Speech
from deitalk.pipeline.suggest import MODEL, NAMED, emotion_map
from deitalk.postprocess.life.gaze import SIDE_DEGREES
from deitalk.postprocess.life.voice import measure_voice
from deitalk.research.arguments import new_file, one_line_errors
from deitalk.research.evaluation.acted import EMOTIONS as ASKED
from deitalk.research.evaluation.acted import evaluate
from deitalk.research.evaluation.prominence import find_syllables
from deitalk.research.evaluation.report import identified, write_json
from deitalk.research.evaluation.strength_clips import (
    ACTORS,
    NEUTRAL,
    READERS,
    StrengthClip,
    read_strength_clips,
)
from deitalk.research.lips.head_lips import HeadLips
from deitalk.research.training.suggestion import PLACES, measure, recalls
from rig import default_controls
from rig.arrays import Bool, Float32, Float64, Int64
from rig.conversion.arkit import raw_to_arkit
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
PARTS = ("strength", "motion", "readers", "auto")
FROZEN = 0.06 / FRAME_RATE
SHAPES = {
    "BrowInnerUp": ".10", "BrowDownLeft": ".10", "EyeSquintLeft": ".12", "MouthSmileLeft": ".12",
    "NoseSneerLeft": ".05",
}  # fmt: skip
"""Shapes of ARKit, and the least range of a calm face."""
Rows = dict[str, float]
Columns = dict[str, Rows]
WANTED = {
    "whole face: high above low": ".90", "upper face: high above low": ".88",
    "opening range: high above low": ".80", "intensity: high above low": ".80 in sadness",
    "joined, intensity: high above low": ".98", "joined, whole face: high above low": ".97",
    "joined, upper face: high above low": ".95",
    "joined at one level, intensity: high above low": ".95",
    "joined at one level, whole face: high above low": ".93",
    "joined at one level, upper face: high above low": ".92",
    "opening range: high over neutral, angry": "1.3 to 1.5",
    "opening range: high over neutral, happy": "1.2 to 1.45",
    "in a pause of 2 s over speech": ".6", "in a pause of 2 s over speech, constant curve": ".95",
    ".1 s before the voice over apex": ".7", "frame 0 over apex": ".3",
    "last frame over mean": ".5", "p5 over p95 in speech": ".6",
    "apex r, upper face": ".9 at most", "apex r, whole face": ".9 at most",
    "labels named by poses": ".9", "brow peaks in 10 s": "5 at most", "saccades a minute": "45",
    "longest aversion, s": "2 at most", "frozen frames while listening": ".05 at most",
    "closures kept in all emotions, intensity 2": "1", "brow peaks, r with prominence": ".5",
    "accents, r with prominence": ".5", "unweighted recall": ".70; .55 of another corpus",
    "readers neutral": ".95",
    **{f"range of {name}": least for name, least in SHAPES.items()},
}  # fmt: skip
"""What a row should be, at least where nothing is said, by its name."""


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


def brow_peaks(take: Performance) -> Int64:
    """Frames at which the brows are raised or lowered most."""
    columns = (take.curves.values[:, both].mean(axis=1) for both in BROWS)
    found: Int64 = find_peaks(sum(columns), prominence=0.1)[0]
    return found


def acted_by(sound: Float32, emotion: str, actor: str) -> Performance:
    """A take of an actor with a character of its own."""
    own = {"own": 1.0, "side": 0.25 * np.sin(sum(map(ord, actor)))}
    voice = ActorReference(0.0, 1, 10.0, traits=own)
    return animate(sound, emotion, sample_rate=SAMPLE_RATE, voice=voice)


def apex(sound: Float32, emotion: str, actor: str) -> Float64:
    """Mean expression of the strongest third of the frames of speech [shape=(C,)]."""
    take = acted_by(sound, emotion, actor)
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


def named_rows(sounds: Mapping[str, Float32]) -> Rows:
    """Return the share of labels that are recognised by mean poses, on each actor's calm sound."""
    poses = np.array(
        [
            [
                acted_by(sound, label, actor).curves.values[:, FACE].mean(axis=0, dtype=np.float64)
                for label in LABELS
            ]
            for actor, sound in sounds.items()
        ]
    )
    right = []
    for own, pose in enumerate(poses):
        others = np.delete(poses, own, axis=0).mean(axis=0)
        distances = np.linalg.norm(pose[:, None] - others, axis=2)
        right.append(distances.argmin(axis=1) == np.arange(len(LABELS)))
    return {"labels named by poses": float(np.mean(right))}


def calm_rows(sound: Float32) -> Rows:
    """Brows and eyes of a calm take, and a listener's frozen frames."""
    take = animate(sound, sample_rate=SAMPLE_RATE)
    values, seconds = take.curves.values, len(sound) / SAMPLE_RATE
    shapes = raw_to_arkit(take.curves).curves
    sides = [CONTROLS.index(f"CTRL_{s}_eye.{axis}") for s in "LR" for axis in ("tx", "ty")]
    left_x, left_y, right_x, right_y = values[:, sides].T * SIDE_DEGREES
    looks = np.stack(((left_x + right_x) / 2, (left_y + right_y) / 2), axis=1)
    fast = np.linalg.norm(np.diff(looks, axis=0), axis=1) * FRAME_RATE > 20
    away = np.abs(looks[:, 0] - np.median(looks[:, 0])) > 4
    heard = animate(silence(1), sample_rate=SAMPLE_RATE, listen=20).curves.values
    return {
        "brow peaks in 10 s": len(brow_peaks(take)) * 10 / seconds,
        **{f"range of {n}": float(np.subtract(*np.percentile(shapes[n], (95, 5)))) for n in SHAPES},
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


def motion(clips: Sequence[StrengthClip]) -> Columns:
    """Rows by emotion; ``neutral`` has those of calm takes."""
    report: Columns = {}
    for code, emotion in ASKED.items():
        heard = _heard(clips, code)
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
        if len(heard := _heard(clips, NEUTRAL)) > 1:
            report["neutral"] |= named_rows(heard)
    return report


def _heard(clips: Sequence[StrengthClip], code: str) -> dict[str, Float32]:
    """Speech of one clip of every actor in an emotion."""
    own = {clip.speaker: clip for clip in clips if clip.emotion == code}
    sounds = {actor: load_audio(clip.path).waveform for actor, clip in own.items()}
    return {a: padded_speech(s) for a, s in sounds.items() if speech_activity(s).any()}


def strengths(table_of: Path, split: str) -> Columns:
    """Rows of acted strengths by group of emotions, and over all pairs of takes."""
    found = evaluate(require_model(MODEL, DEITalk), table_of, split=split)
    report = {g: {n: v for n, v in rows.items() if n in WANTED} for g, rows in found.items()}
    pairs = [rows["actors and emotions"] for rows in found.values()]
    names = [name for name in next(iter(report.values())) if "above" in name]
    if any(pairs):
        report["all"] = {
            name: float(np.average([rows[name] for rows in report.values()], weights=pairs))
            for name in names
        }
    return report


def reader_rows(clips: Sequence[StrengthClip]) -> Rows:
    """Brows of readers: peaks in 10 s, and on which syllables; means of recordings."""
    rows = []
    for clip in clips:
        take = animate(clip.path)
        speech = Speech.of_recording(take.recording)
        voice = measure_voice(speech.activity, speech.prosody)
        syllables = find_syllables(speech.waveform)
        peaks = brow_peaks(take) / FRAME_RATE
        accents = np.array([accent.frame for accent in voice.accents]) / FRAME_RATE
        rows.append(
            (
                len(peaks) * 10 * FRAME_RATE / speech.n_frames,
                syllables.r(peaks),
                syllables.r(accents),
            )
        )
    names = "brow peaks in 10 s", "brow peaks, r with prominence", "accents, r with prominence"
    return dict(zip(names, map(mean_of_finite, zip(*rows, strict=True)), strict=True))


def suggested(clips: Sequence[StrengthClip]) -> Rows:
    """Recalls of the most probable emotion of actors, and the share of readers who are neutral."""
    network, found = require_model(MODEL, DEITalk), emotion_map()
    rows, truth = [], []
    for clip in clips:
        numbers = measure(network, load_audio(clip.path).waveform)
        if numbers is not None and (clip.kind == READERS or clip.emotion in PLACES):
            rows.append(found.probabilities(numbers))
            truth.append(PLACES.get(clip.emotion, 0))
    scores = recalls(np.stack(rows), np.array(truth, np.int64))
    if clips[0].kind == READERS:
        return {"readers neutral": scores[f"recall {NAMED[0]}"]}
    return scores


def read_clips(
    path: Path, kind: str, split: str, most: int, sentences: int = 3
) -> list[StrengthClip]:
    """Clips of so many speakers of a split; of a reader so many sentences, evenly spread."""
    clips = [clip for clip in read_strength_clips(path, kind) if split in (clip.split, "all")]
    by_speaker: dict[str, list[StrengthClip]] = {}
    for clip in clips:
        by_speaker.setdefault(clip.speaker, []).append(clip)
    names = sorted(by_speaker)[:most]
    if kind == READERS:
        return [c for n in names for c in by_speaker[n][:: -(-len(by_speaker[n]) // sentences)]]
    return [clip for clip in clips if clip.speaker in names]


def with_wanted(columns: Columns) -> Columns:
    """Columns after one that says what a row should be."""
    names = dict.fromkeys(name for rows in columns.values() for name in rows)
    wanted: Any = {name: WANTED.get(name, "") for name in names}
    return {"at least": wanted, **columns}


@one_line_errors
def main(arguments: Sequence[str] | None = None) -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("actors", type=Path, help="table of recordings of actors")
    parser.add_argument("--readers", type=Path, action="append", default=[], help="of readers")
    parser.add_argument("--split", default="validation", help="speakers; all of another corpus")
    parser.add_argument("--most", type=int, default=12, help="speakers at most, but of strengths")
    parser.add_argument("--sentences", type=int, default=3, help="of a reader at most")
    parser.add_argument("--only", action="append", choices=PARTS, help="these rows alone")
    parser.add_argument("--json", type=new_file, help="also write the measures to this file")
    options = parser.parse_args(arguments)
    chosen, most = options.only or PARTS, max(options.most, 2)
    report: dict[str, Columns] = {}
    actors = read_clips(options.actors, ACTORS, options.split, most)
    asked = options.split, most, max(options.sentences, 1)
    readers = {path.stem: read_clips(path, READERS, *asked) for path in options.readers}
    spoken = {options.actors.stem: actors, **readers}
    if "strength" in chosen:
        report["strength"] = strengths(options.actors, options.split)
    if "motion" in chosen:
        report["motion"] = motion(actors)
    if "readers" in chosen and readers:
        report["readers"] = {name: reader_rows(clips) for name, clips in readers.items()}
    if "auto" in chosen:
        report["auto"] = {name: suggested(clips) for name, clips in spoken.items()}
    for name, columns in report.items():
        sys.stdout.write("\n".join(table(name, with_wanted(columns))) + "\n\n")
    write_json(options.json, identified(MODEL) | report)


if __name__ == "__main__":
    sys.exit(main())
