"""A whole clip through a frontend in bounded memory."""

from collections.abc import Callable

from torch import Tensor


def encode_in_segments(
    frames: Callable[[Tensor, int, int], Tensor],
    waveform: Tensor,
    rows: Tensor,
    segment: int,
    context: int,
    progress: Callable[[float], None],
) -> Tensor:
    """Fill `rows` segment by segment.

    Parameters
    ----------
    frames : callable
        ``frames(waveform, first, last)`` maps (1, S) to the rows first to last - 1, as
        (1, last - first, D).
    waveform : Tensor [shape=(S,)]
        The clip.
    rows : Tensor [shape=(T, D)]
        Where the rows go.
    segment, context : int
        Rows that are kept at once, and rows on either side of them that are computed for them and
        thrown away.
    progress : callable
        Told the share that is done, 0 to 1.

    Returns
    -------
    Tensor [shape=(T, D)]
        `rows`.
    """
    n_frames = len(rows)
    for start in range(0, n_frames, segment):
        stop = min(start + segment, n_frames)
        first, last = max(start - context, 0), min(stop + context, n_frames)
        computed = frames(waveform.unsqueeze(0), first, last)
        rows[start:stop] = computed[0, start - first : stop - first]
        progress(stop / n_frames)
    return rows
