"""What is heard of a whole recording, as operators of a graph.

The functions of `deitalk.audio.voice_activity`, `deitalk.audio.vocal_strength` and
`deitalk.postprocess.voice_intensity`, which say what each step is for and hold its numbers, in
torch: without loops over frames, and by operators that every runtime of ONNX has. Tests hold both
to the same values.

Letters: S samples, T frames, K frequency bands, W samples of a window.
"""

import math
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional as F

from deitalk.audio.frames import FRAME_RATE, SAMPLE_RATE
from deitalk.audio.vocal_strength import (
    ACTIVE_DB,
    AROUND_BLOCKS,
    BAND_EDGES_HZ,
    BANDS,
    BLOCK_FRAMES,
    DILATIONS,
    FEWEST_FRAMES,
    HIGHEST,
    KERNEL,
    LEVEL_DB,
    LONGEST,
    LOWEST,
    PITCH_SEMITONES,
    REST_WEIGHT,
    SHORTEST,
    TILT_DB,
    UNIT_DB,
    VOICED,
    WINDOW,
    vocal_strength,
)
from deitalk.audio.voice_activity import (
    BAND_EDGES_HZ as ACTIVITY_EDGES_HZ,
)
from deitalk.audio.voice_activity import (
    CLEAN_DB,
    FLOOR_PERCENTILE,
    FLOOR_SECONDS,
    KEEP_DB,
    LONGEST_CLOSURE,
    LONGEST_DROWNED,
    NOISY_DB,
    OPEN_DB,
    SHORT_FLOOR_DB,
    SHORT_SECONDS,
    SILENCE_DB,
    SPEECH_RANGE_DB,
    TOP_BANDS,
)
from deitalk.config.rules import Gates, PoseSize, RulesConfig, ScaleOpening, VoiceIntensity
from deitalk.emotions import EMOTIONS
from deitalk.models.onnx.spectra import SpectralPower
from deitalk.pipeline.speech import EFFORT_FRAMES, EFFORT_SHARE
from deitalk.postprocess.control_groups import ControlGroups
from deitalk.postprocess.factors import AROUND_FRAMES, LEAST_PREDICTED, MOST_RESIZED
from deitalk.postprocess.torch_columns import constant
from deitalk.postprocess.voice_intensity import (
    AROUND_WEIGHT,
    BRIGHTEST_DB,
    DEEPEST_DB,
    END_FRAMES,
    FAINTEST,
    FALL_FRAMES,
    FEWEST_VOICED,
    FURTHEST_SEMITONES,
    HOLD_AT_END,
    LEVEL_SHARE,
    MOST_BASE,
    MOST_TAKE,
    MOST_TONE,
    MOST_VARIATION,
    NEAR_FRAMES,
    NEAR_SHARE,
    NETWORK_WEIGHT,
    REST_AT_END,
    RISE_FRAMES,
    SMOOTHING_FRAMES,
    STEEPNESS,
    TONE_SHARE,
)
from rig import ControlSet
from rig.curves.edit import TRUNCATE

FAR = 10**6
"""Frames to a neighbour that there is not."""
PERIOD = 3
"""Frames of a whole number of samples."""
PERIOD_SAMPLES = PERIOD * SAMPLE_RATE // FRAME_RATE
FFT = 2 * WINDOW
"""Points of the Fourier transform of prosody."""


def frame_windows(sound: Tensor, n_frames: Tensor | int, *, nearest: bool) -> Tensor:
    """`WINDOW` samples around the time of each frame (T, W), zeros outside of the sound.

    `nearest` rounds the time to the next sample, else to the one before.
    """
    half = WINDOW // 2
    padded = F.pad(sound, (half, half + PERIOD_SAMPLES))
    frames = torch.arange(n_frames) * SAMPLE_RATE
    starts = (frames + (FRAME_RATE // 2 if nearest else 0)) // FRAME_RATE
    return padded[starts[:, None] + torch.arange(WINDOW)]


def decibels(power: Tensor, least: float = 1e-12) -> Tensor:
    """10 log10 of a power."""
    return 10 / math.log(10) * torch.log(power + least)


class BandLevels(nn.Module):
    """`deitalk.audio.voice_activity.window_levels`."""

    window: Tensor
    bands: Tensor

    def __init__(self) -> None:
        super().__init__()
        window = np.hanning(WINDOW + 1)[:-1]
        bins = np.ceil(np.array(ACTIVITY_EDGES_HZ) * WINDOW / SAMPLE_RATE).astype(int)
        self.power = SpectralPower(WINDOW, WINDOW, int(bins[-1]))
        number = np.arange(self.power.bins)
        bands = (number[:, None] >= bins[:-1]) & (number[:, None] < bins[1:])
        constant(self, "window", window)
        constant(self, "bands", bands * 2 / (WINDOW * (window**2).sum()))

    def forward(self, windows: Tensor) -> Tensor:
        """Levels (T, K) in dB of windows (T, W)."""
        power = self.power(windows * self.window)
        return decibels((power @ self.bands).clamp_min(10 ** (SILENCE_DB / 10)), 0.0)


class Measured(NamedTuple):
    """Prosody of frames, as `deitalk.audio.vocal_strength.Prosody` [shape=(..., T)]."""

    level: Tensor
    bright: Tensor
    dark: Tensor
    pitch: Tensor
    periodicity: Tensor
    bands: Tensor
    """[shape=(..., T, 26)]."""

    @property
    def tilt(self) -> Tensor:
        """Bright over dark, dB."""
        return decibels((self.bright + 1e-12) / (self.dark + 1e-12), 0.0)


class MeasureProsody(nn.Module):
    """`deitalk.audio.vocal_strength.measure_windows`."""

    window: Tensor
    sums: Tensor
    waves: Tensor

    def __init__(self) -> None:
        super().__init__()
        bins = WINDOW + 1
        frequency = np.fft.rfftfreq(FFT, 1 / SAMPLE_RATE)
        edges = np.searchsorted(frequency, BAND_EDGES_HZ)
        number = np.arange(bins)[:, None]
        columns = [
            np.full((bins, 1), 1 / bins),
            ((frequency > 1000) & (frequency < 4000))[:, None],
            ((frequency > 80) & (frequency < 1000))[:, None],
            (number >= edges[:-1]) & (number < edges[1:]),
        ]
        self.power = SpectralPower(WINDOW, FFT, bins)
        turns = np.outer(np.arange(bins), np.arange(LONGEST)) % FFT
        weight = np.full((bins, 1), 2.0)
        weight[[0, -1]] = 1
        waves = np.cos(2 * np.pi / FFT * turns) * weight / FFT
        unused = ((0, self.power.bins - bins), (0, 0))
        sums = np.concatenate(columns, axis=1).astype(float)
        constant(self, "window", np.hanning(WINDOW))
        constant(self, "sums", np.pad(sums, unused))
        constant(self, "waves", np.pad(waves, unused))

    def forward(self, windows: Tensor) -> Measured:
        """Measures of windows (T, W)."""
        power = self.power(windows * self.window)
        mean, bright, dark, bands = torch.split(power @ self.sums, [1, 1, 1, BANDS], dim=-1)
        correlation = power @ self.waves
        correlation = correlation / (correlation[..., :1] + 1e-12)
        periodicity, lag = correlation[..., SHORTEST:].max(dim=-1)
        pitch = 12 / math.log(2) * torch.log(SAMPLE_RATE / 100 / (lag + SHORTEST).float())
        rows = (decibels(mean), bright, dark)
        return Measured(*(row[..., 0] for row in rows), pitch, periodicity, bands)


# Statistics of some of the frames, of which there may be none.


def masked_mean(values: Tensor, used: Tensor) -> Tensor:
    """Mean of the values (T,) where `used` (T,) is 1; 0 where there is none."""
    return (values * used).sum() / used.sum().clamp_min(1)


def masked_percentile(values: Tensor, used: Tensor, percent: float) -> Tensor:
    """Percentile along the first axis where `used` is 1, linear between two values."""
    count = (used > 0).long().sum(dim=0, keepdim=True)
    ordered = torch.sort(torch.where(used > 0, values, torch.full_like(values, 1e9)), dim=0)[0]
    last = (count - 1).clamp_min(0)
    place = last.float() * (percent / 100)
    below = place.floor().long()
    low, high = (torch.gather(ordered, 0, k) for k in (below, torch.minimum(below + 1, last)))
    return (low + (place - below.float()) * (high - low))[0]


def neighbours(used: Tensor) -> tuple[Tensor, Tensor]:
    """Last used frame up to each one and next one from it on (T,); `FAR` away where there is none.

    `used` (T,) is 1 at some frames.
    """
    places, far = used.nonzero().flatten(), torch.full((1,), FAR, dtype=torch.long)
    count = torch.cumsum(used.long(), dim=0)
    last = torch.cat((-far, places))[count]
    following = torch.cat((places, far))[count - used.long()]
    return last, following


def smoothed(values: Tensor, sigma: float) -> Tensor:
    """`rig.curves.edit.gaussian_smooth` with zeros beyond the ends, (T,)."""
    radius = int(TRUNCATE * sigma + 0.5)
    kernel = torch.exp(-0.5 * (torch.arange(-radius, radius + 1).double() / sigma) ** 2)
    kernel = (kernel / kernel.sum()).float()[None, None]
    return F.conv1d(values[None, None], kernel, padding=radius)[0, 0]


def mean_beside(values: Tensor, used: Tensor, sigma: float) -> Tensor:
    """Gaussian mean over the used frames (T,); 0 far from them."""
    weight, total = smoothed(used, sigma), smoothed(values * used, sigma)
    return torch.where(weight > 1e-3, total / weight.clamp_min(1e-3), torch.zeros_like(total))


def mean_around(values: Tensor, used: Tensor) -> Tensor:
    """`deitalk.postprocess.factors.mean_around`."""
    weight = smoothed(used, AROUND_FRAMES) + 1e-6
    total = smoothed(values * used, AROUND_FRAMES) + 1e-6 * masked_mean(values, used)
    return torch.where(used.sum() > 0, total / weight, values)


# Speech activity, the level of the speech, and gates.


class SpeechActivity(nn.Module):
    """`deitalk.audio.voice_activity.speech_activity` and `level_gain`."""

    def __init__(self) -> None:
        super().__init__()
        self.levels = BandLevels()

    def forward(self, sound: Tensor, n_frames: Tensor | int) -> Tensor:
        """Frames with speech: 1, all others 0 (T,)."""
        levels = self.levels(frame_windows(sound, n_frames, nearest=False))
        excess = torch.topk(levels - self._floor(levels), TOP_BANDS, dim=1)[0].mean(dim=1)
        # Runs of `keeps` that hold at least one frame of `opens`.
        opens, keeps = (excess >= OPEN_DB).float(), (excess >= KEEP_DB).float()
        opened, begun = neighbours(opens), neighbours(1 - keeps)
        speech = keeps * ((opened[0] > begun[0]) | (opened[1] < begun[1])).float()
        # Frames without speech that are no pause.
        loudest = masked_percentile(excess, torch.ones_like(excess), 95)
        share = ((loudest - NOISY_DB) / (CLEAN_DB - NOISY_DB)).clamp(0, 1)
        gap = torch.round(LONGEST_DROWNED + share * (LONGEST_CLOSURE - LONGEST_DROWNED))
        last, following = neighbours(speech)
        bridged = ((following - last - 1).float() <= gap) & (last >= 0) & (following < FAR)
        speech = torch.maximum(speech, bridged.float())
        # A single frame is a click.
        beside = F.pad(speech, (1, 1))
        paired = speech * torch.maximum(beside[:-2], beside[2:])
        return torch.where(self._is_short(sound), speech, paired)

    def gain(self, sound: Tensor, speech: Tensor, target_db: float) -> Tensor:
        """Factor that brings the speech (T,) to a level; 1 if there is none."""
        # A frame's own samples begin at floor(533.33 t): 533, 533 and 534 of them.
        rows = F.pad(sound.square(), (0, PERIOD_SAMPLES))
        inside = F.pad(torch.ones_like(sound), (0, PERIOD_SAMPLES))
        third = PERIOD_SAMPLES // PERIOD
        sizes = [third, third, PERIOD_SAMPLES - 2 * third]
        n_periods = (speech.shape[0] + PERIOD - 1) // PERIOD
        sums = [
            torch.stack(
                [
                    part.sum(dim=1)
                    for part in torch.split(
                        x[: n_periods * PERIOD_SAMPLES].view(-1, PERIOD_SAMPLES), sizes, dim=1
                    )
                ],
                dim=1,
            ).flatten()[: speech.shape[0]]
            for x in (rows, inside)
        ]
        energy, count = ((part * speech).sum() for part in sums)
        level = decibels(energy / count.clamp_min(1), 1e-30)
        gain = torch.exp((target_db - level) * (math.log(10) / 20))
        return torch.where(energy > 0, gain, torch.ones_like(gain))

    def _is_short(self, sound: Tensor) -> Tensor:
        return torch.as_tensor(sound.shape[0]) < SHORT_SECONDS * SAMPLE_RATE

    def _floor(self, levels: Tensor) -> Tensor:
        """Level per band (T, K) above which there is more than noise, dB."""
        half = round(FLOOR_SECONDS * FRAME_RATE / 2)
        hop, total = half // 3, torch.as_tensor(levels.shape[0])
        number = torch.arange((levels.shape[0] + hop - 1) // hop + 1)
        centres = torch.minimum(number * hop, total - 1)  # the last frame too
        places = centres + torch.arange(-half, half)[:, None]  # (2 half, N)
        inside = ((places >= 0) & (places < total)).long()
        rows = levels[torch.minimum(places.clamp_min(0), total - 1)]  # (2 half, N, K)
        used = inside[:, :, None].expand_as(rows)
        lowest = masked_percentile(rows, used, FLOOR_PERCENTILE)  # (N, K)
        frames = torch.arange(levels.shape[0])
        before = frames // hop
        first, second = centres[before], centres[before + 1]
        share = ((frames - first).float() / (second - first).clamp_min(1).float())[:, None]
        floor = lowest[before] + share * (lowest[before + 1] - lowest[before])
        highest = levels.amax(dim=1)
        loudest = masked_percentile(highest, torch.ones_like(highest), 98)
        floor = torch.maximum(floor, loudest - SPEECH_RANGE_DB)
        is_short = total < SHORT_SECONDS * FRAME_RATE
        return torch.where(is_short, torch.full_like(floor, SHORT_FLOOR_DB - OPEN_DB), floor)


def faded(progress: Tensor) -> Tensor:
    """`deitalk.postprocess.voice_intensity.fade`."""
    return 0.5 + 0.5 * torch.cos(math.pi * progress.clamp(0, 1))


def gates_of(speech: Tensor, rule: Gates | None) -> tuple[Tensor, Tensor]:
    """Gates of the mouth and of the expression (T,)."""
    if rule is None:
        return torch.ones_like(speech), torch.ones_like(speech)
    last, following = neighbours(speech)
    frames = torch.arange(speech.shape[0])
    since, until = (frames - last).float(), (following - frames).float()
    mouth = torch.maximum(
        faded(since / (rule.mouth_closes + 1)), faded(until / (rule.mouth_opens + 1))
    )
    fading = faded((since - rule.expression_holds) / rule.expression_fades)
    expression = torch.maximum(fading, faded(until / (rule.expression_rises + 1)))
    # A take that ends in silence ends in a face at rest.
    trailing = since[-1]
    depth = ((trailing - HOLD_AT_END) / (REST_AT_END - HOLD_AT_END)).clamp(0, 1)
    held = torch.maximum(trailing - rule.expression_fades, (trailing / 4).floor())
    progress = (since - held) / (trailing - held).clamp_min(1e-6)
    ends = 1 - depth * (1 - faded(progress))
    is_ending = (trailing > 0) & (trailing < rule.expression_holds + rule.expression_fades)
    is_last = is_ending & (following >= FAR)
    return mouth, torch.where(is_last & (since > 0), ends, expression)


# Strength of the voice.


class Strength(nn.Module):
    """`deitalk.audio.vocal_strength.VocalStrength.follow` with the weights of the package."""

    def __init__(self) -> None:
        super().__init__()
        self.members: list[str] = []
        for name, value in vocal_strength().weights.items():
            _, number, part = name.split(".", 2)
            if number not in self.members:
                self.members.append(number)
            self.register_parameter(
                self._key(number, part), nn.Parameter(torch.from_numpy(value), requires_grad=False)
            )

    def forward(self, measured: Measured, voiced: Tensor, speech: Tensor) -> tuple[Tensor, Tensor]:
        """Strength of the recording (), and around each frame (T,), dB above the usual."""
        enough = speech.sum() >= FEWEST_FRAMES
        speaks = torch.where(enough, speech, torch.ones_like(speech))
        loud = torch.log(measured.bands + 1e-9) / math.log(10)
        power = torch.log(
            masked_mean((measured.bands + 1e-9).sum(dim=1), speaks).clamp_min(1e-12)
        ) / math.log(10)
        columns = (measured.pitch / 12 * voiced, voiced, measured.periodicity * speech, speech)
        rows = torch.cat(
            ((loud - power).clamp(LOWEST, HIGHEST), torch.stack(columns, dim=1)), dim=1
        )
        weight = speech.clamp_min(REST_WEIGHT)[:, None]
        read = [self._member(number, rows, weight) for number in self.members]
        whole = torch.stack([part[0] for part in read]).mean()
        blocks = torch.stack([part[1] for part in read]).mean(dim=0)
        place = (torch.arange(speech.shape[0]).float() + 0.5) / BLOCK_FRAMES - 0.5
        place = torch.minimum(place.clamp_min(0), torch.as_tensor(blocks.shape[0] - 1).float())
        below = place.floor().long()
        above = torch.minimum(below + 1, torch.as_tensor(blocks.shape[0] - 1))
        around = blocks[below] + (place - below.float()) * (blocks[above] - blocks[below])
        any_voiced = (voiced.sum() > 0).float()
        return whole * any_voiced, around * any_voiced

    def _key(self, number: str, part: str) -> str:
        return f"m{number}_{part.replace('.', '_')}"

    def _part(self, number: str, part: str) -> Tensor:
        found: Tensor = getattr(self, self._key(number, part))
        return found

    def _member(self, number: str, rows: Tensor, weight: Tensor) -> tuple[Tensor, Tensor]:
        x = (rows - self._part(number, "mean")) / self._part(number, "spread")
        direct = [self._linear(number, "direct", part) for part in self._pooled(x, weight)]
        x = self._layer(number, 0, x)
        for k in range(1, len(DILATIONS)):
            x = x + self._layer(number, k, x)
        both = zip(direct, self._pooled(x, weight), strict=True)
        found = [
            UNIT_DB
            * (first + self._linear(number, "output", F.gelu(self._linear(number, "hidden", then))))
            for first, then in both
        ]
        return found[0][0, 0], found[1][:, 0]

    def _linear(self, number: str, name: str, x: Tensor) -> Tensor:
        weight, bias = (self._part(number, f"{name}.{part}") for part in ("weight", "bias"))
        return x @ weight.T + bias

    def _layer(self, number: str, layer: int, x: Tensor) -> Tensor:
        weight, bias = (self._part(number, f"layers.{layer}.{k}") for k in ("weight", "bias"))
        dilation = DILATIONS[layer]
        padding = KERNEL // 2 * dilation
        out = F.conv1d(x.T[None], weight, bias, padding=padding, dilation=dilation)
        return F.gelu(out[0].T)

    def _pooled(self, x: Tensor, weight: Tensor) -> tuple[Tensor, Tensor]:
        """Mean and spread (N, 2 C) of all frames, and of the blocks with those around them."""
        reach = int(4 * AROUND_BLOCKS)
        steps = torch.arange(-reach, reach + 1).float()
        kernel = torch.exp(-0.5 * (steps / AROUND_BLOCKS) ** 2)[None, None]
        more = (x.shape[0] + BLOCK_FRAMES - 1) // BLOCK_FRAMES * BLOCK_FRAMES - x.shape[0]

        def near(rows: Tensor) -> Tensor:
            blocks = F.pad(rows, (0, 0, 0, more)).view(-1, BLOCK_FRAMES, rows.shape[1]).sum(dim=1)
            return F.conv1d(blocks.T[:, None], kernel, padding=reach)[:, 0].T

        def whole(rows: Tensor) -> Tensor:
            return rows.sum(dim=0, keepdim=True)

        # About a centre, without which squares of float32 would lose the spread.
        centre = whole(weight * x) / whole(weight)
        moved = x - centre
        found = []
        for sums in (whole, near):
            total = sums(weight)
            mean = sums(weight * moved) / total
            square = sums(weight * moved.square()) / total - mean.square()
            found.append(torch.cat((mean + centre, square.clamp_min(1e-4).sqrt()), dim=1))
        return found[0], found[1]


# Intensity of the voice.


class Heard(NamedTuple):
    """What is heard of a recording [shape=(T,)]."""

    speech: Tensor
    mouth: Tensor
    expression: Tensor
    voice: Tensor
    """Intensity of the voice, 0 to 1."""
    held: Tensor
    """Intensity that the emotional reading holds, 0 to 2."""
    opening: Tensor
    """Factor on the opening of the mouth."""


class ClipHearing(nn.Module):
    """What the rules of one model read of a recording.

    Parameters
    ----------
    controls : ControlSet
    rules : RulesConfig
    """

    usual: Tensor
    posing: Tensor

    def __init__(self, controls: ControlSet, rules: RulesConfig) -> None:
        super().__init__()
        self.rules = rules
        self.activity, self.prosody, self.strength = SpeechActivity(), MeasureProsody(), Strength()
        sizes = [getattr(rules.pose_size, name, 0.0) for name in EMOTIONS]
        constant(self, "usual", sizes)
        constant(self, "posing", np.asarray(ControlGroups(controls).posing, np.int64))

    def forward(
        self,
        sound: Tensor,
        speech: Tensor,
        network: Tensor,
        effort: Tensor | None,
        readings: tuple[Tensor, Tensor],
        emotion: Tensor,
    ) -> Heard:
        """Hear a recording.

        Parameters
        ----------
        sound : Tensor [shape=(S,)]
            16 kHz, any level.
        speech : Tensor [shape=(T,)]
            From `SpeechActivity`.
        network, effort : Tensor [shape=(T,)]
            What the network predicts: intensity, and strength of the voice or None.
        readings : tuple of Tensor [shape=(T, C)]
            Neutral and emotional.
        emotion : Tensor [shape=(T, 5)]
            Weights of the trained emotions.
        """
        rule, n_frames = self.rules.voice_intensity, speech.shape[0]
        mouth, expression = gates_of(speech, self.rules.gates)
        voice, take = network, torch.zeros(())
        if rule is not None:
            windows = frame_windows(sound, n_frames, nearest=True)
            measured = self.prosody(windows)
            loudest = masked_percentile(measured.level, torch.ones_like(measured.level), 95)
            active = measured.level > loudest - ACTIVE_DB
            voiced = (active & (measured.periodicity > VOICED)).float()
            whole, around = self._strengths(measured, voiced, speech, effort)
            take = MOST_TAKE * torch.tanh(rule.strength_weight * whole / MOST_TAKE)
            voice = voice_intensity(network, measured, voiced, speech, around, rule)
        held = self._held(network, readings, emotion, speech)
        near, usual = mean_around(voice, speech), mean_around(network, speech)
        opening = opening_factor(self.rules.scale_opening, near, usual, take)
        return Heard(speech, mouth, expression, voice, held, opening)

    def _strengths(
        self, measured: Measured, voiced: Tensor, speech: Tensor, effort: Tensor | None
    ) -> tuple[Tensor, Tensor]:
        """`deitalk.pipeline.speech.Speech.strengths`."""
        whole, around = self.strength(measured, voiced, speech)
        strength = whole
        if effort is not None:
            near = smoothed(speech * effort, EFFORT_FRAMES)
            near = near / smoothed(speech, EFFORT_FRAMES).clamp_min(1e-6)
            strength = whole + EFFORT_SHARE * (masked_mean(effort, speech) - whole)
            around = around + EFFORT_SHARE * (near - around)
        rows = strength + AROUND_WEIGHT * (around - masked_mean(around, speech))
        speaks = speech.sum() > 0
        return torch.where(speaks, strength, whole), torch.where(
            speaks, rows, whole.expand_as(rows)
        )

    def _held(
        self, network: Tensor, readings: tuple[Tensor, Tensor], emotion: Tensor, speech: Tensor
    ) -> Tensor:
        """`deitalk.postprocess.factors.held_intensity`."""
        rule: PoseSize | None = self.rules.pose_size
        if rule is None:
            return network
        neutral, emotional = (part.index_select(1, self.posing) for part in readings)
        size = mean_around((emotional - neutral).abs().sum(dim=1), speech)
        change = size / ((emotion @ self.usual) * network).clamp_min(1e-6)
        pure = (2 * (emotion * (self.usual > 0).float()).amax(dim=1) - 1).clamp(0, 1)
        held = network * change.clamp(1 / MOST_RESIZED, MOST_RESIZED) ** pure
        return torch.where(speech.sum() > 0, held, network)


def opening_factor(
    rule: ScaleOpening | None, voice: Tensor, network: Tensor, take: Tensor
) -> Tensor:
    """`deitalk.postprocess.factors.opening_factor`."""
    if rule is None:
        return torch.ones_like(voice)
    ratio = (1 + rule.gain * (voice - rule.usual)) / (1 + rule.gain * (network - rule.usual))
    return ratio * (1 + rule.take * take).clamp_min(0)


def expression_scale(applied: Tensor, held: Tensor) -> Tensor:
    """`deitalk.postprocess.factors.expression_scale`."""
    return applied / held.clamp_min(LEAST_PREDICTED)


def voice_intensity(
    network: Tensor,
    measured: Measured,
    voiced: Tensor,
    speech: Tensor,
    strength: Tensor,
    rule: VoiceIntensity,
) -> Tensor:
    """`deitalk.postprocess.voice_intensity.voice_intensity`; all are (T,)."""
    base = MOST_BASE * torch.tanh(rule.strength_weight * strength / MOST_BASE)
    z = _variation(network, measured, voiced, speech, rule) + base
    # The mean intensity of the take is that of its base.
    mean = masked_mean(_intensity(base), speech)
    low, high = torch.full((), -2 * MOST_VARIATION), torch.full((), 2 * MOST_VARIATION)
    for _ in range(math.ceil(math.log2(4 * MOST_VARIATION / 1e-6))):
        middle = (low + high) / 2
        is_more = masked_mean(_intensity(z + middle), speech) > mean
        low, high = torch.where(is_more, low, middle), torch.where(is_more, middle, high)
    found = _decayed(_intensity(z + low), speech)
    return torch.where((voiced.sum() > 0) & (speech.sum() > 0), found, network)


def deviation(intensity: Tensor) -> Tensor:
    """`deitalk.postprocess.voice_intensity.deviation`."""
    share = ((intensity - FAINTEST) / (1 - FAINTEST)).clamp(1e-3, 1 - 1e-3)
    return torch.log(share / (1 - share)) / STEEPNESS


def _intensity(z: Tensor) -> Tensor:
    return FAINTEST + (1 - FAINTEST) * torch.sigmoid(STEEPNESS * z)


def _centred(track: Tensor, used: Tensor) -> Tensor:
    beside = mean_beside(track, used, SMOOTHING_FRAMES)
    return beside - masked_mean(beside, used)


def _variation(
    network: Tensor, measured: Measured, voiced: Tensor, speech: Tensor, rule: VoiceIntensity
) -> Tensor:
    deepest = masked_percentile(measured.level, speech, 95) - DEEPEST_DB
    index = LEVEL_SHARE / LEVEL_DB * _centred(torch.maximum(measured.level, deepest), speech)
    toned = voiced * speech * (measured.tilt < BRIGHTEST_DB).float()
    middle = masked_percentile(measured.pitch, toned, 50)
    toned = toned * ((measured.pitch - middle).abs() <= FURTHEST_SEMITONES).float()
    enough = (toned.sum() >= FEWEST_VOICED).float()
    for track, unit in ((measured.pitch, PITCH_SEMITONES), (measured.tilt, TILT_DB)):
        tone = ((track - masked_mean(track, toned)) / unit).clamp(-MOST_TONE, MOST_TONE)
        index = index + enough * TONE_SHARE * mean_beside(tone, toned, SMOOTHING_FRAMES)
    z = NETWORK_WEIGHT * _centred(deviation(network), speech) + rule.index_weight * index
    limited = MOST_VARIATION * torch.tanh(z / MOST_VARIATION)
    return limited - NEAR_SHARE * mean_beside(limited, speech, NEAR_FRAMES)


def _decayed(intensity: Tensor, speech: Tensor) -> Tensor:
    last, following = neighbours(speech)
    frames, end = torch.arange(speech.shape[0]), torch.as_tensor(speech.shape[0] - 1)
    is_after, is_before = following < FAR, last >= 0
    left = torch.where(is_before, last, following).clamp_min(0)
    right = torch.where(is_after, following, last)
    left, right = torch.minimum(left, end), torch.minimum(right.clamp_min(0), end)
    share = (frames - left).float() / (right - left).clamp_min(1).float()
    held = intensity[left] + share * (intensity[right] - intensity[left])
    fall = torch.where(is_after, torch.full((), FALL_FRAMES), torch.full((), END_FRAMES))
    since, until = (frames - last).float(), (following - frames).float()
    kept = torch.maximum(torch.exp(-since / fall), torch.exp(-until / RISE_FRAMES))
    return torch.where(speech > 0, intensity, FAINTEST + (held - FAINTEST) * kept)
