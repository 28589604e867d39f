"""The frozen frontend of another model: only the layers behind it are trained.

The paper trains behind a published encoder, ours may train behind that of another model. Without
augmentation the features of a clip never change, so that they are computed once per clip and a step
costs a fraction: captures can be fitted, or variants compared, in minutes.

Letters: S samples, T rig frames, D width of the features.
"""

import hashlib
import re
from collections import OrderedDict
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from deitalk.audio.frames import FRAME_RATE, SAMPLE_RATE
from deitalk.data.clips import Clip
from deitalk.data.waveforms import read_waveform, recorded_frames
from deitalk.models.checkpoint import require_model
from deitalk.models.curve_model import DEITalk
from rig.files import atomic_write, remove_leftovers

_FILE = re.compile(r"[0-9a-f]{32}\.npy|\d+(\.table)?\.npy")
"""Names of files of features."""
OPEN_FILES = 16
"""Features that are mapped at once."""


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
    owner : DEITalk or None
        The model, where it is loaded.

    Raises
    ------
    CheckpointError
        If there is no such model.

    Attributes
    ----------
    owner : DEITalk
        The model.
    """

    def __init__(self, name: str, folder: Path | None = None, owner: DEITalk | None = None) -> None:
        self.name, self.folder = name, folder
        self.owner = owner or require_model(name, DEITalk)
        self._features: OrderedDict[Path, NDArray[np.float16]] = OrderedDict()

    def features(self, clip: Clip, n_frames: int) -> NDArray[np.float16]:
        """Features of a whole clip, computed once for all clips of its recording.

        Parameters
        ----------
        clip : Clip
            Its recording, read only if it is to be computed, is the key of the cache.
        n_frames : int
            Rig frames T that are needed; beyond the recording there is silence.

        Returns
        -------
        ndarray [shape=(T or more, D)]
        """
        sound = clip.audio
        if sound in self._features:
            self._features.move_to_end(sound)
        elif self.folder is not None and (path := self._file(sound)).is_file():
            self._remember(sound, np.load(path, mmap_mode="r"))
        known = self._features.get(sound)
        if known is None or len(known) < n_frames:
            waveform = read_waveform(clip.audio)
            length = n_frames * SAMPLE_RATE // FRAME_RATE
            padded = np.pad(waveform, (0, max(length - len(waveform), 0)))
            features = self.owner.frontend.encode(torch.from_numpy(padded), n_frames)
            known = self._keep(clip.audio, features.cpu().numpy().astype(np.float16))
        return known

    def prepare(
        self,
        clips: Sequence[Clip],
        window_frames: int,
        device: torch.device | str = "cpu",
        progress: Callable[[float], None] = lambda share: None,
    ) -> None:
        """Compute the features of clips on a device, before other processes map them.

        Parameters
        ----------
        clips : sequence of Clip
            Recordings whose features are on disk are not read again.
        window_frames : int
            Frames of a window, which may be longer than a clip.
        device : device
            Where the frontend computes; it returns to the CPU.
        progress : callable
            Called with the share done.
        """
        if self.folder is not None:
            self.folder.mkdir(parents=True, exist_ok=True)
        self.owner.frontend.to(device)
        for done, clip in enumerate(clips, 1):
            self.features(clip, max(recorded_frames(str(clip.audio)), window_frames))
            progress(done / len(clips))
        self.owner.frontend.to("cpu")

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
