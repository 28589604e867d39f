"""What live needs of a causal network: arrays in, arrays out, state in the caller's hands.

`deitalk.models.causal.in_torch` does it in torch, `deitalk.models.onnx.causal_network` in ONNX
Runtime. This module imports neither.

Letters: B streams, G groups of spectra (one a rig frame), P spectra of a group, W samples of a
spectrum, C controls.
"""

from collections.abc import Sequence
from typing import NamedTuple, Protocol, TypeAlias

from deitalk.audio.frames import FRAME_RATE, SAMPLE_RATE
from deitalk.models.network import NetworkFacts
from rig.arrays import Float32

State: TypeAlias = tuple[Float32, ...]
"""What a network keeps of streams between two calls; every array begins with the stream."""


class SpectraGrid(NamedTuple):
    """Where the spectra lie that a causal network reads."""

    spectra: int
    """P, of a rig frame."""
    length: int
    """W, samples of a spectrum."""
    delay: int
    """Groups that must come after a frame's own before the frame is known."""

    @property
    def rate(self) -> int:
        """Spectra a second."""
        return FRAME_RATE * self.spectra

    @property
    def lookahead_samples(self) -> int:
        """Samples after the time of a frame that the network's rows depend on."""
        last = (self.delay + 1) * self.spectra - 1
        return round(last * SAMPLE_RATE / self.rate) + self.length - self.length // 2


class NetworkRows(NamedTuple):
    """What the network gives for consecutive frames."""

    neutral: Float32
    """[shape=(B, G, C)]."""
    emotional: Float32
    """[shape=(B, G, C)]."""
    saliency: Float32
    """[shape=(B, G), range -1 to 1]; 0 without the intensity module."""
    strength: Float32
    """Predicted intensity [shape=(B, G), range 0 to 1]; 1 without the intensity module."""


class CausalNetwork(NetworkFacts, Protocol):
    """A network whose frames depend on the past and a bounded look-ahead."""

    @property
    def grid(self) -> SpectraGrid:
        """Where the spectra lie."""

    def first_state(self, batch: int) -> State:
        """State of streams before their first sample."""

    def begin(self, windows: Float32, state: State) -> State:
        """Read the first groups of streams, as many as the grid's `delay`: they give no frame.

        The decoder begins with the first frame, as on a whole clip. Parameters as for `advance`.
        """

    def advance(self, windows: Float32, styles: Float32, state: State) -> tuple[NetworkRows, State]:
        """Read the next frames of streams in the neutral and in another emotion.

        Parameters
        ----------
        windows : array [shape=(B, G P, W)]
            Samples of the next groups of spectra.
        styles : array [shape=(B, G, 5 + actors)]
            From `styles_of`, of the frames that are read: the grid's `delay` before the groups.
        state : State
            From `first_state`, or from the call before.
        """


def take(state: State, streams: Sequence[int]) -> State:
    """State of some streams."""
    index = list(streams)
    return tuple(part[index] for part in state)


def put(state: State, streams: Sequence[int], new: State) -> None:
    """Replace the state of some streams, in place."""
    index = list(streams)
    for old, part in zip(state, new, strict=True):
        old[index] = part
