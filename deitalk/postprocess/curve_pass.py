"""The one pass after the network: two readings of a speech in, finished curves out.

`CurvePass.forward` is the order of the rules, for a whole recording (large blocks), a voice that
has not ended (small ones), many of either side by side, in training, and as a graph of ONNX: it
has no loop over frames or streams, no control flow, and its state is one tensor in the caller's
hands. Each rule has its numbers in `deitalk.config.rules` and is left out where it is off.

By construction, intensity 0 gives the neutral reading, the expression grows with the intensity,
and lips that meet in the neutral reading still meet.

Letters: B streams, T frames of a call, R = 2 readings (neutral, then the one that is shown), C
controls, K contacts, W frames around a frame.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn

from deitalk.audio.held_sound import POSE_FRAMES
from deitalk.config.rules import LimitContactSpeed, RulesConfig
from deitalk.emotions import LABELS
from deitalk.postprocess.control_groups import ControlGroups
from deitalk.postprocess.curve_stages import (
    NEUTRAL,
    PEAK_FRAMES,
    SHOWN,
    YIELDING_STEP,
    Around,
    Blend,
    Closure,
    Express,
    Gate,
    Hold,
    MeetPhones,
    OpenMouth,
    QuietLips,
    RestLips,
    Sharpen,
    SpeedLimit,
    TongueOut,
    slowed_frames,
)
from deitalk.postprocess.factors import LEAST_PREDICTED
from deitalk.postprocess.life.play import Play
from deitalk.postprocess.torch_columns import Columns, constant
from deitalk.postprocess.tracks import N_MOTION, N_SHOWN, N_VARIANTS, VOICE, rest_rows
from rig import ControlSet
from rig.arrays import Float32
from rig.controls import DEFAULT_ID

OUTSIDE = 0.01
"""Distance beyond a control's range from which a value counts as outside."""


class Voice(NamedTuple):
    """Columns of the `VoiceTracks` of the frames that come out."""

    scale: Tensor
    """[shape=(B, T, 1, 1)], as the next ones, to be multiplied with curves (B, T, R, C)."""
    opening: Tensor
    held: Tensor
    closed: Tensor
    bitten: Tensor
    funnel: Tensor
    purse: Tensor
    back: Tensor
    kept: Tensor
    side: Tensor
    felt: Tensor
    emotion: Tensor
    """[shape=(B, T, 9)]."""
    variants: Tensor
    """[shape=(B, T, 24)]."""

    @property
    def ways(self) -> Tensor:
        """Weights of the rows of `expressions.ExpressionTable` [shape=(B, T, 66)]."""
        rows = torch.cat((self.emotion, self.variants), dim=-1)
        return torch.cat((rows, rows * self.side.squeeze(-1)), dim=-1)

    @classmethod
    def of(cls, columns: Tensor) -> "Voice":
        """Split columns (B, T, 44)."""
        sizes = [VOICE - len(LABELS) - N_VARIANTS, len(LABELS), N_VARIANTS]
        single, emotion, variants = torch.split(columns, sizes, dim=-1)
        tracks = [single[..., k, None, None] for k in range(sizes[0])]
        return cls(*[*tracks, emotion, variants])


class CurvePass(nn.Module):
    """The rules of one control set, in the order in which they apply.

    Parameters
    ----------
    controls : ControlSet
        Columns of the curves.
    rules : RulesConfig
        Which rules apply, and their numbers.
    ahead : int, optional
        Frames after a frame that its contacts may see; by default all that matter.

    Attributes
    ----------
    behind, ahead : int
        Frames before and after a frame that its contacts see. What comes out is `ahead` frames
        behind what comes in.
    """

    rest: Tensor
    minimum: Tensor
    maximum: Tensor
    before: Tensor

    def __init__(
        self, controls: ControlSet, rules: RulesConfig = RulesConfig(), ahead: int | None = None
    ) -> None:
        super().__init__()
        count, groups = len(controls), ControlGroups(controls)
        yielding = LimitContactSpeed(step=YIELDING_STEP)
        slowed = max(slowed_frames(rules.limit_contact_speed), slowed_frames(yielding))
        self.behind = PEAK_FRAMES // 2 + slowed
        self.ahead = self.behind if ahead is None else min(ahead, self.behind)
        window, self.size = (self.behind, self.ahead), count
        seals, tongue = ([*k, *(k + count)] for k in (groups.seals, groups.tongue))
        self.unseen = max(POSE_FRAMES - self.behind - self.ahead, 0)
        self.hold = Hold(rules.hold_pose, groups)
        # scale, closed and bitten follow both readings
        self.around = Around(seals, tongue, [2 * count + k for k in (0, 3, 4)], *window)
        self.sharpen = Sharpen(rules.sharpen_contacts)
        self.closure = Closure(rules.keep_contacts, groups)
        self.seals = Columns(groups.seals, count)
        self.meet_phones = MeetPhones(groups, count)
        self.tongue_out = TongueOut(rules.limit_contact_speed, groups, count, *window)
        self.open_mouth = OpenMouth(rules.scale_opening, groups, count)
        self.blend = Blend(rules.keep_contacts, groups, count)
        self.closing = SpeedLimit(yielding, *window)
        self.express = Express(rules.expressions, controls)
        self.rest_lips = RestLips(rules.expressions, groups, count)
        self.limit_speed = SpeedLimit(rules.limit_contact_speed, *window)
        self.quieten = QuietLips(rules.dead_zone, groups, count)
        self.gate = Gate(rules.gates, groups, controls.rest)
        self.play = Play(controls) if controls.id == DEFAULT_ID else None
        for name in ("rest", "minimum", "maximum"):
            constant(self, name, getattr(controls, name))
        constant(self, "before", rest_rows(controls.rest, self.behind + self.ahead))

    def first(self, batch: int) -> Tensor:
        """A face at rest, the state before the first frame.

        [shape=(B, N, 2 C + 44)]: the pose that a held sound keeps, then the last frames.
        """
        return self.before.expand(batch, -1, -1).clone()

    def example(self, batch: int = 2, n_frames: int = 3) -> tuple[Tensor, ...]:
        """Arguments of `forward`, for a trace of it."""
        face, first = self.rest.expand(batch, n_frames, -1).clone(), self.first(batch)
        shown = face.new_zeros(batch, n_frames, N_SHOWN)
        said = first[:, :n_frames, 2 * self.size :]
        return face, face, said, shown, face[:, 0], face.new_ones(batch), first

    def forward(
        self,
        neutral: Tensor,
        emotional: Tensor,
        voice: Tensor,
        shown: Tensor,
        gain: Tensor,
        ruled: Tensor,
        state: Tensor,
    ) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Finish the next frames.

        Parameters
        ----------
        neutral, emotional : Tensor [shape=(B, T, C)]
            Two readings of the same speech, as the network gives them.
        voice : Tensor [shape=(B, T, 44)]
            What voice and acting say of the same frames: `tracks.VoiceTracks`.
        shown : Tensor [shape=(B, T, 2 + 43)]
            Gates and motion of the frames that come *out*: `tracks.shown_columns`.
        gain : Tensor [shape=(B, C)]
            Factor on the distance of each control from rest.
        ruled : Tensor [shape=(B,)]
            1 for streams with rules; 0 for the network alone, with its motion if there is any.
        state : Tensor [shape=(B, N, 2 C + 44)]
            From `first`, or of the call before.

        Returns
        -------
        curves, neutral : Tensor [shape=(B, T, C)]
            Finished, of the frames `ahead` before those that came in.
        outside : Tensor [shape=(B, T)]
            Values of `curves` by over .01 outside of their ranges, before the gain or with it,
            before they were clamped.
        state : Tensor
        """
        # Frames that come out, with what is around them.
        readings = torch.cat((neutral, emotional), dim=-1)
        # A held sound keeps its pose.
        new = Voice.of(voice)
        kept = new.kept.squeeze(-1) * ruled[:, None, None]
        readings, pose = self.hold(
            readings, state[..., : 2 * self.size], new.back.squeeze(-1), kept
        )
        rows = torch.cat((state[:, 1:], torch.cat((readings, voice), dim=-1)), dim=1)
        pose = torch.cat((pose, voice[:, -1:]), dim=-1)
        state = torch.cat((pose, rows[:, neutral.shape[1] :]), dim=1)
        rows = rows[:, self.unseen :]
        own = rows[:, self.behind : self.behind + neutral.shape[1]]
        plain, acted, said_rows = torch.split(own, [self.size, self.size, VOICE], dim=-1)
        raw, said = torch.stack((plain, acted), dim=2), Voice.of(said_rows)
        mouth, expression, motion = torch.split(shown, [1, 1, N_MOTION], dim=-1)
        near = self.around(rows, neutral.shape[1])

        # Contacts of both readings (B, T, R, K, W): likely ones meet, and known ones.
        contacts = self.sharpen(near.seals)
        likely = self.closure(self.around.middle(contacts))
        contacts = self.meet_phones.close(contacts, near)
        closed = self.closure(self.around.middle(contacts))  # (B, T, R)
        curves = self.seals.put(raw, self.around.middle(contacts))
        curves = self.meet_phones(curves, closed - likely, said.funnel, said.purse)
        curves = self.tongue_out(curves, near.tongue, 1 - closed)
        # The expression is the difference of the readings, scaled; it parts no closed lips.
        free = 1 - closed[:, :, :1]
        curves = self.blend(curves, free, said.scale)
        # Poses of the emotions, which yield to closed lips; lips that cover the teeth.
        closing = self.closing(self.closure(contacts[:, :, NEUTRAL].transpose(-1, -2)))
        least = said.held.clamp_min(LEAST_PREDICTED)
        strength, missing = ((said.scale * held).squeeze(-1) for held in (least, least - said.held))
        slow = 1 - closing.unsqueeze(-1)
        curves = self.express(curves, said.ways, said.emotion, strength, missing, free, slow, mouth)
        # The mouth opens as voice and emotion are strong, where lips do not meet.
        shown = strength * (1 - said.emotion[..., :1])
        curves = self.open_mouth(curves, free, said.opening, said.felt, shown)
        curves = self.rest_lips(curves)
        # Lips start to close earlier and part later; what is hardly open is shut.
        limited = self.limit_speed(self.blend.contacts(contacts, near.scale))
        curves = self.quieten(self.seals.put(curves, limited))
        # Silence: the mouth shuts, a share of the expression stays.
        curves = self.gate(curves, mouth.unsqueeze(2), expression.unsqueeze(2))
        # Streams without rules: the readings as they are.
        plain = raw[:, :, :1] + (raw - raw[:, :, :1]) * said.scale
        curves = torch.where(ruled[:, None, None, None] > 0, curves, plain)
        # Blinks, gaze, brows and neck.
        if self.play is not None:
            curves = self.play(curves, motion, mouth)

        # Ranges and gain.
        outside = self._beyond(curves)
        curves = self._within(curves)
        curves = self.rest + (curves - self.rest) * gain[:, None, None]
        outside = (outside | self._beyond(curves)).float().sum(dim=-1)
        curves = self._within(curves)
        return curves[:, :, SHOWN], curves[:, :, NEUTRAL], outside, state

    def _beyond(self, curves: Tensor) -> Tensor:
        acted = curves[:, :, SHOWN]
        return (acted < self.minimum - OUTSIDE) | (acted > self.maximum + OUTSIDE)

    def _within(self, curves: Tensor) -> Tensor:
        return torch.minimum(torch.maximum(curves, self.minimum), self.maximum)


class TorchPass:
    """A `CurvePass` with arrays: a `deitalk.models.protocol.CurveRules`.

    Its state stays a tensor on the device of the rules.

    Parameters
    ----------
    rules : CurvePass
    play : callable, optional
        Does what they do.
    """

    def __init__(self, rules: CurvePass, play: Callable[..., Any] | None = None) -> None:
        self.rules, self.play = rules, play or rules
        self.behind, self.ahead = rules.behind, rules.ahead
        self.before: Float32 = rules.before.cpu().numpy()

    def first(self, batch: int) -> Tensor:
        """State before the first frame."""
        return self.rules.first(batch)

    @torch.no_grad()
    def __call__(self, *arrays: Any) -> tuple[Float32, Float32, Float32, Tensor]:
        """Finish the next frames; parameters and results are those of `CurvePass.forward`."""
        device = self.rules.rest.device
        given = (torch.as_tensor(array, device=device) for array in arrays)
        curves, neutral, outside, state = self.play(*given)
        # One array crosses the bus.
        columns = torch.cat((curves, neutral, outside.unsqueeze(-1)), dim=-1).cpu().numpy()
        size = self.rules.size
        return columns[..., :size], columns[..., size:-1], columns[..., -1], state
