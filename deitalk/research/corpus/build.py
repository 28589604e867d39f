"""Build a dataset folder from speech engines and recordings: ``corpus build``.

The work is divided into shards of a few minutes; a shard depends on the seed and its number
alone, is written by one process, and is skipped if it exists. So an interrupted build is continued,
and two builds with one seed and the same engines are equal byte by byte. Workers end with the
process that started them; the next build removes their unfinished files.
"""

import hashlib
import io
import json
import shutil
import tempfile
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from deitalk.audio.frames import SAMPLE_RATE
from deitalk.emotions import EMOTIONS
from deitalk.errors import DataError
from deitalk.research.corpus.aligned_recordings import aligned_utterances
from deitalk.research.corpus.performance import CURVE_RATE, Take, perform, split_of
from deitalk.research.corpus.pool import worker_pool
from deitalk.research.corpus.recordings import Recording
from deitalk.research.corpus.rig_targets import act
from deitalk.research.corpus.synthesis import synthetic_utterances
from deitalk.research.corpus.utterance import Utterance
from rig import ControlSet, RigCurves, default_controls, write_curves
from rig.errors import TargetError
from rig.files import (
    atomic_write,
    begin_folder,
    claim,
    kind_of,
    record,
    remove_leftovers,
    replace_recorded,
)
from rig.files.atomic import temporary_name

SHARD_SECONDS = 240.0
MIX = {"espeak": 0.35, "flite": 0.45, "festival": 0.20}
"""Share of every engine; a missing engine's share goes to the others."""
COLUMNS = (
    "clip", "audio", "curves", "emotion", "speaker", "voice", "source", "language", "phones",
    "intensity", "transcript",
)  # fmt: skip
FOLDERS = ("audio", "curves", "phones", "intensity", "shards")
KIND = "dataset"
"""Kind of the folder in its manifest."""


@dataclass(frozen=True)
class Shard:
    """One unit of work: minutes of one engine, or a slice of the recordings."""

    name: str
    engine: str
    seconds: float
    seed: int
    recordings: tuple[Recording, ...] = ()
    alignments: Path | None = None

    @property
    def fingerprint(self) -> str:
        """Hash of the settings and files that determine the shard's clips, without their folder."""
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
    """Make every missing shard, then write ``clips.csv``.

    Parameters
    ----------
    out : Path
        The dataset folder.
    shards : sequence of Shard
        From `synthetic_shards` and `recorded_shards`.
    workers : int
        Processes.
    progress : callable
        Called with the seconds of speech of every finished shard; 0 for one that existed.

    Returns
    -------
    DataFrame
        The rows of ``clips.csv``.

    Raises
    ------
    DataError
        If the folder was begun with another seed, length or set of recordings, if no shard gave a
        clip, or if a worker process was ended.
    rig.errors.TargetError
        If the folder has files of another origin, ``clips.csv`` was edited, or another process
        writes there.
    """
    with claim(out), _held_caches(shards):
        _begin(out, shards)
        try:
            # Build in a locked folder.
            missing = [shard for shard in shards if not _table(out, shard).is_file()]
            for _ in range(len(shards) - len(missing)):
                progress(0.0)
            for seconds in _made(out, missing, workers):
                progress(seconds)
            return _write_clips(out, shards)
        finally:
            _clean(out)


def _made(out: Path, shards: Sequence[Shard], workers: int) -> Iterator[float]:
    """Make shards here or in processes; yield the seconds of each as it is done."""
    if min(workers, len(shards)) <= 1:
        yield from (build_shard(out, shard) for shard in shards)
        return
    with worker_pool(workers) as pool:
        futures = [pool.submit(build_shard, out, shard) for shard in shards]
        try:
            for future in as_completed(futures):
                yield future.result()
        except BrokenProcessPool:
            raise DataError(
                f"{out}: a worker process was ended, perhaps for lack of memory; run the command "
                "again, with fewer workers"
            ) from None


def _begin(out: Path, shards: Sequence[Shard]) -> None:
    """Check the folder and the plan, and make the folders of the clips."""
    plan = out / "shards" / "plan.json"
    if kind_of(out) is None and plan.is_file():
        record(out, [], kind=KIND)  # begun before datasets had a manifest
    begin_folder(out, kind=KIND)
    _check_plan(out, shards)
    for name in FOLDERS:
        (out / name).mkdir(exist_ok=True)
    _clean(out)


@contextmanager
def _held_caches(shards: Sequence[Shard]) -> Iterator[None]:
    """Clean the folders of phone times, except those in use by another build."""
    with ExitStack() as held:
        for folder in {shard.alignments for shard in shards if shard.alignments is not None}:
            with suppress(TargetError):
                held.enter_context(claim(folder))
                remove_leftovers(folder)
        yield


def _clean(out: Path) -> None:
    """Remove unfinished files of an ended process; the folder is locked."""
    for folder in (out, *(out / name for name in FOLDERS)):
        remove_leftovers(folder)


def _write_clips(out: Path, shards: Sequence[Shard]) -> pd.DataFrame:
    """Join the shards' tables to ``clips.csv`` with the speakers' splits and ages."""
    frame = pd.concat(
        [pd.read_csv(_table(out, shard), keep_default_na=False, dtype=str) for shard in shards]
    )
    if frame.empty:
        raise DataError(f"{out}: no clip was made; no recording could be aligned")
    frame = frame.sort_values("clip")
    frame["split"] = frame["speaker"].map(split_of)
    ages = {r.speaker: str(r.age) for s in shards for r in s.recordings if r.age is not None}
    frame["age"] = frame["speaker"].map(lambda speaker: ages.get(speaker, ""))
    replace_recorded(out, "clips.csv", frame.to_csv(index=False, lineterminator="\n"))
    return frame


def _check_plan(out: Path, shards: Sequence[Shard]) -> None:
    """Write the plan or compare it, so that two builds are never mixed in one folder."""
    path = out / "shards" / "plan.json"
    known = _read_plan(path)
    plan = {shard.name: shard.fingerprint for shard in shards}
    changed = [name for name in plan if known.get(name, plan[name]) != plan[name]]
    if changed:
        raise DataError(
            f"{out}: {changed[0]} was begun with another seed, length or set of recordings; "
            "build with the same options to continue, or name another folder"
        )
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_write(path) as beside:
        beside.write_text(json.dumps(known | plan, indent=1) + "\n")


def _read_plan(path: Path) -> dict[str, str]:
    try:
        return dict(json.loads(path.read_text(encoding="utf-8")))
    except FileNotFoundError:
        return {}
    except (ValueError, TypeError, RecursionError):
        raise DataError(f"{path}: damaged; build in another folder") from None


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


def build_shard(out: Path, shard: Shard) -> float:
    """Write every clip of one shard; return its seconds of speech."""
    with _scratch(out):
        return _build_shard(out, shard)


@contextmanager
def _scratch(out: Path) -> Iterator[None]:
    """Direct the engines' temporary files to the dataset folder, which the next build cleans."""
    before, folder = tempfile.tempdir, out / temporary_name("scratch")
    folder.mkdir()
    tempfile.tempdir = str(folder.absolute())
    try:
        yield
    finally:
        tempfile.tempdir = before
        shutil.rmtree(folder, ignore_errors=True)


def _build_shard(out: Path, shard: Shard) -> float:
    """Write the clips, and the shard's table last: a shard with a table is complete."""
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


def _write(out: Path, name: str, take: Take, rng: np.random.Generator) -> list[dict[str, str]]:
    """Write one recording with its curves in the voice's own emotion and in another one."""
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
    coarse = (np.round(values * 1024) / 1024).astype(
        np.float32
    )  # halves the file, below visibility
    write_curves(path, RigCurves(coarse, controls.names, fps=CURVE_RATE))
