"""Channels of a recording to one: which of them, or their mean.

Letters: n samples of a block at the source's rate, C channels, W windows of 0.1 s.
"""

from typing import NamedTuple

import numpy as np

from deitalk.audio.choice import CENTRE, LOUDEST, MIX, channel_index
from rig.arrays import Float32, Float64

WINDOWS_A_SECOND = 10
FAINT_POWER = 1e-6  # -60 dBFS
BELOW_LOUDEST_DB = 40.0  # quieter windows hold no voice
APART_DB = 6.0  # a voice is that much louder in its own channel than in any other
LEAST_SECONDS, LEAST_SHARE = 0.5, 0.05  # of the windows with sound, that a channel leads
CENTRE_BELOW_DB = 30.0  # a quieter centre holds no speech of its own


class Mixing(NamedTuple):
    """Weights by which channels are mixed to one."""

    weights: Float32
    """[shape=(C,)]"""
    channel: str | None
    """The one that is taken, as `AudioChoice.channel`; None for the mean by default."""
    notes: tuple[str, ...] = ()


class Survey:
    """Powers of channels over a recording.

    Parameters
    ----------
    channels : int
        C.
    rate : int
        Hz.
    """

    def __init__(self, channels: int, rate: int) -> None:
        self.window = max(rate // WINDOWS_A_SECOND, 1)
        self.n_samples = 0
        self.total = np.zeros(channels)
        self.products = np.zeros((channels, channels))
        self.windows: list[Float32] = []

    def add(self, block: Float32) -> None:
        """Take one block (n, C)."""
        samples = block.astype(np.float64)
        self.total += samples.sum(axis=0)
        self.products += samples.T @ samples
        self.n_samples += len(block)
        n_windows = len(block) // self.window
        if n_windows:
            whole = samples[: n_windows * self.window].reshape(n_windows, self.window, -1)
            spread = np.square(whole).mean(axis=1) - np.square(whole.mean(axis=1))
            self.windows.append(spread.astype(np.float32))

    @property
    def covariance(self) -> Float64:
        """Products of all pairs of channels without their means [shape=(C, C)]."""
        count = max(self.n_samples, 1)
        return np.asarray(self.products / count - np.outer(self.total, self.total) / count**2)

    @property
    def leads(self) -> Float64:
        """Time in which each channel is the loudest by far, seconds [shape=(C,)]."""
        channels = len(self.total)
        if not self.windows:
            return np.zeros(channels)
        power = np.concatenate(self.windows)
        loudest = power.max(axis=1)
        least = max(FAINT_POWER, float(np.percentile(loudest, 99)) / 10 ** (BELOW_LOUDEST_DB / 10))
        power = power[loudest > least]
        if not len(power):
            return np.zeros(channels)
        second = np.partition(power, -2, axis=1)[:, -2]
        apart = power.max(axis=1) > second * 10 ** (APART_DB / 10)
        counts = np.bincount(power.argmax(axis=1)[apart], minlength=channels)
        fewest = max(LEAST_SECONDS * WINDOWS_A_SECOND, LEAST_SHARE * len(power))
        return np.where(counts >= fewest, counts, 0) / WINDOWS_A_SECOND


def mixing(survey: Survey, channel: str | None, layout: tuple[str, ...]) -> Mixing:
    """Weights of a chosen channel, or of the mean of all where none is chosen.

    Parameters
    ----------
    survey : Survey
        Of the whole recording.
    channel : str or None
        Of `AudioChoice`.
    layout : tuple of str
        Names of the channels, or empty.

    Raises
    ------
    AudioError
        If there is no such channel.
    """
    count = len(survey.total)
    if channel == MIX or (channel is None and count == 1):
        return Mixing(np.full(count, 1 / count, np.float32), channel)
    power = survey.covariance.diagonal()
    if channel == LOUDEST:
        loudest = int(power.argmax())
        note = (f"channel {loudest + 1} of {count} is the loudest: took it alone",)
        return Mixing(only(loudest, count), str(loudest + 1), note if count > 1 else ())
    if channel is not None:
        return Mixing(only(channel_index(channel, count, layout), count), channel)
    # The mean of all channels, or the loudest if the mean cancels.
    count, covariance = len(survey.total), survey.covariance
    power = covariance.diagonal()
    unrelated = power.sum() / count**2  # the mean's power if the channels were independent
    if survey.n_samples and covariance.mean() < 0.1 * unrelated:
        loudest = int(power.argmax())
        text = f"the {count} channels cancel each other: took channel {loudest + 1} alone"
        return Mixing(only(loudest, count), str(loudest + 1), (text,))
    leads = survey.leads
    notes: tuple[str, ...] = ()
    if (leads > 0).sum() >= 2:
        names = layout or (("left", "right") if count == 2 else ())
        parts = [
            f"{k + 1}{f' ({names[k]})' if names else ''} leads for {leads[k]:.1f} s"
            for k in np.flatnonzero(leads)
        ]
        first = int(np.flatnonzero(leads)[0]) + 1
        notes = (
            f"channels hold different voices: {', '.join(parts)}; all are mixed, the option "
            f"channel takes one: {'left or right' if count == 2 else first}",
        )
    return Mixing(np.full(count, 1 / count, np.float32), None, notes)


def only(index: int, count: int) -> Float32:
    """Weights of one channel [shape=(C,)]."""
    return np.asarray(np.eye(count, dtype=np.float32)[index])


def has_own_centre(survey: Survey, layout: tuple[str, ...]) -> bool:
    """Whether the centre of a surround recording is loud enough to have the speech."""
    if len(layout) < 3 or "FC" not in layout:
        return False
    power = survey.covariance.diagonal()
    centre = power[layout.index("FC")]
    return bool(centre > FAINT_POWER and centre * 10 ** (CENTRE_BELOW_DB / 10) > power.max())


def centre(layout: tuple[str, ...]) -> Mixing:
    """The centre of a surround recording."""
    note = f"{len(layout)} channels ({', '.join(layout)}): took the centre, which has the speech"
    return Mixing(only(layout.index("FC"), len(layout)), CENTRE, (note,))
