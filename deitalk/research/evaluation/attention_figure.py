"""Figures of temporal attention over vowels and over plosives (SDFA §5.2.3, Fig. 9).

The paper shows one vowel with even weights and one /b/ with all weight on its centre. Here the
average of every vowel and plosive of a recording is shown, with the evenness of the weights.

Letters: T frames, L spectra of a window.
"""

from collections.abc import Set
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from deitalk.errors import DataError
from deitalk.evaluation.figures import drawing
from deitalk.postprocess.phones import PLOSIVES, VOWELS, Phones
from rig.arrays import Float32


@dataclass(frozen=True, eq=False)
class AttentionMap:
    """Attention of the frames at the middle of one kind of phone.

    Parameters
    ----------
    rows : array [shape=(K, L)]
        One row per phone; each sums to 1.
    phones : tuple of str
        Names of the phones.
    """

    rows: Float32
    phones: tuple[str, ...]

    @property
    def mean(self) -> Float32:
        """Mean row [shape=(L,)]."""
        return np.asarray(self.rows.mean(axis=0), dtype=np.float32)

    @property
    def evenness(self) -> float:
        """Mean entropy of a row over that of even weights: 1 flat, 0 all on one spectrum."""
        safe = np.maximum(self.rows.astype(np.float64), 1e-12)
        entropy = -(safe * np.log(safe)).sum(axis=1)
        return float(entropy.mean() / np.log(self.rows.shape[1]))

    @property
    def peak(self) -> float:
        """Mean over rows of the largest weight; even weights have 1 / L."""
        return float(self.rows.max(axis=1).mean())


def attention_maps(
    weights: Float32, phones: Phones, fps: float
) -> tuple[AttentionMap, AttentionMap]:
    """Rows at the middle of every vowel and of every plosive.

    Parameters
    ----------
    weights : array [shape=(T, L)]
        From `deitalk.research.evaluation.attention.attention_of`.
    phones : sequence of (start, end, phone)
        Seconds and ARPABET names, stress digits ignored.
    fps : float
        Frames per second of `weights`.

    Returns
    -------
    vowels, plosives : AttentionMap

    Raises
    ------
    DataError
        If the recording has no vowel or no plosive.
    """
    vowels, plosives = (attention_at(weights, phones, fps, names) for names in (VOWELS, PLOSIVES))
    for kind, found in (("vowel", vowels), ("plosive", plosives)):
        if not found.phones:
            raise DataError(f"the phones have no {kind}; choose a longer recording")
    return vowels, plosives


def attention_at(weights: Float32, phones: Phones, fps: float, names: Set[str]) -> AttentionMap:
    """Rows at the middle of every phone of the given names; may be empty."""
    found = [(s, e, p.rstrip("012")) for s, e, p in phones if p.rstrip("012") in names]
    places = [min(round((s + e) / 2 * fps), len(weights) - 1) for s, e, _ in found]
    return AttentionMap(weights[places], tuple(phone for *_, phone in found))


def plot_attention(
    vowels: AttentionMap, plosives: AttentionMap, frame_rate: float, path: Path
) -> None:
    """Draw both kinds: one row of colour per phone, and the means below.

    Parameters
    ----------
    vowels, plosives : AttentionMap
        From `attention_maps`.
    frame_rate : float
        Spectra per second, for the axis.
    path : Path
        .png, .svg or .pdf.

    Raises
    ------
    MissingError
        If matplotlib is not installed.
    """
    with drawing(path, (10, 6)) as figure:
        axes = figure.subplots(2, 2, sharex=True, height_ratios=(2, 1))
        n_spectra = vowels.rows.shape[1]
        times = (np.arange(n_spectra) - n_spectra // 2) / frame_rate * 1000
        largest = max(float(kind.rows.max()) for kind in (vowels, plosives))
        for column, (name, kind) in zip(
            axes.T, (("vowels", vowels), ("plosives", plosives)), strict=True
        ):
            extent = (float(times[0]), float(times[-1]), len(kind.rows), 0)
            column[0].imshow(kind.rows, aspect="auto", extent=extent, vmin=0, vmax=largest)
            column[0].set_title(f"{name}: {len(kind.rows)}, evenness {kind.evenness:.2f}")
            column[0].set_yticks(np.arange(len(kind.phones)) + 0.5, kind.phones, fontsize=6)
            column[1].plot(times, kind.mean)
            column[1].axhline(1 / n_spectra, color="0.7", lw=1)
            column[1].set_ylim(0, largest)
            column[1].set_xlabel("ms from the frame")


def plot_clip(weights: Float32, fps: float, frame_rate: float, phones: Phones, path: Path) -> None:
    """Draw attention along a recording: time across, the window's spectra down.

    Parameters
    ----------
    weights : array [shape=(T, L)]
        From `deitalk.research.evaluation.attention.attention_of`.
    fps, frame_rate : float
        Frames and spectra per second.
    phones : sequence of (start, end, phone)
        Written along the top; may be empty.
    path : Path
        .png, .svg or .pdf.

    Raises
    ------
    MissingError
        If matplotlib is not installed.
    """
    seconds, n_spectra = len(weights) / fps, weights.shape[1]
    with drawing(path, (min(max(6.0, 2.2 * seconds), 60.0), 4)) as figure:
        map_axis, even_axis = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1))
        early, late = ((k - n_spectra // 2 - 0.5) / frame_rate * 1000 for k in (0, n_spectra))
        map_axis.imshow(
            weights.T,
            aspect="auto",
            extent=(0, seconds, late, early),
            vmin=0,
            interpolation="nearest",
        )
        map_axis.axhline(0, color="w", lw=0.5, alpha=0.5)
        map_axis.set_ylabel("ms from the frame")
        rows = [AttentionMap(weights[i : i + 1], ("",)).evenness for i in range(len(weights))]
        even_axis.plot(np.arange(len(weights)) / fps, rows)
        even_axis.set(ylim=(0, 1.02), ylabel="evenness", xlabel="seconds", xlim=(0, seconds))
        for start, end, phone in phones:
            name = phone.rstrip("012")
            colour = "tab:red" if name in PLOSIVES else "tab:blue" if name in VOWELS else "0.5"
            even_axis.axvline(start, color="0.85", lw=0.5)
            map_axis.text((start + end) / 2, early, name, ha="center", va="bottom", fontsize=6,
                          color=colour)  # fmt: skip
