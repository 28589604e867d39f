"""Columns of each frame that the pass after the network reads besides the readings.

Letters: T frames (with more axes before them, as in the arrays that are joined), S styles.
"""

from typing import Any, NamedTuple

import numpy as np

from deitalk.array_functions import Array, join, library, single
from deitalk.audio.held_sound import POSE_FRAMES
from deitalk.emotions import LABELS
from deitalk.emotions.variants import EMOTION_OF
from rig.arrays import Float32

N_VARIANTS = len(EMOTION_OF)
VOICE = 11 + len(LABELS) + N_VARIANTS
"""Columns of `VoiceTracks`."""
GATES = 2
"""Columns of the gates in `shown_columns`."""


class VoiceTracks(NamedTuple):
    """Columns of the pass that come from voice and acting, arrays or tensors."""

    scale: Array
    """Factor on the difference of the readings [shape=(T,)]."""
    opening: Array
    """Factor on the opening of the mouth [shape=(T,)]."""
    held: Array
    """Intensity already in the emotional reading [shape=(T,), range 0 to 2]."""
    phones: Array
    """From `deitalk.postprocess.known_phones.phone_tracks` [shape=(T, 4)]."""
    emotion: Array
    """Weights of the emotions [shape=(T, 9)]."""
    back: Array
    """Frames since the pose that a held sound keeps [shape=(T,)]; `deitalk.audio.held_sound`."""
    kept: Array
    """Share of that pose that is shown [shape=(T,), range 0 to 1]."""
    variants: Array
    """Weights of their variants [shape=(T, 24)]; 0: the pose of the emotion itself."""
    side: Array
    """1: the left side does what one side does alone, -1: the right one [shape=(T,)]."""
    felt: Array
    """Intensity of the emotion in the voice [shape=(T,), range 0 to 1.6]."""

    def columns(self) -> Array:
        """All of them side by side [shape=(T, 44)]."""
        factors = library(self.scale).stack((self.scale, self.opening, self.held), axis=-1)
        singles = [single(part) for part in (self.back, self.kept, self.side, self.felt)]
        kept = library(self.scale).stack(singles, axis=-1)
        columns = factors, self.phones, kept, self.emotion, self.variants
        return join([single(part) for part in columns], -1)


class MotionTracks(NamedTuple):
    """Motion above the mouth of frames, before the emotion decides what moves; of tensors too."""

    lids: Any
    """Closure of the left and the right lids [shape=(T, 2), range 0 to 1]."""
    gaze: Any
    """Degrees to the character's left and up [shape=(T, 2)]."""
    calm_gaze: Any
    """The same of the neutral reading."""
    vergence: Any
    """Degrees by which each eye turns inwards [shape=(T, 1)]."""
    accents: Any
    """Swells of the accents on the left and the right [shape=(T, 2), range 0 to 1]."""
    gestures: Any
    """Motion of each stem of `deitalk.postprocess.life.face.STEMS` in a neutral face, on the left,
    then on the right [shape=(T, 18)]."""
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


MOTION = MotionTracks(2, 2, 2, 1, 2, 18, 1, 4, len(LABELS), 1, 1)
"""Widths of the columns."""
N_MOTION: int = sum(MOTION)
N_SHOWN = GATES + N_MOTION


def shown_columns(mouth: Float32, expression: Float32, motion: MotionTracks | None) -> Float32:
    """Gate of the mouth and share of the expression [shape=(T,)], and motion beside them.

    [shape=(T, 2 + 43)]; without motion a still face.
    """
    columns = np.zeros((*mouth.shape, N_SHOWN), np.float32)
    columns[..., 0], columns[..., 1] = mouth, expression
    if motion is not None:
        np.concatenate(motion, axis=-1, out=columns[..., GATES:], casting="unsafe")
    return columns


def rest_rows(rest: Float32, window: int) -> Float32:
    """State of the pass for a face at `rest` [shape=(C,)] and a voice that changes nothing.

    Both readings and the columns of `VoiceTracks`, of the pose that a held sound keeps and of the
    last frames, `window` that contacts see or more [shape=(N, 2 C + 44)].
    """
    count = 1 + max(window, POSE_FRAMES)
    ones, zeros = np.ones((count, 1)), np.zeros((count, VOICE - 3))
    face = np.tile(rest, (count, 2))
    return np.concatenate((face, ones, ones, ones, zeros), axis=1, dtype=np.float32)
