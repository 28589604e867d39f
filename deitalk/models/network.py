"""Protocol of curve networks (arrays in, arrays out), and the loader of both kinds.

`deitalk.models.curve_model.DEITalk` evaluates in torch, `deitalk.models.onnx.OnnxNetwork` in ONNX
Runtime. `load_network` imports the one that is asked for when it is called, so that importing this
module imports neither torch nor ONNX Runtime.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple, Protocol

import numpy as np

from deitalk.config import RulesConfig
from deitalk.emotions import EMOTIONS
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


class Reading(NamedTuple):
    """Output of a network for a whole recording."""

    neutral: Float32
    """Curves of the neutral reading [shape=(T, C)]."""
    emotional: Float32
    """Curves with the emotion; the same array as `neutral` if all weights are neutral."""
    tracks: Tracks


def styles_of(emotion: Float32, actors: Sequence[str], actor: str) -> Float32:
    """Weights of all styles (..., 5 + actors): those of the emotions (..., 5), and of an actor."""
    chosen = np.array([name == actor for name in actors], np.float32)
    shape = (*emotion.shape[:-1], len(actors))
    return np.concatenate((emotion, np.broadcast_to(chosen, shape)), axis=-1, dtype=np.float32)


class NetworkFacts(Protocol):
    """What is known of a network before it reads anything."""

    @property
    def controls(self) -> ControlSet:
        """Columns of the curves."""

    @property
    def rules(self) -> RulesConfig:
        """Post-processing that belongs to the model."""

    @property
    def actors(self) -> tuple[str, ...]:
        """Names of the actors whose styles it has; empty if it has none."""


class CurveNetwork(NetworkFacts, Protocol):
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


def chosen_actor(actors: Sequence[str], name: str | None) -> str:
    """The actor whose style is wanted, or the model's first, or nobody.

    Raises
    ------
    CheckpointError
        If the model has no such actor.
    """
    if name is not None and name not in actors:
        known = ", ".join(actors) or "none: it is of one actor, or of nobody"
        raise CheckpointError(f"actor {quoted(name)} is unknown; the model's are {known}")
    return name or next(iter(actors), "")


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
