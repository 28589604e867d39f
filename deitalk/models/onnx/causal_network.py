"""Causal curve models in ONNX Runtime, without torch.

Letters: B streams, G frames of a call, P spectra of a frame, W samples of a spectrum.
"""

import json
from collections.abc import Callable

import numpy as np

from deitalk.audio.frames import SAMPLE_RATE
from deitalk.audio.running_level import first_level, levelled
from deitalk.models.onnx.network import OpenedGraph
from deitalk.models.protocol import (
    NetworkRows,
    Reading,
    SpectraGrid,
    State,
    Tracks,
    is_neutral,
    styles_of,
)
from deitalk.models.streams import StreamedNetwork
from rig.arrays import Float32

PROGRESS_FRAMES = 300


class OnnxCausalNetwork(StreamedNetwork, OpenedGraph):
    """A causal model; a `CausalNetwork`, and a `CurveNetwork` for whole recordings."""

    is_causal = True
    device = "cpu"

    def _read_metadata(self) -> None:
        self.grid = SpectraGrid(**json.loads(self.metadata["grid"]))
        states = json.loads(self.metadata["state"])
        self.rings = tuple(map(int, json.loads(self.metadata["rings"])))
        self._reads_effort = self.metadata["effort"] == "true"
        self._names = [str(state["name"]) for state in states]
        self._first = [np.full(state["shape"], state["first"], np.float32) for state in states]

    def first_state(self, batch: int) -> State:
        """See `CausalNetwork`."""
        kept = (np.repeat(first[None], batch, axis=0) for first in self._first)
        return first_level(batch), *kept

    def _next(self, windows: Float32, styles: Float32, state: State) -> tuple[NetworkRows, State]:
        given, level = levelled(windows, self.grid.spectra, state[0])
        inputs = {"windows": given, "emotion": np.ascontiguousarray(styles)}
        found = self._session.run(None, inputs | dict(zip(self._names, state[1:], strict=True)))
        curves, neutral, *others = found[: len(NetworkRows._fields)]
        return NetworkRows(neutral, curves, *others), (level, *found[len(NetworkRows._fields) :])

    def read(
        self,
        sound: Float32,
        weights: Float32,
        actor: str = "",
        progress: Callable[[float], None] = lambda share: None,
        gain: float = 1.0,
    ) -> Reading:
        """Curves of a whole recording; see `deitalk.models.protocol.CurveNetwork`."""
        grid, total = self.grid, len(weights)
        styles = styles_of(weights, self.actors, actor)[None]
        index = np.arange((total + grid.delay) * grid.spectra) - grid.lead
        centres = index * SAMPLE_RATE / grid.rate
        starts = np.round(centres).astype(np.int64) - grid.length // 2
        after = max(int(starts[-1]) + grid.length - len(sound), 0)
        before = max(-int(starts[0]), 0)
        padded = np.pad(sound * np.float32(gain), (before, after))
        rows = np.lib.stride_tricks.sliding_window_view(padded, grid.length)
        first = grid.delay * grid.spectra
        state, parts = self.first_state(1), []
        self.begin(rows[starts[:first] + before][None], state, [0])
        for start in range(0, total, PROGRESS_FRAMES):
            stop = min(start + PROGRESS_FRAMES, total)
            places = starts[first + start * grid.spectra : first + stop * grid.spectra] + before
            found = self.advance(rows[places][None], styles[:, start:stop], state, [0])
            parts.append([part[0] for part in found])
            progress(stop / total)
        neutral, curves, saliency, strength, effort = (
            np.concatenate(part) for part in zip(*parts, strict=True)
        )
        emotional = neutral if is_neutral(weights) else curves
        tracks = Tracks(saliency, strength, effort if self._reads_effort else None)
        return Reading(neutral, emotional, tracks)
