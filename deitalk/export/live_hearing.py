"""What is heard of voices that have not ended, as operators of a graph; a frame a call.

`deitalk.live.hearing`, `deitalk.live.activity`, `deitalk.live.intensity` and
`deitalk.audio.held_sound.follow_held` in torch; they say what each step is for and hold its
numbers. Tests hold both to the same values.

Letters: B streams, K frequency bands, W samples of a window.
"""

from typing import NamedTuple

import torch
from torch import Tensor, nn

from deitalk.audio.held_sound import BEFORE, EARLY, GOES_ON, NEVER, PERIODIC, POSE
from deitalk.audio.prosody import (
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
from deitalk.config.rules import Gates, HoldPose, RulesConfig, VoiceIntensity
from deitalk.export.clip_hearing import (
    BandLevels,
    MeasureProsody,
    change_of,
    deviation,
    expression_after,
    faded,
    limited,
    opening_factor,
)
from deitalk.live.activity import (
    FLOOR_FRAMES,
    GATE_AHEAD,
    LOUD_PERCENTILE,
    LOUDEST_PERCENTILE,
    MOST_STEP,
    QUIET_ROWS,
    RunningActivity,
)
from deitalk.live.hearing import MEASURED_AHEAD
from deitalk.live.intensity import (
    AROUND_SMOOTHING,
    MEMORIES,
    MOST_LEVEL,
    NEAR_SHARE,
    PRESENCE_SMOOTHING,
    SMOOTHING,
    USUAL_FRAMES,
)
from deitalk.postprocess.factors import LEARNT_USUAL
from deitalk.postprocess.feeling import (
    BRIGHTEST_DB,
    FURTHEST_SEMITONES,
    LEVEL_SHARE,
    MOST,
    MOST_TONE,
    NETWORK_SHARE,
    TONE_SHARE,
)
from deitalk.postprocess.torch_columns import constant

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
    silent: Tensor
    """Frames since the last speech, at the frame whose gates came last [shape=(B,)]."""
    share: Tensor
    """Share of the expression of that frame; below 0 before the first [shape=(B,)]."""
    near: Tensor
    """Last band levels, whose steadiness tells a held sound [shape=(B, BEFORE, K)]."""
    held: Tensor
    """Of the held sound: `age`, `since`, `back` and `share` of `HeldState` [shape=(B, 4)]."""
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
    """Display, its presence, and its mean around [shape=(B, 3)]."""


class LiveHeard(NamedTuple):
    """What is heard at a row of the network, and the gates of the frame that comes out."""

    intensity: Tensor
    """[shape=(B,)], as the others."""
    opening: Tensor
    mouth: Tensor
    expression: Tensor
    back: Tensor
    """Frames since the pose that a held sound keeps."""
    kept: Tensor


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

    memories: Tensor

    def __init__(self, rules: RulesConfig) -> None:
        super().__init__()
        self.rules, self.past = rules, RunningActivity(rules.gates).past
        self.hold = rules.hold_pose or HoldPose()
        constant(self, "memories", MEMORIES)
        self.levels, self.prosody = BandLevels(), MeasureProsody()
        self.n_bands = self.levels.bands.shape[1]

    def first(self, batch: int) -> tuple[HearingState, SpokenState]:
        """State of streams before their first frame."""
        quiet = SHORT_FLOOR_DB - OPEN_DB
        levels = torch.full((batch, FLOOR_FRAMES, self.n_bands), NONE_DB)
        levels[:, -QUIET_ROWS:] = quiet
        opens = self.rules.scale_opening
        usual = (0.0, 0.0) if opens is None else (opens.usual, LEARNT_USUAL)
        gates = self.rules.gates or Gates()
        settled = min(5 * gates.feeling_decays, gates.feeling_leaves)
        held = torch.tensor([0.0, NEVER, 0.0, 0.0]).repeat(batch, 1)
        activity = HearingState(
            levels,
            torch.full((batch, FLOOR_FRAMES), NONE_DB),
            torch.full((batch, self.n_bands), quiet),
            torch.full((batch, GATE_AHEAD + 1), float(LONGEST_CLOSURE)),
            torch.zeros(batch, self.past),
            torch.full((batch,), float(settled)),
            torch.full((batch,), -1.0),
            torch.full((batch, BEFORE, self.n_bands), NONE_DB),
            held,
            torch.zeros(batch, MEASURED_AHEAD, MEASURES),
        )
        weights = torch.from_numpy(USUAL_FRAMES).float().repeat(batch, 1)
        return activity, SpokenState(
            torch.tensor(usual).repeat(batch, 1),
            torch.zeros(batch, 5),
            weights,
            torch.zeros(batch, 3),
        )

    def forward(
        self,
        window: Tensor,
        due: Tensor,
        network: Tensor,
        effort: Tensor,
        rest: Tensor,
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
        rest : Tensor [shape=(B,)]
            Share of the expression that stays in silence.
        state
            From `first`, or from the call before.
        """
        before, spoken = state
        levels, measured = self.levels(window), self.prosody(window)
        sounding, back, kept, before = self._held(levels, measured.tone, before)
        on, gap, before = self._activity(levels, sounding, due, before)
        flags = torch.cat((before.on, on[:, None]), dim=1)
        mouth, expression, before = self._gates(flags, gap, rest, before)
        row = before.measured[:, 0]
        place = -1 - MEASURED_AHEAD
        beside = torch.maximum(flags[:, place - 1], flags[:, place + 1])
        speaking = flags[:, place] * beside
        voice = network
        if self.rules.voice_intensity is not None:
            voice, spoken = self._intensity(network, row, speaking, effort, spoken)
        both = torch.stack((voice, network), dim=1)
        near = spoken.near + AROUND_SMOOTHING * speaking[:, None] * (both - spoken.near)
        opening = opening_factor(self.rules.scale_opening, near[:, 0], near[:, 1])
        new = torch.stack(
            (measured.level, measured.tilt, measured.pitch, measured.periodicity), dim=1
        )
        rows = torch.cat((before.measured[:, 1:], new[:, None]), dim=1)
        heard = LiveHeard(voice, opening, mouth, expression, back, kept)
        return heard, (before._replace(on=flags[:, 1:], measured=rows), spoken._replace(near=near))

    def _held(
        self, levels: Tensor, tone: Tensor, state: HearingState
    ) -> tuple[Tensor, Tensor, Tensor, HearingState]:
        """1 where a sound is held, the pose of the frame `EARLY` before, and what is kept."""
        rule = self.hold
        age, since, back, risen = state.held.unbind(1)
        rows = torch.cat((state.near, levels[:, None]), dim=1)
        is_known = state.near[:, 0, 0] < NONE_DB
        steady = is_known & (change_of(rows)[:, 0] <= rule.steady_db) & (tone > PERIODIC)
        age = torch.where(steady, age + 1, torch.zeros_like(age)).clamp_max(NEVER)
        is_held = age >= rule.frames
        is_onset = is_held & (age == rule.frames) & (since + 1 > GOES_ON)
        since = torch.where(is_held, torch.zeros_like(since), (since + 1).clamp_max(NEVER))
        first = torch.full_like(back, rule.frames + BEFORE - POSE - EARLY)
        back = torch.where(is_onset, first, (back + 1).clamp_max(NEVER))
        grown = ((age - rule.frames + 1) / rule.leaves).clamp_max(1)
        risen = torch.where(is_held, grown, risen)
        share = risen * (1 - since / rule.leaves).clamp(0, 1)
        shown = torch.where(since <= GOES_ON, back, torch.zeros_like(back))
        held = torch.stack((age, since, back, risen), dim=1)
        return is_held.to(age.dtype), shown, share, state._replace(near=rows[:, 1:], held=held)

    def _activity(
        self, levels: Tensor, held: Tensor, due: Tensor, state: HearingState
    ) -> tuple[Tensor, Tensor, HearingState]:
        """Whether the frame is speech, the gap that was bridged then, and what is kept."""
        excess = torch.topk(levels - state.floor, TOP_BANDS, dim=1)[0].mean(dim=1)
        was_on = state.on[:, -1]
        on = (excess >= KEEP_DB + (OPEN_DB - KEEP_DB) * (1 - was_on)).to(levels.dtype)
        on = torch.maximum(on, held)
        row = torch.where(held[:, None] > 0, torch.full_like(levels, NONE_DB), levels)
        ring = torch.cat((state.levels[:, 1:], row[:, None]), dim=1)
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

    def _gates(
        self, flags: Tensor, gap: Tensor, rest: Tensor, state: HearingState
    ) -> tuple[Tensor, Tensor, HearingState]:
        """Gates of the frame `GATE_AHEAD` before the last of the flags (B, P + 1)."""
        rule: Gates | None = self.rules.gates
        if rule is None:
            return torch.ones_like(gap), torch.ones_like(gap), state
        pair = flags[:, 1:] * flags[:, :-1]
        none = torch.zeros_like(flags[:, :1])
        speaking = torch.maximum(torch.cat((none, pair), dim=1), torch.cat((pair, none), dim=1))
        lags = torch.arange(self.past + 1) - (self.past - GATE_AHEAD)
        far = torch.full_like(flags, float(NEVER))
        since = torch.where((speaking > 0) & (lags <= 0), -lags.to(flags.dtype), far).amin(dim=1)
        until = torch.where((speaking > 0) & (lags >= 0), lags.to(flags.dtype), far).amin(dim=1)
        apart = ((since + until - 1) > gap).to(flags.dtype)
        since, until = since * apart, until * apart
        opens = min(rule.mouth_opens, GATE_AHEAD) + 1
        mouth = torch.maximum(faded(since / (rule.mouth_closes + 1)), faded(until / opens))
        # Speech may have ended before what is kept of it; speech that comes raises the share.
        since = torch.minimum(since, 1 + state.silent).clamp_max(NEVER)
        wanted = expression_after(since, until, rest, rule)
        wanted = torch.where(until < NEVER, torch.ones_like(wanted), wanted)
        before = torch.where(state.share < 0, wanted, state.share)
        share = torch.minimum(torch.maximum(wanted, before - MOST_STEP), before + MOST_STEP)
        return mouth, share, state._replace(silent=since, share=share)

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
        more = torch.minimum(state.weights + 1, self.memories)
        weights = torch.where(counts, more, state.weights)
        means = state.means + (new - state.means) / weights.clamp_min(1)
        means = torch.where(counts, means, state.means)
        distance = new - means
        tilts = (distance[:, 2] / TILT_DB).clamp(-MOST_TONE, MOST_TONE)
        pitches = (distance[:, 3] / PITCH_SEMITONES).clamp(-MOST_TONE, MOST_TONE)
        is_near = (distance[:, 3].abs() <= FURTHEST_SEMITONES).to(row.dtype)
        target = NETWORK_SHARE * distance[:, 0]
        target = target + LEVEL_SHARE * (distance[:, 1] / LEVEL_DB).clamp(-MOST_LEVEL, MOST_LEVEL)
        target = target + TONE_SHARE * toned * (tilts + is_near * pitches)
        display, presence, near = state.values.unbind(1)
        display = display + speaking * SMOOTHING * (target - display)
        near = near + speaking * AROUND_SMOOTHING * (limited(display) - near)
        presence = presence + PRESENCE_SMOOTHING * (speaking - presence)
        shown = rule.display * presence * (limited(display) - NEAR_SHARE * near)
        found = MOST * torch.sigmoid(rule.per_decibel * (means[:, 4] - rule.middle) + shown)
        values = torch.stack((display, presence, near), dim=1)
        return found, state._replace(means=means, weights=weights, values=values)
