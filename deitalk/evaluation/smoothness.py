"""Whole clips as examples, what a network predicts of them, and steps and jerk of curves.

Letters: T frames, C controls.
"""

from typing import NamedTuple

import numpy as np
import torch

from deitalk.audio.frames import FRAME_RATE, frame_centres
from deitalk.audio.prosody import level_db
from deitalk.audio.voice_activity import speech_activity
from deitalk.data.clips import Clip, read_phones
from deitalk.data.waveforms import n_clip_frames, recorded_frames
from deitalk.data.windows import cut, load_clip
from deitalk.emotions import EMOTIONS
from deitalk.models.curve_model import DEITalk
from rig import ControlSet
from rig.arrays import Bool, Float32

MOVING = 0.02
"""Least standard deviation of a moving control."""


def smoothness(curves: Float32) -> dict[str, float]:
    """Steps and jerk of the controls that move.

    Parameters
    ----------
    curves : ndarray [shape=(T, C)]
        Values at 30 Hz.

    Returns
    -------
    dict
        ``largest_step`` (control units per frame), ``step_p99`` (99th percentile of steps), and
        ``jerk_per_speed``: RMS of the third derivative over RMS of the first, 1/s², median of
        the controls; independent of their range.
    """
    moving = curves[:, curves.std(axis=0) > MOVING].astype(np.float64)
    if len(moving) < 4 or not moving.shape[1]:
        return {}
    steps = np.diff(moving, axis=0)
    speed = np.sqrt(np.square(steps).mean(axis=0)) * FRAME_RATE
    jerk = np.sqrt(np.square(np.diff(moving, 3, axis=0)).mean(axis=0)) * FRAME_RATE**3
    return {
        "largest_step": float(np.abs(steps).max()),
        "step_p99": float(np.percentile(np.abs(steps), 99)),
        "jerk_per_speed": float(np.median(jerk / speed)),
    }


MAX_CLIPS = 60


class Example(NamedTuple):
    """A whole clip at 30 frames per second."""

    waveform: Float32
    curves: Float32
    emotion: str
    intensity: Float32
    phones: list[tuple[float, float, str]]
    known: Bool
    """Controls that the curves hold [shape=(C,)]."""
    speaker: str


def lips_together(curves: Float32, controls: ControlSet) -> Float32:
    """Mean of the four lips-together controls [shape=(T,)]."""
    places = [i for i, name in enumerate(controls.names) if "lipsTogether" in name]
    mean: Float32 = curves[:, places].mean(axis=1)
    return mean


def speaking_frames(example: Example) -> Bool:
    """Frames with speech [shape=(T,)]; a last frame that is begun only has none."""
    speaking = np.zeros(len(example.curves), bool)
    found = speech_activity(example.waveform)[: len(speaking)]
    speaking[: len(found)] = found > 0
    return speaking


def knows_contact(known: Bool, controls: ControlSet) -> bool:
    """Whether curves hold the lips-together controls, so that their contacts can be scored."""
    return bool(all(known[i] for i, name in enumerate(controls.names) if "lipsTogether" in name))


def load_example(clip: Clip, controls: ControlSet, *, sound: bool = True) -> Example:
    """Read a whole clip, resampled to 30 frames per second; without `sound` it is silent."""
    loaded = load_clip(clip, controls, sound=sound)
    n_samples = len(loaded.waveform)
    n_frames = n_clip_frames(n_samples) if sound else recorded_frames(str(clip.audio))
    waveform, curves, intensity, _ = cut(loaded, 0, n_frames)
    phones = read_phones(clip.phones) if clip.phones else []
    return Example(waveform, curves, clip.emotion, intensity, phones, loaded.known, clip.speaker)


@torch.no_grad()
def predict(model: DEITalk, example: Example) -> tuple[Float32, Float32 | None]:
    """The network's curves [shape=(T, C)] and intensity [shape=(T,)] before any rule."""
    n_frames = len(example.curves)
    device = next(model.parameters()).device
    analysis = model.analyse(torch.from_numpy(example.waveform).to(device), n_frames)
    one_hot = torch.eye(len(EMOTIONS), device=device)[EMOTIONS.index(example.emotion)]
    styles = model.styles(one_hot.expand(n_frames, -1), example.speaker)
    curves: Float32 = model.decode(analysis, styles).cpu().numpy()
    return curves, None if analysis.strength is None else analysis.strength.cpu().numpy()


def loudness(waveform: Float32, n_frames: int) -> Float32:
    """Level of the recording on a scale of 40 dB [shape=(T,), range 0 to 1]: the baseline."""
    level = level_db(waveform, frame_centres(np.arange(n_frames)))
    top = np.percentile(level, 95)
    scaled: Float32 = np.clip(1 + (level - top) / 40, 0, 1).astype(np.float32)
    return scaled
