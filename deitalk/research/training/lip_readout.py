"""Readout of the lips from the speech encoder: run it by ``python -m`` and its name.

Writes a model's ``lips.safetensors`` (`deitalk.models.lip_readout`) from ridge regressions on the
features of its frozen encoder. Contacts are taught by the phones of a dataset folder's training
recordings, each clean and once more in noise and rooms, and become probabilities on those of its
validation speakers; width and corners are taught by measured lips of speakers that are not held
out. A regression is the mean of what it does not know, so that measures are amplified about their
mean.
"""

import argparse
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import torch
from safetensors.torch import save
from scipy.optimize import minimize

from deitalk.audio.frames import FRAME_RATE
from deitalk.audio.load import Recording, load_audio
from deitalk.audio.voice_activity import normalise_level
from deitalk.data.augment_waveform import Surroundings, augment
from deitalk.data.clips import Clip, read_clips, read_phones
from deitalk.models.checkpoint import load_model
from deitalk.models.curve_model import DEITalk
from deitalk.models.folder import LIP_WEIGHTS
from deitalk.models.lip_readout import MEASURES, TAPS, LipReadout
from deitalk.postprocess.phones import BILABIALS, LABIODENTALS, Phones
from deitalk.research.arguments import new_file
from deitalk.research.evaluation.ridge import REACH, Readout, Rows
from deitalk.research.lips.dataset import SPEAKER_CLIPS
from deitalk.research.lips.fit import TOLERANCE_CM, looseness, neutral_reading
from deitalk.research.lips.head_lips import MEASURES as HEAD_MEASURES
from deitalk.research.lips.head_lips import HeadLips
from deitalk.research.lips.measured import LipClip, read_lips
from rig.arrays import Float32, Float64
from rig.face.head import build_head
from rig.files import atomic_write

CONTACT_PENALTY, MEASURE_PENALTY = 100_000.0, 10_000.0
SHARE = 0.7
"""Of the regression in a measure; the rest is the decoder's."""
GAINS = (1.8, 1.5)
"""Of the mixed measures about their mean."""
SMOOTHING = (0.25, 0.5, 0.25)
"""Of the measures, over frames."""
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
    def hear(self, recording: Recording, waveform: Float32 | None = None) -> Float32:
        """Features [shape=(T, D)] of a recording, or of a changed copy."""
        sound = recording.waveform if waveform is None else waveform
        sound_tensor = torch.from_numpy(normalise_level(sound))
        found = self.model.frontend.encode(sound_tensor, recording.n_frames)
        return np.asarray(found.float().numpy())

    def late(self, features: Float32, frames: int) -> Float32:
        """For a causal model the features so many frames before, else the same."""
        if not self.model.is_causal:
            return features
        return features[np.maximum(np.arange(len(features)) - frames, 0)]

    def contacts(
        self, clips: Sequence[Clip], surroundings: Surroundings | None = None
    ) -> Iterator[Rows]:
        """Features and contacts of recordings, each also changed where there are surroundings."""
        rng = np.random.default_rng(1)
        for clip in clips:
            assert clip.phones is not None
            recording = load_audio(clip.audio)
            targets = contact_rows(read_phones(clip.phones), recording.n_frames)
            yield self.late(self.hear(recording), REACH), targets
            if surroundings is not None:
                changed = augment(recording.waveform, rng, surroundings)
                yield self.late(self.hear(recording, changed), REACH), targets

    def measures(self, clips: Sequence[LipClip]) -> tuple[list[Rows], list[Float32]]:
        """Features with measured lips, and the curves that the network has for the recordings."""
        rows, curves = [], []
        for clip in clips:
            recording = load_audio(clip.sound)
            sound = torch.from_numpy(normalise_level(recording.waveform))
            features, found = neutral_reading(self.model, sound, recording.n_frames)
            n = min(recording.n_frames, len(clip.measures))
            late = self.late(features.float().numpy(), TAPS // 2)
            known = np.isfinite(clip.measures[:n]).all(axis=1, keepdims=True)
            wanted = np.where(known, clip.measures[:n][:, self.chosen], np.nan)
            rows.append((late[:n], wanted.astype(np.float32)))
            curves.append(found.numpy())
        return rows, curves


def contact_rows(phones: Phones, n_frames: int) -> Float32:
    """1 in frames within p b m, and within f v [shape=(T, 2)]."""
    times = np.arange(n_frames) / FRAME_RATE
    rows = np.zeros((n_frames, 2), np.float32)
    for start, end, name in phones:
        for column, names in enumerate((BILABIALS, LABIODENTALS)):
            if name in names:
                rows[(times >= start) & (times < end), column] = 1
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


def calibration(scores: Float64, is_contact: Float64) -> Float64:
    """Slope and offset with which the logistic function of scores is a probability."""
    signs = 2 * is_contact - 1

    def loss(v: Float64) -> float:
        return float(np.logaddexp(0, -signs * (v[0] * scores + v[1])).mean())

    return np.asarray(minimize(loss, np.array([8.0, -4.0])).x, np.float64)


def shown_measures(curves: Float64, measures: Float64) -> tuple[Float64, Float64]:
    """Linear map (M, C) and constant (M,) from curves to their measures on the head."""
    mean, centre = curves.mean(axis=0), measures.mean(axis=0)
    x = curves - mean
    gram = x.T @ x + LEAST * len(x) * np.eye(x.shape[1])
    weights = np.linalg.solve(gram, x.T @ (measures - centre)).T
    return weights, centre - weights @ mean


def moving_controls(teacher: Teacher, pose: Float32) -> Float64:
    """Change of the controls per measure of `MEASURES`, the others unchanged [shape=(C, 2)]."""
    lips, controls = teacher.lips, teacher.model.controls
    slope = torch.func.jacrev(lips)(torch.from_numpy(pose)).detach().numpy()
    free = looseness(controls, ("lipsTogether",)).numpy().astype(np.float64) ** 2
    spread = free[:, None] * slope.T
    inverse = np.linalg.inv(slope @ spread + np.diag(np.square(TOLERANCE_CM)))
    return np.asarray((spread @ inverse)[:, teacher.chosen], np.float64)


@torch.no_grad()
def fill(
    module: LipReadout,
    contacts: Readout,
    slopes: Sequence[Float64],
    measures: Readout,
    shown: tuple[Float64, Float64],
    moves: Float64,
    mean: Float64,
) -> None:
    """Give the module its weights; `mean` is that of the measured lips (2,)."""
    kernel, bias = folded(contacts)
    slope = np.array([a for a, _ in slopes])
    first = padded(kernel * slope[:, None, None], module.causal)
    offsets = bias * slope + np.array([b for _, b in slopes])
    taps, constant = folded(measures)
    wide = np.apply_along_axis(np.convolve, 2, taps, np.array(SMOOTHING))
    gain = np.array(GAINS)
    # change = mean + gain (share regression + (1 - share) shown - mean) - shown
    second = padded(wide * (gain * SHARE)[:, None, None], module.causal)
    rest = constant * gain * SHARE + (1 - gain) * mean
    weights, offset = shown
    left = gain * (1 - SHARE) - 1
    for target, values in (
        (module.listen.weight, np.concatenate((first, second))),
        (module.listen.bias, np.concatenate((offsets, rest))),
        (module.shown.weight, left[:, None] * weights),
        (module.shown.bias, left * offset),
        (module.moves.weight, moves),
    ):
        assert target is not None
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
    contacts = Readout.fit([*teacher.contacts(taught, surroundings)], penalty=CONTACT_PENALTY)
    pairs = [(contacts(features), targets) for features, targets in teacher.contacts(judged)]
    scores, closed = (np.concatenate(part).astype(np.float64) for part in zip(*pairs, strict=True))
    slopes = [calibration(scores[:, k], closed[:, k]) for k in range(2)]
    clips: dict[str, list[LipClip]] = {}
    for clip in read_lips(lips, teacher.lips.eye_distance):
        if clip.speaker not in held_out:
            clips.setdefault(clip.speaker, []).append(clip)
    chosen = [clip for group in clips.values() for clip in group[:CLIPS]]
    rows, curves = teacher.measures(chosen)
    count = {name: min(len(group), CLIPS) for name, group in clips.items()}
    shares = [min(1.0, SPEAKER_CLIPS / count[clip.speaker]) for clip in chosen]
    measures = Readout.fit(rows, shares, MEASURE_PENALTY)
    every = np.concatenate(curves)
    with torch.no_grad():
        own = teacher.lips.displacements(torch.from_numpy(every)).numpy()[:, teacher.chosen]
    by_speaker: dict[str, list[Float32]] = {}
    for (_, wanted), clip in zip(rows, chosen, strict=True):
        by_speaker.setdefault(clip.speaker, []).append(wanted)
    means = [np.nanmean(np.concatenate(group), axis=0) for group in by_speaker.values()]
    module = LipReadout(model.frontend.output_size, model.controls.names, causal=model.is_causal)
    fill(
        module,
        contacts,
        slopes,
        measures,
        shown_measures(every.astype(np.float64), own.astype(np.float64)),
        moving_controls(teacher, every.mean(axis=0)),
        np.mean(means, axis=0).astype(np.float64),
    )
    return module


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
        surroundings = Surroundings.read(given.noise, given.rooms)
    module = fit(model, given.data, given.lips, given.held_out, surroundings)
    state = {LIP_WEIGHTS + name: value.half() for name, value in module.state_dict().items()}
    with atomic_write(given.out) as beside:
        beside.write_bytes(save(state))
    sys.stdout.write(f"{given.out}\n")


if __name__ == "__main__":
    main()
