"""Voices that are animated while they are spoken, in the worker process that keeps their state.

One order holds what has come for all of them since the last one, and the network reads them in one
call.
"""

from pathlib import Path
from typing import Any

import numpy as np

from api.compute.models import model_of, placed
from api.compute.order import MOST_VOICES, OUT, SAMPLES, Answer, Limits, Order
from api.errors import names_of
from deitalk.acting import Acting
from deitalk.live.animator import LiveAnimator
from deitalk.models.load import load_causal
from rig.arrays import Float32
from rig.errors import UserError


class Voices:
    """Voices by number; each has a stream of its model's animator."""

    def __init__(self) -> None:
        self.animators: dict[str, LiveAnimator] = {}
        self.places: dict[int, tuple[str, int]] = {}
        self.interrupted: dict[int, int] = {}
        """Frame at which the sound begins that comes next, of voices that an order interrupted."""

    def perform(self, actions: list[dict[str, Any]], samples: Float32, limits: Limits) -> Any:
        """Carry out actions in their order; return facts of new voices, errors, and all frames.

        A voice ends by an error of its own; the others go on.
        """
        self.interrupted = {}
        opened, failed, at = {}, {}, 0
        for action in actions:
            voice, begin = int(action["voice"]), at
            at += action.get("count", 0)
            try:
                if action["do"] == "open":
                    opened[voice] = self._open(voice, action["model"], action["fields"], limits)
                elif voice in self.places:
                    self._act(voice, action, samples[begin:at])
            except UserError as error:
                self.places.pop(voice, None)
                failed[voice] = error
        read = {model: animator.read() for model, animator in self.animators.items()}
        frames = {  # curves and track of the head [shape=(n, C + 6)]
            voice: np.concatenate((read[model][k], self.animators[model].heads[k]), axis=1)
            for voice, (model, k) in self.places.items()
            if len(read[model][k])
        }
        return opened, failed, frames

    def _act(self, voice: int, action: dict[str, Any], samples: Float32) -> None:
        model, place = self.places[voice]
        animator = self.animators[model]
        if action["do"] == "feed":
            animator.take(samples, stream=place)
        elif action["do"] == "set":
            animator.set(stream=place, **action["fields"])
        elif action["do"] == "interrupt":
            shown, head = None, None
            if action["shown"] is not None:
                shown, head = np.split(np.float32(action["shown"]), [len(animator.names)])
            self.interrupted[voice] = animator.interrupt(place, shown=shown, head=head)
        elif action["do"] == "finish":
            animator.end(place)
        else:
            self.places.pop(voice)

    def _open(self, voice: int, model: str, fields: dict[str, Any], limits: Limits) -> float:
        """Give a voice a place; return the look-ahead of its model."""
        if model not in self.animators:
            network = load_causal(placed(model_of(model, limits), limits), lasts=True)
            self.animators[model] = LiveAnimator(network, streams=MOST_VOICES, life="off")
        taken = {place for name, place in self.places.values() if name == model}
        place = min(set(range(MOST_VOICES)) - taken)
        self.animators[model].open(place, Acting.of(files={}, **fields))
        self.places[voice] = (model, place)
        return self.animators[model].lookahead_seconds


_voices = Voices()


def perform_voices(order: Order, limits: Limits, progress: Any) -> Answer:
    """Carry out the actions of an order; frames of all voices as float32, one after another."""
    samples = np.fromfile(SAMPLES, "<f4").astype(np.float32)
    opened, failed, frames = _voices.perform(order["options"]["actions"], samples, limits)
    out = Path(OUT) / "frames"
    parts = [rows.astype("<f4").tobytes() for rows in frames.values()]
    out.write_bytes(b"".join(parts))
    counts = [[voice, len(rows)] for voice, rows in frames.items()]
    errors = [[voice, names_of(error), str(error)] for voice, error in failed.items()]
    facts = {
        "opened": list(opened.items()), "failed": errors, "frames": counts,
        "interrupted": list(_voices.interrupted.items()),
    }  # fmt: skip
    return {"file": str(out), "facts": facts}
