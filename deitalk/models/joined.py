"""Recordings of any lengths in one pass: their frames one after the other.

What depends on a frame alone takes the rows of all recordings as they are. A convolution or a
maximum over time takes them with gaps, so that no recording reaches into another, and a pass has as
many calls of torch for a hundred recordings as for one.

Letters: K frames of all recordings, N rows with gaps, D width.
"""

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from rig.arrays import Int64


class JoinedClips:
    """Where the frames of recordings lie.

    Parameters
    ----------
    counts : sequence of int
        Frames of each recording.
    device : torch.device
        Of the rows.
    """

    def __init__(self, counts: Sequence[int], device: torch.device) -> None:
        self.counts, self.device = list(counts), device

    @property
    def frames(self) -> Tensor:
        """Number of each row in its recording [shape=(K,)]."""
        return torch.from_numpy(np.concatenate([*map(np.arange, self.counts)])).to(self.device)

    @property
    def totals(self) -> Tensor:
        """Frames of the recording of each row [shape=(K,)]."""
        return torch.from_numpy(np.repeat(self.counts, self.counts)).to(self.device)

    def spread(self, rows: Tensor, gap: int, fill: float = 0.0) -> Tensor:
        """Rows (B, K, D) with `gap` rows before and after each recording (B, N, D)."""
        places, count = self._with_gaps(gap)
        out = rows.new_full((len(rows), count, rows.shape[-1]), fill)
        return out.index_copy_(1, places, rows)

    def taken(self, rows: Tensor, gap: int) -> Tensor:
        """The rows (B, K, D) of `spread` ones (B, N, D)."""
        return rows.index_select(1, self._with_gaps(gap)[0])

    def gaps(self, gap: int) -> Tensor:
        """Numbers of the rows of the gaps."""
        places, count = self._host(gap)
        return torch.from_numpy(np.setdiff1d(np.arange(count), places)).to(self.device)

    def _host(self, gap: int) -> tuple[Int64, int]:
        before = gap * np.arange(1, len(self.counts) + 1).repeat(self.counts)
        total = sum(self.counts)
        return np.arange(total) + before, total + gap * (len(self.counts) + 1)

    def _with_gaps(self, gap: int) -> tuple[Tensor, int]:
        places, count = self._host(gap)
        return torch.from_numpy(places).to(self.device), count
