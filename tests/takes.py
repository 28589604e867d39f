"""Captured takes for tests: bursts of sound with an opening jaw, as Live Link Face leaves them."""

from pathlib import Path

import numpy as np
import soundfile

from rig.conversion.arkit import arkit_controls
from rig.formats.livelink_csv import LiveLinkTake, frame_ticks, write_take

RATE = 16_000
BURST, PERIOD = 0.5, 0.9


def bursts(seconds: float, *, hertz: float = 120.0, pauses: tuple[tuple[float, float], ...] = ()):
    """Sound [shape=(S,)] of bursts of a voice-like tone every 0.9 s; none within the pauses."""
    t = np.arange(int(seconds * RATE)) / RATE
    tone = sum(np.sin(2 * np.pi * hertz * k * t) / k for k in range(1, 20))
    noise = 1e-4 * np.random.default_rng(0).standard_normal(len(t))
    return (0.1 * is_open(t, pauses) * tone + noise).astype(np.float32)


def is_open(t: np.ndarray, pauses: tuple[tuple[float, float], ...] = ()) -> np.ndarray:
    """Whether a burst is at given seconds."""
    quiet = np.any([(t >= a) & (t < b) for a, b in pauses], axis=0) if pauses else False
    return ((t + 1e-6) % PERIOD < BURST) & ~np.asarray(quiet)


def write_live_link(
    path: Path, seconds: float, *, fps: float = 30.0, without: tuple[str, ...] = (), **sound
) -> Path:
    """Write a Live Link Face CSV and a .wav of the same name; return the CSV."""
    path.parent.mkdir(parents=True, exist_ok=True)
    names = tuple(n for n in arkit_controls().names if n not in without)
    n_frames = round(seconds * fps)
    values = np.zeros((n_frames, len(names)))
    values[:, names.index("EyeBlinkLeft")] = np.linspace(0, 0.5, n_frames)
    if "JawOpen" in names:
        opens = is_open(np.arange(n_frames) / fps, sound.get("pauses", ()))
        values[:, names.index("JawOpen")] = 0.6 * opens
    write_take(path, LiveLinkTake(frame_ticks(n_frames, fps) + 3_600_000, values, names))
    soundfile.write(path.with_suffix(".wav"), bursts(seconds, **sound), RATE)
    return path
