"""Contacts of the lips on recordings with phones: ``evaluate MODEL --contacts TABLE``.

The table is a CSV file with the columns clip, start, end (seconds), label and kind, and beside it
or below it the recordings, ``<clip>.opus`` or another audio file. Kinds are closure (p b m),
labial (f v w), release (of a closure), vowel, silence and other; labels, in any alphabet, name the
sounds in the report. Such phones are set by hand, in any language: sets on which a model is
chosen, not trained.

Curves are scored as by `deitalk.research.evaluation.gestures`, beside the ridge regressions of
`deitalk.research.evaluation.ridge`, which the training recordings of a dataset folder teach.
"""

import csv
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from deitalk.audio.frames import FRAME_RATE
from deitalk.audio.load import load_audio
from deitalk.errors import DataError
from deitalk.evaluation.report import table
from deitalk.evaluation.smoothness import lips_together
from deitalk.evaluation.validation import closure_scores, summarise_closures
from deitalk.models.curve_model import DEITalk
from deitalk.postprocess.phones import (
    CLEAR_SECONDS,
    NEAR_LIPS,
    VOWELS,
    WIDEN_FRAMES,
    Phones,
)
from deitalk.research.evaluation.clip_scores import animated, held_closures
from deitalk.research.evaluation.gestures import SHUT
from deitalk.research.evaluation.ridge import (
    ContactRidge,
    Judged,
    losses,
    score_contacts,
    teachers,
)
from deitalk.research.lips.measured import SOUNDS
from rig import limits
from rig.arrays import Float32
from rig.errors import quoted
from rig.files.reading import read_text

KINDS = {
    "closure": "M", "labial": "V", "release": "W", "vowel": "AA", "silence": "SIL", "other": "T",
}  # fmt: skip
"""Phone by which a kind is scored; a release is near the lips and is no sound to score."""
COLUMNS = ("clip", "start", "end", "label", "kind")


class Labelled(NamedTuple):
    """A recording and its sounds."""

    audio: Path
    sounds: tuple[tuple[float, float, str, str], ...]
    """Start, end, label and kind."""

    @property
    def phones(self) -> Phones:
        """The sounds by their kinds."""
        return [(start, end, KINDS[kind]) for start, end, _, kind in self.sounds]


def read_table(path: Path) -> list[Labelled]:
    """Recordings of a table.

    Raises
    ------
    DataError
        If the table cannot be read or is not as described, or a recording is missing.
    """
    rows: dict[str, list[tuple[float, float, str, str]]] = {}
    lines = read_text(path, limits.TRACK_BYTES, error=DataError).splitlines()
    reader = csv.DictReader(lines)
    if missing := [name for name in COLUMNS if name not in (reader.fieldnames or ())]:
        raise DataError(f"{path}: lacks the column {missing[0]}; needs {', '.join(COLUMNS)}")
    for row in reader:
        if row["kind"] not in KINDS:
            raise DataError(f"{path}: kind {quoted(row['kind'])}; known are {', '.join(KINDS)}")
        try:
            start, end = float(row["start"]), float(row["end"])
        except (TypeError, ValueError):
            raise DataError(f"{path}: line {reader.line_num}: start and end are seconds") from None
        rows.setdefault(row["clip"], []).append((start, end, row["label"], row["kind"]))
    if not rows:
        raise DataError(f"{path}: holds no sound; give the phones of a recording")
    files = {p.name: p for p in sorted(path.parent.rglob("*")) if p.suffix in SOUNDS}
    found = []
    for name, sounds in rows.items():
        sound = next((files[name + s] for s in SOUNDS if name + s in files), None)
        if sound is None:
            raise DataError(f"{path}: no sound of {quoted(name)} beside it ({', '.join(SOUNDS)})")
        found.append(Labelled(sound, tuple(sounds)))
    return found


def shut_beside_vowels(lips: Float32, phones: Phones) -> tuple[int, int]:
    """Vowels that touch no labial, and how many of them have shut lips in or beside them.

    Lips are shut at `SHUT`, within the vowel widened by two frames; no p b m f v w is within
    67 ms of that window.
    """
    times, slack = np.arange(len(lips)) / FRAME_RATE, WIDEN_FRAMES / FRAME_RATE
    busy = [(start, end) for start, end, name in phones if name in NEAR_LIPS]
    free, shut = 0, 0
    for start, end, name in phones:
        if name not in VOWELS:
            continue
        first, last = start - slack, end + slack
        near = any(first - CLEAR_SECONDS < b and last + CLEAR_SECONDS > a for a, b in busy)
        window = lips[(times >= first) & (times <= last)]
        if not near and len(window):
            free += 1
            shut += bool(window.max() >= SHUT)
    return free, shut


def shut_sounds(scored: Sequence[tuple[Float32, Labelled]]) -> dict[str, dict[str, float]]:
    """Share of each sound's instances in which the lips shut, of sounds that need no contact.

    Instances count that are 67 ms away from every labial; sounds with fewer than five are left
    out. By label: ``n`` and ``shut``.
    """
    counts: dict[str, list[bool]] = {}
    for lips, clip in scored:
        times = np.arange(len(lips)) / FRAME_RATE
        busy = [(s, e) for s, e, _, kind in clip.sounds if KINDS[kind] in NEAR_LIPS]
        for start, end, label, kind in clip.sounds:
            window = lips[(times >= start) & (times < end)]
            near = any(start - CLEAR_SECONDS < e and end + CLEAR_SECONDS > s for s, e in busy)
            if kind in ("vowel", "other") and not near and len(window):
                counts.setdefault(label, []).append(bool(window.max() >= SHUT))
    shares = {
        label: {"n": len(hits), "shut": float(np.mean(hits))}
        for label, hits in counts.items()
        if len(hits) >= 5
    }
    return dict(sorted(shares.items(), key=lambda item: -item[1]["shut"]))


def evaluate(
    model: DEITalk,
    path: Path,
    *,
    data: Path,
    most: int | None = None,
    encoder: Path | None = None,
    progress: Callable[[float], None] = lambda share: None,
) -> dict[str, Any]:
    """Score a model on a table of phones.

    Parameters
    ----------
    model : DEITalk
        In evaluation mode.
    path : Path
        The table.
    data : Path
        Dataset folder whose training recordings teach the ridge regressions.
    most : int or None
        Most recordings, evenly spread.
    encoder : Path or None
        Folder of a published Whisper encoder whose layers are read by a ridge too.
    progress : callable
        Called with the share done, 0 to 1.

    Returns
    -------
    dict
        ``scores`` by prediction: ``animated``, ``network``, ``ridge: own``, ``ridge: layer N``;
        ``shut`` by sound, of `deitalk.animate`.

    Raises
    ------
    DataError
        If a table or folder is not as described.
    CheckpointError
        If there is no such encoder.
    """
    clips = read_table(path)
    if most is not None and len(clips) > most:
        clips = [clips[i] for i in np.linspace(0, len(clips) - 1, most).round().astype(int)]
    taught = teachers(data)
    if not taught:
        raise DataError(f"{data}: no training recording with phones teaches the ridge; add some")
    total = len(taught) + len(clips)
    ridge = ContactRidge(
        model, taught, encoder, lambda share: progress(share * len(taught) / total)
    )
    scores: dict[str, dict[str, Any]] = {}
    lips: dict[bool, list[tuple[Float32, Labelled]]] = {False: [], True: []}
    for i, clip in enumerate(clips):
        recording = load_audio(clip.audio)
        for raw, found in lips.items():
            curves = animated(recording, "neutral", model, raw=raw).curves.values
            found.append((lips_together(curves, model.controls), clip))
        progress((len(taught) + i + 1) / total)
    for raw, name in ((False, "animated"), (True, "network")):
        scores[name] = contact_scores(lips[raw])
    judged = {"": [Judged(clip.audio, clip.phones) for clip in clips]}
    for name, rows in score_contacts(ridge, judged).items():
        scores[f"ridge: {name}"] = rows[""]
    return {"scores": scores, "shut": shut_sounds(lips[False])}


def contact_scores(scored: Sequence[tuple[Float32, Labelled]]) -> dict[str, float]:
    """Scores of closures, and of shut lips beside vowels."""
    held = [h for lips, clip in scored for h in held_closures(lips, clip.phones)]
    found = summarise_closures([closure_scores(lips, c.phones) for lips, c in scored], held)
    free, shut = np.sum([shut_beside_vowels(lips, c.phones) for lips, c in scored], axis=0)
    return {
        "bilabial_hits_at_5_percent": found.hit_rate,
        "bilabial_window_auc": found.window_auc,
        "bilabial_frame_auc": found.frame_auc,
        "found_bilabials_held_at_0.9": found.reached,
        "bilabials": found.n_closures,
        "shut_beside_free_vowels": float(shut / free) if free else float("nan"),
        "free_vowels": int(free),
    }


def as_markdown(report: Mapping[str, Any]) -> str:
    """Markdown tables, and where curves lie below the ridge."""
    scores = report["scores"]
    lines = ["Contacts of the lips:", "", *table("", scores), ""]
    lines += ["Share of sounds away from labials with shut lips:", ""]
    lines += [*table("", {k: v for k, v in report["shut"].items() if v["shut"] > 0}), ""]
    lines.append(losses({"": scores["animated"]}, {"": scores["ridge: own"]}))
    return "\n".join(lines) + "\n"
