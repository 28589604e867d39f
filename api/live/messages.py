"""Messages of `WS /v1/live`.

::

    client   {"type": "start", "sample_rate": 48000, "encoding": "pcm16", "frames": "binary", …}
    server   {"type": "header", "names": […], "head": […], "fps": 30, "lookahead_seconds": 0.2, …}
    client   samples as bytes, any number a message       {"type": "set", "emotion": "sad"}
    server   frames as bytes or {"type": "frames", …}
    client   {"type": "stop"}
    server   the last frames, {"type": "end", "frames": 421}
"""

import struct
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from deitalk.postprocess.life.amounts import PARTS, Life
from rig.arrays import Float32
from rig.limits import SEED

FRAME = struct.Struct("<Ifd")
"""Number of the frame, seconds between its sound and this message, its time in the sound."""


class Change(BaseModel):
    """Emotion, intensity and rules from now on; what is left out stays as it is."""

    model_config = ConfigDict(extra="forbid")

    emotion: Annotated[str, Field(max_length=400)] | dict[str, float] | None = None
    intensity: Annotated[float, Field(ge=0, le=4)] | None = None
    raw: bool | None = None


class Start(Change):
    """The first message; what follows `model` is for causal models."""

    sample_rate: int = Field(default=16_000, ge=8_000, le=192_000)
    encoding: Literal["pcm16", "float32"] = "pcm16"
    frames: Literal["binary", "json"] = "binary"
    model: str = Field(default="live", max_length=64)
    head: bool = False
    idle: bool = True
    life: Annotated[str, Field(max_length=200)] | dict[str, float] | None = None
    look_at: str = Field(default="0,0", max_length=60)
    seed: int | None = Field(default=None, ge=0, le=SEED)

    def motion(self) -> dict[str, Any]:
        """Motion above the mouth: without a head that is sent, the eyes do not turn against it.

        Raises
        ------
        DeitalkError
            If `life` or `look_at` is not as for `deitalk.animate`.
        """
        life = Life.of(self.life, self.look_at)
        factors = {part: getattr(life, part) for part in PARTS}
        if not self.head:
            factors["head"] = 0.0
        return {"idle": self.idle, "life": factors, "look_at": life.look_at, "seed": self.seed}


def frames_message(
    first: int,
    values: Float32,
    late: list[float],
    fps: float,
    *,
    as_json: bool,
    head: Float32 | None = None,
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
    head : array [shape=(T, 6)], optional
        Track of the head: ``head`` of a frame in JSON, the last six numbers of a record.
    """
    if not as_json:
        rows = (values if head is None else np.concatenate((values, head), axis=1)).astype("<f4")
        return b"".join(
            FRAME.pack(first + k, late[k], (first + k) / fps) + rows[k].tobytes()
            for k in range(len(rows))
        )
    listed = [
        {
            "index": first + k,
            "time": (first + k) / fps,
            "late": round(late[k], 4),
            "values": np.round(values[k].astype(float), 5).tolist(),
        }
        | ({} if head is None else {"head": np.round(head[k].astype(float), 4).tolist()})
        for k in range(len(values))
    ]
    return {"type": "frames", "frames": listed}
