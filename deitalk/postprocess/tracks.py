"""What the pass after the network reads of each frame besides the readings; arrays, no torch.

Letters: T frames (with more axes before them, as in the arrays that are joined), S styles.
"""

from typing import Any, NamedTuple

import numpy as np

from deitalk.emotions import LABELS
from deitalk.emotions.variants import EMOTION_OF
from rig.arrays import AnyFloat, Float32

N_VARIANTS = len(EMOTION_OF)
VOICE = 8 + len(LABELS) + N_VARIANTS
"""Columns of `VoiceTracks`."""
LIVE_AHEAD = 2
"""Frames after a frame that its contacts see in a voice that has not ended."""
GATES = 2
"""Columns of the gates in `shown_columns`."""


class VoiceTracks(NamedTuple):
    """What voice and acting say of frames."""

    scale: AnyFloat
    """Factor on the difference of the readings [shape=(T,)]."""
    opening: AnyFloat
    """Factor on the opening of the mouth [shape=(T,)]."""
    held: AnyFloat
    """Intensity that the emotional reading holds [shape=(T,), range 0 to 2]."""
    phones: AnyFloat
    """From `deitalk.postprocess.known_phones.phone_tracks` [shape=(T, 4)]."""
    emotion: AnyFloat
    """Weights of the emotions [shape=(T, 9)]."""
    variants: AnyFloat
    """Weights of their variants [shape=(T, 24)]; 0: the pose of the emotion itself."""
    side: AnyFloat
    """1: the left side does what one side does alone, -1: the right one [shape=(T,)]."""

    def columns(self) -> Float32:
        """All of them side by side [shape=(T, 41)]."""
        single = np.stack((self.side, self.scale, self.opening, self.held), axis=-1)
        parts = (single, self.phones, self.emotion, self.variants)
        return np.concatenate(parts, axis=-1, dtype=np.float32)


class MotionTracks(NamedTuple):
    """Motion above the mouth of frames, before the emotion decides what moves; of tensors too."""

    lids: Any
    """Closure of the left and the right lids [shape=(T, 2), range 0 to 1]."""
    gaze: Any
    """Degrees to the character's left and up [shape=(T, 2)]."""
    calm_gaze: Any
    """The same of the neutral reading."""
    accents: Any
    """Swells of the brows' accents on the left and the right [shape=(T, 2), range 0 to 1]."""
    frowns: Any
    """The same of frowns of thought."""
    question: Any
    """Swell of the questions [shape=(T, 1), range 0 to 1]."""
    drift: Any
    """Slow noise of each stem of `deitalk.postprocess.life.head.STEMS` [shape=(T, 7)]."""
    posture: Any
    """Share of what an emotion holds that is shown [shape=(T, 1)]."""
    neck: Any
    """Breath, swallowing, and turns to the left and the right [shape=(T, 4), range 0 to 1]."""
    mixture: Any
    """Emotion shown: weights times intensity [shape=(T, 9)]."""
    side: Any
    """How much stronger the character's left side moves than the right [shape=(T, 1)]."""
    amount: Any
    """Factor on brows, lids and cheeks [shape=(T, 1)]."""


MOTION = MotionTracks(2, 2, 2, 2, 2, 1, 7, 1, 4, len(LABELS), 1, 1)
"""Widths of the columns."""
N_MOTION: int = sum(MOTION)
N_SHOWN = GATES + N_MOTION


def shown_columns(mouth: Float32, expression: Float32, motion: MotionTracks | None) -> Float32:
    """Gates [shape=(T,)] and motion side by side [shape=(T, 2 + 34)]; None: a still face."""
    columns = np.zeros((*mouth.shape, N_SHOWN), np.float32)
    columns[..., 0], columns[..., 1] = mouth, expression
    if motion is not None:
        np.concatenate(motion, axis=-1, out=columns[..., GATES:], casting="unsafe")
    return columns


def rest_rows(rest: Float32, count: int) -> Float32:
    """Rows of the pass for a face at `rest` [shape=(C,)] and a voice that changes nothing.

    Both readings and the columns of `VoiceTracks` [shape=(count, 2 C + 41)].
    """
    ones, zeros = np.ones((count, 1)), np.zeros((count, VOICE - 4))
    face = np.tile(rest, (count, 2))
    return np.concatenate((face, ones, ones, ones, ones, zeros), axis=1, dtype=np.float32)
