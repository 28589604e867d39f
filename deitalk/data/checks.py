"""Checks of a dataset folder before training: ``deitalk data check DIR``.

Every clip is read once; a fault is one line with the clips it concerns. Files that
training could not read (values out of their control's range among them) are unreadable here.

The offset between sound and curves is the lag at which the jaw follows the level of the vowels
best, pooled over the clips. A single clip is called shifted only if it is so against the embedded
model's curves too: loud consonants, short clips and long pauses mislead the level. A lag means
curves that are early or late, the most common fault of captures.

Letters: T frames, C controls.
"""

from collections import Counter
from collections.abc import Callable, Sequence
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np

from deitalk.audio.frames import FRAME_RATE, SAMPLE_RATE
from deitalk.audio.load import Recording, load_audio
from deitalk.audio.voice_activity import speech_activity
from deitalk.data.captures.splits import APART_SECONDS
from deitalk.data.captures.survey import Survey
from deitalk.data.captures.verdicts import Check, capture_rows, verdict
from deitalk.data.clips import (
    SPLITS,
    Clip,
    read_clips,
    read_intensity,
    read_known,
    read_phones,
)
from deitalk.data.offset import ClipLags, clip_lags, predicted_curves, sharpest_peak
from deitalk.emotions import EMOTIONS
from rig import ControlSet, RigCurves, default_controls, read_curves
from rig.arrays import Float64
from rig.controls import DEFAULT_ID
from rig.errors import UserError

SHIFTED_SECONDS = 0.05
"""Lag of the level, pooled or of a clip, beyond which the curves do not belong to the sound."""
JAW = "CTRL_C_jaw.ty"
LENGTH_SECONDS = 0.1
DEAD = 1e-3
FEW = 0.05
OPEN_SHARE = 0.25
CLIPPED_SHARE = 0.01


class Measured(NamedTuple):
    """Measurements of one clip."""

    name: str
    fps: float
    source_rate: int
    audio_seconds: float
    curve_end: float
    """Last frame's time on the audio's axis, seconds."""
    missing: tuple[str, ...]
    """Known controls that the curves lack."""
    low: Float64
    high: Float64
    """Smallest and largest value of every control [shape=(C,)]; NaN where it is unknown."""
    lags: ClipLags | None
    """Lags of the jaw against the level; None if one does not move, or the clip is short."""
    shift: float
    """Lag of a clip that is shifted by itself, seconds; else 0."""
    speech_share: float
    open_share: float
    """Mean jaw in silence by its 95th percentile in speech; NaN where unknown."""
    clipped: float
    notes: tuple[str, ...]
    """What the reader of the curves corrected."""


class Inspection(NamedTuple):
    """Checks of a dataset folder, and what they are drawn from."""

    checks: list[Check]
    survey: Survey | None
    """Survey of the clips that state their take; None if there are none."""


def inspect_dataset(
    folder: Path | str,
    *,
    controls: ControlSet | None = None,
    most: int | None = None,
    progress: Callable[[float], None] = lambda share: None,
) -> Inspection:
    """Check every clip of a dataset folder.

    Parameters
    ----------
    folder : Path
        Dataset folder.
    controls : ControlSet or None
        Another rig than the board, whose curves the dataset has.
    most : int or None
        Read at most so many clips, evenly spread.
    progress : callable
        Called with the share done.

    Returns
    -------
    Inspection

    Raises
    ------
    DataError
        If ``clips.csv`` itself cannot be used.
    """
    controls = controls or default_controls()
    clips = read_clips(folder)
    places = np.linspace(0, len(clips) - 1, min(most or len(clips), len(clips))).round().astype(int)
    measured, unreadable, survey = [], [], Survey(controls)
    for done, place in enumerate(places):
        clip = clips[place]
        try:
            measured.append(measure(clip, controls))
            if clip.take:
                survey.add(clip, _recording(str(clip.audio)), _curves(clip, controls))
        except UserError as error:
            unreadable.append(f"{clip.name} ({error})")
        progress((done + 1) / len(places))
    checks = [
        verdict("files", unreadable, f"{len(measured)} clips can be read", "unreadable", "error"),
        *_of_the_table(clips),
    ]
    checks += _of_the_clips(measured, controls) if measured else []
    if not survey.clips:
        return Inspection(checks, None)
    rows = capture_rows(survey)
    names = {row.name for row in rows}
    return Inspection([c for c in checks if c.name not in names] + rows, survey)


def measure(clip: Clip, controls: ControlSet) -> Measured:
    """Read one clip and measure it; its phones and intensity are read too."""
    recording, curves = _recording(str(clip.audio)), _curves(clip, controls)
    times = curves.times + clip.offset_seconds
    end = float(times[-1])
    if clip.take:  # its curves go on beyond the clip
        end = min(end, recording.duration - 1 / curves.fps)
    if clip.phones is not None:
        read_phones(clip.phones)
    if clip.intensity is not None:
        read_intensity(clip.intensity, times)
    low, high = np.full(len(controls), np.nan), np.full(len(controls), np.nan)
    wanted = [n for n, k in zip(controls.names, read_known(clip.known, controls), strict=True) if k]
    present = [name for name in wanted if name in set(curves.names)]
    places, columns = [controls.index(n) for n in present], [curves.index(n) for n in present]
    low[places] = curves.values[:, columns].min(axis=0)
    high[places] = curves.values[:, columns].max(axis=0)
    speaking = speech_activity(recording.waveform) > 0
    lags = clip_lags(curves, recording.waveform, predicted=None, offset=clip.offset_seconds)
    open_share = float("nan")
    if JAW in curves.names and speaking.any() and not speaking.all():
        jaw = np.interp(np.arange(len(speaking)) / FRAME_RATE, times, curves[JAW])
        most = max(float(np.percentile(jaw[speaking], 95)), 1e-3)
        open_share = float(jaw[~speaking].mean() / most)
    return Measured(
        clip.name,
        curves.fps,
        recording.source_rate,
        recording.duration,
        end,
        tuple(name for name in wanted if name not in set(present)),
        low,
        high,
        lags,
        _shift(clip, lags, curves),
        float(speaking.mean()),
        open_share,
        recording.clipped_fraction,
        curves.notes,
    )


def _curves(clip: Clip, controls: ControlSet) -> RigCurves:
    return read_curves(clip.curves, controls=None if controls.id == DEFAULT_ID else controls)


@lru_cache(maxsize=8)
def _recording(path: str) -> Recording:
    return load_audio(path)


@lru_cache(maxsize=8)
def _predicted(path: str) -> RigCurves | None:
    return predicted_curves(_recording(path))


def _shift(clip: Clip, lags: ClipLags | None, curves: RigCurves) -> float:
    """Lag of a clip that is early or late by level and model, seconds; else 0.

    Clips that state their take are judged by take (`Survey.sync`).
    """
    if clip.take or lags is None or abs(lags.lag) < SHIFTED_SECONDS:
        return 0.0
    recording = _recording(str(clip.audio))
    predicted, offset = _predicted(str(clip.audio)), clip.offset_seconds
    found = clip_lags(curves, recording.waveform, predicted=predicted, offset=offset)
    return found.lag if found is not None and found.is_shifted else 0.0


def _of_the_table(clips: Sequence[Clip]) -> list[Check]:
    """Splits, speakers and emotions."""
    splits = Counter(clip.split for clip in clips)
    counts = ", ".join(f"{splits[s]} {s}" for s in SPLITS)
    missing = [f"no {s} clips" for s in SPLITS if not splits[s]]
    emotions = Counter(clip.emotion for clip in clips if clip.split == "train")
    total = max(sum(emotions.values()), 1)
    rare = [f"{e} {emotions[e] / total:.0%}" for e in EMOTIONS if emotions[e] / total < FEW]
    shares = ", ".join(f"{e} {emotions[e] / total:.0%}" for e in EMOTIONS)
    split = verdict("splits", missing, counts, f"of three splits are empty ({counts})")
    if not splits["train"]:
        split = Check("splits", "error", f"no clips to train on ({counts})")
    elif set(splits) == {"train"}:
        text = f"{counts}: all are learnt from, finetune judges by folds, train needs validation"
        split = Check("splits", "ok", text)
    # Speakers in several splits: an error, a warning where their takes or blocks are apart.
    homes: dict[str, set[str]] = {}
    for clip in clips:
        homes.setdefault(clip.speaker, set()).add(clip.split)
    mixed = {who: f"{who} ({', '.join(sorted(at))})" for who, at in homes.items() if len(at) > 1}
    close = [who for who in mixed if not are_apart([c for c in clips if c.speaker == who])]
    well, fault = f"{len(homes)}, each in one split", "in several splits"
    if not close:
        fault += ", in takes or blocks that are apart: scores hold for them only"
    wrong = [mixed[who] for who in close or mixed]
    speakers = verdict("speakers", wrong, well, fault, "error" if close else "warning")
    few = f"of {len(EMOTIONS)} are rare in train; finetune moves as its base there"
    return [
        split,
        speakers,
        verdict("emotions", rare, shares, few),
    ]


def are_apart(clips: Sequence[Clip]) -> bool:
    """Whether clips in different splits are of different takes, or `APART_SECONDS` apart."""
    takes: dict[str, list[Clip]] = {}
    for clip in clips:
        takes.setdefault(clip.take, []).append(clip)
    if "" in takes:
        return False
    for own in takes.values():
        own.sort(key=lambda clip: clip.span)
        for clip, following in pairwise(own):
            near = following.span[0] - clip.span[1] < APART_SECONDS
            if clip.split != following.split and near:
                return False
    return True


def _of_the_clips(clips: Sequence[Measured], controls: ControlSet) -> list[Check]:
    """Names, rates, lengths, offset, silence, ranges and channels that never move."""
    rates = Counter(clip.fps for clip in clips)
    frames = ", ".join(f"{n} at {rate:g} Hz" for rate, n in sorted(rates.items()))
    lengths = [
        f"{c.name} ({c.curve_end + 1 / c.fps - c.audio_seconds:+.2f} s)"
        for c in clips
        if abs(c.curve_end + 1 / c.fps - c.audio_seconds) > LENGTH_SECONDS
    ]
    incomplete = [f"{c.name} (lacks {len(c.missing)}, {c.missing[0]})" for c in clips if c.missing]
    narrow = [f"{c.name} ({c.source_rate} Hz)" for c in clips if c.source_rate < SAMPLE_RATE]
    clipped = [f"{c.name} ({c.clipped:.0%})" for c in clips if c.clipped > CLIPPED_SHARE]
    mute = [c.name for c in clips if c.speech_share == 0]
    corrected = [f"{c.name} ({'; '.join(c.notes)})" for c in clips if c.notes]
    gaping = [f"{c.name} ({c.open_share:.0%})" for c in clips if c.open_share > OPEN_SHARE]
    # Lag of the jaw behind the level, pooled, and the clips that differ clearly.
    lags = [clip.lags.scores / clip.lags.n_groups for clip in clips if clip.lags is not None]
    if lags:
        pooled: Float64 = np.mean(lags, axis=0)
        lag, r = sharpest_peak(pooled), max(pooled.max(), 0) ** 0.5
        text = f"curves {lag * 1000:+.0f} ms after the sound (r {r:.2f})"
        shifted = [f"{clip.name} ({clip.shift * 1000:+.0f} ms)" for clip in clips if clip.shift]
        offset = verdict("offset", shifted, text, f"clips seem shifted; all: {text}")
        if abs(lag) > SHIFTED_SECONDS:
            offset = Check("offset", "warning", f"{text}; set offset_s to correct it")
    else:
        offset = Check("offset", "warning", "unknown: no clip of 2 s whose jaw and loudness move")
    # Controls that never move in any clip; those of the lips are named.
    lows, highs = (np.array([getattr(c, side) for c in clips]) for side in ("low", "high"))
    present = np.isfinite(lows).any(axis=0)
    travel = np.zeros(len(controls))
    travel[present] = np.nanmax(highs[:, present], axis=0) - np.nanmin(lows[:, present], axis=0)
    moves = travel >= DEAD
    lips = [controls.names[i] for i in controls.subset("lip") if present[i] and not moves[i]]
    text = f"{moves.sum()} of {len(controls)} controls move"
    return [
        verdict("controls", incomplete, "every clip holds those it knows", "clips", "error"),
        Check("frame rates", "ok", frames),
        *([verdict("units", corrected, "", "files are corrected in reading")] if corrected else []),
        verdict("sample rates", narrow, "16 kHz or more", "below 16 kHz"),
        verdict("lengths", lengths, "sound and curves end together", "differ"),
        offset,
        verdict("clipping", clipped, "none", "clips distort"),
        verdict("speech", mute, "in every clip", "clips hold none"),
        verdict("silence", gaping, "the mouth shuts", "clips keep it open"),
        verdict("movement", lips, text, f"lip controls never move ({text})"),
    ]
