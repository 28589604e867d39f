"""Voices that are animated while they are spoken, in the worker process that keeps their state.

One order holds what has come for all of them since the last one, and the network reads them in one
call.
"""

from pathlib import Path
from typing import Any

import numpy as np

from api.compute.networks import causal_network
from api.compute.order import MOST_VOICES, OUT, SAMPLES, Answer, Limits, Order
from deitalk.acting import Acting
from deitalk.live.animator import LiveAnimator
from rig.arrays import Float32


class Voices:
    """Voices by number; each has a stream of its model's animator."""

    def __init__(self) -> None:
        self.animators: dict[str, LiveAnimator] = {}
        self.places: dict[int, tuple[str, int]] = {}

    def perform(self, actions: list[dict[str, Any]], samples: Float32, limits: Limits) -> Any:
        """Carry out actions in their order; return facts of new voices, and all frames."""
        opened, at = {}, 0
        for action in actions:
            voice, kind = int(action["voice"]), action["do"]
            if kind == "open":
                opened[voice] = self._open(voice, action["model"], action["fields"], limits)
            elif voice not in self.places:
                at += action.get("count", 0)
            elif kind == "feed":
                animator, place = self._place(voice)
                animator.take(samples[at : at + action["count"]], stream=place)
                at += action["count"]
            elif kind == "set":
                animator, place = self._place(voice)
                animator.set(stream=place, **action["fields"])
            elif kind == "finish":
                animator, place = self._place(voice)
                animator.end(place)
            else:
                self.places.pop(voice)
        return opened, self._frames()

    def _open(self, voice: int, model: str, fields: dict[str, Any], limits: Limits) -> float:
        """Give a voice a place; return the look-ahead of its model."""
        if model not in self.animators:
            network = causal_network(model, limits)
            self.animators[model] = LiveAnimator(network, streams=MOST_VOICES, life="off")
        taken = {place for name, place in self.places.values() if name == model}
        place = min(set(range(MOST_VOICES)) - taken)
        self.animators[model].open(place, Acting.of(files={}, **fields))
        self.places[voice] = (model, place)
        return self.animators[model].lookahead_seconds

    def _place(self, voice: int) -> tuple[LiveAnimator, int]:
        model, place = self.places[voice]
        return self.animators[model], place

    def _frames(self) -> dict[int, Float32]:
        """Curves and track of the head of each voice [shape=(n, C + 6)]."""
        read = {model: animator.read() for model, animator in self.animators.items()}
        return {
            voice: np.concatenate((read[model][k], self.animators[model].heads[k]), axis=1)
            for voice, (model, k) in self.places.items()
        }


_voices = Voices()


def perform_voices(order: Order, limits: Limits, progress: Any) -> Answer:
    """Carry out the actions of an order; frames of all voices as float32, one after another."""
    samples = np.fromfile(SAMPLES, "<f4").astype(np.float32)
    opened, frames = _voices.perform(order["options"]["actions"], samples, limits)
    out = Path(OUT) / "frames"
    parts = [rows.astype("<f4").tobytes() for rows in frames.values()]
    out.write_bytes(b"".join(parts))
    counts = [[voice, len(rows)] for voice, rows in frames.items() if len(rows)]
    return {"file": str(out), "facts": {"opened": list(opened.items()), "frames": counts}}
