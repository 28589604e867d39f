"""Blinks of takes of recordings: ``python -m deitalk.research.evaluation.blinks FOLDER``.

The motion of each recording is drawn as for a neutral take of a nameless actor. The command prints
how many takes there are and how many different ones (lids and gaze), blinks a minute, their
intervals (median and 5th to 95th percentile), how long full blinks are more than half closed, and
the share that begins within `NEAR_SECONDS` of the end of a phrase, beside the share of all times
that lies there (chance). Published human ranges are in `deitalk.postprocess.life.blinks`.

Letters: T frames at 30 per second.
"""

import argparse
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from deitalk.audio.frames import FRAME_RATE
from deitalk.audio.load import load_audio
from deitalk.emotions import LABELS
from deitalk.errors import DataError
from deitalk.evaluation.report import table
from deitalk.pipeline.speech import Speech
from deitalk.postprocess.life.character import Seeds
from deitalk.postprocess.life.motion import plan_motion
from deitalk.postprocess.life.voice import measure_voice
from deitalk.research.arguments import new_file, one_line_errors
from deitalk.research.corpus.recordings import AUDIO_SUFFIXES
from deitalk.research.evaluation.report import write_json
from rig.arrays import Float32, Float64

NEAR_SECONDS = (-0.15, 0.45)
STEP = 0.01
"""Seconds from time to time, for the share by chance."""


class Take(NamedTuple):
    """Lids of a recording, and where its phrases end."""

    lids: Float32
    """Closure of the left lid [shape=(T,), range 0 to 1]."""
    ends: Float64
    """Seconds."""
    gaze: Float32
    """Degrees to the left and up [shape=(T, 2)]."""


def draw_take(waveform: Float32, seed: int = 0) -> Take:
    """Take of a recording [shape=(S,)] at 16 kHz."""
    speech = Speech.of(waveform)
    voice = measure_voice(speech.activity, speech.prosody)
    calm = np.zeros((voice.n_frames, len(LABELS)), np.float32)
    motion = plan_motion(voice, calm, Seeds.of(waveform, "", seed)).tracks
    ends = np.array([phrase.stop for phrase in voice.phrases], np.float64) / FRAME_RATE
    return Take(motion.lids[:, 0].astype(np.float32), ends, motion.calm_gaze.astype(np.float32))


def find_blinks(lids: Float32) -> list[tuple[float, float]]:
    """Start of each blink, and how long it is more than half closed, in seconds.

    The latter is 0 of an incomplete blink. Two blinks without an open frame between them are one.
    """
    edges = np.flatnonzero(np.diff(np.pad(lids > 0, 1).astype(int)))
    found = []
    for start, stop in zip(edges[::2], edges[1::2], strict=True):
        closure = lids[start:stop]
        half = (closure > 0.5).sum() if closure.max() > 0.95 else 0
        found.append((float(start) / FRAME_RATE, float(half) / FRAME_RATE))
    return found


def measure_blinks(takes: Iterable[Take]) -> dict[str, str]:
    """The measures of the command, by name; "–" where there is none."""
    takes = list(takes)
    blinks = [find_blinks(take.lids) for take in takes]
    starts = [np.array([start for start, _ in found]) for found in blinks]
    seconds = [len(take.lids) / FRAME_RATE for take in takes]
    intervals = np.concatenate([np.diff(start) for start in starts])
    half = np.array([length for found in blinks for _, length in found if length])
    pairs = list(zip(takes, starts, seconds, strict=True))
    near = np.concatenate([_near(times, take.ends) for take, times, _ in pairs])
    chance = [_near(np.arange(0, length, STEP), take.ends) for take, _, length in pairs]
    lows = [f"{edge:.1f}" for edge in np.percentile(intervals, (5, 95))] if len(intervals) else []
    return {
        "takes": str(len(takes)),
        "different ones": str(len({take.lids.tobytes() + take.gaze.tobytes() for take in takes})),
        "blinks a minute": f"{60 * sum(map(len, blinks)) / sum(seconds):.1f}",
        "interval, s": f"{np.median(intervals):.1f} ({' to '.join(lows)})" if lows else "–",
        "half closed, s": f"{np.median(half):.2f}" if len(half) else "–",
        "at ends of phrases (chance)": _share(near, np.concatenate(chance)),
    }


def _near(times: Float64, ends: Float64) -> Float64:
    """1 where a time is near an end, else 0."""
    after = times[:, None] - ends
    is_near = (after > NEAR_SECONDS[0]) & (after < NEAR_SECONDS[1])
    near: Float64 = np.asarray(is_near.any(axis=1), np.float64)
    return near


def _share(near: Float64, chance: Float64) -> str:
    return f"{near.mean():.2f} ({chance.mean():.2f})" if len(near) else "–"


def recordings(paths: Sequence[Path], most: int) -> list[Path]:
    """Recordings, and those of folders, at most so many of each folder, evenly spread."""
    found: list[Path] = []
    for path in paths:
        files = [path]
        if path.is_dir():
            files = sorted(f for f in path.rglob("*") if f.suffix.lower() in AUDIO_SUFFIXES)
            if not files:
                raise DataError(f"{path}: holds no {', '.join(AUDIO_SUFFIXES)}")
        chosen = np.linspace(0, len(files) - 1, min(most, len(files))).round().astype(int)
        found += [files[i] for i in chosen]
    return found


@one_line_errors
def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("recordings", type=Path, nargs="+", help="speech, or folders of it")
    parser.add_argument("--most", type=int, default=60, help="recordings of a folder")
    parser.add_argument("--seed", type=int, default=0, help="another drawing")
    parser.add_argument("--json", type=new_file, help="also write the measures to this file")
    options = parser.parse_args(arguments)
    files = recordings(options.recordings, max(1, options.most))
    takes = [draw_take(load_audio(path).waveform, options.seed) for path in files]
    found = measure_blinks(takes)
    sys.stdout.write("\n".join(table("blinks", {"here": found})) + "\n")
    write_json(options.json, {"blinks": found})


if __name__ == "__main__":
    sys.exit(main())
