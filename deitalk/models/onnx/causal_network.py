"""Causal curve models in ONNX Runtime, one frame a call, without torch.

Letters: B streams, G frames of a call, P spectra of a frame, W samples of a spectrum.
"""

import json
from collections.abc import Callable
from typing import Self

import numpy as np

from deitalk.audio.frames import SAMPLE_RATE
from deitalk.models.onnx.network import OnnxFile, damaged
from deitalk.models.protocol import (
    NetworkRows,
    Product,
    Reading,
    SpectraGrid,
    State,
    Tracks,
    is_neutral,
    styles_of,
)
from rig.arrays import Float32

PROGRESS_FRAMES = 300


class OnnxCausalNetwork:
    """A causal model; a `CausalNetwork`, and a `CurveNetwork` for whole recordings.

    Parameters
    ----------
    file : OnnxFile

    Raises
    ------
    CheckpointError
        If its metadata are damaged.
    """

    product: Product = "curves"
    is_causal = True

    def __init__(self, file: OnnxFile) -> None:
        self.path, self.metadata, self._session = file.path, file.metadata, file.session
        self.controls, self.rules, self.actors = file.controls, file.rules, file.actors
        try:
            self.grid = SpectraGrid(**json.loads(self.metadata["grid"]))
            states = json.loads(self.metadata["state"])
            self._frontend = int(self.metadata["frontend_states"])
            self._names = [str(state["name"]) for state in states]
            self._first = [np.full(state["shape"], state["first"], np.float32) for state in states]
        except (KeyError, TypeError, ValueError):
            raise damaged(self.path) from None

    def eval(self) -> Self:
        """The network itself: it has no other mode."""
        return self

    def first_state(self, batch: int) -> State:
        """See `CausalNetwork`; so the next two methods."""
        return tuple(np.repeat(first[None], batch, axis=0) for first in self._first)

    def begin(self, windows: Float32, state: State) -> State:
        """Read the first groups, which change the states of the frontend, the first ones, alone."""
        groups = windows.shape[1] // self.grid.spectra
        shape = len(windows), groups, 5 + len(self.actors)
        _, after = self.advance(windows, np.zeros(shape, np.float32), state)
        return (*after[: self._frontend], *state[self._frontend :])

    def advance(self, windows: Float32, styles: Float32, state: State) -> tuple[NetworkRows, State]:
        """Read the next frames."""
        frames = []
        for k in range(styles.shape[1]):
            group = windows[:, k * self.grid.spectra : (k + 1) * self.grid.spectra]
            inputs = {"windows": np.ascontiguousarray(group), "emotion": styles[:, k]}
            found = self._session.run(None, inputs | dict(zip(self._names, state, strict=True)))
            frames.append(found[:4])
            state = tuple(found[4:])
        curves, neutral, saliency, strength = (
            np.stack(part, axis=1) for part in zip(*frames, strict=True)
        )
        return NetworkRows(neutral, curves, saliency, strength), state

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
        centres = np.arange((total + grid.delay) * grid.spectra) * SAMPLE_RATE / grid.rate
        starts = np.round(centres).astype(np.int64) - grid.length // 2
        after = max(int(starts[-1]) + grid.length - len(sound), 0)
        before = grid.length // 2
        padded = np.pad(sound * np.float32(gain), (before, after))
        rows = np.lib.stride_tricks.sliding_window_view(padded, grid.length)
        first = grid.delay * grid.spectra
        state = self.begin(rows[starts[:first] + before][None], self.first_state(1))
        parts = []
        for start in range(0, total, PROGRESS_FRAMES):
            stop = min(start + PROGRESS_FRAMES, total)
            places = starts[first + start * grid.spectra : first + stop * grid.spectra] + before
            found, state = self.advance(rows[places][None], styles[:, start:stop], state)
            parts.append([part[0] for part in found])
            progress(stop / total)
        neutral, curves, saliency, strength = (
            np.concatenate(part) for part in zip(*parts, strict=True)
        )
        emotional = neutral if is_neutral(weights) else curves
        return Reading(neutral, emotional, Tracks(saliency, strength))
