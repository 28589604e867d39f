"""Warnings about curves."""

import numpy as np

from deitalk.audio.load import Recording
from deitalk.batch.findings import findings
from deitalk.pipeline.performance import Performance
from rig import RigCurves, default_controls


def performance(seconds, *, jaw=0.3, contact=0.0):
    """A jaw that is open all the time, and one frame with a contact."""
    controls, n_frames = default_controls(), round(30 * seconds)
    values = np.tile(controls.rest, (n_frames, 1)).astype(np.float32)
    values[:, controls.names.index("CTRL_C_jaw.ty")] = jaw
    lips = [i for i, name in enumerate(controls.names) if "lipsTogether" in name]
    values[n_frames // 2, lips] = contact
    curves = RigCurves(values, controls.names)
    sound = Recording(np.zeros(16_000, np.float32), "a.wav", 16_000, 1)
    track = np.zeros(n_frames, np.float32)
    return Performance(curves, curves, track, track, sound, 0)


def test_mouth_that_never_closes_is_found():
    (warning,) = findings(performance(6.0))
    assert warning.startswith("the lips never meet in 6.0 s of speech")


def test_one_contact_little_speech_or_a_closed_jaw_are_no_warning():
    assert findings(performance(6.0, contact=0.9)) == ()
    assert findings(performance(4.0)) == ()
    assert findings(performance(6.0, jaw=0.0)) == ()
