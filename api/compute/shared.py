"""A network whose recordings another process reads: the worker's side of `api.compute.reader`.

::

    worker    {"model", "actor", "samples"}, then float32: sound (S,), weights (T, 5)
    reader    {"together", "curves", "tracks"}, then float32 (T, columns); or {"error"} and b""

`together` counts the recordings of the pass.
"""

import json
from collections.abc import Callable
from contextlib import suppress
from multiprocessing import connection, current_process
from typing import Any

import numpy as np

from api.errors import describe
from deitalk.models.protocol import CurveNetwork, Reading, Tracks
from rig.arrays import Float32

ANSWER_SECONDS = 30.0
"""Time after which a worker reads by itself."""


class SharedNetwork:
    """A network whose recordings the reader reads, with all else of its own.

    Parameters
    ----------
    network : CurveNetwork
        The same model in this process, on the processor.
    name : str
        As requests name it.
    address : str
        Of the reader.

    Attributes
    ----------
    together : int
        Recordings of the pass in which the last one was read; 1 if this process read it.
    """

    _line: connection.Connection | None = None

    def __init__(self, network: CurveNetwork, name: str, address: str) -> None:
        self.network, self.name, self.address = network, name, address
        self.together = 1

    def __getattr__(self, name: str) -> Any:
        return getattr(self.network, name)

    def eval(self) -> "SharedNetwork":
        """The network."""
        return self

    def read(
        self,
        sound: Float32,
        weights: Float32,
        actor: str = "",
        progress: Callable[[float], None] = lambda share: None,
        gain: float = 1.0,
    ) -> Reading:
        """As `CurveNetwork.read`."""
        with suppress(EOFError, OSError, ValueError):
            reading = self._read_there(sound * np.float32(gain), weights, actor)
            progress(1.0)
            return reading
        SharedNetwork._line, self.together = None, 1
        return self.network.read(sound, weights, actor, progress, gain)

    def _read_there(self, sound: Float32, weights: Float32, actor: str) -> Reading:
        """A reading by the other process; an error where it fails or gives none in time."""
        if SharedNetwork._line is None:
            key = current_process().authkey
            SharedNetwork._line = connection.Client(self.address, authkey=key)
        line, given = SharedNetwork._line, {"model": self.name, "actor": actor}
        line.send_bytes(json.dumps(given | {"samples": len(sound)}).encode())
        line.send_bytes(np.concatenate((sound, weights.ravel()), dtype="<f4").tobytes())
        if not line.poll(ANSWER_SECONDS):
            raise TimeoutError
        answer, data = json.loads(line.recv_bytes()), line.recv_bytes()
        if "error" in answer:
            raise ValueError(answer["error"])
        self.together = answer["together"]
        return unpacked(answer, data, len(weights))


def packed(result: Reading | Exception) -> tuple[dict[str, Any], bytes]:
    """Facts of a reading, and its columns [shape=(T, columns)]."""
    if isinstance(result, Exception):
        return {"error": describe(result)}, b""
    curves = [result.neutral]
    if result.emotional is not result.neutral:
        curves.append(result.emotional)
    there = [track is not None for track in result.tracks]
    tracks = [track for track in result.tracks if track is not None]
    rows = np.column_stack([*curves, *tracks]).astype("<f4")
    return {"curves": len(curves), "tracks": there}, rows.tobytes()


def unpacked(answer: dict[str, Any], data: bytes, n_frames: int) -> Reading:
    """The reading of `packed`."""
    rows = np.frombuffer(data, "<f4").reshape(n_frames, -1)
    count = sum(answer["tracks"])
    tracks = iter(rows[:, rows.shape[1] - count :].T.copy())
    parts = np.split(rows[:, : rows.shape[1] - count], answer["curves"], axis=1)
    curves = [np.array(part, np.float32, order="C") for part in parts]
    return Reading(
        curves[0],
        curves[-1],
        Tracks(*(next(tracks) if there else None for there in answer["tracks"])),
    )
