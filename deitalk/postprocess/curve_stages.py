"""The rules of `deitalk.postprocess.curve_pass`, each a module; settings of None leave it out.

Letters: B streams, T frames of a call, R = 2 readings (neutral, then the one that is shown), C
controls, K contacts, W frames around a frame. Curves are (B, T, R, C).
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional as F

from deitalk.config.rules import (
    DeadZone,
    Expressions,
    Gates,
    HoldPose,
    KeepContacts,
    LimitContactSpeed,
    ScaleOpening,
    SharpenContacts,
)
from deitalk.postprocess.control_groups import ControlGroups
from deitalk.postprocess.expressions import expression_table
from deitalk.postprocess.torch_columns import Columns, constant, smoothstep
from rig import ControlSet
from rig.arrays import Float32

PEAK_FRAMES = 7
"""A frame belongs to the highest peak within three frames (0.1 s) of it."""
GENTLE = 1.5
"""Steepness of the share of contacts by which certain ones stay above likely ones."""
PARTED = 0.8
"""Share by which a contact that is added lowers what parts the lips."""
TIP_DOWN = 0.3
"""How far the tongue is out where its tip is between the teeth, and not raised behind them."""
YIELDING_STEP = 1 / 3
"""Share of a mood's pose that yields in a frame, 0.1 s in all: disgust raises the lip by .6."""
ROUNDED = (0.15, 0.6)
"""Mean of purse, or of funnel, at which an expression begins to yield, and yields fully."""
YIELDED = 0.25
"""Share that is taken away by full rounding, so that a smile does not pump with the vowels."""
NEUTRAL, SHOWN = 0, 1
"""Places of the readings."""


class Hold(nn.Module):
    """What speech moves, contacts excepted, keeps its pose while a sound is held."""

    speaks: Tensor

    def __init__(self, rule: HoldPose | None, groups: ControlGroups) -> None:
        super().__init__()
        self.rule = rule
        speaks = groups.follows_mouth.astype(np.float32)
        speaks[groups.seals] = 0
        constant(self, "speaks", np.tile(speaks, 2))

    def forward(
        self, readings: Tensor, before: Tensor, back: Tensor, kept: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Keep poses.

        Parameters
        ----------
        readings : Tensor [shape=(B, T, 2 C)]
            Both, side by side.
        before : Tensor [shape=(B, N, 2 C)]
            The pose that was kept before, and the last frames.
        back, kept : Tensor [shape=(B, T, 1)]
            Frames since the pose, and its share; both 0 where none is kept.

        Returns
        -------
        readings : Tensor [shape=(B, T, 2 C)]
        pose : Tensor [shape=(B, 1, 2 C)]
            Of the last frame.
        """
        if self.rule is None:
            return readings, readings[:, -1:]
        place = torch.arange(readings.shape[1], device=readings.device)[:, None] - back
        place = (place + before.shape[1]).clamp_min(0).long().expand(-1, -1, readings.shape[2])
        poses = torch.cat((before, readings), dim=1).gather(1, place)
        return readings + kept * self.speaks * (poses - readings), poses[:, -1:]


class Near(NamedTuple):
    """What is around each frame."""

    seals: Tensor
    """Contacts of both readings [shape=(B, T, R, K, W)]."""
    scale: Tensor
    """Factor on the difference of the readings [shape=(B, T, 1, W)]."""
    closed: Tensor
    """1 within phones that close the lips [shape=(B, T, 1, 1, W)]."""
    bitten: Tensor
    """1 within phones with the lower lip at the teeth."""
    tongue: Tensor
    """How far the tongue is drawn in, below 0 out, in both readings [shape=(B, T, R, 1, W)]."""


class Around(nn.Module):
    """Frames behind and ahead of each frame, of the rows that contacts depend on.

    Parameters
    ----------
    seals, tongue : sequence of int [shape=(2 K,) and (2,)]
        Contacts and the tongue of both readings, of all columns of a row.
    voice : sequence of int [shape=(3,)]
        Scale, closed and bitten.
    behind, ahead : int
        W = behind + 1 + ahead.
    """

    columns: Tensor
    window: Tensor

    def __init__(
        self,
        seals: Sequence[int],
        tongue: Sequence[int],
        voice: Sequence[int],
        behind: int,
        ahead: int,
    ) -> None:
        super().__init__()
        self.behind = behind
        self.sizes = [len(seals) // 2] * 2 + [len(tongue) // 2] * 2 + [1] * 3
        constant(self, "columns", np.array([*seals, *tongue, *voice]))
        constant(self, "window", np.arange(behind + 1 + ahead))

    def forward(self, rows: Tensor, n_frames: int) -> Near:
        """Gather rows (B, behind + T + ahead, ...)."""
        near = rows.index_select(2, self.columns)
        index = torch.arange(n_frames, device=rows.device)[:, None] + self.window
        near = near[:, index].permute(0, 1, 3, 2)  # (B, T, 2 K + 5, W)
        *readings, scale, closed, bitten = torch.split(near, self.sizes, dim=2)
        seals, tongue = (torch.stack(readings[k : k + 2], dim=2) for k in (0, 2))
        return Near(seals, scale, closed.unsqueeze(2), bitten.unsqueeze(2), tongue)

    def middle(self, windows: Tensor) -> Tensor:
        """Values (...) of the frames themselves in windows (..., W)."""
        return windows[..., self.behind]


class Sharpen(nn.Module):
    """Likely contacts raised, and unlikely ones lowered.

    A network trained on squared errors gives an uncertain /b/ as 0.5: lips that almost meet. Two
    S-curves of the means of two neighbouring frames decide how high their peak is, and which frames
    beside it belong to the contact, so that a contact that is found is held for two frames. The
    frames around keep what the network gives: lips of people close and part as gently. A peak of
    0.2 becomes 0.24, 0.25 one half, and 0.5 becomes 0.99; 0 and 1 stay, and between two peaks the
    lips part. An uncertain contact is brief, or it would reach into the vowels around.
    """

    def __init__(self, rule: SharpenContacts | None) -> None:
        super().__init__()
        self.rule = rule

    def forward(self, contacts: Tensor) -> Tensor:
        """Contacts by frame (..., W)."""
        rule = self.rule
        if rule is None:
            return contacts
        values = contacts.clamp(0, 1)
        pairs = (values + torch.cat((values[..., 1:], values[..., -1:]), dim=-1)) / 2
        rows = pairs.reshape(-1, 1, pairs.shape[-1])
        peaks = F.max_pool1d(rows, PEAK_FRAMES, 1, PEAK_FRAMES // 2).reshape(pairs.shape)
        shoulder = (rule.shoulder + rule.doubt * (1 - peaks)).clamp_max(rule.sharpest)
        height = decided(peaks, torch.full_like(peaks, rule.peak), rule.height, rule.tail)
        share = pairs / peaks.clamp_min(1e-6)
        met = height * decided(share, shoulder, rule.steepness, rule.tail)
        met = torch.maximum(met, torch.cat((met[..., :1], met[..., :-1]), dim=-1))
        return torch.maximum(met, height * values)


def decided(values: Tensor, middle: Tensor, steepness: float, tail: float = 0.0) -> Tensor:
    """S-curve from 0 to 1 that makes one half of `middle`; a share of it is gentle."""
    distance = _log_odds(values) - _log_odds(middle)
    steep = torch.sigmoid(steepness * distance)
    return steep + tail * (torch.sigmoid(GENTLE * distance) - steep) if tail else steep


def _log_odds(share: Tensor) -> Tensor:
    share = share.clamp(1e-7, 1 - 1e-7)
    return torch.log(share / (1 - share))


class Closure(nn.Module):
    """How closed the lips are, 0 to 1: lips together, or lip on teeth."""

    def __init__(self, rule: KeepContacts | None, groups: ControlGroups) -> None:
        super().__init__()
        self.rule = rule or KeepContacts()
        self.sizes = [len(groups.together), len(groups.bite)]

    def forward(self, seals: Tensor) -> Tensor:
        """Of contacts (..., K)."""
        if not any(self.sizes):
            return seals.new_zeros(seals.shape[:-1])
        together, bite = torch.split(seals, self.sizes, dim=-1)
        parts = [part.mean(dim=-1) for part in (together, bite) if part.shape[-1]]
        closed = parts[0] if len(parts) == 1 else torch.maximum(*parts)
        return smoothstep((closed - self.rule.begin) / (self.rule.full - self.rule.begin))


class MeetPhones(nn.Module):
    """Lips that meet, lips at the teeth and rounded lips where the phones require it.

    What a network shows stays where it is more; nothing is lowered but what parts closed lips.
    """

    bites: Tensor

    def __init__(self, groups: ControlGroups, size: int) -> None:
        super().__init__()
        constant(self, "bites", np.repeat([0.0, 1.0], (len(groups.together), len(groups.bite))))
        self.lively = Columns(groups.lively, size)
        self.funnel, self.purse = (Columns(places, size) for places in groups.rounding)

    def close(self, contacts: Tensor, near: Near) -> Tensor:
        """Contacts (B, T, R, K, W), met within the phones that close them."""
        bites = self.bites[:, None]
        met = torch.where(bites > 0, near.bitten, near.closed)
        return torch.where(met > 0, contacts.clamp_min(1), contacts)

    def forward(self, curves: Tensor, added: Tensor, funnel: Tensor, purse: Tensor) -> Tensor:
        """Lower what parts the lips by the closure `added` (B, T, R); round them at least so."""
        lowered = PARTED * added.clamp_min(0).unsqueeze(-1)
        curves = curves * (1 - lowered * self.lively.mask)
        for columns, least in ((self.funnel, funnel), (self.purse, purse)):
            raised = (least > 0) & (columns.mask > 0)
            curves = torch.where(raised, torch.maximum(curves, least), curves)
        return curves


class OpenMouth(nn.Module):
    """The mouth opened by a factor where lips do not meet; in an emotion by its strength too."""

    def __init__(self, rule: ScaleOpening | None, groups: ControlGroups, size: int) -> None:
        super().__init__()
        self.rule, self.lively = rule, Columns(groups.lively, size)

    def forward(
        self, curves: Tensor, free: Tensor, opening: Tensor, felt: Tensor, shown: Tensor
    ) -> Tensor:
        """Open the mouth.

        More expression moves the shown reading one way: further where the emotion is strong in the
        voice, back where it is weak.

        Parameters
        ----------
        curves : Tensor [shape=(B, T, R, C)]
            Both readings.
        free : Tensor [shape=(B, T, 1), range 0 to 1]
            How far the lips of the neutral one do not meet.
        opening : Tensor [shape=(B, T, 1, 1)]
            Factor on both readings.
        felt : Tensor [shape=(B, T, 1, 1), range 0 to 1.6]
            Intensity of the emotion in the voice.
        shown : Tensor [shape=(B, T, 1), range 0 to 4]
            Intensity to show of emotions other than neutral.
        """
        if self.rule is None:
            return curves
        more = self.rule.shown * shown.clamp_max(1).unsqueeze(-1) * (felt - self.rule.middle)
        opening = torch.cat((opening, opening * (1 + more)), dim=2)
        return curves * (1 + (opening - 1) * free.unsqueeze(-1) * self.lively.mask)


class Blend(nn.Module):
    """The difference of the readings, scaled; it parts no lips that are closed."""

    def __init__(self, rule: KeepContacts | None, groups: ControlGroups, size: int) -> None:
        super().__init__()
        self.rule = rule
        self.opening, self.seals = Columns(groups.opening, size), Columns(groups.seals, size)

    def forward(self, curves: Tensor, free: Tensor, scale: Tensor) -> Tensor:
        """Scale the difference (B, T, 1, 1) as far as neutral lips are `free` (B, T, 1)."""
        neutral = curves[:, :, :1]
        difference = (curves - neutral) * scale
        if self.rule is not None:
            difference = difference * (1 - (1 - free.unsqueeze(-1)) * self.opening.mask)
            closes = self.seals.mask > 0
            difference = torch.where(closes, difference.clamp_min(0), difference)
        return neutral + difference

    def contacts(self, contacts: Tensor, scale: Tensor) -> Tensor:
        """The same of contacts (B, T, R, K, W), around each frame."""
        neutral = contacts[:, :, :1]
        difference = (contacts - neutral) * scale.unsqueeze(2)
        return neutral + (difference if self.rule is None else difference.clamp_min(0))


class Express(nn.Module):
    """The expression changed by the table of `deitalk.postprocess.expressions`."""

    gains: Tensor
    poses: Tensor
    parting: Tensor
    moods: Tensor
    spreading: Tensor
    taught: Tensor
    opening: Tensor
    changed: Tensor

    def __init__(self, rule: Expressions | None, controls: ControlSet) -> None:
        super().__init__()
        captured = () if rule is None else rule.captured
        table, size = expression_table(controls.names, captured), len(controls)
        self.is_on = rule is not None and len(table.places) > 0
        is_mood = table.is_mood[:, None]
        constant(self, "gains", table.gains)
        constant(self, "poses", table.poses)
        constant(self, "taught", table.taught * (1.0 if rule is None else rule.size))
        constant(self, "parting", np.where(is_mood, 0, table.parting))
        constant(self, "moods", np.where(is_mood, table.parting, 0))
        constant(
            self, "opening", np.isin(table.places, ControlGroups(controls).opening).astype(float)
        )
        constant(self, "spreading", table.spreading)
        constant(self, "changed", table.changed[:, None])
        self.columns = Columns(table.places, size)
        rounding = (Columns(places, size) for places in ControlGroups(controls).rounding)
        self.rounding = nn.ModuleList(columns for columns in rounding if len(columns))

    def forward(
        self,
        curves: Tensor,
        ways: Tensor,
        emotion: Tensor,
        strength: Tensor,
        missing: Tensor,
        free: Tensor,
        slow: Tensor,
        spoken: Tensor,
    ) -> Tensor:
        """Change the reading that is shown.

        What a network does not show, in silence most, is added of the pose that it is taught. In
        silence nothing yields to the lips, which are at rest.

        Parameters
        ----------
        curves : Tensor [shape=(B, T, R, C)]
            The neutral reading, and the blend of both.
        ways : Tensor [shape=(B, T, 66)]
            Weights of the rows of the table.
        emotion : Tensor [shape=(B, T, 9)]
            Weights of the emotions.
        strength : Tensor [shape=(B, T, 1), range 0 to 4]
            Intensity to show.
        missing : Tensor [shape=(B, T, 1), range 0 to 4]
            Part of it that the blend lacks.
        free : Tensor [shape=(B, T, 1), range 0 to 1]
            Share of the opening that closed lips leave to an expression.
        slow : Tensor [shape=(B, T, 1), range 0 to 1]
            The same of the moods, which changes slowly and is never more.
        spoken : Tensor [shape=(B, T, 1), range 0 to 1]
            Gate of the mouth: 1 in speech, 0 in silence.
        """
        if not self.is_on:
            return curves
        free, slow = 1 - (1 - free) * spoken, 1 - (1 - slow) * spoken
        part = self.columns(curves)
        neutral, blend = part[:, :, NEUTRAL], part[:, :, SHOWN]
        pose = ways @ self.poses + (ways @ self.parting) * free
        pose = pose + (ways @ self.moods) * slow
        yields = 1 - (1 - free) * self.opening  # closed lips stay closed
        read = (blend - neutral) + missing * (emotion @ self.taught) * yields
        shown = read * (ways @ self.gains) + pose * strength
        rounded = self._rounded(curves[:, :, NEUTRAL]) * spoken
        kept = 1 - YIELDED * rounded * (emotion @ self.changed)
        shown = shown * (1 - self.spreading + self.spreading * kept)
        return self.columns.put(curves, torch.stack((neutral, neutral + shown), dim=2))

    def _rounded(self, neutral: Tensor) -> Tensor:
        """How rounded the lips are [shape=(B, T, 1), range 0 to 1]."""
        rounding = neutral[..., :1] * 0
        for columns in self.rounding:
            rounding = torch.maximum(rounding, columns(neutral).mean(dim=-1, keepdim=True))
        begin, full = ROUNDED
        return smoothstep((rounding - begin) / (full - begin))


class RestLips(nn.Module):
    """Lips that cover the teeth of the neutral reading; the expression stays."""

    def __init__(self, rule: Expressions | None, groups: ControlGroups, size: int) -> None:
        super().__init__()
        self.rule, self.lips = rule, Columns(groups.lips, size)

    def forward(self, curves: Tensor) -> Tensor:
        """Lower both readings by as much."""
        rule = self.rule
        if rule is None or not rule.covers_teeth or not len(self.lips):
            return curves
        part = self.lips(curves)
        jaw, upper, lower = torch.split(part[:, :, :1], [1, 2, 2], dim=-1)
        raised = upper.clamp_max(2 * rule.upper)
        above = (lower - rule.lower - rule.per_jaw * jaw).clamp_min(0)
        lowered = raised * (1 - raised / (4 * rule.upper)), rule.share * above
        return self.lips.put(curves, part - torch.cat((0 * jaw, *lowered), dim=-1))


class SpeedLimit(nn.Module):
    """Values that rise earlier and fall later, until no step is larger than that of a rule.

    Peaks keep their height; the frames around them are raised.
    """

    fall: Tensor

    def __init__(self, rule: LimitContactSpeed | None, behind: int, ahead: int) -> None:
        super().__init__()
        frames = slowed_frames(rule)
        self.first, self.stop = behind - min(frames, behind), behind + min(frames, ahead) + 1
        lags = np.abs(np.arange(self.first, self.stop) - behind)
        constant(self, "fall", lags * (0.0 if rule is None else rule.step))

    def forward(self, windows: Tensor) -> Tensor:
        """Values (...) of the frames themselves, raised by those around them (..., W)."""
        return (windows[..., self.first : self.stop] - self.fall).amax(dim=-1)


def slowed_frames(rule: LimitContactSpeed | None) -> int:
    """Frames before and after a value of 1 that the limit raises."""
    return 0 if rule is None else int(1 / rule.step)


class TongueOut(nn.Module):
    """A tongue that comes out for two frames or more, and gradually, where lips do not meet.

    A readout of /th/ that is one frame long is wrong in seven of ten, and a tongue that is out in
    single pictures is a red flash. Its tip is lowered meanwhile.
    """

    def __init__(
        self,
        rule: LimitContactSpeed | None,
        groups: ControlGroups,
        size: int,
        behind: int,
        ahead: int,
    ) -> None:
        super().__init__()
        self.is_on = rule is not None
        self.tongue, self.tip = Columns(groups.tongue, size), Columns(groups.tongue_tip, size)
        step = None if rule is None else LimitContactSpeed(step=rule.tongue)
        self.limit = SpeedLimit(step, behind, ahead)

    def forward(self, curves: Tensor, near: Tensor, free: Tensor) -> Tensor:
        """Of both readings, from the tongue around (B, T, R, 1, W), as far as lips are `free`."""
        if not self.is_on or not len(self.tongue):
            return curves
        out = (-near).clamp_min(0)
        pairs = torch.minimum(out[..., 1:], out[..., :-1])
        lasting = torch.maximum(F.pad(pairs, (1, 0)), F.pad(pairs, (0, 1)))
        shown = self.limit(lasting) * free.unsqueeze(-1)
        curves = self.tongue.put(curves, self.tongue(curves).clamp_min(0) - shown)
        down = (shown.amax(dim=-1, keepdim=True) / TIP_DOWN).clamp_max(1)
        lowered: Tensor = curves * (1 - down * self.tip.mask)
        return lowered


class QuietLips(nn.Module):
    """Small values of the controls that part the lips set to 0, larger ones reduced by as much."""

    def __init__(self, rule: DeadZone | None, groups: ControlGroups, size: int) -> None:
        super().__init__()
        self.rule, self.opening = rule, Columns(groups.opening, size)

    def forward(self, curves: Tensor) -> Tensor:
        """Of both readings."""
        if self.rule is None:
            return curves
        width = self.rule.width * self.opening.mask
        return curves - torch.minimum(torch.maximum(curves, -width), width)


class Gate(nn.Module):
    """The mouth brought to rest in silence, and the share of the expression that is shown."""

    rest: Tensor

    def __init__(self, rule: Gates | None, groups: ControlGroups, rest: Float32) -> None:
        super().__init__()
        self.rule = rule
        self.speaks = Columns(np.flatnonzero(groups.follows_mouth), len(rest))
        constant(self, "rest", rest)

    def forward(self, curves: Tensor, mouth: Tensor, expression: Tensor) -> Tensor:
        """Of both readings, by a gate and a share (B, T, 1, 1)."""
        if self.rule is None:
            return curves
        speaks, neutral = self.speaks.mask, curves[:, :, :1]
        curves = neutral + (curves - neutral) * expression
        return self.rest + (curves - self.rest) * (1 - speaks + speaks * mouth)
