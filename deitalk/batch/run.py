"""`animate_batch`: all lines of a manifest or a folder, in processes, begun again where they were.

::

    source -> lines -> references of actors -> orders -> workers -> files at their names
                                                                 -> journal -> tables
"""

import hashlib
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import replace
from functools import partial
from pathlib import Path
from time import monotonic
from typing import Any

from deitalk.acting import Acting, acted_as
from deitalk.audio.choice import AudioChoice
from deitalk.batch.actors import references
from deitalk.batch.cloud import is_url, opened_url
from deitalk.batch.journal import DONE, FAILED, Entry
from deitalk.batch.lines import BadLine, Line, Written, line_key, parse_formats
from deitalk.batch.orders import Order, Outcome
from deitalk.batch.outputs import Outputs, opened_folder
from deitalk.batch.performer import Performer
from deitalk.batch.processes import Pool, Workers
from deitalk.batch.recordings import Recordings
from deitalk.batch.report import BatchReport, Pace, Progress, Row, failed_text, summary_text
from deitalk.batch.source import FAILED as FAILED_TABLE
from deitalk.batch.source import SUMMARY, read_source, waves
from deitalk.emotions import ActorReference, EmotionTrack
from deitalk.errors import AudioError, CheckpointError, DeitalkError
from deitalk.installed import __version__
from deitalk.models.device import check_device, require_device
from deitalk.models.folder import RIG_FILE, model_folder, product_of, weights_hash
from deitalk.models.load import Backend, chosen_backend
from rig.errors import TargetError, UserError, quoted

Run = Callable[[Sequence[Order]], Iterator[list[Outcome]]]
"""Results of orders, as they come."""


class Batch:
    """Lines of a batch on their way to rows of its summary.

    Parameters
    ----------
    lines : sequence of Line or BadLine
        In the order of their source.
    outputs : Outputs
        The output folder.
    model : str
        Identity of the model.

    Attributes
    ----------
    rows : list of Row
        One for each line, complete after `perform`.
    notes : list of str
        What applies to the whole batch.
    """

    def __init__(self, lines: Sequence[Line | BadLine], outputs: Outputs, model: str) -> None:
        self.lines, self.outputs, self.model = lines, outputs, model
        self.journal, self.recordings = outputs.journal, Recordings()
        self.rows: list[Row] = []
        self.notes: list[str] = []
        self._orders: list[Order] = []
        self._entries: dict[str, tuple[int, Entry]] = {}
        self._before: dict[str, Entry] = {}
        self._voices: dict[str, ActorReference] = {}
        self._waves = waves(lines)
        self._needed = {
            name for line in lines if isinstance(line, Line) for name in line.beside.values()
        }

    def prepare(self, run: Run) -> None:
        """Measure the actors, then find what is to be done first."""
        good = [line for line in self.lines if isinstance(line, Line)]
        signed = self.recordings.signature
        self._voices = references(
            good, self.outputs, lambda audio: signed(audio) and f"{signed(audio)} {self.model}", run
        )
        actors = {line.actor for line in good if line.acting.voice is None} - {""}
        if unmeasured := sorted(actors - self._voices.keys()):
            self.notes.append(
                f"too few lines with voice for a reference of {', '.join(unmeasured[:5])}"
            )
        errors = [x.error if isinstance(x, BadLine) else "was not animated" for x in self.lines]
        self.rows = [
            Row(line.number, line.audio, line.output, FAILED, error=error)
            for line, error in zip(self.lines, errors, strict=True)
        ]
        for place in self._waves[0] if self._waves else ():
            self.rows[place] = self._row(place)

    def perform(self, run: Run, progress: Progress) -> None:
        """Animate what is to be done, the longest recordings first.

        Lines that begin or end at others wait for these, so that the order of the workers changes
        nothing.
        """
        later = [self.lines[place] for wave in self._waves[1:] for place in wave]
        ahead = {line.output: self.recordings.size(line.audio) for line in later}
        sizes = {order.output: order.size for order in self._orders} | ahead
        pace = Pace(len(sizes), sum(sizes.values()))
        for number, wave in enumerate(self._waves):
            if number:
                self._orders = []
                for place in wave:
                    self.rows[place] = self._row(place)
            ordered = {order.output for order in self._orders}
            for place in wave:
                if number and self.lines[place].output not in ordered:
                    pace.add(sizes[self.lines[place].output], 0.0, failed=False)
            orders = sorted(self._orders, key=lambda order: -order.size)
            for outcomes in run(orders) if orders else ():
                self._store(outcomes)
                for outcome in outcomes:
                    failed = outcome.status == FAILED
                    pace.add(sizes[outcome.output], outcome.seconds, failed=failed)
                progress(pace.share, pace.text())

    def _row(self, place: int) -> Row:
        """The row of a line that needs no work; else a preliminary one, and an order."""
        line = self.lines[place]
        if isinstance(line, BadLine):
            return self.rows[place]
        try:
            acting = self._acting(line)
            return self._known(place, line, acting) or self._ordered(line, acting)
        except UserError as error:
            return replace(self.rows[place], error=str(error))

    def _acting(self, line: Line) -> Acting:
        """The acting of a line, with the voice of its actor, and the takes beside it.

        Raises
        ------
        DeitalkError
            If a line that it follows, or leads into, was not made.
        """
        voice = line.acting.voice or self._voices.get(line.actor)
        beside: dict[str, Any] = {}
        for name, output in line.beside.items():
            edges = self.journal.edges(output)
            number, entry = self._entries.get(output, (0, None))
            if edges is None or entry is None or self.rows[number].status == FAILED:
                raise DeitalkError(f"{name}: line {output} was not made; see its own row")
            beside[name] = edges[name == "after"]
        return Acting.of(line.acting, voice=voice, **beside)

    def _known(self, place: int, line: Line, acting: Acting) -> Row | None:
        """The row of a line whose outputs are there."""
        if not self.recordings.signature(line.audio):
            raise AudioError(f"there is no recording {line.audio}; check the path")
        entry = self.journal.entry(line.output)
        key = line_key(line, acting, self.model)
        fresh = Entry(line.output, line.audio, self.recordings.signature(line.audio), key=key)
        self._entries[line.output] = (place, fresh)
        if entry is None or entry.state != DONE or entry.key != key:
            return None
        state = self.outputs.state(line.output)
        lacks_edges = line.output in self._needed and self.journal.edges(line.output) is None
        if state == "missing" or lacks_edges:
            return None
        fresh.sound, self._before[line.output] = entry.sound, entry
        if (entry.signature, entry.audio) != (fresh.signature, fresh.audio):
            return None
        status = "unchanged" if state == "intact" else "edited"
        row = self.rows[place]
        return replace(row, status=status, seconds=entry.seconds, warnings=entry.warnings, error="")

    def _ordered(self, line: Line, acting: Acting) -> Row:
        """Order a line; `known` is the sound that its outputs are of, if they are there."""
        place, entry = self._entries[line.output]
        self.outputs.check_free(line.targets)
        size = self.recordings.size(line.audio)
        order = Order(
            line.output, line.audio, acting, line.written, line.actor, entry.sound, size,
            choice=line.choice, dubbing=line.dubbing, with_edges=line.output in self._needed,
        )  # fmt: skip
        self._orders.append(order)
        return self.rows[place]

    def _store(self, outcomes: Sequence[Outcome]) -> None:
        """Place the files of results, and complete their rows."""
        placed = []
        for outcome in outcomes:
            if outcome.status == "full":
                raise TargetError(
                    f"{self.outputs.folder}: no space left; free some and run the same batch "
                    "again, the finished lines are kept"
                )
            number, entry = self._entries[outcome.output]
            if outcome.status == "unchanged":
                old = self._before[entry.output]
                entry.seconds, entry.frames, entry.warnings = old.seconds, old.frames, old.warnings
            else:
                entry.seconds, entry.frames = outcome.seconds, outcome.frames
                entry.warnings, entry.error = "\n".join(outcome.warnings), outcome.error
                entry.sound = outcome.sound
            entry.state = FAILED if outcome.status == FAILED else DONE
            placed.append((entry, outcome))
        self.outputs.place(placed)
        with self.journal.transaction():
            for entry, outcome in placed:
                if outcome.edges is not None:
                    self.journal.write_edges(entry.output, outcome.edges)
        for entry, outcome in placed:
            number, _ = self._entries[entry.output]
            # The row of a line that a worker has returned.
            row = self.rows[number]
            status = FAILED if entry.state == FAILED else outcome.status
            place = (row.number, row.audio, row.output)
            self.rows[number] = Row(*place, status, entry.seconds, entry.warnings, entry.error)


def model_identity(model: str | Path, backend: Backend = "auto", device: str = "cpu") -> str:
    """Hash of everything of a curve model that outputs follow from, and of this version.

    Raises
    ------
    CheckpointError
        If there is no such model, or it makes a mesh.
    DeitalkError
        If the backend is unknown.
    """
    folder = model_folder(model)
    if product_of(folder) != "curves":
        raise CheckpointError(
            f"{model}: a mesh model; a DEITalk model (curves) is needed, such as default"
        )
    parts = [__version__, chosen_backend(model, backend, device), weights_hash(folder)]
    for name in ("config.yaml", RIG_FILE):
        if (folder / name).is_file():
            parts.append((folder / name).read_text(encoding="utf-8"))
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()


def animate_batch(
    source: str | Path,
    out: str | Path,
    emotion: str | Path | Mapping[str, float] | EmotionTrack = "neutral",
    *,
    acting: Acting | None = None,
    actor: str = "",
    formats: str = "csv",
    fps: float | None = None,
    digits: int | None = None,
    timecode: str = "zero",
    delay: int = 0,
    handles: int = 0,
    track: int | None = None,
    channel: str | int | None = None,
    raw: str | None = None,
    model: str | Path = "default",
    backend: Backend = "auto",
    device: str = "cpu",
    workers: int | None = None,
    ray: str | None = None,
    force: bool = False,
    progress: Progress = lambda share, text: None,
    **fields: Any,
) -> BatchReport:
    """Animate many recordings; a run that was ended goes on where it was.

    Outputs follow from the recording's bytes, its settings and the model: lines whose outputs are
    there already are left. Processes are spawned, so a script needs
    ``if __name__ == "__main__":``.

    Parameters
    ----------
    source : str or Path
        A manifest (`deitalk.batch.manifest`), or a folder of recordings, whose subfolders are
        kept.
    out : str or Path
        Folder of the results: new, empty, or one that was begun from the same source.
    emotion, acting, fields
        As for `deitalk.animate`, of lines whose manifest does not give them.
    actor : str
        Who speaks, of lines whose manifest does not say: lines of one actor share a measured voice.
    formats : str
        A list such as ``"csv;take"``.
    fps, digits, timecode, delay, handles
        Of the written curves; see `deitalk.batch.lines.Written`.
    track, channel, raw
        Which signal of the recordings, as for `deitalk.load_audio`.
    model : str or Path
        Name or folder of a curve model.
    backend : str
        As for `deitalk.models.load.load_network`.
    device : str
        ``cpu``, ``cuda``, ``cuda:N`` or ``mps``: where the networks of all processes are.
    workers : int, optional
        Processes; by default one for each processor of this machine, or of the cluster.
    ray : str, optional
        Address of a Ray cluster whose machines do the work, or ``local`` (extra ``ray``). Paths
        must be URLs, or on a disk that all machines have.
    force : bool
        Go on in a folder that was begun from another source.
    progress : callable
        Called with the share done, 0 to 1, and a text on rate and time left.

    Returns
    -------
    BatchReport
        Failed lines are in it, and in ``batch-failed.csv``; they are no error.

    Raises
    ------
    UserError
        If the source cannot be read, a default is wrong, the model cannot be loaded, or `out`
        must not or cannot be written.
    """
    began = monotonic()
    for name, path in {"source": source, "out": out}.items():
        if not isinstance(path, str | Path):
            raise DeitalkError(f"{name} {quoted(path)} must be a path or a URL")
    form = {"fps": fps, "digits": digits, "timecode": timecode, "delay": delay, "handles": handles}
    written = Written(parse_formats(formats), **form).checked()  # type: ignore[arg-type]
    choice = AudioChoice.of(track, channel, raw)
    acted = acted_as(emotion, acting, fields, animate_batch)
    defaults = Line(0, "", "", acted, written, choice, actor)
    # Refuse a device that this machine lacks; those of a cluster are checked there.
    if device == "cpu" or ray is not None:
        check_device(device)
    else:
        require_device(device)
    identity, count = model_identity(model, backend, device), workers
    if count is not None and count < 1:
        raise DeitalkError(f"workers {workers} must be 1 or more")
    if count is None and ray is None:
        is_linux = hasattr(os, "sched_getaffinity")
        count = len(os.sched_getaffinity(0)) if is_linux else os.cpu_count()
    plan = read_source(source, out, defaults)
    with opened_url(str(out)) if is_url(out) else opened_folder(Path(out)) as outputs:
        # The folder must have been begun from this source.
        name = str(source) if is_url(source) else os.path.realpath(source)
        known = outputs.journal.about("source")
        if known not in (None, name) and not force:
            raise TargetError(
                f"{out} was made from {known}, not from {name}; name another folder, or set "
                "`force=True`",
                parameter="force",
            )
        with outputs.journal.transaction():
            outputs.journal.describe("source", name)
        outputs.begin()
        batch = Batch(plan.lines, outputs, identity)
        make = partial(Performer, str(model), backend=backend, device=device)
        if ray is None:
            staging = partial(make, stage=outputs.stage)
            machines: AbstractContextManager[Pool] = Workers(count or 1, staging)
        else:
            from deitalk.batch.cluster import Cluster

            machines = Cluster(ray, count, make, outputs.stage)
        with machines as pool:
            batch.prepare(pool.run)
            batch.perform(pool.run, progress)
        failed = [row for row in batch.rows if row.status == FAILED]
        outputs.write_table(SUMMARY, summary_text(batch.rows))
        if failed or outputs.has_table(FAILED_TABLE):
            outputs.write_table(FAILED_TABLE, failed_text(failed))
    notes = (*plan.notes, *batch.notes)
    return BatchReport(batch.rows, str(out), monotonic() - began, notes)
