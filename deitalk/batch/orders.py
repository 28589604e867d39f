"""Lines to orders for the workers, and results to files, journal and rows of the summary."""

import hashlib
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path

from deitalk.acting import Acting
from deitalk.batch.cloud import AnyOutputs
from deitalk.batch.journal import DONE, FAILED, Entry, Journal
from deitalk.batch.lines import BadLine, Line, line_key
from deitalk.batch.messages import Order, Outcome
from deitalk.batch.report import Pace, Progress, Row
from deitalk.batch.source import ACTORS
from deitalk.batch.storage import Recordings
from deitalk.emotions import ActorReference, parse_actor
from deitalk.errors import AudioError, CheckpointError, DeitalkError
from deitalk.installed import __version__
from deitalk.models.folder import RIG_FILE, describe_model, model_folder, product_of, weights_hash
from deitalk.models.load import BACKENDS, Backend
from deitalk.pipeline.speech import reference_of
from rig.errors import TargetError, UserError, quoted

Run = Callable[[Sequence[Order]], Iterator[list[Outcome]]]
"""Results of orders, as they come."""


class Batch:
    """Lines of a batch on their way to rows of its summary.

    Parameters
    ----------
    lines : sequence of Line or BadLine
        In the order of their source.
    outputs : Outputs or CloudOutputs
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

    def __init__(self, lines: Sequence[Line | BadLine], outputs: AnyOutputs, model: str) -> None:
        self.lines, self.outputs, self.model = lines, outputs, model
        self.journal, self.recordings = outputs.journal, Recordings()
        self.rows: list[Row] = []
        self.notes: list[str] = []
        self._orders: list[Order] = []
        self._entries: dict[str, tuple[int, Entry]] = {}
        self._before: dict[str, Entry] = {}

    def prepare(self, run: Run) -> None:
        """Measure the actors, then find what is to be done."""
        good = [line for line in self.lines if isinstance(line, Line)]
        voices = references(good, self.outputs, self.recordings.signature, run)
        actors = {line.actor for line in good if line.acting.voice is None} - {""}
        if unmeasured := sorted(actors - voices.keys()):
            self.notes.append(
                f"too few lines with voice for a reference of {', '.join(unmeasured[:5])}"
            )
        for line in self.lines:
            self.rows.append(self._row(line, voices))

    def perform(self, run: Run, progress: Progress) -> None:
        """Animate what is to be done, the longest recordings first."""
        orders = sorted(self._orders, key=lambda order: -order.size)
        sizes = {order.output: order.size for order in orders}
        new = [self._entries[order.output][1] for order in orders if not order.known]
        self.outputs.announce(new)
        pace = Pace(len(orders), sum(sizes.values()))
        for outcomes in run(orders) if orders else ():
            self._store(outcomes)
            for outcome in outcomes:
                failed = outcome.status == FAILED
                pace.add(sizes[outcome.output], outcome.seconds, failed=failed)
            progress(pace.share, pace.text())

    def _row(self, line: Line | BadLine, voices: dict[str, ActorReference]) -> Row:
        """The row of a line that needs no work; else a preliminary one, and an order."""
        if isinstance(line, BadLine):
            return Row(line.number, line.audio, line.output, FAILED, error=line.error)
        try:
            return self._known(line, voices) or self._ordered(line, voices)
        except UserError as error:
            return Row(line.number, line.audio, line.output, FAILED, error=str(error))

    def _known(self, line: Line, voices: dict[str, ActorReference]) -> Row | None:
        """The row of a line whose outputs are there."""
        if not self.recordings.signature(line.audio):
            raise AudioError(f"there is no recording {line.audio}; check the path")
        entry = self.journal.entry(line.output)
        key = line_key(line, _acting(line, voices), self.model)
        fresh = Entry(line.output, line.audio, self.recordings.signature(line.audio), key=key)
        self._entries[line.output] = (len(self.rows), fresh)
        if entry is None or entry.state != DONE or entry.key != key:
            return None
        state = self.outputs.state(line.output)
        if state == "missing":
            return None
        fresh.sound, self._before[line.output] = entry.sound, entry
        if (entry.signature, entry.audio) != (fresh.signature, fresh.audio):
            return None
        status = "unchanged" if state == "intact" else "edited"
        place = (line.number, line.audio, line.output)
        return Row(*place, status, entry.seconds, entry.warnings)

    def _ordered(self, line: Line, voices: dict[str, ActorReference]) -> Row:
        """Order a line; `known` is the sound that its outputs are of, if they are there."""
        _, entry = self._entries[line.output]
        self.outputs.check_free(line.targets)
        size = self.recordings.size(line.audio)
        order = Order(
            line.output, line.audio, _acting(line, voices), line.written, line.actor, entry.sound,
            size,
        )  # fmt: skip
        self._orders.append(order)
        return Row(line.number, line.audio, line.output, FAILED, error="was not animated")

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
        for entry, outcome in placed:
            number, _ = self._entries[entry.output]
            # The row of a line that a worker has returned.
            row = self.rows[number]
            status = FAILED if entry.state == FAILED else outcome.status
            place = (row.number, row.audio, row.output)
            self.rows[number] = Row(*place, status, entry.seconds, entry.warnings, entry.error)


def _acting(line: Line, voices: dict[str, ActorReference]) -> Acting:
    """The acting of a line, with the voice of its actor where none is given."""
    return Acting.of(line.acting, voice=line.acting.voice or voices.get(line.actor))


def model_identity(model: str | Path, backend: Backend = "torch") -> str:
    """Hash of everything of a curve model that outputs follow from, and of this version.

    Raises
    ------
    CheckpointError
        If there is no such model, or it makes a mesh.
    DeitalkError
        If the backend is unknown.
    """
    if backend not in BACKENDS:
        raise DeitalkError(f"backend {quoted(backend)} is unknown; use torch or onnx")
    if str(model).endswith(".onnx"):
        parts = [__version__, "onnx", str(describe_model(model)["sha256"])]
        return hashlib.sha256("\0".join(parts).encode()).hexdigest()
    folder = model_folder(model)
    if product_of(folder) != "curves":
        raise CheckpointError(
            f"{model}: a mesh model; a DEITalk model (curves) is needed, such as default"
        )
    parts = [__version__, backend, weights_hash(folder)]
    for name in ("config.yaml", RIG_FILE):
        if (folder / name).is_file():
            parts.append((folder / name).read_text(encoding="utf-8"))
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()


# References of the actors of a batch: the usual voice of each, measured on its own lines.
#
# A reference stays in the output folder as ``batch-actors/<actor>.json`` and is used by later runs,
# so that a line added tomorrow does not change those of today. It is measured again once the file
# is removed.


MOST_LINES = 100
"""Lines of an actor that are measured, spread evenly over all of them."""
FEWEST_LINES = 3
"""With fewer lines with voice an actor gets no reference."""


def file_of(actor: str) -> str:
    """Path of an actor's reference below the output folder."""
    plain = re.sub(r"[^0-9a-z]+", "-", actor.lower()).strip("-")[:60]
    if plain != actor:
        plain = f"{plain}-{hashlib.sha256(actor.encode()).hexdigest()[:6]}".lstrip("-")
    return f"{ACTORS}/{plain}.json"


def references(
    lines: Iterable[Line],
    outputs: AnyOutputs,
    signature: Callable[[str], str],
    run: Callable[[Sequence[Order]], Iterator[list[Outcome]]],
) -> dict[str, ActorReference]:
    """References of all actors who have one: read from the output folder, or measured.

    Parameters
    ----------
    lines : iterable of Line
        All lines of the batch.
    outputs : Outputs or CloudOutputs
        The output folder; its journal keeps the strength of each recording.
    signature : callable
        State of a recording's file; empty if it is not there.
    run : callable
        Measures recordings: orders to results.

    Raises
    ------
    EmotionError
        If a reference in the output folder is malformed.
    """
    found: dict[str, ActorReference] = {}
    samples: dict[str, list[tuple[str, str]]] = {}
    for actor, chosen in _by_actor(lines).items():
        content = outputs.reference(file_of(actor))
        if content is not None:
            found[actor] = parse_actor(content, f"{outputs.folder}/{file_of(actor)}")
        else:
            audios = dict.fromkeys(line.audio for line in _spread(chosen))
            signed = [(audio, signature(audio)) for audio in audios]
            samples[actor] = [(audio, sign) for audio, sign in signed if sign]
    journal = outputs.journal
    _measure([sample for group in samples.values() for sample in group], journal, run)
    for actor, group in samples.items():
        measured = [journal.voice(*sample) for sample in group]
        voiced = [m for m in measured if m is not None and m[0] is not None]
        if len(voiced) >= FEWEST_LINES:
            text = reference_of(voiced).as_json()
            outputs.keep_reference(file_of(actor), text)
            found[actor] = parse_actor(text.encode(), actor)  # rounded, as later runs read it
    return found


def _by_actor(lines: Iterable[Line]) -> dict[str, list[Line]]:
    """Lines of each actor, without those with a reference of their own."""
    found: dict[str, list[Line]] = {}
    for line in lines:
        if line.actor and line.acting.voice is None:
            found.setdefault(line.actor, []).append(line)
    return found


def _spread(lines: list[Line]) -> list[Line]:
    step = max(len(lines) / MOST_LINES, 1.0)
    return [lines[int(i * step)] for i in range(min(len(lines), MOST_LINES))]


def _measure(
    samples: list[tuple[str, str]],
    journal: Journal,
    run: Callable[[Sequence[Order]], Iterator[list[Outcome]]],
) -> None:
    """Enter the strength of every recording that is not known yet."""
    signs = {audio: sign for audio, sign in samples if journal.voice(audio, sign) is None}
    orders = [Order(audio, audio, only_voice=True) for audio in signs]
    for outcomes in run(orders) if orders else ():
        with journal.transaction():
            for outcome in outcomes:
                if outcome.status == "done":
                    row = (outcome.strength, outcome.seconds)
                    journal.write_voice(outcome.output, signs[outcome.output], *row)
