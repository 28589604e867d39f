r"""Training of a small causal model to give what a larger one gives: knowledge distillation.

The teacher hears windows of clean speech of training speakers, the student the same windows in
rooms, noise, colours and levels. The student learns the teacher's curves in the neutral and in an
acted reading, what its readout reads of lips and phones, strength and effort of the voice, and by a
linear map its features (as `deitalk.research.training.distillation`). ::

    python -m deitalk.research.training.small_model RECORDINGS... --noise NOISE --rooms ROOMS \
        --config configs/small.yaml -o small/

RECORDINGS are folders of recordings as for ``corpus build``; of their speakers those of the split
train are used, and those of the split validation for the printed losses. ``--lips`` adds the sound
of a folder of measured lips. Sources are drawn alike, or by ``--share``. Motion encoder and
classifier of emotions stay untrained. Not in the papers.

B windows, S samples, T rig frames, M spectra, F mel bins, D width, C controls.
"""

import argparse
import copy
import math
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple, cast

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor, nn
from torch.nn import functional as F

from deitalk.audio.frames import FRAME_RATE, SAMPLE_RATE
from deitalk.audio.load import load_audio
from deitalk.audio.running_level import levelled
from deitalk.config.curves import Config
from deitalk.data.augment_waveform import Surroundings
from deitalk.emotions import EMOTIONS
from deitalk.errors import ConfigError, DataError
from deitalk.frontends.causal_whisper import PERIOD, CausalWhisperFrontend
from deitalk.frontends.strided import MOMENTUM
from deitalk.frontends.whisper import LogMel
from deitalk.models.checkpoint import require_model, save_model
from deitalk.models.curve_model import DEITalk, Output
from deitalk.models.device import require_device
from deitalk.models.lip_readout import CHANNELS, HIDDEN, LipReadout
from deitalk.research.arguments import one_line_errors
from deitalk.research.config import read_training
from deitalk.research.corpus.performance import split_of
from deitalk.research.corpus.recordings import recordings
from deitalk.research.lips.measured import read_lips
from deitalk.research.training.surroundings import read_surroundings
from rig.arrays import Float32
from rig.files.folder import check_folder

RATE, DECAY, BETAS, CLIP = 1.5e-3, 0.02, (0.9, 0.98), 1.0
"""Settings of AdamW: largest rate, weight decay, betas and largest norm of the gradient."""
WARM_SHARE = 0.04
"""Share of the steps in which the rate rises; it falls as a cosine in the others."""
AVERAGE = 0.999
"""Factor of the moving mean of the weights, which is kept."""
STATISTICS_CHUNKS, STATISTICS_WINDOWS = 4, 128
"""What the norms of the mean weights are measured on at the end."""
REPORT_STEPS = 500
VALIDATION_WINDOWS, VALIDATION_RECORDINGS = 192, 70
"""Windows of the printed losses, and most recordings of a source that they are cut from."""
PART = 64
"""Windows that are changed, or heard by the teacher, at once."""
LEVEL_DB = -23.0
"""Level of speech without its pauses."""
SPEED = 1.22
"""Largest factor of the speed, and its inverse the least."""
MARGIN = 4800
"""Samples that stay before and after a recording's sound."""
ROOM_SAMPLES = 8000
EDGE = 4
"""Frames at the ends of a window that no loss counts."""
HEAVY = {
    "C_jaw.ty": 8.0,
    "lipsTogether": 6.0,
    "lowerLipDepress": 4.0,
    "upperLipRaise": 4.0,
    "lipBite": 3.0,
    "funnel": 3.0,
    "purse": 3.0,
    "cornerPull": 2.0,
    "stretch": 2.0,
    "cornerDepress": 2.0,
    "tongue": 1.0,
}
"""Weights of controls by parts of their names, of which the largest holds."""
OTHERS = 0.7
"""Weight of all other controls."""
CONTACT_WEIGHTS = (4.0, 2.0, 1.0, 1.0, 1.0, 1.0, 1.0)
"""Weights of `CHANNELS` in their cross entropy."""


class Size(NamedTuple):
    """How much is trained."""

    steps: int = 6776
    batch: int = 64
    """Windows of a step."""
    chunk: int = 512
    """Windows that are made at once, for several steps."""
    frames: int = 243
    """T of a window: 8.1 s."""


class Chance:
    """Random numbers on a device."""

    def __init__(self, seed: int, device: torch.device) -> None:
        self.device, self.generator = device, torch.Generator(device=device).manual_seed(seed)

    def uniform(self, *shape: int) -> Tensor:
        """Numbers of 0 to 1."""
        return torch.rand(*shape, device=self.device, generator=self.generator)

    def normal(self, *shape: int) -> Tensor:
        """Numbers of mean 0 and deviation 1."""
        return torch.randn(*shape, device=self.device, generator=self.generator)

    def below(self, limit: int, count: int) -> Tensor:
        """Whole numbers below a limit [shape=(count,)]."""
        return torch.randint(limit, (count,), device=self.device, generator=self.generator)

    def order(self, count: int) -> Tensor:
        """A permutation [shape=(count,)]."""
        return torch.randperm(count, device=self.device, generator=self.generator)

    def drawn(self, weights: Tensor, count: int) -> Tensor:
        """Places of `weights`, drawn by them [shape=(count,)]."""
        return torch.multinomial(weights, count, replacement=True, generator=self.generator)


def joined(paths: Sequence[Path]) -> npt.NDArray[np.int16]:
    """Recordings without their silent ends, at one level, one after the other [shape=(S,)].

    Raises
    ------
    DataError
        If none holds a sound.
    """
    parts = []
    for path in paths:
        sound = np.asarray(load_audio(path).waveform, np.float32)
        loud = np.flatnonzero(np.abs(sound) > 0.01 * np.abs(sound).max(initial=0))
        if len(loud):
            sound = sound[max(0, loud[0] - MARGIN) : loud[-1] + MARGIN]
            gain = min(0.06 / (float(np.sqrt(np.mean(sound**2))) + 1e-6), 0.9 / np.abs(sound).max())
            parts.append((sound * gain * 32767).astype(np.int16))
    if not parts:
        raise DataError(f"{paths[0]}: no sound in it; name folders of speech")
    return np.concatenate(parts)


class Sounds:
    """Speech of one split, from which windows are cut.

    Parameters
    ----------
    paths : mapping of str to sequence of Path
        Recordings of each source.
    shares : mapping of str to float
        How often a source is drawn; 1 where it is not named.
    length : int
        Samples S of a window.
    device : torch.device
    """

    def __init__(
        self,
        paths: Mapping[str, Sequence[Path]],
        shares: Mapping[str, float],
        length: int,
        device: torch.device,
    ) -> None:
        self.length, least = length, int(length * 1.25) + 3
        parts = [joined(each) for each in paths.values()]
        parts = [np.pad(part, (0, max(least - len(part), 0))) for part in parts]
        self.sizes = torch.tensor([len(part) for part in parts], device=device)
        self.begins = self.sizes.cumsum(0) - self.sizes
        self.shares = torch.tensor([shares.get(name, 1.0) for name in paths], device=device)
        self.samples = torch.from_numpy(np.concatenate(parts)).to(device)

    def windows(self, count: int, chance: Chance, *, at_any_speed: bool) -> Tensor:
        """Windows (B, S), seven of ten of them at another speed if that is wanted."""
        source = chance.drawn(self.shares, count)
        speed = torch.ones(count, device=chance.device)
        if at_any_speed:
            changed = torch.exp(math.log(SPEED) * (2 * chance.uniform(count) - 1))
            speed = torch.where(chance.uniform(count) < 0.3, speed, changed)
        free = (self.sizes[source] - self.length * 1.25 - 2).clamp_min(0)
        first = self.begins[source] + (chance.uniform(count) * free).long()
        steps = torch.arange(self.length, device=chance.device)
        found = []
        for begin, factor in zip(torch.split(first, PART), torch.split(speed, PART), strict=True):
            at = steps * factor[:, None]
            whole = at.floor().long()
            left, right = (self.samples[begin[:, None] + whole + k].float() / 32768 for k in (0, 1))
            found.append(left + (at - whole) * (right - left))
        return torch.cat(found)


def at_level(sound: Tensor) -> Tensor:
    """Windows (B, S) whose louder frames have the level `LEVEL_DB`."""
    hop = SAMPLE_RATE // FRAME_RATE
    power = sound[:, : sound.shape[1] // hop * hop].reshape(len(sound), -1, hop).square().mean(2)
    mean = power.mean(1, keepdim=True)
    for _ in range(2):
        loud = (power > 0.1 * mean).float()
        mean = (power * loud).sum(1, keepdim=True) / loud.sum(1, keepdim=True).clamp_min(1)
    level = mean.clamp_min(1e-8).sqrt()
    return sound / level * 10 ** (LEVEL_DB / 20)


class Changes:
    """Colours, rooms, noise and levels of many windows at once, on their device.

    `deitalk.data.augment_waveform` does so for one recording at a time.

    Parameters
    ----------
    surroundings : Surroundings
        With noise and rooms.
    length : int
        Samples S of a window.
    chance : Chance
    """

    def __init__(self, surroundings: Surroundings, length: int, chance: Chance) -> None:
        noise = np.concatenate(surroundings.noises)
        self.noise = torch.from_numpy(np.resize(noise, max(len(noise), length + 1)))
        self.noise = self.noise.float().to(chance.device)
        rooms = np.stack([_response(room) for room in surroundings.rooms])
        self.rooms = torch.from_numpy(rooms).to(chance.device)
        self.length, self.chance = length, chance
        self.size = 1 << (length + ROOM_SAMPLES - 1).bit_length()
        hertz = torch.linspace(0, SAMPLE_RATE / 2, self.size // 2 + 1, device=chance.device)
        self.hertz = hertz.clamp_min(60)

    def __call__(self, windows: Tensor) -> Tensor:
        """Change windows (B, S) of clean speech at one level."""
        return torch.cat([self._changed(part, windows) for part in torch.split(windows, PART)])

    def _changed(self, sound: Tensor, voices: Tensor) -> Tensor:
        count, uniform = len(sound), self.chance.uniform
        spectrum = torch.fft.rfft(sound, self.size) * 10 ** (self._colour_db(count) / 20)
        spectrum = spectrum * torch.fft.rfft(self._room(count), self.size)
        sound = at_level(torch.fft.irfft(spectrum, self.size)[:, : self.length])
        noise = self._noise(count, voices)
        noise = noise / noise.square().mean(1, keepdim=True).sqrt().clamp_min(1e-6)
        ratio_db = 3 + 35 * uniform(count, 1)
        noisy = sound + noise * 10 ** ((LEVEL_DB - ratio_db) / 20)
        sound = torch.where(uniform(count, 1) < 0.6, noisy, sound)
        return sound * 10 ** ((-32 + 40 * uniform(count, 1)) / 20)

    def _colour_db(self, count: int) -> Tensor:
        """Gains (B, K) of the bins: smooth along octaves, some with a band limit."""
        uniform = self.chance.uniform
        knots = self.chance.normal(count, 10) * (6 * uniform(count, 1)).clamp_max(5)
        octaves = math.log2(SAMPLE_RATE / 2 / 60)
        at = (torch.log2(self.hertz / 60) / octaves * 9).clamp(0, 8.999)
        low = at.floor().long()
        gain = knots[:, low] + (at - low) * (knots[:, low + 1] - knots[:, low])
        gain = torch.where(uniform(count, 1) < 0.65, gain, 0.0)
        top = torch.where(uniform(count, 1) < 0.2, 3200 + 4000 * uniform(count, 1), 9000.0)
        return gain - 40 * torch.sigmoid((self.hertz - top) / 150)

    def _room(self, count: int) -> Tensor:
        """Impulse responses (B, `ROOM_SAMPLES`): recorded, noise that decays, or none."""
        uniform = self.chance.uniform
        seconds = torch.arange(ROOM_SAMPLES, device=self.rooms.device) / SAMPLE_RATE
        fall = torch.exp(-seconds * 6.9 / (0.1 + 0.6 * uniform(count, 1)))
        made = self.chance.normal(count, ROOM_SAMPLES) * fall
        made = made / made.square().sum(1, keepdim=True).sqrt() * (0.2 + 0.8 * uniform(count, 1))
        made[:, :32] = 0
        made[:, 0] = 1
        recorded = self.rooms[self.chance.below(len(self.rooms), count)]
        room = torch.where(uniform(count, 1) < 0.5, made, recorded)
        none = F.one_hot(room.new_zeros(count).long(), ROOM_SAMPLES).float()
        return torch.where(uniform(count, 1) < 0.3, room, none)

    def _noise(self, count: int, voices: Tensor) -> Tensor:
        """Noise (B, S): recorded, of a random slope, or four of the `voices`."""
        uniform = self.chance.uniform
        start = (uniform(count) * (len(self.noise) - self.length)).long()
        recorded = self.noise[start[:, None] + torch.arange(self.length, device=start.device)]
        slope = (self.hertz / 1000) ** (-1.5 * uniform(count, 1))
        white = torch.fft.rfft(self.chance.normal(count, self.length), self.size)
        coloured = torch.fft.irfft(white * slope, self.size)[:, : self.length]
        orders = [self.chance.order(len(voices))[:count] for _ in range(4)]
        babble = torch.stack([voices[order] for order in orders]).sum(0)
        kind = uniform(count, 1)
        return torch.where(kind < 0.45, recorded, torch.where(kind < 0.85, coloured, babble))


def _response(room: Float32) -> Float32:
    """An impulse response from its loudest sample on, of energy 1 [shape=(`ROOM_SAMPLES`,)]."""
    kept = room[int(np.abs(room).argmax()) :][:ROOM_SAMPLES].astype(np.float32)
    kept = np.pad(kept, (0, ROOM_SAMPLES - len(kept)))
    return np.asarray(kept / (np.sqrt(np.square(kept).sum()) + 1e-9), np.float32)


class GivenSpectra(LogMel):
    """Stands in a frontend that is given spectra (B, M, F) in place of windows of samples."""

    def decades(self, windows: Tensor) -> Tensor:
        """The spectra as they are."""
        return windows


class Lesson(NamedTuple):
    """Windows as the student hears them, and what the teacher gives for them."""

    spectra: Tensor
    """[shape=(B, M, F)]."""
    emotion: Tensor
    """[shape=(B, 5)]."""
    curves: Tensor
    """[shape=(B, T, C)]."""
    lips: Tensor
    """[shape=(B, T, 11)]."""
    strength: Tensor
    """[shape=(B, T)]."""
    effort: Tensor
    """[shape=(B, T)]."""
    speech: Tensor
    """[shape=(B, T, D)]."""

    def at(self, places: Tensor) -> "Lesson":
        """Some of the windows."""
        return Lesson(*(values[places] for values in self))


class Student(NamedTuple):
    """Parts of a network, of the kinds that this training needs."""

    model: DEITalk
    frontend: CausalWhisperFrontend
    lips: LipReadout

    @classmethod
    def of(cls, model: DEITalk) -> "Student":
        """The parts of a model.

        Raises
        ------
        ConfigError
            If it has others.
        """
        frontend, lips = model.frontend, model.lips
        learns = getattr(model.config.frontend, "learns", "") == "everything"
        if lips is None or not (learns and model.is_causal and model.config.effort):
            raise ConfigError(
                "the configuration needs model.frontend of the kind causal_whisper that learns "
                "everything, model.effort and model.lips; begin with configs/small.yaml"
            )
        return cls(model, cast("CausalWhisperFrontend", frontend), lips)

    def answers(self, lesson: Lesson) -> tuple[Output, Tensor, Tensor]:
        """Output, features (B, T, D), and logits of `CHANNELS` and measures (B, T, 11)."""
        count, frames = lesson.curves.shape[:2]
        speech, _ = self.frontend.read(lesson.spectra, self.frontend.first_state(count))
        speech = speech[:, self.frontend.delay :]
        given = self.model(speech, lesson.emotion, *places(count, frames, speech.device))
        padded = F.pad((speech - self.lips.silence).transpose(1, 2), (self.lips.margin, 0))
        rows = self.lips.listen(padded).transpose(1, 2)
        logits = self.lips.phones(rows[..., :HIDDEN].relu())
        return given, speech, torch.cat((logits, rows[..., HIDDEN:]), dim=-1)


def places(count: int, frames: int, device: torch.device) -> tuple[Tensor, Tensor]:
    """Frames (B, T) of windows that are whole clips, and their number (B,)."""
    numbers = torch.arange(frames, device=device).expand(count, -1)
    return numbers, torch.full((count,), frames, device=device)


class Lessons:
    """What makes lessons.

    Parameters
    ----------
    teacher : DEITalk
        With readouts of lips and effort.
    student : Student
    changes : Changes
    frames : int
        T.
    """

    def __init__(self, teacher: DEITalk, student: Student, changes: Changes, frames: int) -> None:
        self.teacher, self.changes, self.chance = teacher, changes, changes.chance
        self.frames, self.total = frames, frames + student.frontend.delay
        self.frontend, config = student.frontend, student.frontend.config
        self.mel = LogMel(config.n_mels, config.rate * self.frontend.spectra)
        self.mel = self.mel.to(self.chance.device)

    @torch.no_grad()
    def lesson(self, sounds: Sounds, count: int, *, changed: bool) -> Lesson:
        """Windows and what the teacher gives; the student hears them changed or as they are."""
        clean = at_level(sounds.windows(count, self.chance, at_any_speed=changed))
        emotion = self._emotions(count)
        taught = [
            self._taught(*part)
            for part in zip(torch.split(clean, PART), torch.split(emotion, PART), strict=True)
        ]
        spectra = self._spectra(self.changes(clean) if changed else clean)
        spectra = self._masked(spectra) if changed else spectra
        return Lesson(spectra, emotion, *(torch.cat(rows) for rows in zip(*taught, strict=True)))

    def _emotions(self, count: int) -> Tensor:
        """Weights (B, 5): neutral, an emotion, or an emotion that is mixed with neutral."""
        uniform, each = self.chance.uniform, torch.eye(len(EMOTIONS), device=self.chance.device)
        emotion = each[self.chance.below(len(EMOTIONS), count)]
        neutral = each[EMOTIONS.index("neutral")].expand(count, -1)
        share = uniform(count, 1)
        mixed = share * emotion + (1 - share) * neutral
        emotion = torch.where(uniform(count, 1) < 0.2, mixed, emotion)
        return torch.where(uniform(count, 1) < 0.45, neutral, emotion)

    def _taught(self, clean: Tensor, emotion: Tensor) -> tuple[Tensor, ...]:
        """Targets of a `Lesson`, in its order, from windows (B, S)."""
        speech = self.teacher.frontend(clean, self.total)
        given = self.teacher(speech, emotion, *places(len(clean), self.total, clean.device))
        lips = cast("LipReadout", self.teacher.lips)(speech)
        strength, effort = given.intensity.strength, given.intensity.effort
        rows = given.curves.half(), lips, strength, effort, speech.half()
        return tuple(row[:, : self.frames] for row in rows)

    def _spectra(self, sound: Tensor) -> Tensor:
        """Spectra (B, M, F) of windows (B, S) at the running level."""
        per, found = self.frontend.spectra, []
        for part in torch.split(sound, PART):
            windows = self.mel.windows(part, self.total * per, -self.frontend.lead)
            level = self.frontend.first_state(len(part)).level
            found.append(self.mel.decades(levelled(windows, per, level)[0]))
        return torch.cat(found)

    def _masked(self, spectra: Tensor) -> Tensor:
        """Three of ten windows with up to nine spectra near the beginning as their mean."""
        count, uniform = len(spectra), self.chance.uniform
        first = (uniform(count, 1, 1) * 80).long()
        width = (uniform(count, 1, 1) * 10).long()
        width = torch.where(uniform(count, 1, 1) < 0.3, width, 0)
        at = torch.arange(spectra.shape[1], device=spectra.device)[:, None]
        mean = spectra.mean(dim=(1, 2), keepdim=True)
        return torch.where((at >= first) & (at < first + width), mean, spectra)


class Losses:
    """Losses of the student, in units of the spread of what the teacher gives in a lesson.

    Parameters
    ----------
    names : sequence of str
        Controls.
    lesson : Lesson
    hint : Linear
        From the student's features to the teacher's.
    """

    def __init__(self, names: Sequence[str], lesson: Lesson, hint: nn.Linear) -> None:
        self.hint = hint
        heavy = [max((HEAVY[k] for k in HEAVY if k in name), default=OTHERS) for name in names]
        weights = torch.tensor(heavy, device=lesson.curves.device)
        spread = lesson.curves.float().var(dim=(0, 1)) + 1e-3
        self.scale = 0.5 * weights / spread / len(heavy)
        self.measures = lesson.lips[..., len(CHANNELS) :].var(dim=(0, 1)) + 1e-4
        self.strength, self.effort = lesson.strength.var() + 1e-3, lesson.effort.var() + 1e-2
        self.contacts = weights.new_tensor(CONTACT_WEIGHTS)

    def __call__(self, student: Student, lesson: Lesson) -> dict[str, Tensor]:
        """The losses of a lesson by name, weighted."""
        given, speech, read = student.answers(lesson)
        assert given.intensity is not None and given.intensity.effort is not None
        inner, n = slice(EDGE, lesson.curves.shape[1] - EDGE), len(CHANNELS)
        curves = (given.curves.float() - lesson.curves.float())[:, inner]
        phones = F.binary_cross_entropy_with_logits(
            read[..., :n], lesson.lips[..., :n], reduction="none"
        )
        lips = (read[..., n:] - lesson.lips[..., n:])[:, inner]
        moved = lips.diff(dim=1, prepend=lips[:, :1])
        strength = (given.intensity.strength - lesson.strength)[:, inner].square()
        effort = (given.intensity.effort - lesson.effort)[:, inner].square()
        features = (self.hint(speech) - lesson.speech.float())[:, inner]
        return {
            "curves": (curves.square() * self.scale).sum(-1).mean(),
            "motion": 2 * (curves.diff(dim=1).square() * self.scale).sum(-1).mean(),
            "phones": 3 * (phones * self.contacts)[:, inner].mean(),
            "lips": 0.3 * ((lips.square() + moved.square()) / self.measures).mean(),
            "strength": 0.1 * (strength / self.strength).mean(),
            "effort": 0.1 * (effort / self.effort).mean(),
            "features": 0.3 * (features.square().mean() + features.diff(dim=1).square().mean()),
        }


def begin(config: Config, teacher: DEITalk, device: torch.device) -> Student:
    """A student of random weights, whose maps between curves and lips are the teacher's."""
    student = Student.of(DEITalk(config.model, pretrained=False, rules=config.rules).to(device))
    assert teacher.lips is not None
    own, given = student.lips.state_dict(), teacher.lips.state_dict()
    own |= {name: given[name] for name in own if given[name].shape == own[name].shape}
    student.lips.load_state_dict(own)
    with torch.no_grad():
        student.lips.listen.weight.mul_(0.1)
    for part in (student.lips.shown, student.lips.moves, student.model.motion):
        part.requires_grad_(False)
    student.lips.kept.requires_grad_(False)
    student.model.intensity.classifier.requires_grad_(False)
    mel = GivenSpectra(student.frontend.config.n_mels, student.frontend.mel.rate)
    student.frontend.mel = mel.to(device)
    return student


class Training:
    """The student, the mean of its weights, and what it learns from.

    Parameters
    ----------
    student : Student
    lessons : Lessons
    sounds : Sounds
        Of training speakers.
    size : Size
    """

    def __init__(self, student: Student, lessons: Lessons, sounds: Sounds, size: Size) -> None:
        self.student, self.lessons, self.sounds, self.size = student, lessons, sounds, size
        widths = student.frontend.output_size, lessons.teacher.frontend.output_size
        hint = nn.Linear(*widths).to(lessons.chance.device)
        names = student.model.controls.names
        first = lessons.lesson(sounds, min(size.chunk, 256), changed=True)
        self.losses = Losses(names, first, hint)
        self.mean = [value.detach().clone() for value in student.model.parameters()]
        self.positions = student.frontend.encoder.positions.clone()
        self.learns = [value for value in student.model.parameters() if value.requires_grad]
        self.optimiser = torch.optim.AdamW(
            [*self.learns, *hint.parameters()], lr=RATE, betas=BETAS, weight_decay=DECAY
        )

    def run(self) -> Iterator[tuple[int, Tensor]]:
        """Train; gives the number of steps so far and the loss after every step."""
        done = 0
        while done < self.size.steps:
            chunk = self.lessons.lesson(self.sounds, self.size.chunk, changed=True)
            order = torch.randperm(self.size.chunk, device=self.lessons.chance.device)
            for part in torch.split(order, self.size.batch)[: self.size.steps - done]:
                loss = self._step(chunk.at(part), done)
                done += 1
                yield done, loss

    def _step(self, lesson: Lesson, number: int) -> Tensor:
        for group in self.optimiser.param_groups:
            group["lr"] = rate_at(number / self.size.steps)
        # Positions begin anew in a stream: each step begins at another one.
        rolled = self.positions[:PERIOD].roll(int(torch.randint(PERIOD, ())), 0)
        self.student.frontend.encoder.positions[:PERIOD] = rolled
        self.student.model.train()
        loss = torch.stack([*self.losses(self.student, lesson).values()]).sum()
        self.optimiser.zero_grad(set_to_none=True)
        loss.backward()  # type: ignore[no-untyped-call]
        nn.utils.clip_grad_norm_(self.learns, CLIP)
        self.optimiser.step()
        share = min(AVERAGE, (number + 2) / (number + 11))
        with torch.no_grad():
            for mean, value in zip(self.mean, self.student.model.parameters(), strict=True):
                mean.lerp_(value, 1 - share)
        return loss.detach()

    @torch.no_grad()
    def average(self) -> Student:
        """A copy of the mean weights in evaluation mode, its norms measured on new lessons."""
        found = Student.of(copy.deepcopy(self.student.model))
        for value, mean in zip(found.model.parameters(), self.mean, strict=True):
            value.copy_(mean)
        found.frontend.encoder.positions.copy_(self.positions)
        norms = cast("list[nn.BatchNorm1d]", list(found.frontend.norms))
        for norm in norms:
            norm.reset_running_stats()
            norm.momentum = None  # the mean of all
        found.model.train()
        for _ in range(STATISTICS_CHUNKS):
            count = min(self.size.chunk, STATISTICS_WINDOWS)
            found.answers(self.lessons.lesson(self.sounds, count, changed=True))
        for norm in norms:
            norm.momentum = MOMENTUM
        found.model.eval()
        return found

    @torch.no_grad()
    def report(self, lesson: Lesson) -> str:
        """Losses of the mean weights in a lesson, as text."""
        student, parts = self.average(), torch.split(torch.arange(len(lesson.curves)), PART)
        rows = [self.losses(student, lesson.at(part)) for part in parts]
        means = {name: sum(float(row[name]) for row in rows) / len(rows) for name in rows[0]}
        return ", ".join(f"{name} {value:.4f}" for name, value in means.items())


def rate_at(share: float) -> float:
    """Learning rate after a share of the steps: it rises, then falls as a cosine."""
    rise = min(1, share / WARM_SHARE + 0.02)
    fall = 0.5 + 0.5 * math.cos(math.pi * max(0, share - WARM_SHARE) / (1 - WARM_SHARE))
    return RATE * rise * fall + 1e-6


def save_student(folder: Path, student: Student, config: Config, teacher: str, steps: int) -> None:
    """Write the model folder, with its graph for ONNX Runtime, in half precision."""
    model = DEITalk(config.model, pretrained=False, rules=config.rules)
    model.load_state_dict(student.model.state_dict())
    about = {"distilled_from": teacher, "steps": steps}
    save_model(folder, model.eval(), config, about, half=True, graph=True)


def spoken(
    folders: Sequence[Path], lips: Path | None, held_out: Sequence[str]
) -> dict[str, dict[str, list[Path]]]:
    """Recordings by split and source; all speakers of `lips` are in train, save `held_out`."""
    found: dict[str, dict[str, list[Path]]] = {"train": {}, "validation": {}, "test": {}}
    for each in [one for folder in folders for one in recordings(folder)]:
        source = each.speaker.partition(":")[0]
        if each.speaker not in held_out:
            found[split_of(each.speaker)].setdefault(source, []).append(each.path)
    for clip in read_lips(lips, 1.0) if lips else ():
        if clip.speaker not in held_out:
            found["train"].setdefault("lips", []).append(clip.sound)
    for source, paths in found["validation"].items():
        every = max(1, len(paths) // VALIDATION_RECORDINGS)
        found["validation"][source] = paths[::every][:VALIDATION_RECORDINGS]
    if not found["train"]:
        raise DataError(f"{folders[0]}: no recording of a training speaker; name more folders")
    return found


def prepare(given: argparse.Namespace, config: Config) -> tuple[Training, Lesson | None]:
    """The training of the command's arguments, and a lesson of validation speakers, if any."""
    size = Size(given.steps, given.batch, given.chunk, given.frames)
    device, shares = torch.device(given.device), dict(given.share)
    teacher = require_model(given.teacher, DEITalk, device=given.device).requires_grad_(False)
    if teacher.lips is None or not teacher.config.effort:
        raise ConfigError(f"teacher {given.teacher}: has no readout of lips or effort")
    torch.backends.cuda.matmul.allow_tf32 = torch.backends.cudnn.allow_tf32 = True
    student = begin(config, teacher, device)
    paths = spoken(given.recordings, given.lips, given.held_out)
    for source in shares.keys() - paths["train"].keys():
        known = ", ".join(sorted(paths["train"]))
        raise ConfigError(f"share {source}: no such source in train; name one of {known}")
    total = size.frames + student.frontend.delay
    length = round((total + 1) * SAMPLE_RATE / FRAME_RATE) + 400
    surroundings = read_surroundings(given.noise, given.rooms)
    changes = Changes(surroundings, length, Chance(given.seed + 1, device))
    lessons = Lessons(teacher, student, changes, size.frames)
    taught = Sounds(paths["train"], shares, length, device)
    for (source, files), samples in zip(paths["train"].items(), taught.sizes, strict=True):
        minutes = int(samples) / SAMPLE_RATE / 60
        sys.stdout.write(f"{source}: {len(files)} recordings for training, {minutes:.1f} min\n")
    training = Training(student, lessons, taught, size)
    if not paths["validation"]:
        return training, None
    judged = Sounds(paths["validation"], shares, length, device)
    count = min(size.chunk, VALIDATION_WINDOWS)
    return training, lessons.lesson(judged, count, changed=False)


def train(given: argparse.Namespace) -> None:
    """Train and write a model; the arguments are those of the command."""
    check_folder(given.out, kind="model", force=True)
    require_device(given.device)
    torch.manual_seed(given.seed)
    begun, config = time.monotonic(), read_training(given.config)
    if not isinstance(config, Config):
        raise ConfigError(f"{given.config}: describes a model of meshes; use configs/small.yaml")
    training, judged = prepare(given, config)
    for step, loss in training.run():
        if step % REPORT_STEPS == 0 or step == given.steps:
            losses = training.report(judged) if judged else "no recording of validation speakers"
            passed = time.monotonic() - begun
            sys.stdout.write(f"step {step}: loss {float(loss):.3f}; {losses}; {passed:.0f} s\n")
            sys.stdout.flush()
    save_student(given.out, training.average(), config, given.teacher, given.steps)
    sys.stdout.write(f"{given.out}\n")


def share(text: str) -> tuple[str, float]:
    """Source and number of ``SOURCE=NUMBER``, a ``type`` for `argparse`."""
    source, _, number = text.partition("=")
    try:
        value = float(number)
    except ValueError:
        value = math.nan
    if not (source and 0 < value < math.inf):
        raise argparse.ArgumentTypeError(f"{text!r} is not SOURCE=NUMBER above 0, such as grid=.1")
    return source, value


def whole(least: int, text: str) -> int:
    """Whole number from a least one on, a ``type`` for `argparse`."""
    if not text.isdecimal() or int(text) < least:
        raise argparse.ArgumentTypeError(f"{text!r} must be a whole number of {least} or more")
    return int(text)


@one_line_errors
def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command of the module's docstring; an error is one line on stderr."""
    usual = Size()
    parser = argparse.ArgumentParser(prog="python -m deitalk.research.training.small_model")
    parser.add_argument("recordings", type=Path, nargs="+", help="folders of recordings")
    parser.add_argument("--lips", type=Path, help="folder of measured lips, for its sound")
    parser.add_argument(
        "--held-out",
        action="append",
        default=[],
        help="speaker, such as s03 or grid:s03; repeatable",
    )
    parser.add_argument(
        "--share",
        type=share,
        action="append",
        default=[],
        metavar="SOURCE=NUMBER",
        help="how often a table, or lips, is drawn (1); repeatable",
    )
    parser.add_argument("--noise", required=True, help="folder of recordings of noise")
    parser.add_argument("--rooms", required=True, help="folder of impulse responses")
    parser.add_argument("--config", type=Path, required=True, help="configs/small.yaml")
    parser.add_argument("--teacher", default="default", help="model: name or folder")
    parser.add_argument("--steps", type=partial(whole, 1), default=usual.steps)
    parser.add_argument(
        "--batch", type=partial(whole, 2), default=usual.batch, help="windows of a step"
    )
    parser.add_argument(
        "--chunk", type=partial(whole, 2), default=usual.chunk, help="windows made at once"
    )
    parser.add_argument(
        "--frames", type=partial(whole, 30), default=usual.frames, help="of a window"
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--device", default="cpu", help="cpu or cuda")
    parser.add_argument("-o", "--out", type=Path, required=True, help="model folder")
    given = parser.parse_args(arguments)
    train(given)


if __name__ == "__main__":
    sys.exit(main())
