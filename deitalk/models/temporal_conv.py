"""Dilated convolutions over time, shared by motion encoder and decoder (DEITalk §4.1)."""

from collections.abc import Sequence

import torch
from torch import Tensor, nn
from torch.nn import functional as F

FEW_FRAMES = 4
"""Frames up to which a causal layer is one product of matrices."""


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
        self._kept: tuple[tuple[int, int], Tensor] | None = None
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

    def forward(self, x: Tensor, past: Tensor | None = None) -> Tensor:
        """Map (B, in_channels, T) to (B, out_channels, T).

        `past` (B, in_channels, span) is what a causal layer was given before; zeros without it.
        """
        if self.causal:
            x = F.pad(x, (self.span, 0)) if past is None else torch.cat((past, x), dim=2)
            if x.shape[2] - self.span <= FEW_FRAMES:
                return self._few(x)
        out: Tensor = self.after(self.conv(x))
        return out

    def _few(self, x: Tensor) -> Tensor:
        """The same for so few frames that a convolution's preparations cost more than its work."""
        dilation, frames = self.conv.dilation[0], x.shape[2] - self.span
        starts = range(0, self.span + 1, dilation)
        taps = [x[:, :, start : start + frames] for start in starts]
        rows = torch.cat(taps, dim=1).transpose(1, 2)  # (B, T, K in_channels)
        out: Tensor = self.after(F.linear(rows, self._flat(), self.conv.bias).transpose(1, 2))
        return out

    def _flat(self) -> Tensor:
        """Weights as one matrix (out_channels, K in_channels), kept until they change."""
        weight = self.conv.weight
        if weight.requires_grad and torch.is_grad_enabled():
            return weight.permute(0, 2, 1).flatten(1)
        state = (weight.data_ptr(), weight._version)
        if self._kept is None or self._kept[0] != state:
            self._kept = (state, weight.detach().permute(0, 2, 1).flatten(1).contiguous())
        return self._kept[1]


def receptive_margin(dilations: Sequence[int], kernel_size: int, *, causal: bool = False) -> int:
    """Frames on either side that a stack of `TemporalConv` spans: 30 for 1 2 4 8 1 2 4 8, k=3.

    Of causal layers, twice as many, before the frame.
    """
    return sum(dilations) * (kernel_size - 1) // (1 if causal else 2)
