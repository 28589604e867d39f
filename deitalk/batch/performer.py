"""One line in a worker process: a recording to staged files."""

import errno
import hashlib
import os
import shutil
import socket
from pathlib import Path
from tempfile import mkdtemp
from typing import Any
from weakref import finalize

from deitalk.batch.journal import File
from deitalk.batch.lines import TAKE
from deitalk.batch.messages import Order, Outcome, Target
from deitalk.batch.storage import read_recording, upload
from rig.errors import UserError, one_line

_FULL = {errno.ENOSPC, errno.EDQUOT}


class Performer:
    """A model in a worker process, with a folder for unfinished files.

    Parameters
    ----------
    model : str
        Name or folder.
    stage : str
        Folder on the disk of the outputs; empty: a temporary one.
    url : str
        Where files are uploaded to; empty: they stay staged.
    """

    def __init__(self, model: str, stage: str, url: str = "") -> None:
        import torch

        from deitalk.models.checkpoint import require_model
        from deitalk.models.curve_model import DEITalk
        from deitalk.models.folder import describe_model

        torch.set_num_threads(1)
        self.network = require_model(model, DEITalk)
        self.about = describe_model(model)
        if not stage:
            stage = mkdtemp(prefix="deitalk-batch-")
            finalize(self, shutil.rmtree, stage, ignore_errors=True)
        self.stage = Path(stage) / f"{socket.gethostname()}-{os.getpid()}"
        self.url, self.count = url, 0

    def __call__(self, order: Order) -> Outcome:
        """Animate a line; whatever is wrong with it is in the result."""
        try:
            return self._measure(order) if order.only_voice else self._perform(order)
        except UserError as error:
            return Outcome(order.output, "full" if _is_full(error) else "failed", str(error))
        except MemoryError:
            text = "not enough memory; give a shorter recording, or use fewer workers"
            return Outcome(order.output, "failed", text)
        except OSError as error:
            text = one_line(error.strerror or error)
            return Outcome(order.output, "full" if _is_full(error) else "failed", text)
        except Exception as error:  # one line must not end a night's work
            text = one_line(f"{type(error).__name__}: {error}")
            return Outcome(order.output, "failed", text)

    def _measure(self, order: Order) -> Outcome:
        from deitalk.pipeline.actor import voice_strength

        recording = decoded(order.audio, read_recording(order.audio)[0])
        strength = voice_strength(recording)
        return Outcome(order.output, "done", seconds=recording.duration, strength=strength)

    def _perform(self, order: Order) -> Outcome:
        from deitalk.batch.findings import findings
        from deitalk.pipeline.curves import animate

        settings = order.settings
        data, sound = read_recording(order.audio)
        if sound == order.known:
            return Outcome(order.output, "unchanged", sound=sound)
        recording = decoded(order.audio, data)
        performance = animate(
            recording,
            settings.emotion,
            model=self.network,
            actor=self._style(settings.actor),
            intensity=settings.intensity,
            intensity_curve=settings.intensity_curve or None,
            voice=settings.voice or order.voice,
            idle=settings.idle,
            raw=settings.raw,
            seed=settings.seed,
        )
        folder, targets = self._write(order, performance)
        staged = _files(folder, targets)
        files = tuple(staged.values())
        if self.url:
            files = tuple(upload(self.url, path, file) for path, file in staged.items())
            shutil.rmtree(folder)
        return Outcome(
            order.output,
            "done",
            sound=sound,
            seconds=recording.duration,
            frames=len(performance.curves),
            warnings=(*recording.warnings, *findings(performance)),
            stage=str(folder),
            targets=targets,
            files=files,
        )

    def _style(self, actor: str) -> str | None:
        """The model's own style of an actor, if it has one."""
        return actor if actor in self.network.config.actors else None

    def _write(self, order: Order, performance: Any) -> tuple[Path, tuple[Target, ...]]:
        from rig import write_curves

        self.count += 1
        folder = self.stage / str(self.count)
        folder.mkdir(parents=True)
        targets = []
        for place, suffix in enumerate(order.settings.formats):
            if suffix == TAKE:
                self._write_take(folder / TAKE, order, performance)
                targets.append(Target(TAKE, order.output))
            else:
                name = f"{place}{suffix}"
                write_curves(folder / name, performance.curves, fps=order.settings.fps)
                targets.append(Target(name, order.output + suffix))
        return folder, tuple(targets)

    def _write_take(self, folder: Path, order: Order, performance: Any) -> None:
        from deitalk.pipeline.take import write_take

        beside = self.stage / TAKE  # one name for all, as each has a lock
        settings = dict(performance.settings) | {"actor": order.settings.actor or None}
        write_take(beside, performance, settings=settings, model=self.about, fps=order.settings.fps)
        os.rename(beside, folder)


def decoded(path: str, data: bytes | None) -> Any:
    """The recording of a file that was read; warnings and errors name its path."""
    from deitalk.audio.decoding import open_sound
    from deitalk.audio.load import load_audio, read_sound

    if data is None:
        return load_audio(path)
    with open_sound(path, data) as sound:
        return read_sound(path, sound)


def _files(folder: Path, targets: tuple[Target, ...]) -> dict[Path, File]:
    """Staged files, and their hashes under the names that they will have; take.json is the last."""
    found: dict[Path, File] = {}
    for name, place in targets:
        staged = folder / name
        if staged.is_dir():
            paths = sorted(staged.iterdir(), key=lambda path: (path.name == "take.json", path.name))
            found |= {path: _file(path, f"{place}/{path.name}") for path in paths}
        else:
            found[staged] = _file(staged, place)
    return found


def _file(path: Path, place: str) -> File:
    status = path.stat()
    sha = hashlib.sha256(path.read_bytes()).hexdigest()
    return File(place, sha, status.st_size, status.st_mtime_ns)


def _is_full(error: BaseException | None) -> bool:
    """Whether an error comes from a full disk."""
    while error is not None:
        if isinstance(error, OSError) and error.errno in _FULL:
            return True
        error = error.__cause__ or error.__context__
    return False
