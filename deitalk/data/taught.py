"""Recordings that a teacher animated once: inputs of a causal frontend, and what it is to learn.

A causal model learns the curves that its teacher, who is given the whole clip, predicts. Both the
teacher's curves and the gathered spectra of the student's frontend depend on no weight that learns,
so that they are computed once, before training. Of every pass over the recordings, half are changed
in speed, room, noise and gain. A training step then costs a fraction, and epochs take minutes on
one core.

::

    taught/0/inputs.npy    gathered spectra             (R, P, C_spec)   float16
             features.npy  speech features              (R, D)           float16
             curves.npy    the network's curves         (R, C)           float16
             strength.npy  predicted intensity          (R,)             float32
             emotion.npy   index of the curves' emotion (R,)             int8
             clips.npy     first row of every clip, and R

R rig frames of all clips, one after another; a folder for every pass.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from deitalk.config import DataConfig
from deitalk.data.augment_waveform import Surroundings, augment, change_speed, speed_factor
from deitalk.data.clips import MEASURED, Clip
from deitalk.data.seeded_batches import SeededBatches, Share
from deitalk.data.windows import Window, n_clip_frames, read_waveform
from deitalk.emotions import EMOTIONS
from deitalk.frontends.causal_mel import CausalMelFrontend
from deitalk.models.curve_model import DEITalk
from rig.arrays import Float32, Float64

GAIN_DB = (-18.0, 14.0)
"""Range of a recording's gain beside the normal level; the running level must make up for it."""
LEAD_SHARE, LEAD_FRAMES = 0.2, 40
"""Share of the windows that begin with silence before a clip, as every stream does, and its most
frames."""
WARM_SHARE, WARM_FRAMES = 0.7, 40
"""Share of the batches in which the LSTM runs before the decoder begins, and its most frames."""
ARRAYS = ("inputs", "features", "curves", "strength", "emotion")


class Row(NamedTuple):
    """A clip that was animated: arrays of T rows."""

    inputs: NDArray[np.float16]
    features: NDArray[np.float16]
    curves: NDArray[np.float16]
    strength: Float32
    emotion: NDArray[np.int8]


def one_clip_each(clips: Sequence[Clip], number: int) -> list[Clip]:
    """Clips of a pass: one of every recording, the next of it in the next pass."""
    of_recording: dict[Path, list[Clip]] = {}
    for clip in clips:
        of_recording.setdefault(clip.audio, []).append(clip)
    return [own[(number + k // 2) % len(own)] for k, own in enumerate(of_recording.values())]


@torch.no_grad()
def animate_clip(
    clip: Clip,
    teacher: DEITalk,
    student: CausalMelFrontend,
    rng: np.random.Generator | None,
    surroundings: Surroundings,
) -> Row:
    """Compute the rows of one clip; without `rng` it is neither changed nor augmented.

    Parameters
    ----------
    clip : Clip
        Its curves are not read.
    teacher : DEITalk
        In evaluation mode; it is given the clip before augmentation.
    student : CausalMelFrontend
        Its level and its spectral layers are used.
    rng : numpy.random.Generator or None
        Source of speed, room, noise and gain.
    surroundings : Surroundings
        Recordings of noise and of rooms.
    """
    sound = read_waveform(clip.audio)
    if rng is not None:
        sound = change_speed(sound, speed_factor(rng))
    frames = n_clip_frames(len(sound))
    analysis = teacher.analyse(torch.from_numpy(sound), frames)
    place = EMOTIONS.index(clip.emotion)
    emotion = torch.zeros(frames, len(EMOTIONS))
    emotion[:, place] = 1
    curves = teacher.decode(analysis, teacher.styles(emotion, ""))
    if rng is not None:
        sound = augment(sound, rng, surroundings)
        sound = sound * np.float32(10 ** (rng.uniform(*GAIN_DB) / 20))
    strength = np.ones(frames) if analysis.strength is None else analysis.strength.numpy()
    return Row(
        gathered_rows(student, sound, frames),
        analysis.speech.numpy().astype(np.float16),
        curves.numpy().astype(np.float16),
        strength.astype(np.float32),
        np.full(frames, place, np.int8),
    )


def gathered_rows(student: CausalMelFrontend, sound: Float32, frames: int) -> NDArray[np.float16]:
    """Gathered spectra of a clip [shape=(T, P, C_spec)]."""
    groups = frames + student.slope_groups
    waveform = torch.from_numpy(np.asarray(sound, np.float32)).unsqueeze(0)
    windows = student.mel.windows(waveform, groups * student.config.frame_spectra)
    rows, _ = student.gathered(windows, student.first_state(1))
    return np.asarray(rows[0, student.slope_groups :].numpy().astype(np.float16))


def write_pass(
    folder: Path,
    clips: Sequence[Clip],
    teacher: DEITalk,
    student: CausalMelFrontend,
    config: DataConfig,
    seed: tuple[int, int],
) -> None:
    """Animate clips and write their rows, unless they are there; every second one is augmented.

    Parameters
    ----------
    folder : Path
        Made here; complete once ``clips.npy`` is there.
    clips : sequence of Clip
        In the order of the rows.
    teacher, student
        As for `animate_clip`.
    config : DataConfig
        Folders of noise and rooms.
    seed : (int, int)
        Of the run, and number of the pass.
    """
    if (folder / "clips.npy").is_file():
        return
    folder.mkdir(parents=True, exist_ok=True)
    surroundings = Surroundings.read(config.noise_folder, config.room_folder)
    parts: list[Row] = []
    for number, clip in enumerate(clips):
        is_changed = (number + seed[1]) % 2 == 1
        rng = np.random.default_rng((*seed, number)) if is_changed else None
        parts.append(animate_clip(clip, teacher, student, rng, surroundings))
    for name in ARRAYS:
        np.save(folder / f"{name}.npy", np.concatenate([getattr(part, name) for part in parts]))
    np.save(folder / "clips.npy", np.cumsum([0, *(len(part.curves) for part in parts)]))


class TaughtBatches(SeededBatches[Window]):
    """Endless batches of random windows of recordings that a teacher animated.

    Every recording is as likely as another, but for `DataConfig.real_fraction` and
    `DataConfig.measured_fraction`; a window that is longer than what is left of its clip goes on
    in the next one. Its ``waveform`` holds gathered spectra, of frames before the window too
    (warm + T + look-ahead, P, C_spec), its ``clean`` the teacher's features (T, D), its
    ``emotion`` one row a frame.

    Parameters
    ----------
    folder : Path
        Holds a folder for every pass.
    clips : sequence of sequence of Clip
        Of every pass.
    config : DataConfig
        Window, and shares of the sources.
    student : CausalMelFrontend
        Gives the look-ahead, and the inputs in silence.
    seed, batch_size, share
        As for `SeededBatches`; an item is a window.
    """

    def __init__(
        self,
        folder: Path,
        clips: Sequence[Sequence[Clip]],
        config: DataConfig,
        student: CausalMelFrontend,
        seed: int,
        batch_size: int,
        share: Share = Share(),
    ) -> None:
        super().__init__(seed, batch_size, share)
        self.config, self.ahead = config, student.config.lookahead_frames
        with torch.no_grad():
            self.silence = gathered_rows(student, np.zeros(8000, np.float32), 10)[-1:]
        names = [folder / str(k) for k in range(len(clips))]
        self.arrays = [
            Row(*(np.load(part / f"{name}.npy", mmap_mode="r") for name in ARRAYS))
            for part in names
        ]
        self.first = [np.load(part / "clips.npy") for part in names]
        self.chances = [_chances(own, config) for own in clips]

    def item(self, number: int) -> Window:
        """Cut the window of a number."""
        rng = self.rng(number)
        frames, warm, lead = self.config.window_frames, self._warm(number), 0
        turn = int(rng.integers(len(self.arrays)))
        rows, first = self.arrays[turn], self.first[turn]
        clip = int(rng.choice(len(first) - 1, p=self.chances[turn]))
        stop = max(int(first[clip + 1]) - frames, int(first[clip]) + 1)
        start = int(rng.integers(first[clip], stop))
        if rng.random() < LEAD_SHARE:
            start, lead = int(first[clip]), int(rng.integers(1, LEAD_FRAMES + 1))
        start = min(start, max(int(first[-1]) - warm - frames - self.ahead, 0))
        end = start + max(warm + frames - lead, 1)
        inputs = self._after(self.silence, lead, rows.inputs[start : end + self.ahead])
        curves, features, strength, chosen = (
            self._after(part[start : start + 1], lead, part[start:end])[warm : warm + frames]
            for part in (rows.curves, rows.features, rows.strength, rows.emotion)
        )
        emotion = torch.from_numpy(chosen.astype(np.int64))
        styles = torch.nn.functional.one_hot(emotion, len(EMOTIONS)).float()
        return Window(
            _tensor(inputs[: warm + frames + self.ahead]),
            _tensor(curves),
            styles,
            styles.mean(dim=0),
            _tensor(strength),
            torch.arange(frames),
            torch.tensor(frames),
            torch.ones(curves.shape[1]),
            _tensor(features),
        )

    def _warm(self, number: int) -> int:
        """Frames that the LSTM runs before the decoder begins; of a batch as a whole."""
        rng = np.random.default_rng((self.seed, number // self.batch_size, 1))
        return int(rng.integers(1, WARM_FRAMES + 1)) if rng.random() < WARM_SHARE else 0

    @staticmethod
    def _after(row: NDArray[Any], count: int, rows: NDArray[Any]) -> NDArray[Any]:
        """Rows after some copies of one."""
        return np.concatenate((row.repeat(count, axis=0), rows))


def _tensor(rows: NDArray[np.generic]) -> Tensor:
    return torch.from_numpy(rows.astype(np.float32))


def _chances(clips: Sequence[Clip], config: DataConfig) -> Float64:
    """Chance of every clip, by its source."""
    measured = np.array([clip.source == MEASURED for clip in clips])
    recorded = np.array([clip.source == "recording" for clip in clips])
    chances = np.ones(len(clips))
    real, own = config.real_fraction, config.measured_fraction
    if real is not None and recorded.any() and (~recorded & ~measured).any():
        chances[recorded] = real / recorded.sum()
        chances[~recorded & ~measured] = (1 - real) / (~recorded & ~measured).sum()
    if own is not None and measured.any() and not measured.all():
        chances[~measured] *= (1 - own) / chances[~measured].sum()
        chances[measured] = own / measured.sum()
    scaled: Float64 = chances / chances.sum()
    return scaled
