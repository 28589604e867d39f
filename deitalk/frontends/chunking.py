"""Encoding of a whole clip in segments, in bounded memory."""

from collections.abc import Callable, Sequence

from torch import Tensor

from deitalk.audio.frames import SAMPLE_RATE


def phase_shifts(phases: int, frame_rate: float) -> list[int]:
    """Shifts in samples, one for each encoding, that divide the period of the spectra evenly.

    Balanced about 0, so that the mean of all encodings is in time; a single one is not shifted.
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
    """Fill `rows` segment by segment with the mean of the encodings at every shift.

    Not in the papers. In noise the mean of two encodings, half a period of the spectra apart,
    separates closures from vowels better than one does (MODEL_CARD.md).

    Parameters
    ----------
    frames : callable
        ``frames(waveform, first, last, shift)`` maps (1, S) to the rows first to last - 1, as
        (1, last - first, D), by spectra that are `shift` samples late.
    waveform : Tensor [shape=(S,)]
        The clip.
    rows : Tensor [shape=(T, D)]
        Filled in place.
    segment, context : int
        Rows kept at once, and rows on either side of them that are computed as context only.
    shifts : sequence of int
        Samples, one for each encoding; from `phase_shifts`.
    progress : callable
        Called with the share done, 0 to 1.

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
