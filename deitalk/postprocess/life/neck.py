"""Neck of a face whose head moves: breath before phrases, swallowing in pauses, the turning muscle.

- The throat widens with the breath drawn in a pause before a phrase: 0.3 to 0.6 s (Winkworth et al.
  1995 for reading and speech), with the lift of the head (`deitalk.postprocess.life.head`).
- People who are awake swallow about once a minute (Lear, Flanagan and Moorrees 1965), not while
  they speak: here in the first pause of at least 1.2 s after a time of that mean has passed.
  Hyoid and larynx take about a second (Logemann 1998).
- The sternocleidomastoid of one side turns the head to the other (Bexander, Mellor and Hodges
  2005): the left one shows from two degrees of turn to the right.

Amounts are small, and set by eye: no data here measures a neck.

Letters: T frames at 30 per second.
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

BREATH, SWALLOWS = "CTRL_neck_throatExhaleInhale.ty", "CTRL_C_neck_swallow.ty"
TURNS = ("CTRL_L_neck_mastoidContract.ty", "CTRL_R_neck_mastoidContract.ty")


def neck_tracks(breath: Float64, swallows: Float64, yaw: Float32 | Float64) -> dict[str, Float32]:
    """Tracks by name for breath and swallowing (range 0 to 1) and the head's turn in degrees."""
    turns = (np.maximum(np.abs(yaw) - FREE_DEGREES, 0) / FULL_DEGREES).clip(max=1)
    tracks = {
        BREATH: breath,
        SWALLOWS: swallows,
        TURNS[0]: turns * (yaw > 0),
        TURNS[1]: turns * (yaw < 0),
    }
    return {name: track.clip(0, 1).astype(np.float32) for name, track in tracks.items()}
