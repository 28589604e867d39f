"""Warnings about the curves of a line, beside those of its recording.

Bilabials (p, b, m) come about once a second in speech, and each shuts the lips: of 528 pieces of
LibriSpeech of 2 to 6 s, 2 % have no contact, of those of 5 s or more none.
"""

from deitalk.audio.frames import FRAME_RATE
from deitalk.pipeline.performance import Performance

CONTACT = 0.5
"""Value of the lips-together controls in a contact; closures of readers reach 0.9."""
MOVING_JAW = 0.05
MOVING_SECONDS = 5.0
"""Time of a moving jaw in which the lips meet; shorter lines may have no p, b or m."""
JAW, LIPS = "CTRL_C_jaw.ty", "lipsTogether"


def findings(performance: Performance) -> tuple[str, ...]:
    """Warnings about a performance that a person should look at."""
    curves = performance.curves
    lips = [i for i, name in enumerate(curves.names) if LIPS in name]
    if not lips or JAW not in curves.names:
        return ()
    moving = int((curves[JAW] > MOVING_JAW).sum()) / FRAME_RATE
    if moving < MOVING_SECONDS or curves.values[:, lips].mean(axis=1).max() >= CONTACT:
        return ()
    text = f"the lips never meet in {moving:.1f} s of speech: look at it; the recording may be"
    return (f"{text} muffled, or no speech",)
