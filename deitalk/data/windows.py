"""Training windows of clips, with their position in the clip (DEITalk §3.2, §4.1).

Letters: S samples, T frames of a window (128), C controls.
"""

import hashlib
import re
from abc import ABC, abstractmethod
from collections import OrderedDict
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from functools import cache, lru_cache
from itertools import count
from pathlib import Path
from typing import Any, Generic, NamedTuple, TypeVar, cast

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.utils.data import IterableDataset, get_worker_info

from deitalk.audio.frames import FRAME_RATE, SAMPLE_RATE, frame_count
from deitalk.audio.load import load_audio
from deitalk.audio.voice_activity import normalise_level
from deitalk.config.curves import DataConfig
from deitalk.data.augment_waveform import Surroundings, augment, change_speed, speed_factor
from deitalk.data.clips import MEASURED, REHEARSED, Clip, read_intensity, read_known
from deitalk.emotions import EMOTIONS
from deitalk.errors import ConfigError, DataError
from deitalk.models.checkpoint import require_model
from deitalk.models.curve_model import DEITalk
from rig import ControlSet, read_curves
from rig.arrays import Bool, Float32, Float64
from rig.controls import DEFAULT_ID
from rig.errors import UserError
from rig.files import atomic_write, remove_leftovers

# Endless batches of numbered items: item k depends on the seed and on k alone.
#
# Hence batch b is the same for any number of loading workers and of processes that share it, and an
# interrupted training continues with the batch that would have come next.

Item = TypeVar("Item", bound=tuple[Any, ...])
"""A NamedTuple of tensors; a batch is the same with a leading axis."""


class Share(NamedTuple):
    """Where to begin, and this process's part of every batch."""

    skip: int = 0
    """Number of the first batch, for a training that is resumed."""
    rank: int = 0
    """Number of this process; it makes the items rank, rank + world, ... of every batch."""
    world: int = 1
    """Processes that share a batch."""


class SeededBatches(ABC, IterableDataset[Item], Generic[Item]):
    """Base of the data sets that training draws from.

    Parameters
    ----------
    seed : int
        Seed of all items.
    batch_size : int
        Items of a batch, over all processes.
    share : Share
        Where to begin, and this process's part; may be set until the iteration begins.
    """

    def __init__(self, seed: int, batch_size: int, share: Share) -> None:
        self.seed, self.batch_size, self.share = seed, batch_size, share

    def __iter__(self) -> Iterator[Item]:
        """Yield this process's part of the batches of this worker, stacked; in the end its error.

        An error that a worker raised would have the worker's traceback in its message.
        """
        worker = get_worker_info()
        n_workers, lane = (worker.num_workers, worker.id) if worker else (1, 0)
        for batch in count(self.share.skip + lane, n_workers):
            first = batch * self.batch_size
            numbers = range(first + self.share.rank, first + self.batch_size, self.share.world)
            try:
                items = [self.item(number) for number in numbers]
            except UserError as error:
                yield cast("Item", error)
                return
            yield type(items[0])(*(torch.stack(field) for field in zip(*items, strict=True)))

    def rng(self, number: int) -> np.random.Generator:
        """Generator of random numbers for the item of a number."""
        return np.random.default_rng((self.seed, number))

    @abstractmethod
    def item(self, number: int) -> Item:
        """Make the item of a number."""


class Window(NamedTuple):
    """One training example; a batch has the same fields with a leading axis."""

    waveform: Tensor
    """[shape=(S,)], level-normalised (then augmented); or features [shape=(T, D)]
    where `FrozenFeatures` are given."""
    curves: Tensor
    """[shape=(T, C)]."""
    emotion: Tensor
    """One-hot of the curves' emotion, then of the actor [shape=(5 + actors,)]."""
    voice: Tensor
    """One-hot of the emotion the voice acts [shape=(5,)]."""
    intensity: Tensor
    """[shape=(T,)], NaN where unknown."""
    frames: Tensor
    """Frame indices in the whole clip [shape=(T,)]."""
    total: Tensor
    """Frames of the whole clip, scalar."""
    known: Tensor
    """1 for controls that the clip's curves hold, else 0 [shape=(C,)]; others are at rest."""


class LoadedClip(NamedTuple):
    """A clip in memory."""

    waveform: NDArray[np.int16] | Float32
    """Level-normalised [shape=(S,)], in steps of `unit`; empty where only curves were read."""
    times: Float64
    values: NDArray[np.float16]
    intensity: Float32
    known: Bool
    """Controls that the curves hold [shape=(C,)]; the others are at rest in `values`."""
    unit: float = 1.0

    @property
    def n_bytes(self) -> int:
        """Memory of the arrays."""
        return sum(part.nbytes for part in self[:4])


def n_starts(n_frames: int, config: DataConfig) -> int:
    """Windows of a clip: one for every stride that leaves a whole window, at least one."""
    return max(n_frames - config.window_frames, 0) // config.stride_frames + 1


def count_windows(clips: Sequence[Clip], config: DataConfig) -> int:
    """Windows of all clips at their own speed; reads headers where the format has one."""
    return sum(n_starts(recorded_frames(str(clip.audio)), config) for clip in clips)


@cache
def recorded_frames(path: str) -> int:
    """Rig frames of a recording, at least 1; by its header where that counts the samples."""
    import soundfile

    with suppress(soundfile.LibsndfileError):
        found = soundfile.info(path)
        if found.format in COUNTED:
            return n_clip_frames(round(found.frames * SAMPLE_RATE / found.samplerate))
    return n_clip_frames(len(load_audio(path).waveform))


COUNTED = ("FLAC", "WAV", "WAVEX", "RF64", "AIFF")
"""Formats of libsndfile whose headers have the number of samples."""


def load_clip(clip: Clip, controls: ControlSet, *, sound: bool = True) -> LoadedClip:
    """Read audio and curves of one clip; without `sound` curves alone, in an eighth of the time.

    Raises
    ------
    DataError
        If the curves lack a control of `controls`; `read_curves` raises its own errors.
    """
    own = None if controls.id == DEFAULT_ID else controls
    curves, known = read_curves(clip.curves, controls=own), read_known(clip.known, controls)
    if curves.names != controls.names:
        missing = sorted(set(controls.names) - set(curves.names))
        if missing:
            raise DataError(
                f"{clip.curves}: lacks {len(missing)} controls of {controls.id}, such as "
                f"{missing[0]}; convert the curves first"
            )
        curves = curves.select(controls.names)
    if clip.source == REHEARSED:
        known[:] = False
    values = np.where(known, curves.values, controls.rest)
    times = np.arange(len(curves.values)) / curves.fps + clip.offset_seconds
    if clip.intensity is None:
        intensity = np.full(len(times), np.nan, np.float32)
    else:
        intensity = read_intensity(clip.intensity, times)
    waveform, unit = _waveform(str(clip.audio)) if sound else (np.zeros(0, np.int16), 1.0)
    return LoadedClip(waveform, times, values.astype(np.float16), intensity, known, unit)


def read_waveform(path: Path) -> Float32:
    """A recording at the normal level [shape=(S,)]."""
    steps, unit = _waveform(str(path))
    return steps.astype(np.float32) * np.float32(unit)


@lru_cache(maxsize=64)
def _waveform(path: str) -> tuple[NDArray[np.int16], float]:
    """A recording at the normal level in 16 bits of its own peak, and the worth of a step."""
    waveform = normalise_level(load_audio(path).waveform)
    unit = float(np.abs(waveform).max(initial=0)) / 32767 or 1.0
    return np.round(waveform / unit).astype(np.int16), unit


def cut(
    loaded: LoadedClip, first: int, n_frames: int, speed: float = 1.0
) -> tuple[Float32, Float32, Float32, int]:
    """Window of a clip played at another speed.

    Parameters
    ----------
    loaded : LoadedClip
        The clip.
    first : int
        First frame, on the time axis after the change of speed.
    n_frames : int
        Frames T to give.
    speed : float
        Factor of speed and pitch; 2 halves the clip.

    Returns
    -------
    waveform [shape=(S,)], curves [shape=(T, C)], intensity [shape=(T,)], total frames
        Beyond the clip's end the audio is silent and the curves hold.
    """
    start = round(first * speed / FRAME_RATE * SAMPLE_RATE)
    length = round(n_frames / FRAME_RATE * SAMPLE_RATE)
    steps = loaded.waveform[start : start + round(length * speed) + 8]
    piece = change_speed(steps.astype(np.float32) * np.float32(loaded.unit), speed)[:length]
    waveform = np.pad(piece, (0, length - len(piece)))
    curves, intensity = curves_of(loaded, first, n_frames, speed)
    return waveform, curves, intensity, n_clip_frames(len(loaded.waveform), speed)


def n_clip_frames(n_samples: int, speed: float = 1.0) -> int:
    """Rig frames of a clip that is played at another speed; at least 1."""
    if speed == 1.0:
        return max(frame_count(n_samples), 1)
    return max(int(np.ceil(n_samples / SAMPLE_RATE * FRAME_RATE / speed)), 1)


def curves_of(
    loaded: LoadedClip, first: int, n_frames: int, speed: float = 1.0
) -> tuple[Float32, Float32]:
    """Curves [shape=(T, C)] and intensity [shape=(T,)] of a window, as `cut` gives them."""
    times = (first + np.arange(n_frames)) / FRAME_RATE * speed
    step = loaded.times[1] - loaded.times[0] if len(loaded.times) > 1 else 1.0
    place = np.clip((times - loaded.times[0]) / step, 0, len(loaded.times) - 1)
    below = np.minimum(place.astype(int), max(len(loaded.times) - 2, 0))
    above = np.minimum(below + 1, len(loaded.times) - 1)
    mix = (place - below).astype(np.float32)
    low, high = loaded.values[below].astype(np.float32), loaded.values[above]
    curves = low + mix[:, None] * (high.astype(np.float32) - low)
    intensity = loaded.intensity[below] * (1 - mix) + loaded.intensity[above] * mix
    return curves, intensity


class WindowBatches(SeededBatches[Window]):
    """Endless batches of random windows of many clips.

    Every clip is as likely as another, whatever its length (those with measured lips by
    `DataConfig.measured_fraction`, their speakers alike; recorded ones by
    `DataConfig.real_fraction`); within a clip the first frame is a random multiple of the stride.
    The clips used last stay in memory, `DataConfig.cache_gigabytes`
    of them.

    Deviation: §4.1 passes over all windows of all clips; drawing with replacement sees as many
    windows in an epoch, needs no list of them, and can be resumed at any batch.

    Parameters
    ----------
    clips : sequence of Clip
        Those of one split.
    controls : ControlSet
        Columns of the curves.
    config : DataConfig
        Window, stride and augmentation.
    seed, batch_size, share
        As for `SeededBatches`; an item is a window.
    frozen_features : FrozenFeatures or None
        A frontend that does not learn: windows carry its features instead of the sound. Only
        without augmentation.
    actors : sequence of str
        Speakers that the emotion's vector tells apart.

    Raises
    ------
    DataError
        If there are no clips.
    """

    def __init__(
        self,
        clips: Sequence[Clip],
        controls: ControlSet,
        config: DataConfig,
        seed: int,
        batch_size: int,
        share: Share = Share(),
        *,
        frozen_features: "FrozenFeatures | None" = None,
        actors: Sequence[str] = (),
    ) -> None:
        if not clips:
            raise DataError("no clips to train on; the dataset has none in this split")
        super().__init__(seed, batch_size, share)
        self.clips, self.controls, self.config = list(clips), controls, config
        self.actors = tuple(actors)
        self.frozen_features = None if config.augment else frozen_features
        self.needs_sound = self.frozen_features is None
        # Measured clips by speaker, if they have a share of their own, and the other clips.
        speakers: dict[str, list[Clip]] = {}
        for clip in self.clips:
            if clip.source == MEASURED:
                speakers.setdefault(clip.speaker, []).append(clip)
        others = [clip for clip in self.clips if clip.source != MEASURED]
        if self.config.measured_fraction is None or not others:
            self.measured, self.others = [], self.clips
        else:
            self.measured, self.others = list(speakers.values()), others
        self.recorded = np.array([clip.source == "recording" for clip in self.others])
        self.surroundings = Surroundings.read(config.noise_folder, config.room_folder)
        self.cache = ClipCache(controls, int(config.cache_gigabytes * 1e9), sound=self.needs_sound)

    def item(self, number: int) -> Window:
        """Cut the window of a number."""
        rng = self.rng(number)
        clip = self._draw(rng)
        loaded = self.cache.read(clip)
        config, speed = self.config, self.speed(rng, clip)
        if self.needs_sound:
            total = n_clip_frames(len(loaded.waveform), speed)
        else:
            total = recorded_frames(str(clip.audio))
        first = int(rng.integers(n_starts(total, config))) * config.stride_frames
        waveform, curves, intensity, _ = cut(loaded, first, config.window_frames, speed)
        return Window(
            torch.from_numpy(self.sound(rng, clip, waveform, first, total)),
            torch.from_numpy(curves),
            torch.cat((_one_hot(clip.emotion, EMOTIONS), _one_hot(clip.speaker, self.actors))),
            _one_hot(clip.voice, EMOTIONS),
            torch.from_numpy(intensity),
            torch.arange(first, first + config.window_frames),
            torch.tensor(total),
            torch.from_numpy(loaded.known.astype(np.float32)),
        )

    def speed(self, rng: np.random.Generator, clip: Clip) -> float:
        """Return the speed of a window, of that of the recording."""
        return speed_factor(rng) if self.config.augment else 1.0

    def sound(
        self, rng: np.random.Generator, clip: Clip, waveform: Float32, first: int, total: int
    ) -> Float32:
        """Return what a window carries of a sound cut at its frame `first` of `total`."""
        if self.config.augment:
            return augment(waveform, rng, self.surroundings, _other_voices(self.clips, rng))
        if self.frozen_features is None:
            return waveform
        stop = first + self.config.window_frames
        rows = self.frozen_features.features(clip, max(total, stop))[first:stop]
        return rows.astype(np.float32)

    def _draw(self, rng: np.random.Generator) -> Clip:
        if self.measured and rng.random() < (self.config.measured_fraction or 0.0):
            clips = self.measured[rng.integers(len(self.measured))]
            return clips[rng.integers(len(clips))]
        fraction = self.config.real_fraction
        if fraction is None or not (0 < self.recorded.sum() < len(self.others)):
            return self.others[rng.integers(len(self.others))]
        wanted = rng.random() < fraction
        places = np.flatnonzero(self.recorded == wanted)
        return self.others[int(places[rng.integers(len(places))])]


class ClipCache:
    """Clips read from files, or from memory if they were used lately.

    Parameters
    ----------
    controls : ControlSet
        Columns of the curves.
    max_bytes : int
        Memory for arrays; the clip used longest ago goes first. One clip always stays.
    sound : bool
        As for `load_clip`.
    """

    def __init__(self, controls: ControlSet, max_bytes: int, *, sound: bool = True) -> None:
        self.controls, self.max_bytes, self.sound = controls, max_bytes, sound
        self.n_bytes = 0
        self._kept: OrderedDict[Clip, LoadedClip] = OrderedDict()

    def read(self, clip: Clip) -> LoadedClip:
        """The loaded clip; errors are those of `load_clip`."""
        if clip in self._kept:
            self._kept.move_to_end(clip)
            return self._kept[clip]
        loaded = load_clip(clip, self.controls, sound=self.sound)
        self._kept[clip] = loaded
        self.n_bytes += loaded.n_bytes
        while self.n_bytes > self.max_bytes and len(self._kept) > 1:
            self.n_bytes -= self._kept.popitem(last=False)[1].n_bytes
        return loaded


def _other_voices(clips: Sequence[Clip], rng: np.random.Generator) -> list[Float32]:
    """Draw four other recordings for babble, in 6 % of the windows: reading them costs time."""
    if rng.random() > 0.06:
        return []
    chosen = [_waveform(str(clips[int(rng.integers(len(clips)))].audio)) for _ in range(4)]
    return [steps.astype(np.float32) * np.float32(unit) for steps, unit in chosen]


def _one_hot(name: str, names: Sequence[str]) -> Tensor:
    """1 at the place of a name, if it is there [shape=(names,)]."""
    return torch.tensor([float(name == other) for other in names])


# The frozen frontend of another model: only the layers behind it are trained.
#
# The paper trains behind a published encoder, ours may train behind that of another model. Without
# augmentation the features of a clip never change, so that they are computed once per clip and a
# step costs a fraction: captures can be fitted, or variants compared, in minutes.
#
# Letters: S samples, T rig frames, D width of the features.


_FILE = re.compile(r"[0-9a-f]{32}\.npy|\d+(\.table)?\.npy")
"""Names of files of features."""
OPEN_FILES = 256
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
