"""Recordings with phone times, several aligned at once, alignments kept in a folder."""

import hashlib
import json
from collections.abc import Callable, Iterator, Sequence
from itertools import islice
from pathlib import Path

import numpy as np

from deitalk.errors import AudioError, MissingError
from deitalk.postprocess.phones import PHONES
from deitalk.research.corpus.alignment import (
    VERSION,
    Alignment,
    align_scored,
    missing,
    reason_against,
)
from deitalk.research.corpus.pool import worker_pool
from deitalk.research.corpus.recordings import Recording, read_waveform
from deitalk.research.corpus.utterance import Phone, Utterance
from rig.files import atomic_write


def aligned_utterances(
    recordings: Sequence[Recording],
    *,
    workers: int = 2,
    cache: Path | None = None,
    progress: Callable[[int, int, Recording, str | None], None] | None = None,
) -> Iterator[Utterance]:
    """Recordings as labelled speech, in their order; bad alignments are left out.

    Parameters
    ----------
    recordings : sequence of Recording
        English speech with transcripts.
    workers : int
        Processes; 1 aligns in this process.
    cache : Path, optional
        Folder for the phone times (one small JSON file each): a second run only reads audio.
    progress : callable, optional
        Called after each recording with (number done, total, recording, reason it was dropped).

    Yields
    ------
    Utterance

    Raises
    ------
    MissingError
        If pocketsphinx is not installed.
    """
    if reason := missing():
        raise MissingError(reason)
    if cache is not None:
        cache.mkdir(parents=True, exist_ok=True)
    total = len(recordings)
    for i, (recording, found) in enumerate(_alignments(recordings, workers, cache)):
        if progress:
            progress(i + 1, total, recording, found.reason)
        if found.reason is None:
            yield _utterance(recording, found)


def _utterance(recording: Recording, found: Alignment) -> Utterance:
    return Utterance(
        waveform=read_waveform(recording.path),
        phones=found.phones,
        text=recording.text,
        style="neutral",
        speaker=recording.speaker,
        engine="recording",
        language="en",
    )


def _alignments(
    recordings: Sequence[Recording], workers: int, cache: Path | None
) -> Iterator[tuple[Recording, Alignment]]:
    """Alignments in the order of `recordings`, a bounded number of them ahead."""
    if workers <= 1:
        yield from ((r, _cached_alignment(r, cache)) for r in recordings)
        return
    with worker_pool(workers) as pool:
        waiting = iter(recordings)
        jobs = [(r, pool.submit(_cached_alignment, r, cache)) for r in islice(waiting, 4 * workers)]
        while jobs:
            recording, job = jobs.pop(0)
            yield recording, job.result()
            jobs += [(r, pool.submit(_cached_alignment, r, cache)) for r in islice(waiting, 1)]


def _cached_alignment(recording: Recording, folder: Path | None) -> Alignment:
    """Read an alignment made before, or make and keep it."""
    path = folder / f"{_cache_key(recording)}.json" if folder else None
    if path and (known := _read_alignment(path)):
        return known
    try:
        found = align_scored(read_waveform(recording.path), recording.text)
    except AudioError as error:
        return Alignment((), -np.inf, str(error))
    if path:
        phones = [[round(p.start, 6), round(p.end, 6), p.name] for p in found.phones]
        content = {"audio": recording.path.name, "text": recording.text, "score": found.score,
                   "reason": found.reason, "phones": phones}  # fmt: skip
        with atomic_write(path) as beside:
            beside.write_text(json.dumps(content), encoding="utf-8")
    return found


def _cache_key(recording: Recording) -> str:
    """Name that changes with the text, the audio file's name and size, and the aligner."""
    size = recording.path.stat().st_size if recording.path.is_file() else 0
    parts = (str(VERSION), recording.speaker, recording.path.name, str(size), recording.text)
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()[:24]


def _read_alignment(path: Path) -> Alignment | None:
    """The cached alignment; None if it is absent or damaged."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        phones = tuple(Phone(float(a), float(b), str(c)) for a, b, c in content["phones"])
    except (OSError, ValueError, KeyError, TypeError):
        return None  # absent or damaged: made again
    if any(p.name not in PHONES for p in phones):
        return None
    score = float(content["score"])
    return Alignment(phones, score, reason_against(phones, score) if phones else content["reason"])
