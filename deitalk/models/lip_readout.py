"""Linear readout of lips from the speech features; not in the papers.

A decoder that is trained on computed faces does not show all that its features hold. The readout
is fitted to phones and to measured lips of people, and corrects the decoder:

- A contact, lips together or lower lip on the teeth, becomes the geometric mean of the decoder's
  and of the probability that the readout gives it: none that either denies, and the decoder's
  timing.
- The width of the mouth and the height of its corners move towards those that the readout gives,
  by the controls that change nothing else of the lips. What an emotion adds stays.

Letters: R readings, B streams, T frames, D width of the features, C controls.
"""

from collections.abc import Sequence

import torch
from torch import Tensor, nn
from torch.nn import functional as F

CONTACTS = ("lipsTogether", "lipBiteD")
"""Parts of the names of the controls of each contact."""
MEASURES = ("width", "corner")
"""Measures of the embedded head that are corrected."""
TAPS = 9
"""Frames that a row is read from: those around it, or in a causal model those up to it."""


class LipReadout(nn.Module):
    """Contacts and measures of the lips from speech features, and the curves that show them.

    Parameters
    ----------
    in_size : int
        Width of the speech features.
    names : sequence of str
        Controls of the rig.
    causal : bool
        Rows depend on features of their frame and of earlier ones.
    """

    places: Tensor
    """1 where a control (column) is of a contact (row) [shape=(2, C)]."""

    def __init__(self, in_size: int, names: Sequence[str], *, causal: bool = False) -> None:
        super().__init__()
        self.causal = causal
        self.listen = nn.Conv1d(in_size, len(CONTACTS) + len(MEASURES), TAPS)
        self.shown = nn.Linear(len(names), len(MEASURES))
        """Part of the change that depends on the curves: less where they show the measure."""
        self.moves = nn.Linear(len(MEASURES), len(names), bias=False)
        """Controls per change of a measure."""
        places = [[float(part in name) for name in names] for part in CONTACTS]
        self.register_buffer("places", torch.tensor(places), persistent=False)

    @property
    def margin(self) -> int:
        """Frames around a row, or before it, that it depends on."""
        return TAPS - 1 if self.causal else TAPS // 2

    def forward(self, speech: Tensor, past: Tensor | None = None) -> Tensor:
        """Read features.

        Parameters
        ----------
        speech : Tensor [shape=(B, T, D)]
            Without positional encoding.
        past : Tensor [shape=(B, TAPS - 1, D)] or None
            What came before, for a causal readout; None: nothing did.

        Returns
        -------
        Tensor [shape=(B, T, 4)]
            Probabilities of `CONTACTS`, and parts of the change of `MEASURES` in cm.
        """
        if past is not None:
            x = torch.cat((past, speech), dim=1).transpose(1, 2)
        else:
            x = F.pad(speech.transpose(1, 2), (self.margin, TAPS - 1 - self.margin))
        rows = self.listen(x).transpose(1, 2)
        n = len(CONTACTS)
        return torch.cat((rows[..., :n].sigmoid(), rows[..., n:]), dim=-1)

    def first_past(self, batch: int) -> Tensor:
        """Features before the first frame of streams: zeros (B, TAPS - 1, D)."""
        return self.listen.weight.new_zeros(batch, TAPS - 1, self.listen.in_channels)

    def correct(self, readings: Tensor, read: Tensor) -> Tensor:
        """Curves of readings of one speech, corrected.

        Parameters
        ----------
        readings : Tensor [shape=(R, ..., T, C)]
            The first is the neutral one.
        read : Tensor [shape=(..., T, 4)]
            From `forward`.
        """
        n = len(CONTACTS)
        likely, wanted = read[..., :n], read[..., n:]
        curves = readings + self.moves(wanted + self.shown(readings[:1]))
        contacts = (curves.clamp(0, 1) * (likely @ self.places)).sqrt()
        return torch.where(self.places.sum(dim=0) > 0, contacts, curves)
