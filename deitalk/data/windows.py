"""Training windows of clips, with their position in the clip (DEITalk §3.2, §4.1).

Letters: S samples, T frames of a window (128), C controls.
"""

from collections import OrderedDict
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from deitalk.audio.frames import FRAME_RATE, SAMPLE_RATE
from deitalk.config.curves import DataConfig
from deitalk.data.augment_waveform import Surroundings, augment, change_speed, speed_factor
from deitalk.data.clips import REHEARSED, Clip, read_intensity, read_known
from deitalk.data.frozen_features import FrozenFeatures
from deitalk.data.seeded_batches import SeededBatches, Share
from deitalk.data.waveforms import n_clip_frames, recorded_frames, sound_of
from deitalk.emotions import EMOTIONS
from deitalk.errors import DataError
from rig import ControlSet, read_curves
from rig.arrays import Bool, Float32, Float64
from rig.controls import DEFAULT_ID


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
    waveform, unit = sound_of(str(clip.audio)) if sound else (np.zeros(0, np.int16), 1.0)
    return LoadedClip(waveform, times, values.astype(np.float16), intensity, known, unit)


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

    Every clip is as likely as another, whatever its length (recorded ones by
    `DataConfig.real_fraction`); within a clip the first frame is a random multiple of the stride.
    The clips used last stay in memory, `DataConfig.cache_gigabytes` of them.

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
    surroundings : Surroundings
        Recordings of noise and rooms for the augmentation.

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
        frozen_features: FrozenFeatures | None = None,
        actors: Sequence[str] = (),
        surroundings: Surroundings = Surroundings(),
    ) -> None:
        if not clips:
            raise DataError("no clips to train on; the dataset has none in this split")
        super().__init__(seed, batch_size, share)
        self.clips, self.controls, self.config = list(clips), controls, config
        self.actors, self.surroundings = tuple(actors), surroundings
        self.frozen_features = None if config.augment else frozen_features
        self.needs_sound = self.frozen_features is None
        self.draw_from(self.clips)
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

    def draw_from(self, clips: list[Clip]) -> None:
        """Draw from some of the clips alone."""
        self.drawn = clips
        self.recorded = np.array([clip.source == "recording" for clip in clips])

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
        fraction, recorded = self.config.real_fraction, self.recorded
        if fraction is None or not 0 < recorded.sum() < len(recorded):
            return self.drawn[rng.integers(len(self.drawn))]
        places = np.flatnonzero(recorded == (rng.random() < fraction))
        return self.drawn[int(places[rng.integers(len(places))])]


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
    chosen = [sound_of(str(clips[int(rng.integers(len(clips)))].audio)) for _ in range(4)]
    return [steps.astype(np.float32) * np.float32(unit) for steps, unit in chosen]


def _one_hot(name: str, names: Sequence[str]) -> Tensor:
    """1 at the place of a name, if it is there [shape=(names,)]."""
    return torch.tensor([float(name == other) for other in names])
