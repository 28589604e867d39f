"""Features of recordings that were encoded several times, each time in other surroundings.

Letters: S samples, T rig frames, D width of the features.
"""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from deitalk.audio.frames import FRAME_RATE, SAMPLE_RATE
from deitalk.data.augment_waveform import Surroundings, augment, change_speed, speed_factor
from deitalk.frontends.base import Frontend
from rig.arrays import Float32

STREAM_GAIN_DB = (-18.0, 14.0)
"""Range of a recording's gain before a causal frontend, whose running level must make up for it."""


MOST_LEAD_FRAMES = 60
"""Frames of silence before it, as every stream begins."""


class EncodedPasses:
    """Features of recordings that were encoded several times, on disk and memory-mapped.

    ::

        features/0.npy         features of every recording in turn   (R, D)    float16
                 0.table.npy   first row and speed of each, and R    (N + 1, 2)

    Parameters
    ----------
    folder : Path
        Where `write` wrote them.
    sounds : sequence of Path
        The recordings, in the order of the rows.
    passes : int
    """

    def __init__(self, folder: Path, sounds: Sequence[Path], passes: int) -> None:
        self.places = {path: place for place, path in enumerate(sounds)}
        self.rows = [np.load(folder / f"{k}.npy", mmap_mode="r") for k in range(passes)]
        self.tables = [np.load(folder / f"{k}.table.npy") for k in range(passes)]

    @classmethod
    def write(
        cls,
        folder: Path,
        sounds: Sequence[Path],
        read: Callable[[Path], Float32],
        frontend: Frontend,
        surroundings: Surroundings,
        *,
        passes: int,
        seed: int,
    ) -> "EncodedPasses":
        """Encode recordings, unless that is done; the first pass is as they are.

        Parameters
        ----------
        folder : Path
            Made here.
        sounds : sequence of Path
            Recordings, each once.
        read : callable
            Gives a recording at 16 kHz and the normal level [shape=(S,)].
        frontend : Frontend
            In evaluation mode.
        surroundings : Surroundings
            Noise and rooms of the other passes; each changes the speed of a recording too.
        passes : int
            Number of encodings of every recording.
        seed : int
            Of what is changed.
        """
        folder.mkdir(parents=True, exist_ok=True)
        for k in range(passes):
            if not (folder / f"{k}.table.npy").is_file():
                _write_pass(folder, k, sounds, read, frontend, surroundings, seed)
        return cls(folder, sounds, passes)

    def speed(self, k: int, sound: Path) -> float:
        """Factor of a recording's speed in a pass."""
        return float(self.tables[k][self.places[sound], 1])

    def window(self, k: int, sound: Path, first: int, n_frames: int) -> NDArray[np.float16]:
        """Features of some frames of a recording in a pass [shape=(T, D)]; the last row holds."""
        place = self.places[sound]
        begin, end = (int(row) for row in self.tables[k][place : place + 2, 0])
        rows = self.rows[k][min(begin + first, end - 1) : min(begin + first + n_frames, end)]
        return np.pad(rows, ((0, n_frames - len(rows)), (0, 0)), mode="edge")


def _write_pass(
    folder: Path,
    k: int,
    sounds: Sequence[Path],
    read: Callable[[Path], Float32],
    frontend: Frontend,
    surroundings: Surroundings,
    seed: int,
) -> None:
    """Write the features of one pass, then its table; parameters as for `EncodedPasses.write`."""
    rows: list[NDArray[np.float16]] = []
    starts, speeds = [0], []
    for place, path in enumerate(sounds):
        sound, speed = read(path), 1.0
        if k:
            rng = np.random.default_rng((seed, k, place))
            speed = speed_factor(rng)
            others = [read(sounds[int(n)]) for n in rng.integers(len(sounds), size=4)]
            sound = augment(change_speed(sound, speed), rng, surroundings, others)
        n_frames = max(int(np.ceil(len(sound) * FRAME_RATE / SAMPLE_RATE)), 1)
        lead = 0
        if k and frontend.is_causal:
            lead = int(rng.integers(MOST_LEAD_FRAMES + 1))
            sound = np.pad(sound, (lead * SAMPLE_RATE // FRAME_RATE, 0))
            sound = sound * np.float32(10 ** (rng.uniform(*STREAM_GAIN_DB) / 20))
        features = frontend.encode(torch.from_numpy(sound), lead + n_frames)[lead:]
        rows.append(features.cpu().numpy().astype(np.float16))
        starts.append(starts[-1] + n_frames)
        speeds.append(speed)
    np.save(folder / f"{k}.npy", np.concatenate(rows))
    np.save(folder / f"{k}.table.npy", np.stack((starts, [*speeds, 1.0]), axis=1))
