"""Readout of the lips from the speech encoder: run it by ``python -m`` and its name.

Writes a model's ``lips.safetensors`` (`deitalk.models.lip_readout`), fitted to the features of its
frozen encoder. Channels are probabilities, which a small network learns from the phones of a
dataset folder's training recordings, each clean, faster or slower, and once more in noise and
rooms, and from the noises alone, in which there is nothing. Measures are ridge regressions on lips
of speakers that are not held out. A regression is the mean of what it does not know, so that
measures are amplified about their mean.
"""

import argparse
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import scipy  # loads its parts at their first use
import torch
from safetensors.torch import save
from torch import Tensor, nn
from torch.nn import functional as F

from deitalk.audio.frames import FRAME_RATE, SAMPLE_RATE, frame_count
from deitalk.audio.load import load_audio
from deitalk.audio.voice_activity import normalise_level
from deitalk.data.augment_waveform import Surroundings, augment, change_speed, speed_factor
from deitalk.data.clips import Clip, read_clips, read_phones
from deitalk.models.checkpoint import load_model
from deitalk.models.curve_model import DEITalk
from deitalk.models.folder import LIP_WEIGHTS
from deitalk.models.lip_readout import CHANNELS, HIDDEN, MEASURES, TAPS, LipReadout
from deitalk.postprocess.phones import SILENCE, Phones
from deitalk.research.arguments import new_file
from deitalk.research.corpus.articulation import CHANNELS as TABLE_CHANNELS
from deitalk.research.corpus.articulation import targets
from deitalk.research.evaluation.ridge import REACH, Readout, Rows
from deitalk.research.lips.fit import TOLERANCE_CM, looseness, neutral_reading
from deitalk.research.lips.head_lips import MEASURES as HEAD_MEASURES
from deitalk.research.lips.head_lips import HeadLips
from deitalk.research.lips.measured import LipClip, read_lips
from deitalk.research.lips.transfer import SPEAKER_CLIPS
from deitalk.research.training.surroundings import read_surroundings
from rig.arrays import Float32, Float64
from rig.face.head import build_head
from rig.files import atomic_write

EPOCHS, BATCH, WINDOW, RATE, DECAY, DROPOUT = 5, 16, 128, 1e-3, 0.3, 0.3
"""Settings of the channels' network, which sees `BATCH` times `WINDOW` frames in a step."""
MEASURE_PENALTY = 10_000.0
SHARES = (0.8, 0.6, 0.8, 0.7)
"""Share of the regression in each measure; the rest is the decoder's."""
GAINS = (1.1, 1.7, 1.1, 1.3)
"""Gains of the mixed measures about their mean."""
KEPT = ("lipsTogether", "funnel", "purse")
"""Parts of the names of controls that move for no measure: phones move them."""
SMOOTHING = (0.25, 0.5, 0.25)
"""Weights over frames that smooth the measures."""
VOICE_FRAMES = 5
"""Frames around speech that count as its own: the mouth opens before it, and closes after it."""
NOISE_TIMES, NOISE_RMS = 3, 0.07
"""How often a noise alone is heard, and its level."""
HELD_VOWELS = 300
"""Synthesised; only the voice is taught of them as speech."""
LEAST = 1e-4
"""Ridge on the curves in the map to the measures of the head, relative to their number."""
CLIPS = 150
"""Most recordings of a measured speaker."""


class Teacher:
    """Features and curves of a model, and the measures of its curves on the head.

    Parameters
    ----------
    model : DEITalk
        With a frozen encoder.
    """

    def __init__(self, model: DEITalk) -> None:
        self.model, self.lips = model, HeadLips(build_head())
        self.chosen = [HEAD_MEASURES.index(name) for name in MEASURES]

    @torch.no_grad()
    def hear(self, sound: Float32) -> Float32:
        """Features [shape=(T, D)] of a sound at 16 kHz."""
        tensor = torch.from_numpy(normalise_level(sound))
        found = self.model.frontend.encode(tensor, frame_count(len(sound)))
        return np.asarray(found.float().numpy())

    def late(self, features: Float32, frames: int) -> Float32:
        """For a causal model the features so many frames before, else the same."""
        if not self.model.is_causal:
            return features
        return features[np.maximum(np.arange(len(features)) - frames, 0)]

    def channels(
        self, clips: Sequence[Clip], surroundings: Surroundings | None = None
    ) -> Iterator[Rows]:
        """Features and channels of recordings, their changed copies, and noises alone."""
        rng = np.random.default_rng(1)
        for clip in clips:
            assert clip.phones is not None
            sound, phones = load_audio(clip.audio).waveform, read_phones(clip.phones)
            factor = speed_factor(rng)
            moved = [(start / factor, end / factor, name) for start, end, name in phones]
            heard = [(sound, phones)]
            if factor != 1:
                heard.append((change_speed(sound, factor), moved))
            if surroundings is not None:
                heard.append((augment(sound, rng, surroundings), phones))
            for changed, said in heard:
                yield self.hear(changed), channel_rows(said, frame_count(len(changed)))
        for noise in () if surroundings is None else surroundings.noises:
            features = self.hear(noise * np.float32(NOISE_RMS / noise.std()))
            yield from [(features, channel_rows((), len(features)))] * NOISE_TIMES
        for _ in range(HELD_VOWELS):
            features = self.hear(held_vowel(rng))
            rows = np.full((len(features), len(CHANNELS)), np.nan, np.float32)
            rows[:, -1] = 1
            yield features, rows

    def read(self, sound: Path) -> Rows:
        """Features [shape=(T, D)] of a recording, and the network's curves [shape=(T, C)]."""
        recording = load_audio(sound)
        waveform = torch.from_numpy(normalise_level(recording.waveform))
        features, curves = neutral_reading(self.model, waveform, recording.n_frames)
        return features.float().numpy(), curves.numpy()

    def measures(self, clip: LipClip, features: Float32) -> Rows:
        """Features and measured lips of a recording."""
        n = min(len(features), len(clip.measures))
        known = np.isfinite(clip.measures[:n]).all(axis=1, keepdims=True)
        wanted = np.where(known, clip.measures[:n][:, self.chosen], np.nan)
        return self.late(features, TAPS // 2)[:n], wanted.astype(np.float32)


def held_vowel(rng: np.random.Generator) -> Float32:
    """Pulses of some pitch, with vibrato, through three resonances: 2 to 6 s at 16 kHz."""
    t = np.arange(round(SAMPLE_RATE * rng.uniform(2, 6))) / SAMPLE_RATE
    swing = rng.uniform(0, 0.03) * np.sin(2 * np.pi * rng.uniform(4.5, 6.5) * t)
    turns = np.cumsum(rng.uniform(85, 330) * (1 + swing) / SAMPLE_RATE)
    sound = scipy.signal.lfilter([1, -1], [1, -0.97], np.diff(np.floor(turns), prepend=0))
    for lowest, highest, width in ((260, 850, 80), (800, 2400, 100), (2300, 3100, 140)):
        r, centre = np.exp(-np.pi * width / SAMPLE_RATE), rng.uniform(lowest, highest)
        angle = 2 * np.pi * centre / SAMPLE_RATE
        sound = scipy.signal.lfilter([1 - r], [1, -2 * r * np.cos(angle), r * r], sound)
    noise = 10 ** rng.uniform(-3, -1.5) * rng.standard_normal(len(sound))
    return np.asarray(0.1 * (sound / sound.std() + noise), np.float32)


def channel_rows(phones: Phones, n_frames: int) -> Float32:
    """Values of `CHANNELS` frame by frame [shape=(T, 7)]; the voice is 1 around speech."""
    times, table = np.arange(n_frames) / FRAME_RATE, targets()
    chosen = [TABLE_CHANNELS.index(name) for name in CHANNELS[:-1]]
    rows = np.zeros((n_frames, len(CHANNELS)), np.float32)
    reach = VOICE_FRAMES / FRAME_RATE
    for start, end, name in phones:
        if name in table:
            rows[(times >= start) & (times < end), :-1] = table[name][chosen]
        if name in table and name != SILENCE:
            rows[(times >= start - reach) & (times < end + reach), -1] = 1
    return rows


def folded(readout: Readout) -> tuple[Float64, Float64]:
    """Kernel (M, D, 2 REACH + 1) and bias (M,) of a readout, its standardisation included."""
    width = len(readout.mean)
    taps = readout.weights.reshape(2 * REACH + 1, width, -1) / readout.scale[None, :, None]
    bias = readout.constant - np.einsum("kdm,d->m", taps, readout.mean)
    return taps.transpose(2, 1, 0), bias


def padded(kernel: Float64, is_causal: bool) -> Float64:
    """The kernel with as many taps as the module has: around its middle, or ending at its last."""
    more = TAPS - kernel.shape[2]
    before = more if is_causal else more // 2
    return np.pad(kernel, ((0, 0), (0, 0), (before, more - before)))


class Network(NamedTuple):
    """Weights of the channels, as the module has them."""

    kernel: Tensor
    """[shape=(HIDDEN, D, TAPS)]."""
    bias: Tensor
    last: nn.Conv1d


def learn_channels(recordings: Sequence[Rows], silence: Float32, *, is_causal: bool) -> Network:
    """Learn the channels (T, K) of recordings from features (T, D), by their cross entropy.

    NaN teaches nothing. Between recordings there is `silence` (D,), as before and after them in
    the module.
    """
    torch.manual_seed(0)
    margin = TAPS - 1 if is_causal else TAPS // 2
    around = ((margin, TAPS - 1 - margin), (0, 0))
    scale = np.concatenate([x[::7] for x, _ in recordings]).std(axis=0, dtype=np.float64) + 1e-3
    scaled = [((x - silence) / scale).astype(np.float16) for x, _ in recordings]
    features = torch.from_numpy(np.concatenate([np.pad(x, around) for x in scaled]))
    wanted = [np.pad(y, around, constant_values=np.nan) for _, y in recordings]
    targets = torch.from_numpy(np.concatenate(wanted))
    first, last = nn.Conv1d(features.shape[1], HIDDEN, TAPS), nn.Conv1d(HIDDEN, len(CHANNELS), 1)
    network = nn.Sequential(nn.Dropout(DROPOUT), first, nn.ReLU(), nn.Dropout(DROPOUT), last)
    optimiser = torch.optim.AdamW(network.parameters(), RATE, weight_decay=DECAY)
    steps = max(EPOCHS * len(features) // (BATCH * WINDOW), 1)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, RATE, total_steps=steps)
    window = torch.arange(min(WINDOW + TAPS - 1, len(features)))
    for _ in range(steps):
        places = torch.randint(len(features) - len(window) + 1, (BATCH, 1)) + window
        inner = places[:, margin : len(window) - TAPS + 1 + margin]
        logits = network(features[places].float().transpose(1, 2)).transpose(1, 2)
        taught = targets[inner].isfinite()
        loss = F.binary_cross_entropy_with_logits(logits[taught], targets[inner][taught])
        optimiser.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        optimiser.step()
        schedule.step()
    per = torch.from_numpy(scale.astype(np.float32))
    assert first.bias is not None
    return Network(first.weight.detach() / per[:, None], first.bias.detach(), last)


def shown_measures(curves: Float64, measures: Float64) -> tuple[Float64, Float64]:
    """Linear map (M, C) and constant (M,) from curves to their measures on the head."""
    mean, centre = curves.mean(axis=0), measures.mean(axis=0)
    x = curves - mean
    gram = x.T @ x + LEAST * len(x) * np.eye(x.shape[1])
    weights = np.linalg.solve(gram, x.T @ (measures - centre)).T
    return weights, centre - weights @ mean


def moving_controls(teacher: Teacher, pose: Float32) -> Float64:
    """Change of the controls per measure of `MEASURES`, the others unchanged [shape=(C, 4)]."""
    lips, controls = teacher.lips, teacher.model.controls
    slope = torch.func.jacrev(lips)(torch.from_numpy(pose)).detach().numpy()
    free = looseness(controls, KEPT).numpy().astype(np.float64) ** 2
    spread = free[:, None] * slope.T
    inverse = np.linalg.inv(slope @ spread + np.diag(np.square(TOLERANCE_CM)))
    return np.asarray((spread @ inverse)[:, teacher.chosen], np.float64)


@torch.no_grad()
def fill_channels(module: LipReadout, found: Network, silence: Float32) -> None:
    """Give the module its weights of the channels."""
    assert module.listen.bias is not None and module.phones.bias is not None
    assert found.last.bias is not None
    module.silence.copy_(torch.from_numpy(silence))
    module.listen.weight[:HIDDEN].copy_(found.kernel)
    module.listen.bias[:HIDDEN].copy_(found.bias)
    module.phones.weight.copy_(found.last.weight[:, :, 0])
    module.phones.bias.copy_(found.last.bias)


@torch.no_grad()
def fill_measures(
    module: LipReadout,
    measures: Readout,
    shown: tuple[Float64, Float64],
    moves: Float64,
    mean: Float64,
) -> None:
    """Give the module its weights of the measures; `mean` is that of the measured lips (4,)."""
    taps, constant = folded(measures)
    wide = np.apply_along_axis(np.convolve, 2, taps, np.array(SMOOTHING))
    constant = constant + wide.sum(axis=2) @ module.silence.numpy()
    gain, share = np.array(GAINS), np.array(SHARES)
    # wanted = mean + gain (share regression + (1 - share) shown - mean)
    assert module.listen.bias is not None
    _set(module.listen.weight[HIDDEN:], padded(wide * (gain * share)[:, None, None], module.causal))
    _set(module.listen.bias[HIDDEN:], constant * gain * share + (1 - gain) * mean)
    _set(module.kept, gain * (1 - share))
    _set(module.shown.weight, shown[0])
    _set(module.shown.bias, shown[1])
    _set(module.moves.weight, moves)


def _set(target: Tensor, values: Float64) -> None:
    target.copy_(torch.from_numpy(np.asarray(values, np.float32)))


def fit(
    model: DEITalk,
    data: Path,
    lips: Path,
    held_out: Sequence[str],
    surroundings: Surroundings | None,
) -> LipReadout:
    """Fit a readout; the arguments are those of the command."""
    teacher = Teacher(model)
    taught, judged = (
        list({clip.audio: clip for clip in read_clips(data, split) if clip.phones}.values())
        for split in ("train", "validation")
    )
    heard = [*teacher.channels(taught, surroundings)]
    known = [teacher.read(clip.audio) for clip in judged]
    silence = np.concatenate([x[[0, -1]] for x, _ in heard]).mean(axis=0)
    module = LipReadout(model.frontend.output_size, model.controls.names, causal=model.is_causal)
    network = learn_channels(heard, silence, is_causal=model.is_causal)
    fill_channels(module, network, silence)
    clips: dict[str, list[LipClip]] = {}
    for clip in read_lips(lips, teacher.lips.eye_distance):
        if clip.speaker not in held_out:
            clips.setdefault(clip.speaker, []).append(clip)
    chosen = [clip for group in clips.values() for clip in group[:CLIPS]]
    spoken = [teacher.read(clip.sound) for clip in chosen]
    rows = [
        teacher.measures(clip, features) for clip, (features, _) in zip(chosen, spoken, strict=True)
    ]
    count = {name: min(len(group), CLIPS) for name, group in clips.items()}
    shares = [min(1.0, SPEAKER_CLIPS / count[clip.speaker]) for clip in chosen]
    measures = Readout.fit(rows, shares, MEASURE_PENALTY)
    plain = [curves for _, curves in (*known, *spoken)]
    every = np.concatenate([*plain, *(said_curves(module, *pair) for pair in (*known, *spoken))])
    with torch.no_grad():
        own = teacher.lips.displacements(torch.from_numpy(every)).numpy()[:, teacher.chosen]
    by_speaker: dict[str, list[Float32]] = {}
    for (_, lips_of), clip in zip(rows, chosen, strict=True):
        by_speaker.setdefault(clip.speaker, []).append(lips_of)
    means = [np.nanmean(np.concatenate(group), axis=0) for group in by_speaker.values()]
    fill_measures(
        module,
        measures,
        shown_measures(every.astype(np.float64), own.astype(np.float64)),
        moving_controls(teacher, every.mean(axis=0)),
        np.mean(means, axis=0).astype(np.float64),
    )
    return module


@torch.no_grad()
def said_curves(module: LipReadout, features: Float32, curves: Float32) -> Float32:
    """Curves (T, C) that show the channels of a recording's features."""
    read = module(torch.from_numpy(features)[None])[0]
    said, _ = module.articulated(torch.from_numpy(curves)[None], read)
    found: Float32 = said[0].numpy()
    return found


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command of the module's docstring."""
    parser = argparse.ArgumentParser(prog="python -m deitalk.research.training.lip_readout")
    parser.add_argument("--data", type=Path, required=True, help="dataset folder with phones")
    parser.add_argument("--lips", type=Path, required=True, help="folder of measured lips")
    parser.add_argument("--held-out", action="append", default=[], help="speaker; repeatable")
    parser.add_argument("--noise", help="folder of noises")
    parser.add_argument("--rooms", help="folder of rooms")
    parser.add_argument("--model", default="default", help="whose encoder: default or live")
    parser.add_argument("-o", "--out", type=new_file, required=True, help="lips.safetensors")
    given = parser.parse_args(arguments)
    model = load_model(given.model)
    assert isinstance(model, DEITalk)
    model.lips = None
    surroundings = None
    if given.noise or given.rooms:
        surroundings = read_surroundings(given.noise, given.rooms)
    module = fit(model, given.data, given.lips, given.held_out, surroundings)
    state = {LIP_WEIGHTS + name: value.half() for name, value in module.state_dict().items()}
    with atomic_write(given.out) as beside:
        beside.write_bytes(save(state))
    sys.stdout.write(f"{given.out}\n")


if __name__ == "__main__":
    main()
