"""What is heard of a whole recording, as operators of a graph.

The functions of `deitalk.audio.voice_activity`, `deitalk.audio.held_sound`,
`deitalk.audio.vocal_strength` and `deitalk.postprocess.feeling`, which say what each step is for
and hold its numbers, in torch: without loops over frames, and by operators that every runtime of
ONNX has. Tests hold both to the same values.

Letters: S samples, T frames, K frequency bands, W samples of a window.
"""

import math
from typing import NamedTuple, cast

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional as F

from deitalk.audio.frames import FRAME_RATE, SAMPLE_RATE
from deitalk.audio.held_sound import (
    BEFORE,
    DEPTH_DB,
    EARLY,
    GOES_ON,
    LAG,
    PERIODIC,
    POSE,
    SMOOTHED,
)
from deitalk.audio.prosody import (
    ACTIVE_DB,
    BAND_EDGES_HZ,
    BANDS,
    LEVEL_DB,
    LONGEST,
    PITCH_SEMITONES,
    SHORTEST,
    TILT_DB,
    VOICED,
    WINDOW,
)
from deitalk.audio.vocal_strength import (
    AROUND_BLOCKS,
    BLOCK_FRAMES,
    DILATIONS,
    FEWEST_FRAMES,
    HIGHEST,
    KERNEL,
    LOWEST,
    REST_WEIGHT,
    UNIT_DB,
    vocal_strength,
)
from deitalk.audio.voice_activity import BAND_EDGES_HZ as ACTIVITY_EDGES_HZ
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
from deitalk.config.rules import (
    Expressions,
    Gates,
    HoldPose,
    RulesConfig,
    ScaleOpening,
    VoiceIntensity,
)
from deitalk.models.onnx.spectra import SpectralPower
from deitalk.pipeline.speech import (
    EFFORT_FRAMES,
    EFFORT_SHARE,
    PHRASE_FRAMES,
    WITHIN_SHARE,
)
from deitalk.postprocess.expressions import expression_table
from deitalk.postprocess.factors import (
    AROUND_FRAMES,
    FAINT_SIZE,
    LEARNT_GAIN,
    LEARNT_USUAL,
    LEAST_PREDICTED,
    MOST_HELD,
    UPPER,
)
from deitalk.postprocess.feeling import (
    BRIGHTEST_DB,
    DEEPEST_DB,
    FAINTEST,
    FEWEST_VOICED,
    FURTHEST_SEMITONES,
    LEVEL_SHARE,
    MOST,
    MOST_DISPLAY,
    MOST_TONE,
    NETWORK_SHARE,
    PAUSE_FRAMES,
    READY_FRAMES,
    SMOOTHING_FRAMES,
    STEEPNESS,
    TONE_SHARE,
)
from deitalk.postprocess.torch_columns import constant
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
    frames = torch.arange(cast(int, n_frames)) * SAMPLE_RATE
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
    """Prosody of frames, as `deitalk.audio.prosody.Prosody` [shape=(..., T)]."""

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

    @property
    def tone(self) -> Tensor:
        """`deitalk.audio.prosody.tonality`."""
        highest = 12 * math.log2(SAMPLE_RATE / SHORTEST / 100)
        return self.periodicity * (self.pitch < highest - 1e-3).float()


class MeasureProsody(nn.Module):
    """`deitalk.audio.prosody.measure_windows`."""

    window: Tensor
    sums: Tensor
    weight: Tensor

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
        weight = np.full((bins, 1), 2.0)
        weight[[0, -1]] = 1
        unused = ((0, self.power.bins - bins), (0, 0))
        sums = np.concatenate(columns, axis=1).astype(float)
        constant(self, "window", np.hanning(WINDOW))
        constant(self, "sums", np.pad(sums, unused))
        constant(self, "weight", np.pad(weight / FFT, unused))

    def forward(self, windows: Tensor) -> Measured:
        """Measures of windows (T, W)."""
        power = self.power(windows * self.window)
        mean, bright, dark, bands = torch.split(power @ self.sums, [1, 1, 1, BANDS], dim=-1)
        # Inverse transform, of whole numbers of turns: not a table, which the file would hold.
        turns = torch.arange(power.shape[1])[:, None] * torch.arange(LONGEST) % FFT
        correlation = power @ (torch.cos(turns.float() * (2 * math.pi / FFT)) * self.weight)
        correlation = correlation / (correlation[..., :1] + 1e-12)
        periodicity, lag = correlation[..., SHORTEST:].max(dim=-1)
        pitch = 12 / math.log(2) * torch.log(SAMPLE_RATE / 100 / (lag + SHORTEST).float())
        level = decibels(mean)[..., 0]
        return Measured(level, bright[..., 0], dark[..., 0], pitch, periodicity, bands)


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

    def __init__(self, prosody: MeasureProsody) -> None:
        super().__init__()
        self.levels, self.prosody = BandLevels(), prosody

    def forward(self, sound: Tensor, n_frames: Tensor | int) -> tuple[Tensor, Tensor]:
        """Frames with speech: 1, all others 0 (T,); and the levels of bands (T, K)."""
        windows, rule = frame_windows(sound, n_frames, nearest=False), HoldPose()
        levels = self.levels(windows)
        _, sounding = follow_held(levels, self.prosody(windows).tone, rule)
        held = torch.maximum(sounding, begins(sounding, BEFORE + rule.frames))
        excess = torch.topk(levels - self._floor(levels, held), TOP_BANDS, dim=1)[0].mean(dim=1)
        excess = torch.where(held > 0, excess.clamp_min(OPEN_DB), excess)
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
        return torch.where(self._is_short(sound), speech, paired), levels

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

    def _floor(self, levels: Tensor, held: Tensor) -> Tensor:
        """Level per band (T, K) above which there is more than noise, dB."""
        half = round(FLOOR_SECONDS * FRAME_RATE / 2)
        hop, total = half // 3, torch.as_tensor(levels.shape[0])
        number = torch.arange((levels.shape[0] + hop - 1) // hop + 1)
        centres = torch.minimum(number * hop, total - 1)  # the last frame too
        places = centres + torch.arange(-half, half)[:, None]  # (2 half, N)
        inside = ((places >= 0) & (places < total)).long()
        places = torch.minimum(places.clamp_min(0), total - 1)
        inside = inside * (1 - held[places].long())
        rows = levels[places]  # (2 half, N, K)
        used = inside[:, :, None].expand_as(rows)
        lowest = masked_percentile(rows, used, FLOOR_PERCENTILE)  # (N, K)
        quiet = torch.full_like(lowest, SHORT_FLOOR_DB - OPEN_DB)
        lowest = torch.where(inside.sum(dim=0)[:, None] > 0, lowest, quiet)
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


def begins(flags: Tensor, count: int) -> Tensor:
    """1 at the `count` frames before each run of flags (T,)."""
    starts = flags * (1 - F.pad(flags, (1, 0))[:-1])
    following = neighbours(starts)[1] - torch.arange(flags.shape[0])
    return (following <= count).float()


# Held sounds.


def change_of(rows: Tensor) -> Tensor:
    """Mean difference of smoothed bands from those `LAG` frames before, dB.

    Rows (B, BEFORE + n, K); the result is (B, n).
    """
    shapes = (rows - rows.amax(dim=2, keepdim=True)).clamp_min(-DEPTH_DB)
    length = rows.shape[1] - SMOOTHED + 1
    smooth = shapes[:, :length]
    for k in range(1, SMOOTHED):
        smooth = smooth + shapes[:, k : length + k]
    smooth = smooth / SMOOTHED
    return (smooth[:, LAG:] - smooth[:, :-LAG]).abs().mean(dim=2)


def follow_held(
    levels: Tensor, tones: Tensor, rule: HoldPose
) -> tuple[tuple[Tensor, Tensor], Tensor]:
    """`deitalk.audio.held_sound.held_sound` of levels (T, K) and tones (T,).

    Returns
    -------
    (back, share), sounding
        [shape=(T,)] each: frames since the pose that is kept, its share, and 1 where a sound is
        held.
    """
    total = levels.shape[0]
    rows = torch.cat((levels[:1].expand(BEFORE, -1), levels, levels[-1:].expand(EARLY, -1)))
    frames = torch.arange(total + EARLY)
    # Before the first frame there is none: the first frames are not steady.
    steady = (change_of(rows[None])[0] <= rule.steady_db) & (frames >= BEFORE)
    steady = steady & (F.pad(tones, (0, EARLY)) > PERIODIC)
    age = frames - neighbours((~steady).float())[0].clamp_min(-1)
    sounding = (age >= rule.frames).float()
    last = neighbours(sounding)[0]
    before = F.pad(last + FAR, (1, 0))[:-1] - FAR  # last held frame before each frame
    is_onset = (sounding > 0) & (age == rule.frames) & (frames - before > GOES_ON)
    onset = neighbours(is_onset.float())[0]
    back = frames - onset + rule.frames + BEFORE - POSE - EARLY
    risen = ((age - rule.frames + 1).float() / rule.leaves).clamp_max(1)
    since = frames - last
    risen = risen[last.clamp_min(0)] * (last >= 0).float()
    share = risen * (1 - since.float() / rule.leaves).clamp(0, 1)
    back = torch.where((since <= GOES_ON) & (onset >= 0), back, torch.zeros_like(back))
    back, share, frames = back[EARLY:], share[EARLY:], frames[:total]
    # The pose is kept from its own frame on, with the most that its sound shows.
    runs = (back > 0).float()
    starts = runs * (1 - F.pad(runs, (1, 0))[:-1])
    levels_of = torch.round(share * rule.leaves**2).long()  # exact, as shares are
    number = torch.cumsum(starts.long(), dim=0) * (rule.leaves**2 + 1)
    most = running_most(torch.where(runs > 0, levels_of + number, torch.zeros_like(number)))
    rising = most - number
    backwards = running_most(torch.where(runs > 0, levels_of - number, -number - 1).flip(0)).flip(0)
    whole = torch.maximum(rising, backwards + number)
    top = (whole.float() / rule.leaves**2) * runs
    share = torch.where((runs > 0) & (rising < whole), top, share)
    start = neighbours(starts)[1]
    place = start.clamp_max(total - 1)
    pose = (place - back[place]).clamp_min(0)
    is_before = (start < FAR) & (frames >= pose) & (frames < start)
    back = torch.where(is_before, frames - pose, back)
    share = torch.where(is_before, top[place], share)
    return (back.float(), share), sounding[:total]


def running_most(values: Tensor) -> Tensor:
    """Largest of the values (T,) up to each, for up to 2^17 frames, an hour."""
    for k in range(17):
        none = (0 * values[:1] - (1 << 40)).expand(1 << k)
        earlier = torch.cat((none, values))[: values.shape[0]]
        values = torch.maximum(values, earlier)
    return values


def faded(progress: Tensor) -> Tensor:
    """`deitalk.postprocess.feeling.fade`."""
    return 0.5 + 0.5 * torch.cos(math.pi * progress.clamp(0, 1))


def expression_after(since: Tensor, until: Tensor, rest: Tensor, rule: Gates) -> Tensor:
    """`deitalk.postprocess.feeling.expression_after`."""
    kept = rest + (1 - rest) * torch.exp(-since / rule.feeling_decays)
    beyond = torch.minimum(since, until) - rule.feeling_leaves
    return kept * faded(beyond / (2 * rule.feeling_decays))


def gates_of(speech: Tensor, rest: Tensor, rule: Gates | None) -> tuple[Tensor, Tensor]:
    """Gate of the mouth and share of the expression (T,), of which `rest` (T,) stays."""
    if rule is None:
        return torch.ones_like(speech), torch.ones_like(speech)
    last, following = neighbours(speech)
    frames = torch.arange(speech.shape[0])
    since, until = (frames - last).float(), (following - frames).float()
    mouth = torch.maximum(
        faded(since / (rule.mouth_closes + 1)), faded(until / (rule.mouth_opens + 1))
    )
    rising = faded((until - READY_FRAMES) / (rule.feeling_rises + 1))
    return mouth, torch.maximum(expression_after(since, until, rest, rule), rising)


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

    mouth: Tensor
    expression: Tensor
    """Share of the expression."""
    voice: Tensor
    """Intensity of the voice, 0 to 1.2."""
    opening: Tensor
    """Factor on the opening of the mouth."""
    back: Tensor
    """Frames since the pose that a held sound keeps."""
    kept: Tensor
    """Share of that pose."""


class ClipHearing(nn.Module):
    """What the rules of one model read of a recording.

    Parameters
    ----------
    rules : RulesConfig
    """

    def __init__(self, rules: RulesConfig) -> None:
        super().__init__()
        self.rules = rules
        self.prosody, self.strength = MeasureProsody(), Strength()
        self.activity = SpeechActivity(self.prosody)

    def forward(
        self,
        sound: Tensor,
        activity: tuple[Tensor, Tensor],
        rest: Tensor,
        network: Tensor,
        effort: Tensor | None,
    ) -> Heard:
        """Hear a recording.

        Parameters
        ----------
        sound : Tensor [shape=(S,)]
            16 kHz, any level.
        activity : tuple of Tensor
            From `SpeechActivity`.
        rest : Tensor [shape=(T,)]
            Share of the expression that stays in silence.
        network, effort : Tensor [shape=(T,)]
            What the network predicts: intensity, and strength of the voice or None.
        """
        rule, (speech, levels) = self.rules.voice_intensity, activity
        mouth, expression = gates_of(speech, rest, self.rules.gates)
        measured = self.prosody(frame_windows(sound, speech.shape[0], nearest=True))
        (back, kept), _ = follow_held(levels, measured.tone, self.rules.hold_pose or HoldPose())
        voice = network
        if rule is not None:
            loudest = masked_percentile(measured.level, torch.ones_like(measured.level), 95)
            active = measured.level > loudest - ACTIVE_DB
            voiced = (active & (measured.periodicity > VOICED)).float()
            around = self._strengths(measured, voiced, speech, effort)
            voice = voice_intensity(network, measured, voiced, speech, around, rule)
        near, usual = mean_around(voice, speech), mean_around(network, speech)
        opening = opening_factor(self.rules.scale_opening, near, usual)
        return Heard(mouth, expression, voice, opening, back, kept)

    def _strengths(
        self, measured: Measured, voiced: Tensor, speech: Tensor, effort: Tensor | None
    ) -> Tensor:
        """`deitalk.pipeline.speech.Speech.strengths` of each frame (T,)."""
        strength, around = self.strength(measured, voiced, speech)
        whole, exact = strength, around
        if effort is not None:
            near = smoothed(speech * effort, EFFORT_FRAMES)
            near = near / smoothed(speech, EFFORT_FRAMES).clamp_min(1e-6)
            strength = whole + EFFORT_SHARE * (masked_mean(effort, speech) - whole)
            exact = around + EFFORT_SHARE * (effort - around)
            around = around + EFFORT_SHARE * (near - around)
        phrase = Phrases(speech)
        share = phrase.sums(speech) / (phrase.sums(speech) + PHRASE_FRAMES)
        changed = share * (phrase.mean(exact) - strength)
        changed = changed + WITHIN_SHARE * (around - phrase.mean(around))
        rows = strength + phrase.inside * changed
        return torch.where(speech.sum() > 0, rows, whole.expand_as(rows))


class Phrases:
    """`deitalk.postprocess.feeling.phrases` of frames of speech (T,).

    Attributes
    ----------
    inside : Tensor [shape=(T,)]
        1 within a phrase.
    """

    def __init__(self, speech: Tensor) -> None:
        last, following = neighbours(speech)
        is_short = (following - last - 1 <= PAUSE_FRAMES) & (last >= 0) & (following < FAR)
        self.speech, self.inside = speech, torch.maximum(speech, is_short.float())
        beside = F.pad(self.inside, (1, 1))
        starts, ends = (self.inside * (1 - part) for part in (beside[:-2], beside[2:]))
        end = torch.as_tensor(speech.shape[0] - 1)
        self.start = torch.minimum(neighbours(starts)[0].clamp_min(0), end)
        self.end = torch.minimum(neighbours(ends)[1], end)

    def sums(self, values: Tensor) -> Tensor:
        """Sum of the values (T,) at the speech of each frame's phrase."""
        total = F.pad(torch.cumsum((values * self.speech).double(), dim=0), (1, 0))
        return (total[self.end + 1] - total[self.start]).float()

    def mean(self, values: Tensor) -> Tensor:
        """Their mean."""
        return self.sums(values) / self.sums(self.speech).clamp_min(1)


class HeldIntensity(nn.Module):
    """`deitalk.postprocess.factors.held_intensity`.

    Parameters
    ----------
    rule : Expressions or None
    controls : ControlSet
    """

    columns: Tensor
    taught: Tensor
    changed: Tensor

    def __init__(self, rule: Expressions | None, controls: ControlSet) -> None:
        super().__init__()
        table = expression_table(controls.names, () if rule is None else rule.captured)
        names = [controls.names[place] for place in table.places]
        upper = [k for k, name in enumerate(names) if any(part in name for part in UPPER)]
        self.is_on = rule is not None and bool(upper)
        size = 1.0 if rule is None else rule.size
        constant(self, "columns", np.asarray(table.places[upper], np.int64))
        constant(self, "taught", size * table.taught[:, upper])
        constant(self, "changed", table.changed[:, None])

    def forward(
        self, neutral: Tensor, emotional: Tensor, weights: Tensor, network: Tensor
    ) -> Tensor:
        """Intensity (...) of readings (..., C), emotions (..., 9) and the predicted one (...)."""
        if not self.is_on:
            return network
        usual = (weights @ self.taught).abs().sum(dim=-1)
        size = (emotional - neutral).index_select(-1, self.columns).abs().sum(dim=-1)
        found = (size / usual.clamp_min(1e-6)).clamp(0, MOST_HELD)
        taught = (usual / FAINT_SIZE).clamp(0, 1) * (weights @ self.changed)[..., 0]
        return network + taught * (found - network)


def opening_factor(rule: ScaleOpening | None, voice: Tensor, network: Tensor) -> Tensor:
    """`deitalk.postprocess.factors.opening_factor`."""
    if rule is None:
        return torch.ones_like(voice)
    opened = 1 + rule.gain * (voice - rule.usual)
    return opened / (1 + LEARNT_GAIN * (network - LEARNT_USUAL))


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
    """`deitalk.postprocess.feeling.voice_intensity`; all are (T,)."""
    state = rule.per_decibel * (strength - rule.middle)
    near = (2 * smoothed(speech, SMOOTHING_FRAMES)).clamp_max(1)
    display = _display(network, measured, voiced, speech)
    found = between(state, speech) + rule.display * near * display
    usual = torch.full_like(state, -rule.per_decibel * rule.middle)
    return MOST * torch.sigmoid(torch.where(speech.sum() > 0, found, usual))


def between(values: Tensor, used: Tensor) -> Tensor:
    """Values (T,) of the used frames, and those between by straight lines."""
    last, following = neighbours(used)
    frames, end = torch.arange(used.shape[0]), torch.as_tensor(used.shape[0] - 1)
    left = torch.where(last >= 0, last, following)
    right = torch.where(following < FAR, following, last)
    left, right = (torch.minimum(place.clamp_min(0), end) for place in (left, right))
    share = (frames - left).float() / (right - left).clamp_min(1).float()
    return values[left] + share * (values[right] - values[left])


def limited(display: Tensor) -> Tensor:
    """`deitalk.postprocess.feeling.limited`."""
    return MOST_DISPLAY * torch.tanh(display / MOST_DISPLAY)


def deviation(intensity: Tensor) -> Tensor:
    """`deitalk.postprocess.feeling.deviation`."""
    share = ((intensity - FAINTEST) / (1 - FAINTEST)).clamp(1e-3, 1 - 1e-3)
    return torch.log(share / (1 - share)) / STEEPNESS


def _centred(track: Tensor, used: Tensor) -> Tensor:
    beside = mean_beside(track, used, SMOOTHING_FRAMES)
    return beside - masked_mean(beside, used)


def _display(network: Tensor, measured: Measured, voiced: Tensor, speech: Tensor) -> Tensor:
    """Standard deviations of every frame about its phrase's mean, limited."""
    deepest = masked_percentile(measured.level, speech, 95) - DEEPEST_DB
    z = NETWORK_SHARE * _centred(deviation(network), speech)
    z = z + LEVEL_SHARE / LEVEL_DB * _centred(torch.maximum(measured.level, deepest), speech)
    toned = voiced * speech * (measured.tilt < BRIGHTEST_DB).float()
    middle = masked_percentile(measured.pitch, toned, 50)
    toned = toned * ((measured.pitch - middle).abs() <= FURTHEST_SEMITONES).float()
    enough = (toned.sum() >= FEWEST_VOICED).float()
    for track, unit in ((measured.pitch, PITCH_SEMITONES), (measured.tilt, TILT_DB)):
        tone = ((track - masked_mean(track, toned)) / unit).clamp(-MOST_TONE, MOST_TONE)
        z = z + enough * TONE_SHARE * mean_beside(tone, toned, SMOOTHING_FRAMES)
    z, phrases = limited(z), Phrases(speech)
    return z - phrases.inside * phrases.mean(z)
