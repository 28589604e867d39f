"""Dilated convolutions over time, shared by motion encoder and decoder (DEITalk §4.1)."""

from collections.abc import Sequence

from torch import Tensor, nn


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
    """

    def __init__(
        self, in_channels: int, out_channels: int, kernel_size: int, dilation: int, dropout: float
    ) -> None:
        super().__init__()
        self.conv = nn.Conv1d(
            in_channels,
            out_channels,
            kernel_size,
            dilation=dilation,
            padding=dilation * (kernel_size - 1) // 2,
        )
        # Paper silent: initialisation. torch's own loses 60 % of the signal per layer; after
        # eight of them only the inputs that join at every layer are left, not speech.
        nn.init.kaiming_normal_(self.conv.weight, nonlinearity="relu")
        assert self.conv.bias is not None
        nn.init.zeros_(self.conv.bias)
        self.after = nn.Sequential(nn.ReLU(), nn.Dropout(dropout))

    def forward(self, x: Tensor) -> Tensor:
        """Map (B, in_channels, T) to (B, out_channels, T)."""
        out: Tensor = self.after(self.conv(x))
        return out


def receptive_margin(dilations: Sequence[int], kernel_size: int) -> int:
    """Frames on either side that a stack of `TemporalConv` spans: 30 for 1 2 4 8 1 2 4 8, k=3."""
    return sum(dilations) * (kernel_size - 1) // 2
