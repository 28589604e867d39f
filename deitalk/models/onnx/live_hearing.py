"""What is heard of voices that have not ended, as operators of a graph; a frame a call.

`deitalk.live.hearing`, `deitalk.live.activity` and `deitalk.live.intensity` in torch; they say what
each step is for and hold its numbers. Tests hold both to the same values.

Letters: B streams, K frequency bands, W samples of a window.
"""

import math
from typing import NamedTuple

import torch
from torch import Tensor, nn

from deitalk.audio.vocal_strength import (
    LEVEL_DB,
    PITCH_SEMITONES,
    TILT_DB,
    VOICED,
)
from deitalk.audio.voice_activity import (
    CLEAN_DB,
    FLOOR_PERCENTILE,
    KEEP_DB,
    LONGEST_CLOSURE,
    LONGEST_DROWNED,
    NOISY_DB,
    OPEN_DB,
    SHORT_FLOOR_DB,
    SPEECH_RANGE_DB,
    TOP_BANDS,
)
from deitalk.config.rules import Gates, RulesConfig, VoiceIntensity
from deitalk.live.activity import (
    FLOOR_FRAMES,
    GATE_AHEAD,
    LOUD_PERCENTILE,
    LOUDEST_PERCENTILE,
    QUIET_ROWS,
    RunningActivity,
)
from deitalk.live.hearing import MEASURED_AHEAD
from deitalk.live.intensity import (
    AROUND_SMOOTHING,
    FORGET_FRAMES,
    MOST_LEVEL,
    SMOOTHING,
    USUAL_FRAMES,
)
from deitalk.models.onnx.clip_hearing import (
    BandLevels,
    MeasureProsody,
    deviation,
    faded,
    opening_factor,
)
from deitalk.postprocess.voice_intensity import (
    AROUND_WEIGHT,
    BRIGHTEST_DB,
    FAINTEST,
    FALL_FRAMES,
    FURTHEST_SEMITONES,
    LEVEL_SHARE,
    MOST_BASE,
    MOST_TONE,
    MOST_VARIATION,
    NEAR_SHARE,
    NETWORK_WEIGHT,
    RISE_FRAMES,
    STEEPNESS,
    TONE_SHARE,
)

NONE_DB = 1e9
"""Level of frames that have not come."""
MEASURES = 4
"""Level, tilt, pitch and periodicity."""


class HearingState(NamedTuple):
    """What is kept of streams between two calls."""

    levels: Tensor
    """Band levels of the last frames, the oldest first [shape=(B, FLOOR_FRAMES, K)]."""
    excess: Tensor
    """[shape=(B, FLOOR_FRAMES)]."""
    floor: Tensor
    """[shape=(B, K)]."""
    gap: Tensor
    """[shape=(B, GATE_AHEAD + 1)]."""
    on: Tensor
    """Which of the last frames are speech, 1 or 0 [shape=(B, P)]."""
    measured: Tensor
    """Measures of the frames whose rows are to come [shape=(B, MEASURED_AHEAD, MEASURES)]."""


class SpokenState(NamedTuple):
    """What is kept of the frames that the network has read."""

    near: Tensor
    """Means of the voice's and of the network's intensity [shape=(B, 2)]."""
    means: Tensor
    """[shape=(B, 5)]."""
    weights: Tensor
    """[shape=(B, 5)]."""
    values: Tensor
    """[shape=(B, 4)]."""


class LiveHeard(NamedTuple):
    """What is heard at a row of the network, and the gates of the frame that comes out."""

    intensity: Tensor
    """[shape=(B,)], as the others."""
    opening: Tensor
    mouth: Tensor
    expression: Tensor


def percentile(ordered: Tensor, count: Tensor, percent: float) -> Tensor:
    """Percentile along the second axis of values in their order, `count` (B, 1, ...) of them."""
    last = (count - 1).clamp_min(0)
    place = last * (percent / 100)
    below = place.floor()
    shape = (ordered.shape[0], 1, *ordered.shape[2:])
    low, high = (
        torch.gather(ordered, 1, k.long().expand(shape))
        for k in (below, torch.minimum(below + 1, last))
    )
    return (low + (place - below) * (high - low))[:, 0]


class LiveHearing(nn.Module):
    """`deitalk.live.hearing.RunningHearing` with the rules of one model.

    Parameters
    ----------
    rules : RulesConfig
    """

    def __init__(self, rules: RulesConfig) -> None:
        super().__init__()
        self.rules, self.past = rules, RunningActivity(rules.gates).past
        self.levels, self.prosody = BandLevels(), MeasureProsody()
        self.n_bands = self.levels.bands.shape[1]

    def first(self, batch: int) -> tuple[HearingState, SpokenState]:
        """State of streams before their first frame."""
        quiet = SHORT_FLOOR_DB - OPEN_DB
        levels = torch.full((batch, FLOOR_FRAMES, self.n_bands), NONE_DB)
        levels[:, -QUIET_ROWS:] = quiet
        usual = 0.0 if self.rules.scale_opening is None else self.rules.scale_opening.usual
        weights = torch.tensor([USUAL_FRAMES, 0, 0, 0, USUAL_FRAMES]).repeat(batch, 1)
        return (
            HearingState(
                levels,
                torch.full((batch, FLOOR_FRAMES), NONE_DB),
                torch.full((batch, self.n_bands), quiet),
                torch.full((batch, GATE_AHEAD + 1), float(LONGEST_CLOSURE)),
                torch.zeros(batch, self.past),
                torch.zeros(batch, MEASURED_AHEAD, MEASURES),
            ),
            SpokenState(
                torch.full((batch, 2), usual),
                torch.zeros(batch, 5),
                weights,
                torch.zeros(batch, 4),
            ),
        )

    def forward(
        self,
        window: Tensor,
        due: Tensor,
        network: Tensor,
        effort: Tensor,
        state: tuple[HearingState, SpokenState],
    ) -> tuple[LiveHeard, tuple[HearingState, SpokenState]]:
        """Hear the next frame.

        Parameters
        ----------
        window : Tensor [shape=(B, W)]
            Sound of the frame that is `MEASURED_AHEAD` after the network's row.
        due : Tensor [shape=(B,)]
            1 at frames whose noise floor is measured.
        network, effort : Tensor [shape=(B,)]
            Of the row: predicted intensity, and strength of the voice.
        state
            From `first`, or from the call before.
        """
        before, spoken = state
        on, gap, kept = self._activity(self.levels(window), due, before)
        flags = torch.cat((before.on, on[:, None]), dim=1)
        mouth, expression = self._gates(flags, gap)
        measured = self.prosody(window)
        row = before.measured[:, 0]
        place = -1 - MEASURED_AHEAD
        beside = torch.maximum(flags[:, place - 1], flags[:, place + 1])
        speaking = flags[:, place] * beside
        voice, moved = network, spoken
        if self.rules.voice_intensity is not None:
            voice, moved = self._intensity(network, row, speaking, effort, spoken)
        both = torch.stack((voice, network), dim=1)
        near = spoken.near + AROUND_SMOOTHING * speaking[:, None] * (both - spoken.near)
        opening = opening_factor(self.rules.scale_opening, near[:, 0], near[:, 1], torch.zeros(()))
        new = torch.stack(
            (measured.level, measured.tilt, measured.pitch, measured.periodicity), dim=1
        )
        kept = kept._replace(
            on=flags[:, 1:], measured=torch.cat((before.measured[:, 1:], new[:, None]), dim=1)
        )
        heard = LiveHeard(voice, opening, mouth, expression)
        return heard, (kept, moved._replace(near=near))

    def _activity(
        self, levels: Tensor, due: Tensor, state: HearingState
    ) -> tuple[Tensor, Tensor, HearingState]:
        """Whether the frame is speech, the gap that was bridged then, and what is kept."""
        excess = torch.topk(levels - state.floor, TOP_BANDS, dim=1)[0].mean(dim=1)
        was_on = state.on[:, -1]
        on = (excess >= KEEP_DB + (OPEN_DB - KEEP_DB) * (1 - was_on)).to(levels.dtype)
        ring = torch.cat((state.levels[:, 1:], levels[:, None]), dim=1)
        above = torch.cat((state.excess[:, 1:], excess[:, None]), dim=1)
        known = (ring[..., :1] < NONE_DB).to(levels.dtype).sum(dim=1, keepdim=True)
        highest = torch.sort(ring.amax(dim=2), dim=1)[0]
        loudest = percentile(highest, known[..., 0], LOUDEST_PERCENTILE) - SPEECH_RANGE_DB
        lowest = percentile(torch.sort(ring, dim=1)[0], known, FLOOR_PERCENTILE)
        floor = torch.maximum(lowest, loudest[:, None])
        frames = (above < NONE_DB).to(levels.dtype).sum(dim=1, keepdim=True)
        loud = percentile(torch.sort(above, dim=1)[0], frames, LOUD_PERCENTILE)
        share = ((loud - NOISY_DB) / (CLEAN_DB - NOISY_DB)).clamp(0, 1)
        gap = torch.round(LONGEST_DROWNED + share * (LONGEST_CLOSURE - LONGEST_DROWNED))
        is_due = due > 0
        floor = torch.where(is_due[:, None], floor, state.floor)
        gaps = torch.cat(
            (state.gap[:, 1:], torch.where(is_due, gap, state.gap[:, -1])[:, None]), dim=1
        )
        return on, state.gap[:, 0], state._replace(levels=ring, excess=above, floor=floor, gap=gaps)

    def _gates(self, flags: Tensor, gap: Tensor) -> tuple[Tensor, Tensor]:
        """Gates of the frame `GATE_AHEAD` before the last of the flags (B, P + 1)."""
        rule: Gates | None = self.rules.gates
        if rule is None:
            return torch.ones_like(gap), torch.ones_like(gap)
        pair = flags[:, 1:] * flags[:, :-1]
        none = torch.zeros_like(flags[:, :1])
        speaking = torch.maximum(torch.cat((none, pair), dim=1), torch.cat((pair, none), dim=1))
        lags = torch.arange(self.past + 1) - (self.past - GATE_AHEAD)
        far = torch.full_like(flags, 1e6)
        since = torch.where((speaking > 0) & (lags <= 0), -lags.to(flags.dtype), far).amin(dim=1)
        until = torch.where((speaking > 0) & (lags >= 0), lags.to(flags.dtype), far).amin(dim=1)
        apart = ((since + until - 1) > gap).to(flags.dtype)
        since, until = since * apart, until * apart
        opens, rises = (min(x, GATE_AHEAD) + 1 for x in (rule.mouth_opens, rule.expression_rises))
        mouth = torch.maximum(faded(since / (rule.mouth_closes + 1)), faded(until / opens))
        fading = faded((since - rule.expression_holds) / rule.expression_fades)
        return mouth, torch.maximum(fading, faded(until / rises))

    def _intensity(
        self, network: Tensor, row: Tensor, speaking: Tensor, effort: Tensor, state: SpokenState
    ) -> tuple[Tensor, SpokenState]:
        """`deitalk.live.intensity.RunningIntensity`, of one frame."""
        rule: VoiceIntensity | None = self.rules.voice_intensity
        assert rule is not None
        level, tilt, pitch, periodicity = row.unbind(1)
        is_toned = (periodicity > VOICED) & (tilt < BRIGHTEST_DB)
        toned = speaking * is_toned.to(row.dtype)
        counts = torch.stack((speaking, speaking, toned, toned, speaking), dim=1) > 0
        new = torch.stack((deviation(network), level, tilt, pitch, effort), dim=1)
        weights = torch.where(counts, (state.weights + 1).clamp_max(FORGET_FRAMES), state.weights)
        means = state.means + (new - state.means) / weights.clamp_min(1)
        means = torch.where(counts, means, state.means)
        distance = new - means
        z, kept, around, near = state.values.unbind(1)
        index = LEVEL_SHARE * (distance[:, 1] / LEVEL_DB).clamp(-MOST_LEVEL, MOST_LEVEL)
        tilts = (distance[:, 2] / TILT_DB).clamp(-MOST_TONE, MOST_TONE)
        pitches = (distance[:, 3] / PITCH_SEMITONES).clamp(-MOST_TONE, MOST_TONE)
        is_near = (distance[:, 3].abs() <= FURTHEST_SEMITONES).to(row.dtype)
        index = index + TONE_SHARE * toned * (tilts + is_near * pitches)
        target = NETWORK_WEIGHT * distance[:, 0] + rule.index_weight * index
        z_new = z + SMOOTHING * (target - z)
        risen = kept + (1 - kept) * (1 - math.exp(-1 / RISE_FRAMES))
        near_new = near + AROUND_SMOOTHING * (_bounded(z_new) - near)
        around_new = around + AROUND_SMOOTHING * (effort - around)
        silent = torch.stack((z, kept * math.exp(-1 / FALL_FRAMES), around, near), dim=1)
        loud = torch.stack((z_new, risen, around_new, near_new), dim=1)
        values = torch.where(speaking[:, None] > 0, loud, silent)
        z, kept, around, near = values.unbind(1)
        strength = means[:, 4] + AROUND_WEIGHT * (around - means[:, 4])
        base = MOST_BASE * torch.tanh(rule.strength_weight * strength / MOST_BASE)
        found = torch.sigmoid(STEEPNESS * (_bounded(z) - NEAR_SHARE * near + base))
        intensity = FAINTEST + (1 - FAINTEST) * found * kept
        return intensity, state._replace(means=means, weights=weights, values=values)


def _bounded(z: Tensor) -> Tensor:
    return MOST_VARIATION * torch.tanh(z / MOST_VARIATION)
