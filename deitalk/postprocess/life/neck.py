"""Neck: breath before phrases, swallows in pauses, and the muscle that turns the head.

- Breath before phrases takes .3 to .6 s (Winkworth et al. 1995).
- People swallow about once a minute, in pauses (Lear et al. 1965); it takes a second (Logemann
  1998).
- The muscle on the other side turns the head (Bexander et al. 2005).

Amounts are set by eye: no data here measures a neck.
"""

import numpy as np

from rig.arrays import Float32, Float64

INHALE = 0.35
INHALE_SECONDS, INHALE_LEAD = (0.45, 0.0, 0.35), 0.08
"""Rise, top and fall; the top is so long before the phrase."""
SWALLOW_EVERY, LEAST_WAIT = 60.0, 5.0
"""Mean and shortest time between two swallows, seconds."""
SWALLOW_PAUSE = 1.2
SWALLOW = (0.45, 0.15, 0.4)
"""Rise, top and fall of a swallow, seconds."""
FREE_DEGREES, FULL_DEGREES = 2.0, 40.0
"""Yaw from which a turning muscle shows, and what it takes more to contract in full."""

BREATH_CONTROL, SWALLOW_CONTROL = "CTRL_neck_throatExhaleInhale.ty", "CTRL_C_neck_swallow.ty"
TURNS = ("CTRL_L_neck_mastoidContract.ty", "CTRL_R_neck_mastoidContract.ty")


def neck_tracks(breath: Float64, swallows: Float64, yaw: Float32 | Float64) -> Float64:
    """Tracks of `BREATH_CONTROL`, `SWALLOW_CONTROL` and `TURNS` [shape=(..., 4), range 0 to 1].

    Of breath and swallowing (range 0 to 1) and of the head's turn in degrees [shape=(...,)].
    """
    turns = np.clip((np.abs(yaw) - FREE_DEGREES) / FULL_DEGREES, 0, 1)
    rows = breath, swallows, turns * (yaw > 0), turns * (yaw < 0)
    return np.clip(np.stack(rows, axis=-1), 0, 1).astype(np.float64)
