"""Messages of `WS /v1/live`.

::

    client   {"type": "start", "sample_rate": 48000, "encoding": "pcm16", "frames": "binary", …}
    server   {"type": "header", "names": […], "fps": 30, "lookahead_seconds": 0.2, …}
    client   samples as bytes, any number a message       {"type": "set", "emotion": "sad"}
    server   frames as bytes or {"type": "frames", …}
    client   {"type": "stop"}
    server   the last frames, {"type": "end", "frames": 421}
"""

import struct
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from rig.arrays import Float32

FRAME = struct.Struct("<Ifd")
"""Number of the frame, seconds between its sound and this message, its time in the sound."""


class Change(BaseModel):
    """Emotion, intensity and rules from now on; what is left out stays as it is."""

    model_config = ConfigDict(extra="forbid")

    emotion: Annotated[str, Field(max_length=400)] | dict[str, float] | None = None
    intensity: Annotated[float, Field(ge=0, le=4)] | None = None
    raw: bool | None = None


class Start(Change):
    """The first message."""

    sample_rate: int = Field(default=16_000, ge=8_000, le=192_000)
    encoding: Literal["pcm16", "float32"] = "pcm16"
    frames: Literal["binary", "json"] = "binary"
    model: str = Field(default="live", max_length=64)


def frames_message(
    first: int, values: Float32, late: list[float], fps: float, *, as_json: bool
) -> bytes | dict[str, Any]:
    """Return consecutive frames as one message.

    Parameters
    ----------
    first : int
        Number of the first frame.
    values : array [shape=(T, C)]
        Curves.
    late : list of float
        Seconds between the arrival of each frame's sound and now.
    fps : float
        Frames per second.
    as_json : bool
        A mapping for JSON; else records of `FRAME` and C little-endian float32.
    """
    rows = values.astype("<f4")
    if not as_json:
        return b"".join(
            FRAME.pack(first + k, late[k], (first + k) / fps) + rows[k].tobytes()
            for k in range(len(rows))
        )
    listed = [
        {
            "index": first + k,
            "time": (first + k) / fps,
            "late": round(late[k], 4),
            "values": np.round(rows[k].astype(float), 5).tolist(),
        }
        for k in range(len(rows))
    ]
    return {"type": "frames", "frames": listed}
