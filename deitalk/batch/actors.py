"""References of the actors of a batch: the usual voice of each, measured on its own lines.

A reference stays in the output folder as ``batch-actors/<actor>.json`` and is used by later runs,
so that a line added tomorrow does not change those of today. It is measured again once the file is
removed.
"""

import hashlib
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import NamedTuple

from deitalk.audio.choice import AudioChoice
from deitalk.batch.lines import Line
from deitalk.batch.orders import Order, Outcome
from deitalk.batch.outputs import Outputs
from deitalk.batch.source import ACTORS
from deitalk.emotions import ActorReference, parse_actor
from deitalk.pipeline.actor_voice import reference_of

MOST_LINES = 100
"""Lines of an actor that are measured, spread evenly over all of them."""
FEWEST_LINES = 3
"""Least number of lines with voice from which an actor gets a reference."""


class Sample(NamedTuple):
    """A recording of an actor."""

    audio: str
    choice: AudioChoice
    sign: str
    """What its voice depends on."""

    @property
    def name(self) -> str:
        """Its name in the journal: its path, and which signal of it."""
        signal = ",".join(f"{name}={value}" for name, value in self.choice.settings.items())
        return f"{self.audio}#{signal}" if signal else self.audio


def file_of(actor: str) -> str:
    """Path of an actor's reference below the output folder."""
    plain = re.sub(r"[^0-9a-z]+", "-", actor.lower()).strip("-")[:60]
    if plain != actor:
        plain = f"{plain}-{hashlib.sha256(actor.encode()).hexdigest()[:6]}".lstrip("-")
    return f"{ACTORS}/{plain}.json"


def references(
    lines: Iterable[Line],
    outputs: Outputs,
    signature: Callable[[str], str],
    run: Callable[[Sequence[Order]], Iterator[list[Outcome]]],
) -> dict[str, ActorReference]:
    """References of all actors who have one: read from the output folder, or measured.

    Parameters
    ----------
    lines : iterable of Line
        All lines of the batch.
    outputs : Outputs
        The output folder; its journal keeps the voice of each recording.
    signature : callable
        What the voice of a recording depends on; empty if its file is not there.
    run : callable
        Measures recordings: orders to results.

    Raises
    ------
    EmotionError
        If a reference in the output folder is malformed.
    """
    found: dict[str, ActorReference] = {}
    samples: dict[str, list[Sample]] = {}
    by_actor: dict[str, list[Line]] = {}
    for line in sorted(lines, key=lambda line: line.output):  # whatever the manifest's order
        if line.actor and line.acting.voice is None:  # without a reference of its own
            by_actor.setdefault(line.actor, []).append(line)
    for actor, chosen in by_actor.items():
        content = outputs.reference(file_of(actor))
        if content is not None:
            found[actor] = parse_actor(content, f"{outputs.shown}/{file_of(actor)}")
        else:
            step = max(len(chosen) / MOST_LINES, 1.0)
            spread = [chosen[int(i * step)] for i in range(min(len(chosen), MOST_LINES))]
            heard = dict.fromkeys((line.audio, line.choice) for line in spread)
            signed = [Sample(*sound, signature(sound[0])) for sound in heard]
            samples[actor] = [sample for sample in signed if sample.sign]
    journal = outputs.journal
    # Enter the voice of every recording that is not known yet.
    listed = [sample for group in samples.values() for sample in group]
    new = {one.name: one for one in listed if journal.voice(one.name, one.sign) is None}
    orders = [
        Order(name, one.audio, only_voice=True, choice=one.choice) for name, one in new.items()
    ]
    for outcomes in run(orders) if orders else ():
        with journal.transaction():
            for outcome in outcomes:
                if outcome.voice is not None:
                    journal.write_voice(outcome.output, new[outcome.output].sign, outcome.voice)
    for actor, group in samples.items():
        measured = [voice for one in group if (voice := journal.voice(one.name, one.sign))]
        if sum(voice.strength is not None for voice in measured) >= FEWEST_LINES:
            text = reference_of(measured).as_json()
            outputs.keep_reference(file_of(actor), text)
            found[actor] = parse_actor(text.encode(), actor)  # rounded, as later runs read it
    return found
