"""Target curves of a rig from articulation, emotion and intensity.

``tables/channels.csv`` maps articulation channels to controls (left and right differ a little),
`deitalk.postprocess.expressions.taught_poses` holds the pose of every emotion at full intensity
with its FACS source (Ekman, Friesen and Hager 2002; EMFACS), and `GAINS` scales the mouth per
emotion. Gains follow studies with
articulographs: strong joy and anger widen the range of the lips 1.2 to 1.5 times against neutral
speech (mostly by `LOUDNESS_GAIN`), quiet sadness narrows it to 0.85 to 0.95.

Letters: N frames, K channels, C controls.
"""

import csv
from functools import cache
from importlib import resources

import numpy as np
from numpy.typing import NDArray

from deitalk.emotions import EMOTIONS
from deitalk.postprocess.expressions import taught_poses
from deitalk.research.corpus.articulation import (
    BITE,
    CHANNELS,
    FUNNEL,
    JAW,
    LOWER,
    PURSE,
    STRETCH,
    TOGETHER,
    UPPER,
)
from rig import ControlSet
from rig.arrays import Float32, Float64

GAINS = {
    "neutral": (1.0, 1.0, 1.0),
    "angry": (1.1, 1.05, 1.05),
    "happy": (1.08, 1.08, 0.95),
    "sad": (0.8, 0.85, 0.95),
    "surprised": (1.2, 1.1, 1.05),
}
"""Factor on jaw, on the lips' opening and spreading, on their rounding, at full intensity."""

LOUDNESS_GAIN = 0.45
"""Gain of the mouth with intensity in every style: 1 + this * (e - the average)."""
USUAL_INTENSITY = 0.575
"""Intensity at a speaker's average prosody."""
FAINT_INTENSITY = 0.1
"""Intensity below which the gains fade to 1: the face goes to rest."""
FALL_MINIMUM_SECONDS = 0.08
"""Relaxation time at the end of a clip that ends with speech, seconds."""

_OPENING = ("upperLipRaise", "lowerLipDepress", "CTRL_C_jaw.ty", "funnel")
_CORNERS = ("cornerPull", "sharpCornerPull", "dimple")
_CONJUGATE = ("eye.tx", "eye.ty", "eye_pupil.ty")
_SPREADING = ("cornerPull", "stretch", "dimple", "sharpCornerPull")


def _rows(name: str) -> list[dict[str, str]]:
    text = resources.files("deitalk.research.corpus").joinpath(f"tables/{name}.csv").read_text()
    return list(csv.DictReader(text.splitlines()))


def _sides(pattern: str) -> tuple[str, ...]:
    """Names of a pair of controls, left first, or of one central control."""
    return tuple(pattern.replace("*", side) for side in "LR") if "*" in pattern else (pattern,)


@cache
def channel_matrix(controls: ControlSet) -> Float64:
    """Matrix from channels to controls [shape=(K + 1, C)]; the last row is stickiness."""
    matrix = np.zeros((len(CHANNELS) + 1, len(controls.names)))
    order = (*CHANNELS, "sticky")
    for row in _rows("channels"):
        names = _sides(row["control"])
        for name, gain in zip(names, (row["left"], row["right"]), strict=False):
            matrix[order.index(row["channel"]), controls.index(name)] += float(gain)
    return matrix


@cache
def style_poses(controls: ControlSet) -> Float64:
    """Pose of every emotion at full intensity, as offsets from rest [shape=(5, C)]."""
    poses = np.zeros((len(EMOTIONS), len(controls.names)))
    for name, sizes in taught_poses(controls.names).items():
        poses[:, controls.index(name)] = [sizes[emotion] for emotion in EMOTIONS]
    return poses * (1 + _lean(controls))


def _lean(controls: ControlSet) -> Float64:
    """Share by which the left side exceeds and the right side falls short [shape=(C,)].

    Expressions are asymmetric; the eyes are not, because both point at one target.
    """
    lean = np.zeros(len(controls.names))
    for side, sign in (("CTRL_L_", 1), ("CTRL_R_", -1)):
        for i, name in enumerate(controls.names):
            if name.startswith(side) and name[len(side) :] not in _CONJUGATE:
                lean[i] = sign * (0.03 if any(base in name for base in _CORNERS) else 0.02)
    return lean


def _columns(controls: ControlSet, words: tuple[str, ...]) -> NDArray[np.intp]:
    return np.array([i for i, n in enumerate(controls.names) if any(w in n for w in words)])


def act(
    channels: Float64, weights: Float64, intensity: Float64, fps: float, controls: ControlSet
) -> Float32:
    """Curves of an utterance from its articulation and emotion.

    Parameters
    ----------
    channels : ndarray [shape=(N, K), range 0 to 1]
        From `deitalk.research.corpus.articulation.articulate`.
    weights : ndarray [shape=(5,) or (N, 5)]
        Weights of the emotions, summing to 1.
    intensity : ndarray [shape=(N,), range 0 to 1]
        e(t); 0 is the face at rest.
    fps : float
        Frames per second.
    controls : ControlSet
        The rig whose controls the tables name.

    Returns
    -------
    ndarray [shape=(N, C)]
        Within the ranges of the controls.
    """
    weights = np.broadcast_to(weights, (len(channels), len(EMOTIONS)))
    moved = _gained(channels, weights, intensity)
    sticky = _stickiness(moved[:, TOGETHER], fps)
    curves = np.column_stack((moved, sticky)) @ channel_matrix(controls)
    pose = (weights @ style_poses(controls)) * intensity[:, None]
    contact = np.maximum(moved[:, TOGETHER], moved[:, BITE])[:, None]
    rounding = np.maximum(moved[:, FUNNEL], moved[:, PURSE])[:, None]
    pose[:, _columns(controls, _OPENING)] *= 1 - contact
    pose[:, _columns(controls, _SPREADING)] *= 1 - 0.5 * rounding
    out = np.clip(controls.rest + curves + pose, controls.minimum, controls.maximum)
    return out.astype(np.float32)


def _gained(channels: Float64, weights: Float64, intensity: Float64) -> Float64:
    """Channels scaled by emotion and intensity; contacts are kept."""
    gains = weights @ np.array([GAINS.get(name, GAINS["neutral"]) for name in EMOTIONS])  # (N, 3)
    gains = 1 + (gains - 1) * intensity[:, None]
    present = np.clip(intensity / FAINT_INTENSITY, 0, 1)  # at 0 articulation is plain
    opening_gain = 1 + LOUDNESS_GAIN * present * (intensity - USUAL_INTENSITY)
    moved = channels.copy()
    contact = np.maximum(moved[:, TOGETHER], moved[:, BITE])
    moved[:, JAW] *= 1 + (gains[:, 0] * opening_gain - 1) * (1 - contact)
    moved[:, [UPPER, LOWER, STRETCH]] *= (gains[:, 1] * opening_gain)[:, None]
    moved[:, [FUNNEL, PURSE]] *= gains[:, [2]]
    return np.clip(moved, 0, 1.6)


def _stickiness(together: Float64, fps: float, seconds: float = 0.06) -> Float64:
    """Stickiness of parting lips: the exponentially decaying closure while it opens."""
    decay = np.exp(-1 / (fps * seconds))
    memory = np.empty_like(together)
    level = 0.0
    for i, value in enumerate(together):
        level = max(value, level * decay)
        memory[i] = level
    return memory - together


def intensity_envelope(z: Float64, speech: tuple[float, float] | None, fps: float) -> Float64:
    """Intensity of every frame from prosody in standard deviations.

    Parameters
    ----------
    z : ndarray [shape=(N,)]
        Smoothed prosody index against the speaker's mean; held through pauses.
    speech : (float, float) or None
        Seconds at which the speech begins and ends; None for silence.
    fps : float
        Frames per second.

    Returns
    -------
    ndarray [shape=(N,), range 0 to 1]
        About 0.575 at an average moment. It rises from rest over 0.35 s, of which 0.2 s are
        before the speech if there is room, and falls back over at most 0.8 s after it: 0 at the
        first and at the last frame.
    """
    times = np.arange(len(z)) / fps
    if speech is None or not len(z):
        return np.zeros(len(z))
    begin, end = speech
    attack = min(0.35, begin + 0.15)
    rest = min(max(times[-1], 0.0), end + 0.8)
    decay = max(rest - end, FALL_MINIMUM_SECONDS)
    rise = np.clip((times - (begin + 0.15 - attack)) / attack, 0, 1)
    fall = np.clip((rest - times) / decay, 0, 1)
    ramp = np.minimum(rise, fall)
    ramp = ramp * ramp * (3 - 2 * ramp)
    envelope: Float64 = ramp * (0.15 + 0.85 / (1 + np.exp(-1.3 * z)))
    return envelope
