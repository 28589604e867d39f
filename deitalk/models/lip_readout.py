"""Readout of lips and tongue from the speech features; not in the papers.

A decoder that is trained on computed faces does not show all that its features hold. The readout
is fitted to phones, by a network of one hidden layer, and to measured lips of people, linearly. It
corrects the decoder:

- A contact, lips together or lower lip on the teeth, becomes the product of the probability that
  the readout gives it and of a power of the decoder's (`POWER`): none that either denies, and the
  decoder's timing.
- Rounding and the tip of the tongue are those of the phones that are heard; the tongue comes out
  for TH alone, between the teeth, and the lower lip does not touch them meanwhile.
- The opening and the width of the mouth, the height of the lower lip and of the corners move
  towards those that the readout gives, by controls that change nothing else of the lips; what
  rounding does to them is counted, so that lips are as narrow as measured ones. They
  stay the decoder's where the decoder shuts the mouth: in pauses, breaths and closures.
- In sounds that are no voice, such as music, dishes or a cat, speech moves the mouth less, or not
  at all. A causal readout leaves this out: it hears a voice late, and the mouth would jump.

What an emotion adds stays. Of a tuned model it corrects the controls that its base's decoder moves;
those that captures show are not corrected.

Letters: R readings, B streams, T frames, D width of the features, C controls.
"""

from collections.abc import Collection, Sequence

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional as F

from deitalk.frontends.flat_kernel import FlatKernel, joined_taps
from deitalk.models.joined import JoinedClips
from deitalk.postprocess.control_groups import OPENING, SPEAKING
from deitalk.postprocess.torch_columns import smoothstep
from rig.arrays import Float32

CONTACTS = ("lipsTogether", "lipBiteD")
"""Parts of the names of the controls of each contact."""
POWER = 0.5
"""Of the decoder's contact, whose product with its probability is the contact."""
CHANNELS = ("together", "bite", "out", "tip", "funnel", "purse", "voice")
"""Of the articulation table of the phones, which are read, the contacts first; then whether there
is speech."""
MEASURES = ("opening", "width", "lower_lip", "corner")
"""Measures of the embedded head that are corrected."""
MOST = (0.3, 0.6, 0.25, 0.17)
"""Largest correction of each, cm: about the 1st and 99th percentiles in read speech. A regression
on readers errs where somebody shouts, and would press the lower lip over an open jaw."""
TAPS = 9
"""Frames that a row is read from: those around it, or in a causal model those up to it."""
HIDDEN = 64
"""Units between the features and the channels."""
OPENERS = ("C_jaw.ty", "mouth_upperLipRaise", "mouth_lowerLipDepress")
"""Parts of the names of the controls whose mean tells how open the decoder's mouth is."""
OPEN = ((0.05, 0.02, 0.05, 0.02), (0.2, 0.1, 0.2, 0.1))
"""That mean, up to which each measure stays the decoder's, and from which it is the readout's: of
the width and the corners less, because rounded lips are hardly open."""
OUT = (0.08, 0.16)
"""Reading of the tongue from which it comes out, and at which it is out."""
RAISED = (0.5, 0.8)
"""Reading of the tip up to which the tongue comes out, and from which it does not: in /l/, which is
heard as TH in part, the tip is at the ridge behind the teeth."""
UNBITTEN = (0.04, 0.1)
"""Reading of the tongue from which the lower lip leaves the teeth, and at which it is away from
them: less than the tongue needs to come out, because TH is heard as F in part."""
VOICE = (0.3, 0.6)
"""Reading of the voice up to which the mouth does not move, and from which it moves as it does."""
SHOWN = {
    "out": ("tongue_inOut", -0.42, 1.0),
    "tip": ("tongue_tipMove.ty", 0.75, 0.0),
    "funnel": ("mouth_funnel", 0.75, 0.0),
    "purse": ("mouth_purse", 0.45, 0.5),
}
"""Part of the names of the controls of a channel, their value at 1, and the share of the decoder's
that is added."""
MEASURED = ("_mouth_", "_jaw")
"""Parts of the names of the controls that show or change a measure."""
PURSED_FUNNEL = 0.35
"""Funnel of pursed lips."""


class LipReadout(nn.Module):
    """Channels of phones and measures of the lips from features, and the curves that show them.

    Parameters
    ----------
    in_size : int
        Width of the speech features.
    names : sequence of str
        Controls of the rig.
    causal : bool
        Rows depend on features of their frame and of earlier ones.
    kept : collection of str
        Controls that are corrected, of a tuned model; empty: all. Measures are corrected where
        captures show no control of the mouth.
    """

    corrects: Tensor | None
    """True for the controls that are corrected [shape=(C,)]; None: all."""
    places: Tensor
    """1 where a control (column) is of a contact (row) [shape=(2, C)]."""
    values: Tensor
    """Of the controls where a channel of `SHOWN` is 1 [shape=(4, C)]."""
    own: Tensor
    """Share of the decoder's curves that stays [shape=(C,)]."""
    low: Tensor
    """Least of the decoder's curves: no tongue comes out by them [shape=(C,)]."""
    most: Tensor
    """`MOST` [shape=(4,)]."""
    fade: Tensor
    """`OPEN` [shape=(2, 4)]."""
    silence: Tensor
    """Features of silence, which is before and after every recording [shape=(D,)]."""
    opens: Tensor
    """Shares of `OPENERS`, whose sum is 1 [shape=(C,)]."""
    speaks: Tensor
    """1 where speech moves a control [shape=(C,)]."""

    def __init__(
        self,
        in_size: int,
        names: Sequence[str],
        *,
        causal: bool = False,
        kept: Collection[str] = (),
    ) -> None:
        super().__init__()
        self.causal, self._flat = causal, FlatKernel()
        shown = [name for name in names if kept and name not in kept]
        self.corrects_measures = not any(part in name for part in MEASURED for name in shown)
        mask = torch.tensor([name in kept for name in names]) if shown else None
        self.register_buffer("corrects", mask, persistent=False)
        self.listen = nn.Conv1d(in_size, HIDDEN + len(MEASURES), TAPS)
        self.phones = nn.Linear(HIDDEN, len(CHANNELS))
        self.register_buffer("silence", torch.zeros(in_size))
        self.shown = nn.Linear(len(names), len(MEASURES))
        """Measures that curves show, cm."""
        self.kept = nn.Parameter(torch.zeros(len(MEASURES)))
        """Share of what the decoder shows, in the measures that are wanted."""
        self.moves = nn.Linear(len(MEASURES), len(names), bias=False)
        """Controls per change of a measure."""

        # By numpy: some operations of torch on the meta device import its compiler.
        def of(*parts: str) -> Float32:
            return np.array([[part in name for name in names] for part in parts], np.float32)

        parts, values, shares = zip(*SHOWN.values(), strict=True)
        places, opens = of(*parts), of(*OPENERS).sum(axis=0)
        tables = {
            "places": of(*CONTACTS),
            "values": np.array(values, np.float32)[:, None] * places,
            "own": 1 - ((1 - np.array(shares, np.float32))[:, None] * places).sum(axis=0),
            "low": np.where(of(SHOWN["out"][0])[0] > 0, np.float32(0), np.float32(-np.inf)),
            "fade": np.array(OPEN, np.float32),
            "most": np.array(MOST, np.float32),
            "opens": opens / np.maximum(opens.sum(), 1),
            "speaks": of(*OPENING, *SPEAKING).max(axis=0),
        }
        for name, table in tables.items():
            self.register_buffer(name, torch.tensor(table), persistent=False)

    @property
    def margin(self) -> int:
        """Frames around a row, or before it, that it depends on."""
        return TAPS - 1 if self.causal else TAPS // 2

    def forward(
        self, speech: Tensor, past: Tensor | None = None, clips: JoinedClips | None = None
    ) -> Tensor:
        """Read features.

        Parameters
        ----------
        speech : Tensor [shape=(B, T, D)]
            Without positional encoding.
        past : Tensor [shape=(B, TAPS - 1, D)] or None
            Distance from silence of what came before, for a causal readout; None: nothing did.
        clips : JoinedClips or None
            Whose frames the features (1, K, D) are.

        Returns
        -------
        Tensor [shape=(B, T, 11)]
            `CHANNELS`, 0 to 1, and the part of the wanted `MEASURES` in cm that is not the
            decoder's.
        """
        x = speech - self.silence
        if past is not None:
            taps = joined_taps(torch.cat((past, x), dim=1), TAPS)
            rows = F.linear(taps, self._flat(self.listen.weight), self.listen.bias)
        else:
            x = x if clips is None else clips.spread(x, TAPS)
            x = F.pad(x.transpose(1, 2), (self.margin, TAPS - 1 - self.margin))
            rows = self.listen(x).transpose(1, 2)
        if clips is not None:
            rows = clips.taken(rows, TAPS)
        channels = self.phones(rows[..., :HIDDEN].relu()).sigmoid()
        return torch.cat((channels, rows[..., HIDDEN:]), dim=-1)

    def next_past(self, past: Tensor, speech: Tensor) -> Tensor:
        """`past` of the call after one with these features."""
        return torch.cat((past, speech - self.silence), dim=1)[:, 1 - TAPS :]

    def first_past(self, batch: int) -> Tensor:
        """`past` of the first frame of streams: silence, which is zeros (B, TAPS - 1, D)."""
        return self.listen.weight.new_zeros(batch, TAPS - 1, self.listen.in_channels)

    def correct(self, readings: Tensor, read: Tensor) -> Tensor:
        """Curves of readings of one speech, corrected.

        Parameters
        ----------
        readings : Tensor [shape=(R, ..., T, C)]
            The first is the neutral one.
        read : Tensor [shape=(..., T, 11)]
            From `forward`.
        """
        said, seals = self.articulated(readings, read)
        neutral = said
        if self.corrects_measures:
            neutral = said + self._measured(readings, said, read)
        if not self.causal:
            heard = read[..., len(CHANNELS) - 1, None]
            voice = smoothstep((heard - VOICE[0]) / (VOICE[1] - VOICE[0]))
            neutral = neutral * (1 - self.speaks * (1 - voice))
        curves = neutral + readings - readings[:1]
        curves = torch.where(self.places.sum(dim=0) > 0, seals, curves)
        return curves if self.corrects is None else torch.where(self.corrects, curves, readings)

    def _measured(self, readings: Tensor, said: Tensor, read: Tensor) -> Tensor:
        """What brings the measures towards those that are wanted [shape=(1, ..., T, C)]."""
        wanted = read[..., len(CHANNELS) :] + self.kept * self.shown(readings[:1])
        first, full = self.fade
        open_ = smoothstep(((readings[:1] @ self.opens)[..., None] - first) / (full - first))
        change = torch.maximum(torch.minimum(wanted - self.shown(said), self.most), -self.most)
        moved: Tensor = self.moves(open_ * change)
        return moved

    def articulated(self, readings: Tensor, read: Tensor) -> tuple[Tensor, Tensor]:
        """Curves that show the channels, of `correct`'s arguments.

        Returns
        -------
        said : Tensor [shape=(1, ..., T, C)]
            Of the neutral reading.
        seals : Tensor [shape=(R, ..., T, C)]
            Of all readings; they hold in the controls of contacts.
        """
        together, bite, out, tip, funnel, purse, _ = read[..., : len(CHANNELS), None].unbind(-2)
        out, free = (smoothstep((out - low) / (high - low)) for low, high in (OUT, UNBITTEN))
        out = out * ((RAISED[1] - tip) / (RAISED[1] - RAISED[0])).clamp(0, 1)
        likely = torch.cat((together, bite), dim=-1) @ self.places
        both = readings.clamp(0, 1) ** POWER * likely
        seals = both * (1 - free * self.places[1])
        funnel = (funnel + PURSED_FUNNEL * purse).clamp_max(1)
        channels = torch.cat((out, tip, funnel, purse), dim=-1)
        said = torch.maximum(readings[:1], self.low) * self.own + channels @ self.values
        return torch.where(self.places.sum(dim=0) > 0, seals[:1], said), seals
