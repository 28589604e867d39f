"""Run a reader on fuzzed inputs in workers with bounded memory and time, and keep failing inputs.

An input is one of: read; refused in one line (UserError); or a failure: any other
exception or warning, a message that is too long or of several lines, more than the time, or a
worker that ends (memory, crash).
"""

import os
import select
import signal
import sys
import tempfile
import time
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from rig.errors import UserError
from rig.limits import MESSAGE_CHARACTERS

from .readers import Reader, Seed, input_of, readers

SECONDS = 5.0
"""Processor time of one input; a busy machine may take `PATIENCE` times as long."""
PATIENCE = 12
BYTES = 2**30
_BATCH = 2000


@dataclass
class Outcome:
    """Results of the inputs of one reader."""

    read: int = 0
    refused: int = 0
    failures: list[tuple[int, str]] = field(default_factory=list)
    slowest: float = 0.0


def attempt(reader: Reader, path: Path) -> str:
    """Read one file: "" if read, "refused", or the failure."""
    try:
        reader.read(path)
    except UserError as error:
        text = str(error)
        if "\n" in text or len(text) > MESSAGE_CHARACTERS or not text:
            return f"message of {len(text)} characters: {text[:200]!r}"
        return "refused"
    except BaseException as error:
        frame = error.__traceback__
        while frame is not None and frame.tb_next is not None:
            frame = frame.tb_next
        where = "" if frame is None else f"{frame.tb_frame.f_code.co_filename}:{frame.tb_lineno}"
        return f"{type(error).__name__} at {where}: {str(error)[:200]!r}"
    return ""


def in_process(reader: Reader, name: str, count: int, seed: int, folder: Path) -> Outcome:
    """Fuzz without workers, for a few inputs whose time is checked afterwards."""
    seeds = reader.seeds(folder)
    outcome = Outcome()
    for one in seeds:  # imports happen here, before time is measured
        (folder / one.name).write_bytes(one.data)
        attempt(reader, folder / one.name)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for index in range(count):
            path = _written(folder, seeds, f"{name}:{seed}:{index}")
            start = time.process_time()
            _count(outcome, index, attempt(reader, path))
            outcome.slowest = max(outcome.slowest, time.process_time() - start)
    return outcome


def in_workers(
    reader: Reader, name: str, first: int, last: int, seed: int, keep: Path
) -> Iterator[Outcome]:
    """Fuzz inputs first … last - 1; yields the same growing outcome after every batch.

    Inputs that fail are written to the folder `keep`.
    """
    outcome = Outcome()
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        seeds = reader.seeds(folder)
        for one in seeds:  # imports happen here, before memory is measured
            (folder / one.name).write_bytes(one.data)
            attempt(reader, folder / one.name)
        while first < last:
            stop = min(first + _BATCH, last)
            first = _batch(reader, name, seeds, first, stop, seed, folder, outcome, keep)
            yield outcome


def _batch(
    reader: Reader, name: str, seeds: list[Seed], first: int, stop: int, seed: int, folder: Path,
    outcome: Outcome, keep: Path,
) -> int:  # fmt: skip
    """Inputs of one worker; returns the first that was not reached."""
    pipe, write = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            os.close(pipe)
            _work(reader, name, seeds, first, stop, seed, folder, write)
        finally:
            os._exit(1)
    os.close(write)
    now, buffer, reason = first, b"", ""
    while now < stop:
        reason = _waited(pipe, child)
        data = b"" if reason else os.read(pipe, 65_536)
        if not data:
            reason = reason or "killed or crashed"
            break
        *lines, buffer = (buffer + data).split(b"\n")
        for line in lines:
            reply = line.decode("utf-8", "replace")
            _count(outcome, now, reply)
            if reply not in ("", "refused"):
                _keep(keep, name, seeds, now, seed, reply)
            now += 1
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    os.close(pipe)
    if now < stop:
        _count(outcome, now, reason)
        _keep(keep, name, seeds, now, seed, reason)
        now += 1
    return now


def _waited(pipe: int, child: int) -> str:
    """Wait for output of a worker: "", or the message of a timeout."""
    begun, used = time.monotonic(), _processor_seconds(child)
    while not select.select([pipe], [], [], SECONDS / 10)[0]:
        spent = _processor_seconds(child) - used
        if spent > SECONDS or time.monotonic() - begun > PATIENCE * SECONDS:
            return f"longer than {SECONDS:g} s"
    return ""


def _processor_seconds(process: int) -> float:
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _work(
    reader: Reader, name: str, seeds: list[Seed], first: int, stop: int, seed: int, folder: Path,
    write: int,
) -> None:  # fmt: skip
    """Work of the child: bounded memory, one line of text per input."""
    import resource

    pages = int(Path("/proc/self/statm").read_text().split()[0])
    most = pages * os.sysconf("SC_PAGE_SIZE") + BYTES
    resource.setrlimit(resource.RLIMIT_AS, (most, most))
    warnings.simplefilter("error")
    for index in range(first, stop):
        path = _written(folder, seeds, f"{name}:{seed}:{index}")
        reply = attempt(reader, path).replace("\n", "\\n")
        os.write(write, reply.encode("utf-8", "replace") + b"\n")
    signal.pause()


def _written(folder: Path, seeds: list[Seed], key: str) -> Path:
    file, data = input_of(seeds, key)
    (folder / file).write_bytes(data)
    return folder / file


def _count(outcome: Outcome, index: int, reply: str) -> None:
    if reply == "":
        outcome.read += 1
    elif reply == "refused":
        outcome.refused += 1
    else:
        outcome.failures.append((index, reply))


def _keep(folder: Path, name: str, seeds: list[Seed], index: int, seed: int, reply: str) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    file, data = input_of(seeds, f"{name}:{seed}:{index}")
    (folder / f"{name}-{seed}-{index}-{file}").write_bytes(data)
    with (folder / "failures.txt").open("a") as log:
        log.write(f"{name} {seed} {index} {file}: {reply}\n")


def fuzz_reader(task: tuple[str, int, int, int, Path]) -> int:
    """Fuzz one reader and print the results; returns the number of failures."""
    name, start, count, seed, keep = task
    begun = time.monotonic()
    *_, outcome = in_workers(readers()[name], name, start, start + count, seed, keep)
    seconds = time.monotonic() - begun
    sys.stdout.write(
        f"{name}: {count} inputs in {seconds:.0f} s ({count / seconds:.0f}/s), {outcome.read} read, "
        f"{outcome.refused} refused, {len(outcome.failures)} failed\n"
    )
    for index, reply in outcome.failures[:20]:
        sys.stdout.write(f"  {index}: {reply}\n")
    sys.stdout.flush()
    return len(outcome.failures)
