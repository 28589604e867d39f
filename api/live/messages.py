"""Messages of `WS /v1/live`.

::

    client   {"type": "start", "sample_rate": 48000, "encoding": "pcm16", "frames": "binary", …}
    server   {"type": "header", "names": […], "head": […], "fps": 30, "lookahead_seconds": 0.2, …}
    client   samples as bytes, any number a message       {"type": "set", "emotion": "sad"}
    server   frames as bytes or {"type": "frames", …}
    client   {"type": "interrupt", "frame": 372}
    server   {"type": "interrupted", "frame": 380, "next": 389}, frames of a mouth that shuts
    client   {"type": "stop"}
    server   the last frames, {"type": "end", "frames": 421}
"""

import struct
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from api.compute.live import MODEL
from api.errors import Problem
from deitalk.acting import LIVE_FIELDS, Acting
from deitalk.audio.frames import FRAME_RATE
from deitalk.errors import ConfigError
from deitalk.models.folder import read_about
from rig.arrays import Float32
from rig.errors import quoted

FRAME = struct.Struct("<Ifd")
"""Number of the frame, seconds between its sound and this message, its time in the sound."""


class Start(BaseModel):
    """The first message, but for its acting."""

    model_config = ConfigDict(extra="forbid")

    sample_rate: int = Field(default=16_000, ge=8_000, le=192_000)
    encoding: Literal["pcm16", "float32"] = "pcm16"
    frames: Literal["binary", "json"] = "binary"
    model: str = Field(default=MODEL, max_length=64)
    head: bool = False


def acting_of(fields: dict[str, Any], before: Acting | None = None) -> Acting:
    """The acting of a message's fields; those that it does not give are those before.

    Raises
    ------
    UserError
        If a field is unknown, wrong, or needs the whole recording.
    """
    known = [name for name, when in LIVE_FIELDS.items() if before is None or when == "change"]
    known += Start.model_fields if before is None else ()
    for name in fields.keys() - Acting.model_fields.keys():
        raise ConfigError(f"no field {quoted(name)}; known are {', '.join(known)}")
    return Acting.of(before, files={}, **fields).check_live()


def frames_message(
    first: int,
    values: Float32,
    late: list[float],
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
    as_json : bool
        A mapping for JSON; else records of `FRAME` and C little-endian float32.
    head : array [shape=(T, 6)], optional
        Track of the head: ``head`` of a frame in JSON, the last six numbers of a record.
    """
    if not as_json:
        rows = (values if head is None else np.concatenate((values, head), axis=1)).astype("<f4")
        return b"".join(
            FRAME.pack(first + k, late[k], (first + k) / FRAME_RATE) + rows[k].tobytes()
            for k in range(len(rows))
        )
    listed = [
        {
            "index": first + k,
            "time": (first + k) / FRAME_RATE,
            "late": round(late[k], 4),
            "values": np.round(values[k].astype(float), 5).tolist(),
        }
        | ({} if head is None else {"head": np.round(head[k].astype(float), 4).tolist()})
        for k in range(len(values))
    ]
    return {"type": "frames", "frames": listed}


def problem_message(problem: Problem) -> dict[str, Any]:
    """Message of a problem."""
    return {"type": "problem", **problem.content}


def header_message(folder: Path, lookahead: float, head: list[str]) -> dict[str, Any]:
    """Return the first answer of a session."""
    about = read_about(folder)
    return {
        "type": "header",
        "names": about["controls"],
        "control_set": about["control_set"],
        "head": head,
        "fps": FRAME_RATE,
        "lookahead_seconds": lookahead,
        "record": "uint32 index, float32 late, float64 time, float32 values, float32 head; "
        "little-endian",
    }
