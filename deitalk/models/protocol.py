"""What is needed of a network: arrays in, arrays out; imports neither torch nor ONNX Runtime.

::

    CurveNetwork    a whole recording -> curves
    CausalNetwork   the next frames of many streams, with the state in the caller's hands

`deitalk.models.curve_model.DEITalk` and `deitalk.models.causal_model.TorchNetwork` evaluate in
torch, the classes of `deitalk.models.onnx` in ONNX Runtime; `deitalk.models.load` makes them.

Letters: B streams, G groups of spectra (one a rig frame), P spectra of a group, W samples of a
spectrum, C controls, T frames.
"""

from collections.abc import Callable, Sequence
from typing import Any, Literal, NamedTuple, Protocol, Self, TypeAlias

import numpy as np

from deitalk.audio.frames import FRAME_RATE, SAMPLE_RATE
from deitalk.audio.voice_activity import WINDOW
from deitalk.config.rules import RulesConfig
from deitalk.emotions import EMOTIONS, LABELS, MOODS
from deitalk.errors import CheckpointError
from rig import ControlSet
from rig.arrays import Float32
from rig.errors import quoted


class Tracks(NamedTuple):
    """What a network predicts of each frame besides curves; None if it has no such module."""

    saliency: Float32 | None
    """e_sim (DEITalk Eq. 5) [shape=(T,), range -1 to 1]."""
    strength: Float32 | None
    """Predicted intensity [shape=(T,), range 0 to 1]."""
    effort: Float32 | None = None
    """Strength of the voice [shape=(T,)], dB above the usual."""


class Reading(NamedTuple):
    """Output of a network for a whole recording."""

    neutral: Float32
    """Curves of the neutral reading [shape=(T, C)]."""
    emotional: Float32
    """Curves with the emotion; the same array as `neutral` if all weights are neutral."""
    tracks: Tracks

    def first(self, n_frames: int) -> "Reading":
        """Its first frames."""
        neutral, emotional, tracks = self
        if len(neutral) == n_frames:
            return self
        cut = neutral[:n_frames]
        return Reading(
            cut,
            cut if emotional is neutral else emotional[:n_frames],
            Tracks(*(None if track is None else track[:n_frames] for track in tracks)),
        )


def styles_of(emotion: Float32, actors: Sequence[str], actor: str) -> Float32:
    """Weights of all styles (..., 5 + actors): those of the emotions (..., 5), and of an actor."""
    chosen = np.array([name == actor for name in actors], np.float32)
    shape = (*emotion.shape[:-1], len(actors))
    return np.concatenate((emotion, np.broadcast_to(chosen, shape)), axis=-1, dtype=np.float32)


Product: TypeAlias = Literal["curves", "mesh"]
NEEDED = {
    "curves": "a DEITalk model (curves) is needed, such as default",
    "mesh": "a mesh model is needed, such as sdfa",
}
"""Rule and way out where a model makes the other product."""


class CurveRules(Protocol):
    """The pass from a network's readings to finished curves.

    `deitalk.postprocess.curve_pass.CurvePass` says what its arrays are, and what they hold.
    """

    behind: int
    """Frames before a frame that its contacts depend on."""
    ahead: int
    """Frames by which what comes out is behind what comes in."""
    before: Float32
    """State of a stream before its first frame [shape=(N, 2 C + 44)]; each row is a face at rest.
    """

    def first(self, batch: int) -> Any:
        """State of streams before their first frame (B, N, 2 C + 44): an array or a tensor."""

    def __call__(self, *arrays: Any) -> tuple[Float32, Float32, Float32, Any]:
        """Finish the next frames.

        Parameters
        ----------
        *arrays : array
            neutral, emotional, voice, shown, gain, ruled and state of `CurvePass.forward`; the
            state as it was given.

        Returns
        -------
        curves, neutral, outside, state : array
        """


class Network(Protocol):
    """What every network of curves has."""

    product: Product

    @property
    def controls(self) -> ControlSet:
        """Columns of the curves."""

    @property
    def rules(self) -> RulesConfig:
        """Post-processing that belongs to the model."""

    def curve_pass(self, *, live: bool = False) -> CurveRules:
        """Rules after it, of whole recordings or with the look-ahead of `deitalk.live`."""

    @property
    def actors(self) -> tuple[str, ...]:
        """Names of the actors whose styles it has; empty if it has none."""

    @property
    def emotions(self) -> tuple[str, ...]:
        """Trained emotions that it shows; the others pass as the first of them."""

    @property
    def is_causal(self) -> bool:
        """Whether its frames depend on the past and a bounded look-ahead."""

    def eval(self) -> Self:
        """The network, ready to predict."""


class CurveNetwork(Network, Protocol):
    """A network from speech and emotion to curves."""

    def read(
        self,
        sound: Float32,
        weights: Float32,
        actor: str = "",
        progress: Callable[[float], None] = ...,
        gain: float = 1.0,
    ) -> Reading:
        """Predict curves of a whole recording.

        Parameters
        ----------
        sound : array [shape=(S,)]
            16 kHz.
        weights : array [shape=(T, 5)]
            Emotion of each frame.
        actor : str
            One of `actors`, or empty.
        progress : callable
            Called with the share of the work that is done, 0 to 1.
        gain : float
            Factor that brings the sound's speech to the level of the training.
        """


State: TypeAlias = tuple[Any, ...]
"""What a network keeps of streams between two calls: arrays, or tensors on its device; each begins
with the stream."""


class SpectraGrid(NamedTuple):
    """Where the spectra lie that a causal network reads."""

    spectra: int
    """P, of a rig frame."""
    length: int
    """W, samples of a spectrum."""
    delay: int
    """Groups that must come after a frame's own before the network knows the frame, and frames of
    the sound that are measured by then."""
    lead: int = 0
    """Spectra of a group that lie before its frame."""
    rules_ahead: int = 2
    """Frames after a frame that its contacts see."""

    @property
    def rate(self) -> int:
        """Spectra a second."""
        return FRAME_RATE * self.spectra

    @property
    def lookahead_seconds(self) -> float:
        """Sound after the time of a frame that its finished curves depend on."""
        last = (self.delay + 1) * self.spectra - 1 - self.lead
        read = round(last * SAMPLE_RATE / self.rate) + self.length - self.length // 2
        measured = self.delay * SAMPLE_RATE // FRAME_RATE + WINDOW - WINDOW // 2
        return max(read, measured) / SAMPLE_RATE + self.rules_ahead / FRAME_RATE


class NetworkRows(NamedTuple):
    """What the network gives for consecutive frames: arrays, or tensors within torch."""

    neutral: Any
    """[shape=(B, G, C)]."""
    emotional: Any
    """[shape=(B, G, C)]."""
    saliency: Any
    """[shape=(B, G), range -1 to 1]; 0 without the intensity module."""
    strength: Any
    """Predicted intensity [shape=(B, G), range 0 to 1]; 1 without the intensity module."""
    effort: Any
    """Strength of the voice [shape=(B, G)], dB above the usual; 0 without a readout."""


class CausalNetwork(Network, Protocol):
    """A network whose frames depend on the past and a bounded look-ahead."""

    @property
    def grid(self) -> SpectraGrid:
        """Where the spectra lie."""

    @property
    def device(self) -> str:
        """Where it computes, such as ``cpu`` or ``cuda:0``."""

    def first_state(self, batch: int) -> State:
        """State of streams before their first sample."""

    def begin(self, windows: Float32, state: State, streams: Sequence[int]) -> None:
        """Read the first groups of streams, as many as the grid's `delay`: they give no frame.

        The decoder begins with the first frame, as on a whole clip. Parameters as for `advance`.
        """

    def advance(
        self, windows: Float32, styles: Float32, state: State, streams: Sequence[int]
    ) -> NetworkRows:
        """Read the next frames of streams in the neutral and in another emotion.

        Parameters
        ----------
        windows : array [shape=(B, G P, W)]
            Samples of the next groups of spectra.
        styles : array [shape=(B, G, 5 + actors)]
            From `styles_of`, of the frames that are read: the grid's `delay` before the groups.
        state : State
            Of all streams, from `first_state`; it is changed.
        streams : sequence of int
            The B of them that are read.
        """


def check_product(model: Any, wanted: Product) -> None:
    """Refuse a loaded model that does not make the wanted product.

    Raises
    ------
    CheckpointError
        It names a model that does.
    """
    if (product := getattr(model, "product", None)) != wanted:
        name = type(model).__name__ if product else quoted(model)
        kind = f"makes {product}" if product else f"is a {type(model).__name__}"
        raise CheckpointError(f"model {name} {kind}; {NEEDED[wanted]}")


def chosen_actor(actors: Sequence[str], name: str | None) -> str:
    """The actor whose style is wanted; empty without a name: the mean of the model's actors.

    Raises
    ------
    CheckpointError
        If the model has no such actor.
    """
    if name is not None and name not in actors:
        known = ", ".join(actors) or "none: it is of one actor, or of nobody"
        raise CheckpointError(f"actor {quoted(name)} is unknown; the model's are {known}")
    return name or ""


def mean_actor_note(actors: Sequence[str], name: str) -> tuple[str, ...]:
    """What a take states where several actors are known and none is named."""
    if name or not actors:
        return ()
    return (f"no actor is named: the mean of {', '.join(actors)}; a style names one",)


def unshown_note(emotions: Sequence[str], weights: Float32) -> tuple[str, ...]:
    """What a take states where it is acted in emotions that the model does not show.

    Parameters
    ----------
    emotions : sequence of str
        Those that it shows.
    weights : array [shape=(T, 5)]
        Trained emotions of each frame.
    """
    lost = [
        name
        for place, name in enumerate(EMOTIONS)
        if weights[:, place].any() and name not in (*emotions, "neutral")
    ]
    if not lost:
        return ()
    text = "no capture of the model shows it, and nothing carries the base's to its rig"
    return (f"{', '.join(lost)} passes as {emotions[0]}: {text}",)


def trained_weights(weights: Float32) -> Float32:
    """Weights (T, 5) that the network reads of a track's (T, 9): moods as their mixtures."""
    trained: Float32 = weights @ _TRAINED
    return trained


def neutral_weights(n_frames: int) -> Float32:
    """Weights of the neutral reading [shape=(T, 5)]."""
    return np.tile(np.eye(len(EMOTIONS), dtype=np.float32)[_NEUTRAL], (n_frames, 1))


def is_neutral(weights: Float32) -> bool:
    """Whether no frame has another emotion."""
    return not (weights[:, _NEUTRAL] < 1).any()


def neutral_and_acted(weights: Float32) -> tuple[Float32, ...]:
    """Weights of the neutral reading of a speech, and of the emotional one if it is another.

    Parameters
    ----------
    weights : array [shape=(T, 5)]
        Emotion of each frame.
    """
    neutral = neutral_weights(len(weights))
    return (neutral,) if is_neutral(weights) else (neutral, weights)


_NEUTRAL = EMOTIONS.index("neutral")
_TRAINED = np.zeros((len(LABELS), len(EMOTIONS)), np.float32)
"""Row by label."""
_TRAINED[: len(EMOTIONS)] = np.eye(len(EMOTIONS))
for _mood, _mixture in MOODS.items():
    _row = _TRAINED[LABELS.index(_mood)]
    _row[[EMOTIONS.index(name) for name in _mixture]] = [*_mixture.values()]
    _row[_NEUTRAL] = 1 - _row.sum()
