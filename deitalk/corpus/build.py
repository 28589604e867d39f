"""Build a dataset folder from speech engines and recordings: ``deitalk corpus build``.

The work is divided into shards of a few minutes; a shard depends on the seed and its number
alone, is written by one process, and is not made again if it is there: an interrupted build goes
on where it stopped, and two builds with one seed and the same engines are equal byte by byte.
"""

import hashlib
import io
import json
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from deitalk.audio import FRAME_RATE, SAMPLE_RATE
from deitalk.corpus.acting import act, intensity_envelope
from deitalk.corpus.alignment import aligned_utterances
from deitalk.corpus.articulation import articulate
from deitalk.corpus.phones import VOWELS
from deitalk.corpus.prosody import (
    Contour,
    apply_contour,
    contour_at,
    prosody_index,
    random_contour,
)
from deitalk.corpus.recordings import Recording
from deitalk.corpus.sources import synthetic_utterances
from deitalk.corpus.utterance import Phone, Utterance
from deitalk.emotions import EMOTIONS
from deitalk.errors import DataError
from rig import ControlSet, RigCurves, default_controls, write_curves
from rig.files import atomic_write

CURVE_RATE = 60
"""Curves are stored at twice the rig's rate, so that training can change the speed of a clip
without blurring closures."""
SHARD_SECONDS = 240.0
MIX = {"espeak": 0.35, "flite": 0.45, "festival": 0.20}
"""Share of every engine; a missing engine's share goes to the others."""
SHARES = (0.7, 0.2)
"""Share of the speakers that train, and that validate; the rest test (§4.1)."""
COLUMNS = (
    "clip", "audio", "curves", "emotion", "speaker", "voice", "source", "language", "phones",
    "intensity", "transcript",
)  # fmt: skip
NATURAL_WEIGHT = 0.6
"""Weight of a recording's own prosody beside the contour that was applied to it."""


@dataclass(frozen=True)
class Shard:
    """A piece of work: minutes of one engine, or a slice of the recordings."""

    name: str
    engine: str
    seconds: float
    seed: int
    recordings: tuple[Recording, ...] = ()
    alignments: Path | None = None

    @property
    def fingerprint(self) -> str:
        """Hash of what the shard's clips depend on, wherever the recordings lie."""
        spoken = [(r.path.name, r.text, r.speaker) for r in self.recordings]
        parts = repr((self.engine, self.seconds, self.seed, spoken))
        return hashlib.sha256(parts.encode()).hexdigest()[:16]


def build(
    out: Path,
    shards: Sequence[Shard],
    *,
    workers: int,
    progress: Callable[[float], None] = lambda seconds: None,
) -> pd.DataFrame:
    """Make every shard that is not there yet, then write ``clips.csv``.

    Parameters
    ----------
    out : Path
        The dataset folder.
    shards : sequence of Shard
        From `synthetic_shards` and `recorded_shards`.
    workers : int
        Processes.
    progress : callable
        Told the seconds of speech of every finished shard; 0 for one that was there.

    Returns
    -------
    DataFrame
        The rows of ``clips.csv``.

    Raises
    ------
    DataError
        If the folder was begun with another seed, length or set of recordings, or if no shard
        gave a clip.
    """
    _check_plan(out, shards)
    for name in ("audio", "curves", "phones", "intensity", "shards"):
        (out / name).mkdir(parents=True, exist_ok=True)
    missing = [shard for shard in shards if not _table(out, shard).is_file()]
    for _ in range(len(shards) - len(missing)):
        progress(0.0)
    for seconds in _made(out, missing, workers):
        progress(seconds)
    return _write_clips(out, shards)


def _made(out: Path, shards: Sequence[Shard], workers: int) -> Iterator[float]:
    """Make shards here or in processes; yield the seconds of each as it is done."""
    if min(workers, len(shards)) <= 1:
        yield from (build_shard(out, shard) for shard in shards)
        return
    with ProcessPoolExecutor(workers, get_context("spawn")) as pool:
        futures = [pool.submit(build_shard, out, shard) for shard in shards]
        try:
            for future in as_completed(futures):
                yield future.result()
        except BaseException:
            pool.shutdown(cancel_futures=True)  # what is done stays; the rest is not begun
            raise


def _write_clips(out: Path, shards: Sequence[Shard]) -> pd.DataFrame:
    """Join the shards' tables to ``clips.csv``; splits and ages are the speakers'."""
    frame = pd.concat(
        [pd.read_csv(_table(out, shard), keep_default_na=False, dtype=str) for shard in shards]
    )
    if frame.empty:
        raise DataError(f"{out}: not one clip was made; no recording could be aligned")
    frame = frame.sort_values("clip")
    frame["split"] = frame["speaker"].map(split_of)
    ages = {r.speaker: str(r.age) for s in shards for r in s.recordings if r.age is not None}
    frame["age"] = frame["speaker"].map(lambda speaker: ages.get(speaker, ""))
    with atomic_write(out / "clips.csv") as beside:
        frame.to_csv(beside, index=False, lineterminator="\n")
    return frame


def _check_plan(out: Path, shards: Sequence[Shard]) -> None:
    """Keep what every shard is made from, so that two builds are never mixed in one folder."""
    path = out / "shards" / "plan.json"
    known = json.loads(path.read_text()) if path.is_file() else {}
    plan = {shard.name: shard.fingerprint for shard in shards}
    changed = [name for name in plan if known.get(name, plan[name]) != plan[name]]
    if changed:
        raise DataError(
            f"{out}: {changed[0]} was begun with another seed, length or set of recordings; "
            "build with the same options to go on, or name another folder"
        )
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_write(path) as beside:
        beside.write_text(json.dumps(known | plan, indent=1) + "\n")


def synthetic_shards(hours: float, seed: int, engines: Sequence[str]) -> list[Shard]:
    """Divide hours of synthetic speech among the engines that are there."""
    total = sum(MIX[engine] for engine in engines)
    shards = []
    for engine in engines:
        seconds = hours * 3600 * MIX[engine] / total
        count = max(round(seconds / SHARD_SECONDS), 1)
        shards += [
            Shard(f"{engine}-{i:03d}", engine, seconds / count, _seed(seed, engine, i))
            for i in range(count)
        ]
    return shards


def recorded_shards(
    recordings: Sequence[Recording], seed: int, alignments: Path | None, size: int = 50
) -> list[Shard]:
    """Divide recordings into shards of `size`; `alignments` keeps their phone times."""
    return [
        Shard(
            f"recording-{i // size:03d}",
            "recording",
            0.0,
            _seed(seed, "recording", i // size),
            tuple(recordings[i : i + size]),
            alignments,
        )
        for i in range(0, len(recordings), size)
    ]


def _seed(seed: int, engine: str, number: int) -> int:
    return int.from_bytes(hashlib.sha256(f"{seed}/{engine}/{number}".encode()).digest()[:6])


def split_of(speaker: str) -> str:
    """Split a speaker belongs to, for ever: 70/20/10 by a hash of the name (§4.1).

    Deviation: the few voices of flite and festival all train; the espeak variants and the
    readers, of whom there are many, are divided. A variant of espeak is one voice in whatever
    accent or language it speaks.
    """
    if speaker.startswith(("flite:", "festival:")):
        return "train"
    if speaker.startswith("espeak:") and "+" in speaker:
        speaker = "espeak:+" + speaker.partition("+")[2]
    place = int.from_bytes(hashlib.sha256(speaker.encode()).digest()[:4]) / 2**32
    if place < SHARES[0]:
        return "train"
    return "validation" if place < sum(SHARES) else "test"


def build_shard(out: Path, shard: Shard) -> float:
    """Write every clip of one shard; return its seconds of speech."""
    rng = np.random.default_rng(shard.seed)
    rows: list[dict[str, str]] = []
    total = 0.0
    for number, utterance in enumerate(_utterances(shard, rng)):
        take = perform(utterance, rng)
        total += len(take.waveform) / SAMPLE_RATE
        rows += _write(out, f"{shard.name}-{number:04d}", take, rng)
    with atomic_write(_table(out, shard)) as beside:
        pd.DataFrame(rows, columns=list(COLUMNS)).to_csv(beside, index=False, lineterminator="\n")
    return total


def _utterances(shard: Shard, rng: np.random.Generator) -> Iterator[Utterance]:
    if shard.engine == "recording":
        return aligned_utterances(shard.recordings, workers=1, cache=shard.alignments)
    return synthetic_utterances(shard.engine, shard.seconds, rng)


def _table(out: Path, shard: Shard) -> Path:
    return out / "shards" / f"{shard.name}.csv"


@dataclass(frozen=True)
class Take:
    """An utterance with its prosody moved, and everything the face needs to act it."""

    utterance: Utterance
    waveform: NDArray[np.float32]
    phones: tuple[Phone, ...]
    intensity: NDArray[np.float64]
    """e(t) [shape=(N,)] at CURVE_RATE."""
    channels: NDArray[np.float64]
    """Articulation [shape=(N, K)] at CURVE_RATE."""


def perform(utterance: Utterance, rng: np.random.Generator) -> Take:
    """Pad with silence, move the prosody along a random contour, articulate.

    Recordings that evaluate keep the prosody they have.
    """
    padded = _pad(utterance, rng)
    contour = _contour(padded, rng)
    waveform, time_map = apply_contour(padded.waveform, contour)
    phones = tuple(_moved(phone, time_map) for phone in padded.phones)
    n_frames = -(-CURVE_RATE * len(waveform) // SAMPLE_RATE)
    source_times = np.interp(np.arange(n_frames) / CURVE_RATE, time_map[1], time_map[0])
    z = _liveliness(padded.waveform, contour, source_times)
    return Take(
        padded,
        waveform,
        phones,
        intensity_envelope(z, speech_span(phones), CURVE_RATE),
        articulate(phones, n_frames, CURVE_RATE, loudness_stress(waveform, phones)),
    )


def _contour(padded: Utterance, rng: np.random.Generator) -> Contour:
    """A random contour; flat for 15 % of the clips and for recordings that evaluate."""
    contour = random_contour(padded.duration_seconds, rng)
    evaluates = padded.engine == "recording" and split_of(padded.speaker) != "train"
    if evaluates or rng.random() < 0.15:
        return contour[0], np.zeros(len(contour[1]))
    return contour


def _moved(phone: Phone, time_map: tuple[NDArray[np.float64], NDArray[np.float64]]) -> Phone:
    """A phone where `apply_contour` put its sound."""
    start, end = np.interp((phone.start, phone.end), *time_map)
    return replace(phone, start=float(start), end=float(end))


def _liveliness(
    waveform: NDArray[np.float32], contour: Contour, times: NDArray[np.float64]
) -> NDArray[np.float64]:
    """What was applied and what the voice itself did, at seconds of the source."""
    natural = prosody_index(waveform, -(-FRAME_RATE * len(waveform) // SAMPLE_RATE))
    heard = np.interp(times, np.arange(len(natural)) / FRAME_RATE, natural)
    z: NDArray[np.float64] = contour_at(contour, times) + NATURAL_WEIGHT * heard
    return z


def _pad(utterance: Utterance, rng: np.random.Generator) -> Utterance:
    """Silence before and after; a recording keeps its own room by fading its edges."""
    before, after = rng.uniform(0.05, 0.9), rng.uniform(0.1, 1.4)
    lead, trail = int(before * SAMPLE_RATE), int(after * SAMPLE_RATE)
    speech = utterance.waveform.copy()
    edge = min(160, len(speech) // 4)
    ramp = np.linspace(0, 1, edge, dtype=np.float32)
    speech[:edge] *= ramp
    speech[len(speech) - edge :] *= ramp[::-1]
    shift = lead / SAMPLE_RATE
    end = shift + len(speech) / SAMPLE_RATE
    phones = (
        Phone(0.0, shift, "SIL"),
        *(replace(p, start=p.start + shift, end=p.end + shift) for p in utterance.phones),
        Phone(end, end + trail / SAMPLE_RATE, "SIL"),
    )
    return replace(utterance, waveform=np.pad(speech, (lead, trail)), phones=phones)


def speech_span(phones: Sequence[Phone]) -> tuple[float, float] | None:
    """Seconds at which the first sound begins and the last one ends."""
    spoken = [phone for phone in phones if phone.name != "SIL"]
    return (spoken[0].start, spoken[-1].end) if spoken else None


def loudness_stress(waveform: NDArray[np.float32], phones: Sequence[Phone]) -> NDArray[np.float64]:
    """Jaw factor of every phone: vowels louder than usual open wider, 4 % a decibel."""
    hop = SAMPLE_RATE // 100
    frames = waveform[: len(waveform) // hop * hop].reshape(-1, hop).astype(np.float64)
    level = 10 * np.log10((frames**2).mean(axis=1) + 1e-8)
    usual = np.percentile(level, 85)
    stress = np.ones(len(phones))
    for i, phone in enumerate(phones):
        inside = level[int(phone.start * 100) : int(phone.end * 100) + 1]
        if phone.name in VOWELS and len(inside):
            stress[i] = np.clip(1 + 0.04 * (inside.max() - usual), 0.7, 1.2)
    return stress


def _write(out: Path, name: str, take: Take, rng: np.random.Generator) -> list[dict[str, str]]:
    """One recording, acted in the voice's own emotion and in another one."""
    import soundfile

    audio, phones, intensity = f"audio/{name}.flac", f"phones/{name}.csv", f"intensity/{name}.csv"
    with atomic_write(out / audio) as beside:
        soundfile.write(beside, take.waveform, SAMPLE_RATE, subtype="PCM_16")
    _write_table(out / phones, [(p.start, p.end, p.name) for p in take.phones], "start,end,phone")
    times = np.arange(len(take.intensity)) / CURVE_RATE
    _write_table(
        out / intensity, list(zip(times[::2], take.intensity[::2], strict=True)), "time,intensity"
    )
    utterance = take.utterance
    voice = utterance.style
    others = [emotion for emotion in EMOTIONS if emotion != voice]
    rows = []
    for emotion in (voice, others[rng.integers(len(others))]):
        curves = f"curves/{name}-{emotion}.npz"
        _write_curves(out / curves, take, emotion, default_controls())
        rows.append(
            {
                "clip": f"{name}-{emotion}",
                "audio": audio,
                "curves": curves,
                "emotion": emotion,
                "speaker": utterance.speaker,
                "voice": voice,
                "source": utterance.engine,
                "language": utterance.language,
                "phones": phones,
                "intensity": intensity,
                "transcript": utterance.text,
            }
        )
    return rows


def _write_table(path: Path, rows: Sequence[tuple[object, ...]], header: str) -> None:
    text = io.StringIO()
    text.write(header + "\n")
    for row in rows:
        text.write(",".join(f"{v:.4f}" if isinstance(v, float) else str(v) for v in row) + "\n")
    with atomic_write(path) as beside:
        beside.write_text(text.getvalue())


def _write_curves(path: Path, take: Take, emotion: str, controls: ControlSet) -> None:
    weights = np.eye(len(EMOTIONS))[EMOTIONS.index(emotion)]
    values = act(take.channels, weights, take.intensity, CURVE_RATE, controls)
    coarse = (np.round(values * 1024) / 1024).astype(np.float32)  # half of the file, unseen
    write_curves(path, RigCurves(coarse, controls.names, fps=CURVE_RATE))
