"""Files that the cases of an acting name, as text."""

import json

KEYS = "time,emotion,strength\n0,happy,0.2\n1.0,angry,1\n2.0,contempt,1\n"
CURVE = "time,intensity\n0,0.3\n1.5,2\n"
VOICE = json.dumps({
    "format": "deitalk-actor", "version": 1, "strength": 3.5, "recordings": 4, "seconds": 20.0,
    "traits": {"side": 0.2, "brow_range": 1.5},
})  # fmt: skip
TIMED = "1\n00:00:00,100 --> 00:00:00,900\nPromise big\n"
SPOKEN = (
    "1\n00:00:00,100 --> 00:00:00,900\nANNA: [angrily] Promise *big*\n\n"
    "2\n00:00:01,000 --> 00:00:01,300\nBOB: No.\n"
)
EDGE = json.dumps({
    "format": "deitalk-edge", "version": 1, "pose": {"CTRL_C_jaw.ty": 0.4}, "quiet": 0.2,
    "speed": {"CTRL_C_jaw.ty": 0.05}, "head": [3, 1, 0, 0, 0, 0], "head_speed": [0] * 6,
    "traits": {"side": 0.1},
})  # fmt: skip
FIXES = json.dumps({
    "schema": "deitalk.edit/1", "name": "fixes", "edits": [
        {"target": "brow", "mode": "offset", "keys": [[0.2, 0], [0.6, 0.4], [1.1, 0, -0.3, 0]]},
        {"target": "CTRL_C_jaw.ty", "mode": "own", "keys": [[0.5, 0.3]], "span": [0.4, 0.8]},
        {"target": "head.yaw", "mode": "scale", "keys": [[0, 2]], "span": [0, 1], "ease": [0.2, 0.2]},
    ],
})  # fmt: skip
FILES = {
    "fixes.edit.json": FIXES, "keys.csv": KEYS, "intensity.csv": CURVE, "anna.json": VOICE,
    "said.srt": TIMED, "spoken.srt": SPOKEN, "edge.json": EDGE,
}  # fmt: skip
