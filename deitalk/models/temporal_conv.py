"""Dilated convolutions over time, shared by motion encoder and decoder (DEITalk §4.1)."""

from collections.abc import Sequence

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from deitalk.frontends.flat_kernel import FlatKernel, joined_taps


class TemporalConv(nn.Module):
    """One layer: dilated convolution that keeps the length, ReLU, dropout.

    Parameters
    ----------
    in_channels, out_channels : int
    kernel_size : int
        Odd. Padding is ``dilation * (kernel_size - 1) / 2``: with kernel 3 and dilation 4, the
        output at frame t depends on t-4, t and t+4; outside the clip there are zeros.
    dilation : int
    dropout : float
    causal : bool
        The output at frame t depends on t-8, t-4 and t instead.

    Attributes
    ----------
    span : int
        Frames that the kernel reaches over, besides its own.
    """

    def __init__(
        self,
        in_channels: int,
        out_channels: int,
        kernel_size: int,
        dilation: int,
        dropout: float,
        *,
        causal: bool = False,
    ) -> None:
        super().__init__()
        self.causal, self.span = causal, dilation * (kernel_size - 1)
        self._flat = FlatKernel()
        self.conv = nn.Conv1d(
            in_channels,
            out_channels,
            kernel_size,
            dilation=dilation,
            padding=0 if causal else self.span // 2,
        )
        # Paper silent: initialisation. torch's own loses 60 % of the signal per layer; after
        # eight of them only the inputs that join at every layer are left, not speech.
        nn.init.kaiming_normal_(self.conv.weight, nonlinearity="relu")
        assert self.conv.bias is not None
        nn.init.zeros_(self.conv.bias)
        self.after = nn.Sequential(nn.ReLU(), nn.Dropout(dropout))

    def forward(self, x: Tensor) -> Tensor:
        """Map (B, in_channels, T) to (B, out_channels, T)."""
        out: Tensor = self.after(self.conv(F.pad(x, (self.span, 0)) if self.causal else x))
        return out

    def advance(self, x: Tensor, past: Tensor) -> tuple[Tensor, Tensor]:
        """Map the next rows (..., T, in_channels) of streams by a causal layer.

        `past` (..., span, in_channels) is what it was given before; that of the next call is
        returned after the rows (..., T, out_channels).
        """
        rows = torch.cat((past, x), dim=-2)
        taps = joined_taps(rows, self.conv.kernel_size[0], self.conv.dilation[0])
        out: Tensor = self.after(F.linear(taps, self._flat(self.conv.weight), self.conv.bias))
        return out, rows[..., -self.span :, :] if self.span else past

    @property
    def reach(self) -> int:
        """Frames before an output's own that it depends on, and if not causal, after it."""
        return self.span if self.causal else self.span // 2

    def add_products(self, out: Tensor, x: "JoinedRows", given: slice, weights: slice) -> None:
        """Add the convolution of some inputs to rows, as products of matrices.

        Parameters
        ----------
        out : Tensor [shape=(N, out_channels)]
            Rows as of `JoinedRows.inner`; changed.
        x : JoinedRows
            Rows of inputs, with gaps of `reach` or more.
        given : slice
            Columns of `x`.
        weights : slice
            Input channels of the convolution that they are.
        """
        kernel = self._flat(self.conv.weight).view(
            self.conv.out_channels, -1, self.conv.in_channels
        )
        for tap, start in enumerate(self._starts):
            out.addmm_(x.inner(start - self.reach)[:, given], kernel[:, tap, weights].T)

    @property
    def _starts(self) -> range:
        """Place of each tap of the kernel, frames after the first."""
        return range(0, self.span + 1, self.conv.dilation[0])


class JoinedRows:
    """Sequences of one length as rows of one matrix, with rows of zeros before and after each.

    A dilated convolution of all of them is then a product of matrices for each tap of the kernel,
    half the time of a convolution of torch on a processor.

    Parameters
    ----------
    count, length, width : int
        Of the sequences.
    gap : int
        Rows of zeros.
    like : Tensor
        Gives type and device.
    """

    def __init__(self, count: int, length: int, width: int, gap: int, like: Tensor) -> None:
        self.gap = gap
        self.matrix = like.new_zeros(gap + count * (length + gap), width)
        blocks = self.matrix[gap:].view(count, length + gap, width)
        self.rows = blocks[:, :length]
        """Views of the sequences [shape=(count, length, width)]."""
        self.gaps = blocks[:, length:]
        """Views of the rows after each [shape=(count, gap, width)]."""

    def inner(self, shift: int = 0) -> Tensor:
        """All rows but the first and the last gap, or those some frames after them, (N, width)."""
        return self.matrix[self.gap + shift : len(self.matrix) - self.gap + shift]


def receptive_margin(dilations: Sequence[int], kernel_size: int, *, causal: bool = False) -> int:
    """Frames on either side that a stack of `TemporalConv` spans: 30 for 1 2 4 8 1 2 4 8, k=3.

    Of causal layers, twice as many, before the frame.
    """
    return sum(dilations) * (kernel_size - 1) // (1 if causal else 2)
