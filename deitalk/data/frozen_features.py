"""The frozen frontend of another model: only the layers behind it are trained.

The paper trains behind a published encoder, ours may train behind that of another model. Without
augmentation the features of a clip never change, so that they are computed once per clip and a step
costs a fraction: captures can be fitted, or variants compared, in minutes. With it every recording
is encoded a few times, each time in other surroundings (`EncodedPasses`).

Letters: S samples, T rig frames, D width of the features.
"""

import hashlib
import re
from collections import OrderedDict
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from deitalk.audio.frames import FRAME_RATE, SAMPLE_RATE
from deitalk.data.augment_waveform import Surroundings, augment, change_speed, speed_factor
from deitalk.data.clips import Clip
from deitalk.errors import ConfigError
from deitalk.frontends.base import Frontend
from deitalk.models.checkpoint import require_model
from deitalk.models.curve_model import DEITalk
from rig.arrays import Float32
from rig.files import atomic_write, remove_leftovers

STREAM_GAIN_DB = (-18.0, 14.0)
"""Range of a recording's gain before a causal frontend, whose running level must make up for it."""
_FILE = re.compile(r"[0-9a-f]{32}\.npy|\d+(\.table)?\.npy")
"""Names of files of features."""
OPEN_FILES = 256
"""Features that are mapped at once."""
MOST_LEAD_FRAMES = 60
"""Frames of silence before it, as every stream begins."""


def remove_features(folder: Path) -> None:
    """Remove the files of features in a folder, and the folder if it holds no others."""
    if not folder.is_dir() or folder.is_symlink():
        return
    remove_leftovers(folder)
    for path in folder.iterdir():
        if _FILE.fullmatch(path.name) and path.is_file():
            path.unlink()
    with suppress(OSError):
        folder.rmdir()


class FrozenFeatures:
    """The frontend of a trained model, and its features of each recording.

    With a folder they lie on disk and are memory-mapped, so that hours need no more memory than
    minutes, and processes that load windows share them::

        FOLDER/<hash of path, time of change and size>.npy    (T, D) float16

    Parameters
    ----------
    name : str
        An embedded model or a model folder.
    folder : Path or None
        Of one model's features; None keeps them in memory.

    Raises
    ------
    CheckpointError
        If there is no such model.

    Attributes
    ----------
    owner : DEITalk
        The model.
    """

    def __init__(self, name: str, folder: Path | None = None) -> None:
        self.name, self.folder = name, folder
        self.owner = require_model(name, DEITalk)
        self._features: OrderedDict[Path, NDArray[np.float16]] = OrderedDict()

    def copy_into(self, model: DEITalk) -> None:
        """Copy the frontend into `model`; no gradient reaches it there.

        Raises
        ------
        ConfigError
            If the model's frontend is built otherwise.
        """
        if model.config.frontend != self.owner.config.frontend:
            raise ConfigError(
                f"train.frozen_frontend={self.name!r} is built otherwise than model.frontend; "
                "use that model's own config.yaml"
            )
        frontend = model.get_submodule("frontend").requires_grad_(False)
        frontend.load_state_dict(self.owner.get_submodule("frontend").state_dict())

    def features(self, clip: Clip, waveform: Float32, n_frames: int) -> NDArray[np.float16]:
        """Features of a whole clip, computed once for all clips of its recording.

        Parameters
        ----------
        clip : Clip
            Its recording is the key of the cache.
        waveform : ndarray [shape=(S,)]
            16 kHz, level-normalised.
        n_frames : int
            Rig frames T; beyond the recording there is silence.

        Returns
        -------
        ndarray [shape=(T, D)]
        """
        known = self._known(clip.audio)
        if known is None or len(known) < n_frames:
            length = n_frames * SAMPLE_RATE // FRAME_RATE
            padded = np.pad(waveform, (0, max(length - len(waveform), 0)))
            features = self.owner.frontend.encode(torch.from_numpy(padded), n_frames)
            known = self._keep(clip.audio, features.cpu().numpy().astype(np.float16))
        return known

    def prepare(
        self,
        clips: Iterable[Clip],
        read: Callable[[Clip], tuple[Float32, int]],
        device: torch.device | str = "cpu",
    ) -> None:
        """Compute the features of clips on a device, before other processes map them.

        Parameters
        ----------
        clips : iterable of Clip
            Recordings whose features are on disk are not read again.
        read : callable
            Gives a clip's sound and frames, as for `features`.
        device : device
            Where the frontend computes; it returns to the CPU.
        """
        if self.folder is not None:
            self.folder.mkdir(parents=True, exist_ok=True)
        self.owner.frontend.to(device)
        for clip in clips:
            if self._known(clip.audio) is None:
                self.features(clip, *read(clip))
        self.owner.frontend.to("cpu")

    def _known(self, sound: Path) -> NDArray[np.float16] | None:
        if sound in self._features:
            self._features.move_to_end(sound)
        elif self.folder is not None and (path := self._file(sound)).is_file():
            self._remember(sound, np.load(path, mmap_mode="r"))
        return self._features.get(sound)

    def _keep(self, sound: Path, features: NDArray[np.float16]) -> NDArray[np.float16]:
        if self.folder is not None and self.folder.is_dir():
            with atomic_write(self._file(sound)) as beside, beside.open("wb") as file:
                np.save(file, features)
            features = np.load(self._file(sound), mmap_mode="r")
        self._remember(sound, features)
        return features

    def _remember(self, sound: Path, features: NDArray[np.float16]) -> None:
        self._features[sound] = features
        while self.folder is not None and len(self._features) > OPEN_FILES:
            self._features.popitem(last=False)

    def _file(self, sound: Path) -> Path:
        assert self.folder is not None
        found = sound.stat()
        text = f"{sound.resolve()}\n{found.st_mtime_ns}\n{found.st_size}"
        return self.folder / f"{hashlib.sha256(text.encode()).hexdigest()[:32]}.npy"


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
