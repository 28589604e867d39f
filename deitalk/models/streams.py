"""State of streams between two calls of a causal network, in numpy or torch.

Letters as in `deitalk.models.protocol`.
"""

from collections.abc import Sequence

import numpy as np

from deitalk.array_functions import as_index, like
from deitalk.emotions import EMOTIONS
from deitalk.models.protocol import NetworkRows, SpectraGrid, State
from rig.arrays import Float32

PLACE = 2
"""Place in a causal network's state of the number of a stream's next row (B, 1)."""


class StreamedNetwork:
    """A `CausalNetwork` whose `_next` computes frames, and whose state of streams is kept here."""

    grid: SpectraGrid
    actors: tuple[str, ...]
    rings: Sequence[int]
    """Length of the ring of each part of the frontend's state, as for `put`."""

    def begin(self, windows: Float32, state: State, streams: Sequence[int]) -> None:
        """Read the first groups, which change the frontend's state, the first parts, alone."""
        groups = windows.shape[1] // self.grid.spectra
        styles = np.zeros((len(windows), groups, len(EMOTIONS) + len(self.actors)), np.float32)
        _, new = self._next(windows, styles, take(state, streams))
        put(state, streams, new[: len(self.rings)], self.rings)

    def advance(
        self, windows: Float32, styles: Float32, state: State, streams: Sequence[int]
    ) -> NetworkRows:
        """Read the next frames."""
        rows, new = self._next(windows, styles, take(state, streams))
        count = len(self.rings)
        put(state, streams, new[:count], self.rings)
        put(state[count:], streams, new[count:])
        return rows

    def _next(self, windows: Float32, styles: Float32, state: State) -> tuple[NetworkRows, State]:
        """The next frames of streams, and what is new of their state."""
        raise NotImplementedError


def take(state: State, streams: Sequence[int]) -> State:
    """State of some streams; of consecutive ones a view."""
    index = _index(streams)
    return tuple(part[index] for part in state)


def put(state: State, streams: Sequence[int], new: State, rings: Sequence[int] = ()) -> None:
    """Replace the state of some streams, in place.

    Parameters
    ----------
    state, new : State
        Of all streams, and what is new of some; the last parts of a longer state stay.
    streams : sequence of int
        Which these are.
    rings : sequence of int, optional
        Of each part, the axis on which row n of a stream lies at place n modulo its length, and of
        which `new` has the rows from the stream's `PLACE` on; 0 if all of the part is new.
    """
    index = _index(streams)
    parts = zip(state, new, rings or [0] * len(new), strict=False)
    for old, part, axis in reversed(list(parts)):  # the rings before the place of their rows
        if axis:
            size, count = old.shape[axis], part.shape[axis]
            rows = np.arange(max(count - size, 0), count)
            numbers, rows = (like(x, old) for x in (np.asarray(streams)[:, None], rows))
            places = as_index(state[PLACE][index] + rows) % size
            old.swapaxes(1, axis)[as_index(numbers), places] = part.swapaxes(1, axis)[:, -size:]
        else:
            old[index] = part


def _index(streams: Sequence[int]) -> slice | list[int]:
    first, last = streams[0], streams[-1]
    whole = list(streams) == list(range(first, last + 1))
    return slice(first, last + 1) if whole else list(streams)
