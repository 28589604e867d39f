"""One line in a worker process: a recording to staged files."""

import hashlib
import os
import shutil
import socket
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from tempfile import mkdtemp
from typing import TYPE_CHECKING, Any, TypeVar
from weakref import finalize

from deitalk.acting import Acting
from deitalk.batch.findings import findings
from deitalk.batch.lines import TAKE, Dubbing, has_option
from deitalk.batch.orders import File, Order, Outcome, Target
from deitalk.batch.recordings import read_recording
from deitalk.models.load import Backend
from deitalk.pipeline.performance import Extra, Performance
from rig.errors import UserError, is_disk_full, one_line

if TYPE_CHECKING:
    from deitalk.pipeline.curves import Prepared


TOGETHER_FRAMES = 32_768
"""Frames from which recordings are enough for one call of a GPU, 18 minutes. On a processor each is
read alone: its files then are the same whatever comes with it."""
T = TypeVar("T")


class Performer:
    """A model in a worker process, with a folder for unfinished files.

    Parameters
    ----------
    model : str
        Name or folder.
    stage : str
        Folder on the disk of the outputs; empty: a temporary one.
    backend : str
        As for `deitalk.models.load.load_network`.
    device : str
        Where the network is, as for `deitalk.models.load.load_network`.
    """

    def __init__(
        self,
        model: str,
        stage: str = "",
        backend: Backend = "auto",
        device: str = "cpu",
    ) -> None:
        from deitalk.models.folder import describe_model
        from deitalk.models.load import chosen_backend, load_network

        chosen = chosen_backend(model, backend, device)
        if chosen == "torch":
            import torch

            torch.set_num_threads(1)
        self.network: Any = load_network(model, backend=chosen, device=device)
        self.together = 0 if device == "cpu" else TOGETHER_FRAMES
        self.about = describe_model(model)
        if not stage:
            stage = mkdtemp(prefix="deitalk-batch-")
            finalize(self, shutil.rmtree, stage, ignore_errors=True)
        self.stage = Path(stage) / f"{socket.gethostname()}-{os.getpid()}"
        self.count = 0

    def __call__(self, orders: Sequence[Order]) -> Iterator[list[Outcome]]:
        """Animate lines, several together; what is wrong with one is in its result."""
        ready: list[tuple[Order, str, Prepared]] = []
        frames = 0
        for order in orders:
            result = self._guarded(order, partial(self._prepared, order))
            if isinstance(result, Outcome):
                yield [result]
                continue
            ready.append((order, *result))
            frames += len(result[1].inputs[1])
            if frames >= self.together:
                yield self._finished(ready)
                ready, frames = [], 0
        if ready:
            yield self._finished(ready)

    def _guarded(self, order: Order, work: Callable[[], T]) -> T | Outcome:
        """The result of some work on a line, or of the line if it fails."""
        try:
            return work()
        except Exception as error:  # one line must not end a night's work
            if isinstance(error, UserError):
                text = str(error)
            elif isinstance(error, MemoryError):
                text = "not enough memory; give a shorter recording, or use fewer workers"
            elif isinstance(error, OSError):
                text = one_line(error.strerror or error)
            else:
                text = one_line(f"{type(error).__name__}: {error}")
            return Outcome(order.output, "full" if is_disk_full(error) else "failed", text)

    def _prepared(self, order: Order) -> tuple[str, "Prepared"] | Outcome:
        """Hash of a line's recording, and the line ready for the network; or its result."""
        from deitalk.audio.load import load_chosen
        from deitalk.pipeline.actor_voice import measure_voice
        from deitalk.pipeline.curves import prepare

        data, sound = read_recording(order.audio)
        if sound == order.known:
            return Outcome(order.output, "unchanged", sound=sound)
        source = order.audio if data is None else data
        recording = load_chosen(source, order.choice, name=order.audio)
        if order.only_voice:
            return Outcome(order.output, "done", voice=measure_voice(recording, self.network))
        acting = order.acting
        if acting.style is None and order.actor in self.network.actors:
            acting = Acting.of(acting, style=order.actor)
        if order.dubbing is not None:
            acting = Acting.of(acting, edit=())  # edits come after the dub
        return sound, prepare(recording, acting, lambda: self.network)

    def _finished(self, group: list[tuple[Order, str, "Prepared"]]) -> list[Outcome]:
        """Results of prepared lines; each alone if they fail together."""
        from deitalk.pipeline.curves import finish_together

        made: Sequence[Performance | None] = [None] * len(group)
        if len(group) > 1:
            with suppress(Exception):
                lines = [prepared for _, _, prepared in group]
                sounds, weights = zip(*(prepared.inputs for prepared in lines), strict=True)
                readings = self.network.read_together(
                    [sound * p.speech.gain for sound, p in zip(sounds, lines, strict=True)],
                    weights,
                    [prepared.style for prepared in lines],
                )
                made = finish_together(lines, readings)
        return [
            self._guarded(line[0], partial(self._performed, *line, performance))
            for line, performance in zip(group, made, strict=True)
        ]

    def _performed(
        self, order: Order, sound: str, prepared: "Prepared", performance: Performance | None
    ) -> Outcome:
        from deitalk.audio.original import start_of
        from deitalk.pipeline.curves import finish
        from deitalk.postprocess.edges import edge_of

        if performance is None:
            performance = finish(prepared, prepared.read())
        written = order.written
        notes: tuple[str, ...] = ()
        extras: tuple[Extra, ...] = ()
        if order.dubbing is not None:
            performance, notes, extras = _dubbed(order.dubbing, order.acting, performance)
        start, note = start_of(written.timecode, written.fps, prepared.recording.start)
        if start and not any(has_option(suffix, "start") for suffix in written.formats):
            note = f"{', '.join(written.formats)} without time code: starts at 0"
        folder, targets = self._write(order, performance, start, extras)
        edges = None
        if order.with_edges:
            first, last = (str(edge_of(performance, "edge", last=end)) for end in (False, True))
            edges = first, last
        warnings = *performance.recording.warnings, *notes, note, *findings(performance)
        return Outcome(
            order.output,
            "done",
            sound=sound,
            seconds=prepared.recording.duration,
            frames=len(performance.curves),
            warnings=tuple(filter(None, warnings)),
            edges=edges,
            stage=str(folder),
            targets=targets,
            files=tuple(_files(folder, targets)),
        )

    def _write(
        self, order: Order, performance: Any, start: float, extras: tuple[Extra, ...]
    ) -> tuple[Path, tuple[Target, ...]]:
        """Stage the files of a line; `start` is the time of day of its first frame, seconds."""
        from rig import write_curves

        written = order.written
        form = {
            "fps": written.fps, "start": start, "delay": written.delay, "handles": written.handles
        }  # fmt: skip
        seconds = performance.recording.duration
        spoken = {"sound": performance.sound_file, "seconds": seconds}
        digits = {"digits": written.digits}
        self.count += 1
        folder = self.stage / str(self.count)
        folder.mkdir(parents=True)
        targets = []
        for place, suffix in enumerate(written.formats):
            if suffix == TAKE:
                from deitalk.pipeline.performance import write_take

                beside = self.stage / TAKE  # one name for all, as each has a lock
                about: Any = form | digits
                write_take(beside, performance, model=self.about, extras=extras, **about)
                os.rename(beside, folder / TAKE)
                targets.append(Target(TAKE, order.output))
            else:
                name = f"{place}{suffix}"
                given: Any = form | spoken | (digits if has_option(suffix, "digits") else {})
                write_curves(folder / name, performance.at(written.fps)[0], **given)
                targets.append(Target(name, order.output + suffix))
        return folder, tuple(targets)


def _dubbed(
    dubbing: Dubbing, acting: Acting, made: Performance
) -> tuple[Performance, tuple[str, ...], tuple[Extra, ...]]:
    """The performance of a line with the mouth that was made of its recording."""
    from deitalk.data.captures.columns import read_mapping
    from deitalk.data.dub import dub

    style = made.acting.style
    found = dub(
        dubbing.performance,
        made.recording.source,
        sound=dubbing.sound or None,
        acting=acting if style is None else Acting.of(acting, style=style),
        mapping=read_mapping(Path(dubbing.mapping)) if dubbing.mapping else None,
        stretch=dubbing.stretch,
        fps=dubbing.source_fps,
        perform=lambda *_, **__: made,
    )
    return found.performance, (*found.notes, found.line), (found.write_report,)


def _files(folder: Path, targets: tuple[Target, ...]) -> Iterator[File]:
    """Staged files under the names that they will have; take.json is the last of its take."""
    for name, place in targets:
        staged = folder / name
        paths = sorted(staged.iterdir()) if staged.is_dir() else [staged]
        for path in sorted(paths, key=lambda path: path.name == "take.json"):
            status, sha = path.stat(), hashlib.sha256(path.read_bytes()).hexdigest()
            final = f"{place}/{path.name}" if staged.is_dir() else place
            yield File(final, sha, status.st_size, status.st_mtime_ns)
