"""References of the actors of a batch: the usual voice of each, measured on its own lines.

A reference stays in the output folder as ``batch-actors/<actor>.json`` and is used by later runs,
so that a line added tomorrow does not change those of today. It is measured again once the file is
removed.
"""

import hashlib
import re
from collections.abc import Callable, Iterable, Iterator, Sequence

from deitalk.batch.journal import Journal
from deitalk.batch.lines import Line
from deitalk.batch.messages import Order, Outcome
from deitalk.batch.outputs import AnyOutputs
from deitalk.batch.source import ACTORS
from deitalk.emotions import ActorReference, parse_actor
from deitalk.pipeline.actor import reference_of

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
