"""Mesh sequences to batches of adjacent frames, augmented as SDFA §4.3, and their bases (§4.4).

Letters: M pairs, F mel bins, L spectra of a window (64), N triangles, P speakers.
"""

from collections.abc import Iterator, Sequence
from functools import lru_cache
from itertools import count
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.utils.data import IterableDataset, get_worker_info

from deitalk.activity import normalise_level
from deitalk.augment_mel import STRETCH, MelWarp, augment_audio, frame_shift
from deitalk.config import MelConfig, MeshDataConfig
from deitalk.data.mesh_folder import MeshClip, MeshFolder
from deitalk.errors import DataError
from deitalk.features import SAMPLE_RATE, MelSpectrogram, derivative
from rig.mesh import Bases, DeformationSolver, GradientBasis, fit_basis, small_parts
from rig.mesh.basis import VARIANCES
from rig.mesh.trimesh import TriMesh, triangle_areas

Floats = NDArray[np.float64]

_EDGE = 2
"""Spectra on either side that two derivatives need."""
_HELD_OUT_FRAMES = 60
_LIVELY_SHARE = 0.05
"""Share of the vertices that move most: lips and jaw, where the error of a basis shows."""


class MeshPair(NamedTuple):
    """Two adjacent frames, t - 1 and t; a batch has the same fields with a leading axis M."""

    mel: Tensor
    """Windows around both [shape=(2, 3, F, L)]."""
    s: Tensor
    """Packed stretch [shape=(2, 6 N)]."""
    r: Tensor
    """Packed rotation [shape=(2, 3 N), radians]."""
    speaker: Tensor
    """One-hot [shape=(P,)]."""


class MelWindows:
    """Cut mel windows around moments of a recording.

    Parameters
    ----------
    config : MelConfig
        Sizes of a window and of its spectra.
    """

    def __init__(self, config: MelConfig) -> None:
        self.config = config
        self.mel = MelSpectrogram(config.window_seconds, config.frame_rate, config.n_mels)
        self.hop = SAMPLE_RATE / config.frame_rate
        self.n_wide = int(np.ceil((config.window_frames + 2 * _EDGE) / STRETCH[0])) + 2
        """Spectra that every warp finds what it needs in."""
        self.n_before = int(np.ceil(self.mel.length / 2 / self.hop))
        """Spectra before the first one that its own window reaches over."""

    def __call__(self, waveform: NDArray[np.float32], times: Floats, warp: MelWarp) -> Tensor:
        """Windows whose spectrum L // 2 is centred at `times`, in seconds [shape=(K, 3, F, L)]."""
        pieces = np.stack([self._piece(waveform, float(time)) for time in times])
        wide = self.mel(torch.from_numpy(pieces), self.n_wide, self.n_before)[:, 0]  # (K, F, W)
        n_spectra = self.config.window_frames + 2 * _EDGE
        mel = torch.stack([warp(one, n_spectra) for one in wide])
        slope = derivative(mel)
        three = torch.stack((mel, slope, derivative(slope)), dim=1)
        return three[..., _EDGE:-_EDGE]

    def _piece(self, waveform: NDArray[np.float32], time: float) -> NDArray[np.float32]:
        """Samples for `n_wide` spectra about a time; silence outside the recording."""
        middle = self.n_before + self.n_wide // 2
        start = round(time * SAMPLE_RATE - middle * self.hop)
        length = round((2 * self.n_before + self.n_wide) * self.hop)
        inside = waveform[max(start, 0) : max(start + length, 0)]
        before = min(max(-start, 0), length)
        return np.pad(inside, (before, length - before - len(inside))).astype(np.float32)


class MeshBatches(IterableDataset[MeshPair]):
    """Endless batches of random pairs of adjacent frames.

    Every pair of the split is as likely as another. Both frames of a pair get one shift, one
    choice of noise and pre-emphasis and one warp of the spectrogram (§4.3, §4.4: 50 pairs in a
    batch of 100 frames).

    Parameters
    ----------
    clips : sequence of MeshClip
        Those of one split.
    speakers : tuple of str
        Places of the one-hot label.
    fps : float
        Frames per second.
    mel : MelConfig
        Sizes of a window.
    n_pairs : int
        Pairs of a batch.
    augment : bool
        All of §4.3, or nothing.
    seed : int
        Pair k depends on the seed and k alone, whatever the number of workers.
    skip : int
        First batch: where an interrupted training goes on.
    """

    def __init__(
        self,
        clips: Sequence[MeshClip],
        speakers: tuple[str, ...],
        fps: float,
        mel: MelConfig,
        *,
        n_pairs: int,
        augment: bool,
        seed: int,
        skip: int = 0,
    ) -> None:
        if not clips:
            raise DataError("no mesh sequences to train on; the data has none in this split")
        self.clips, self.speakers, self.fps = list(clips), speakers, fps
        self.windows = MelWindows(mel)
        self.n_pairs, self.augment, self.seed, self.skip = n_pairs, augment, seed, skip
        self.pairs_before = np.cumsum([0] + [len(c.gradients()[0]) - 1 for c in self.clips])

    @property
    def n_frames(self) -> int:
        """Frames that an epoch passes over."""
        return int(self.pairs_before[-1]) + len(self.clips)

    def __iter__(self) -> Iterator[MeshPair]:
        """Yield this worker's batches, stacked."""
        worker = get_worker_info()
        step, lane = (worker.num_workers, worker.id) if worker else (1, 0)
        for batch in count(self.skip + lane, step):
            numbers = range(batch * self.n_pairs, (batch + 1) * self.n_pairs)
            pairs = [self.pair(number) for number in numbers]
            yield MeshPair(*(torch.stack(field) for field in zip(*pairs, strict=True)))

    def pair(self, number: int) -> MeshPair:
        """The pair of one number."""
        rng = np.random.default_rng((self.seed, number))
        drawn = int(rng.integers(self.pairs_before[-1]))
        which = int(np.searchsorted(self.pairs_before, drawn, side="right")) - 1
        clip, first = self.clips[which], drawn - int(self.pairs_before[which])
        frames = first + np.arange(2, dtype=np.float64)
        waveform, warp = _waveform(clip), MelWarp()
        if self.augment:
            frames = frames + frame_shift(rng)
            waveform, frames_in_piece = self._surroundings(waveform, frames)
            waveform = augment_audio(waveform, rng)
            warp = MelWarp.draw(self.windows.config.n_mels, rng)
        else:
            frames_in_piece = frames
        mel = self.windows(waveform, frames_in_piece / self.fps, warp)
        s, r = clip.gradients()
        return MeshPair(
            mel,
            torch.from_numpy(between_frames(s, frames)),
            torch.from_numpy(between_frames(r, frames)),
            torch.eye(len(self.speakers))[self.speakers.index(clip.speaker)],
        )

    def _surroundings(
        self, waveform: NDArray[np.float32], frames: Floats
    ) -> tuple[NDArray[np.float32], Floats]:
        """A second about the frames, for the noise's sake; and the frames' places in it."""
        reach = self.windows.n_wide * self.windows.hop + self.windows.mel.length
        start = max(round(frames[0] / self.fps * SAMPLE_RATE - reach), 0)
        stop = max(round(frames[-1] / self.fps * SAMPLE_RATE + reach), 1)
        return waveform[start:stop], frames - start / SAMPLE_RATE * self.fps


def between_frames(rows: NDArray[np.float16], places: Floats) -> NDArray[np.float32]:
    """Rows at fractional places, linear, held beyond the ends.

    Parameters
    ----------
    rows : array [shape=(T, D)]
        Packed s or r of every frame.
    places : array [shape=(K,)]
        Frame numbers.

    Returns
    -------
    array [shape=(K, D), float32]

    Notes
    -----
    Where a rotation vector jumps by more than pi between two frames (a sliver near half a turn,
    whose vector has two ends), the nearer frame stands: a mean of the two would be no rotation
    near either. Stretch is linear everywhere, but for such jumps of a sliver's.
    """
    places = np.clip(places, 0, len(rows) - 1)
    below = np.minimum(places.astype(np.int64), max(len(rows) - 2, 0))
    above = np.minimum(below + 1, len(rows) - 1)
    low, high = rows[below].astype(np.float32), rows[above].astype(np.float32)
    share = (places - below).astype(np.float32)[:, None]
    nearer = np.where(share < 0.5, low, high)
    return np.where(np.abs(high - low) > np.pi, nearer, low + share * (high - low))


@lru_cache(maxsize=256)
def _waveform(clip: MeshClip) -> NDArray[np.float32]:
    return normalise_level(clip.waveform())


def fit_mesh_bases(folder: MeshFolder, config: MeshDataConfig, seed: int = 0) -> Bases:
    """Bases of the training split, as small as held-out frames allow.

    Parameters
    ----------
    folder : MeshFolder
        Of the training data.
    config : MeshDataConfig
        How many frames to fit to, and what the bases may cost.
    seed : int
        Which frames.

    Returns
    -------
    Bases
        Of the smallest share of variance whose 99th percentile of vertex error, over the
        twentieth of the vertices that moves most in held-out frames, is within
        `config.basis_error_mm`; else of the largest share tried. The table has a row a share, in
        mm.

    Notes
    -----
    Deviation: the paper keeps 97 % of the variance of unweighted numbers; see `rig.mesh.basis`.
    All speakers share the bases, and the weights are from the mean of their triangles' areas.
    """
    areas = np.mean([triangle_areas(t) for t in folder.templates.values()], axis=0)
    training = _draw_frames(folder.split("train"), config.basis_frames, seed)
    fitted = (
        fit_basis(np.concatenate([s for _, s, _ in training]), areas),
        fit_basis(np.concatenate([r for _, _, r in training]), areas),
    )
    held_out = _draw_frames(
        folder.split("validation") or folder.split("train"), _HELD_OUT_FRAMES, seed + 1
    )
    solvers = {name: mesh_solver(folder.templates[name]) for name, _, _ in held_out}
    truth = [solvers[name].solve(s, r) for name, s, r in held_out]
    lively = _lively(truth, [folder.templates[name] for name, _, _ in held_out])
    table: list[dict[str, float]] = []
    small: tuple[GradientBasis, ...] = fitted
    for share in VARIANCES:
        small = tuple(basis.truncated(basis.size_for(share)) for basis in fitted)
        errors = [
            np.linalg.norm(solvers[name].solve(*_through(small, s, r)) - wanted, axis=-1)
            for (name, s, r), wanted in zip(held_out, truth, strict=True)
        ]
        error = np.concatenate(errors) * folder.unit_mm
        table.append({
            "variance": share,
            "stretch": len(small[0].deviations),
            "rotation": len(small[1].deviations),
            "mean_mm": float(error.mean()),
            "lively_p99_mm": float(np.percentile(error[:, lively], 99)),
        })  # fmt: skip
        if table[-1]["lively_p99_mm"] <= config.basis_error_mm:
            break
    return Bases(small[0], small[1], tuple(table))


def _through(bases: Sequence[GradientBasis], s: Floats, r: Floats) -> tuple[Floats, Floats]:
    """What bases of stretch and rotation leave of frames."""
    stretch, rotation = bases
    return stretch.expand(stretch.project(s)), rotation.expand(rotation.project(r))


def mesh_solver(template: TriMesh) -> DeformationSolver:
    """Solver of a template; its eyes and teeth, where it has them, move as single pieces."""
    return DeformationSolver(template, parts=small_parts(template))


def _draw_frames(
    clips: Sequence[MeshClip], n_frames: int, seed: int
) -> list[tuple[str, Floats, Floats]]:
    """Speaker, s and r of frames drawn evenly from clips."""
    rng = np.random.default_rng(seed)
    each = -(-n_frames // max(len(clips), 1))
    order = rng.permutation(len(clips))[:n_frames]
    drawn = []
    for i in order:
        s, r = clips[i].gradients()
        chosen = np.sort(rng.permutation(len(s))[:each])
        drawn.append((clips[i].speaker, s[chosen].astype(float), r[chosen].astype(float)))
    return drawn


def _lively(frames: Sequence[Floats], templates: Sequence[TriMesh]) -> NDArray[np.int64]:
    """Vertices that move most from their template over all frames."""
    motion = np.max(
        [
            np.linalg.norm(moved - template.vertices, axis=-1).max(axis=0)
            for moved, template in zip(frames, templates, strict=True)
        ],
        axis=0,
    )
    count_ = max(int(_LIVELY_SHARE * len(motion)), 1)
    return np.argsort(motion)[-count_:]
