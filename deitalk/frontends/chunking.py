"""A whole clip through a frontend in bounded memory."""

from collections.abc import Callable, Sequence

from torch import Tensor

from deitalk.audio.mel import SAMPLE_RATE


def phase_shifts(phases: int, frame_rate: float) -> list[int]:
    """Samples by which spectra move so that `phases` hearings divide their period evenly.

    Balanced about 0, so that the mean of all is in time; one hearing is not moved.
    """
    period = SAMPLE_RATE / frame_rate
    return [round((2 * i + 1 - phases) / (2 * phases) * period) for i in range(phases)]


def encode_in_segments(
    frames: Callable[[Tensor, int, int, int], Tensor],
    waveform: Tensor,
    rows: Tensor,
    segment: int,
    context: int,
    shifts: Sequence[int],
    progress: Callable[[float], None],
) -> Tensor:
    """Fill `rows` segment by segment with the mean of what is heard at every shift.

    Paper silent. In noise the mean of two hearings, half a spectrum's period apart, tells closures
    from vowels better than one does (MODEL_CARD.md).

    Parameters
    ----------
    frames : callable
        ``frames(waveform, first, last, shift)`` maps (1, S) to the rows first to last - 1, as
        (1, last - first, D), by spectra that are `shift` samples late.
    waveform : Tensor [shape=(S,)]
        The clip.
    rows : Tensor [shape=(T, D)]
        Where the rows go.
    segment, context : int
        Rows that are kept at once, and rows on either side of them that are computed for them and
        thrown away.
    shifts : sequence of int
        Samples, one for each hearing; from `phase_shifts`.
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
        inner = slice(start - first, stop - first)
        rows[start:stop] = 0
        for shift in shifts:
            rows[start:stop] += frames(waveform.unsqueeze(0), first, last, shift)[0, inner]
        rows[start:stop] /= len(shifts)
        progress(stop / n_frames)
    return rows
