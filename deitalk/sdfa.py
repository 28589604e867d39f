"""SDFA: speech and a speaker to the motion of a mesh (SDFA §3, Fig. 1).

Letters: B frames, F mel bins, L spectra of a window, P speakers, N triangles, V vertices::

    waveform -> mel windows (B, 3, F, L) -> spectral gathering (B, L, 256)
             -> Time-BiLSTM (B, L, 512) -> attention (B, 512)
             -> decoder (B, 6 N), (B, 3 N) -> solve -> vertices (B, V, 3)
"""

from collections.abc import Iterator, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional as F

from deitalk.activity import normalise_level
from deitalk.audio import SAMPLE_RATE
from deitalk.config import SDFAModelConfig
from deitalk.data.mesh_windows import mesh_solver
from deitalk.deformation_decoder import Deformation, DeformationDecoder, InversePCA
from deitalk.errors import CheckpointError, DataError
from deitalk.frontends.mel_bilstm import MelFrontend
from rig.mesh import DeformationSolver, TriMesh

FRAMES_AT_ONCE = 64
"""Windows that go through the network together when predicting."""


class SDFA(nn.Module):
    """The network with the templates it can move.

    Parameters
    ----------
    config : SDFAModelConfig
        Sizes.
    layers : (InversePCA, InversePCA)
        Frozen layers of stretch and of rotation.
    speakers : sequence of str
        Styles, in the order of the one-hot label.
    templates : dict of str to TriMesh
        Expressionless mesh of every speaker.
    fps : float
        Frames per second it was trained at; `predict` gives as many.
    unit_mm : float
        Millimetres in a unit of the templates.
    """

    def __init__(
        self,
        config: SDFAModelConfig,
        layers: tuple[InversePCA, InversePCA],
        speakers: Sequence[str],
        templates: dict[str, TriMesh],
        *,
        fps: float,
        unit_mm: float,
    ) -> None:
        super().__init__()
        self.config, self.fps, self.unit_mm = config, fps, unit_mm
        self.speakers, self.templates = tuple(speakers), dict(templates)
        self.frontend = MelFrontend(config.frontend)
        self.decoder = DeformationDecoder(
            self.frontend.output_size,
            len(self.speakers),
            layers,
            shared=config.shared_size,
            hidden=config.branch_sizes,
            normalise_weights=config.weight_norm,
        )

    def forward(self, mel: Tensor, speaker: Tensor) -> Deformation:
        """Map mel windows (B, 3, F, L) and one-hot speakers (B, P) to s and r of their centres."""
        spectral = self.frontend.spectral(mel)  # z_spec (B, L, 256)
        attended, _ = self.attend(spectral)  # z_att (B, 512)
        deformation: Deformation = self.decoder(attended, speaker)
        return deformation

    def attend(self, spectral: Tensor) -> tuple[Tensor, Tensor]:
        """Articulation analysis (§3.3): z_spec (B, L, 256) to z_att (B, 512) and weights (B, L)."""
        config = self.config.frontend
        memory, _ = self.frontend.recurrent(spectral)
        half = config.window_frames // 2
        first = half - config.query_frames // 2
        query = memory[:, first : first + config.query_frames]
        attended, weights = self.frontend.attention.windows(memory, query)
        if self.frontend.normalise is not None:
            attended = self.frontend.normalise(attended + memory[:, half])
        return attended, weights

    @torch.no_grad()
    def predict(self, waveform: Any, speaker: str | int = 0) -> Deformation:
        """Gradients of a whole recording, frame i at i / fps seconds.

        Parameters
        ----------
        waveform : array [shape=(S,)]
            16 kHz, any level.
        speaker : str or int
            Style, by name or place.

        Returns
        -------
        Deformation
            T = ceil(fps S / 16000) frames.

        Notes
        -----
        Convolutions and Spec-BiLSTM see one spectrum at a time, so they run once a spectrum, not
        once in every window that holds it; the result is that of `forward` on each window.
        Deviation: a window's centre is the spectrum nearest to the frame, at most half a hop
        (4 ms) away, well within the shifts that training sees (8.3 ms).
        """
        pieces = self.pieces(waveform, speaker)
        return Deformation(*(torch.cat(rows) for rows in zip(*pieces, strict=True)))

    @torch.no_grad()
    def pieces(self, waveform: Any, speaker: str | int = 0) -> Iterator[Deformation]:
        """As `predict`, some frames at a time: gradients of a minute take a gigabyte."""
        spectral, index = self._spectral(waveform)
        label = self.label(speaker).to(spectral.device)
        for rows in torch.split(index, FRAMES_AT_ONCE):
            yield self.decoder(self.attend(spectral[rows])[0], label.expand(len(rows), -1))

    @torch.no_grad()
    def attention_weights(self, waveform: Any) -> NDArray[np.float32]:
        """Where each frame of a recording looks [shape=(T, L)]; rows sum to 1 (Fig. 9)."""
        spectral, index = self._spectral(waveform)
        rows = [self.attend(spectral[part])[1] for part in torch.split(index, FRAMES_AT_ONCE)]
        return np.asarray(torch.cat(rows).cpu().numpy(), dtype=np.float32)

    def _spectral(self, waveform: Any) -> tuple[Tensor, Tensor]:
        """z_spec of every spectrum [shape=(K, 256)], and the L of each frame [shape=(T, L)]."""
        config = self.config.frontend
        sound = normalise_level(_checked(waveform))
        n_frames = max(int(np.ceil(len(sound) / SAMPLE_RATE * self.fps - 1e-9)), 1)
        half = config.window_frames // 2
        times = torch.arange(n_frames, dtype=torch.float64) / self.fps
        centres = torch.round(times * config.frame_rate).long()
        index = centres.unsqueeze(1) + torch.arange(config.window_frames)  # 0 is half before 0 s
        # Two spectra more at either end, for the derivatives of those that count.
        before = round((half + 2) * SAMPLE_RATE / config.frame_rate)
        device = next(self.parameters()).device
        padded = F.pad(torch.from_numpy(sound).unsqueeze(0).to(device), (before, 0))
        spectra = self.frontend.mel(padded, int(index.max()) + 5)[..., 2:-2]
        return self.frontend.spectral(spectra)[0], index.to(device)

    def predict_mesh(
        self, waveform: Any, speaker: str | int = 0, template: TriMesh | None = None
    ) -> NDArray[np.float32]:
        """Vertices of a whole recording (§3.5).

        Parameters
        ----------
        waveform : array [shape=(S,)]
            16 kHz, any level.
        speaker : str or int
            Style, by name or place.
        template : TriMesh, optional
            Face to move; it must have the templates' triangles. The speaker's own if not given.

        Returns
        -------
        array [shape=(T, V, 3)]
            In the template's unit; frame i is at i / fps seconds.
        """
        mesh = self.template(speaker) if template is None else template
        return np.concatenate(
            [self.vertices(s, r, mesh) for s, r in self.pieces(waveform, speaker)]
        )

    def vertices(self, s: Tensor, r: Tensor, template: TriMesh) -> NDArray[np.float32]:
        """Solve packed frames (T, 6 N) and (T, 3 N) for a template's vertices (T, V, 3)."""
        solved = _solver(template).solve(s.cpu().double().numpy(), r.cpu().double().numpy())
        return np.asarray(solved, dtype=np.float32)

    def template(self, speaker: str | int) -> TriMesh:
        """Expressionless mesh of a speaker."""
        return self.templates[self.speakers[self._place(speaker)]]

    def label(self, speaker: str | int) -> Tensor:
        """One-hot label [shape=(1, P)] of a speaker."""
        return torch.eye(len(self.speakers))[self._place(speaker)].unsqueeze(0)

    def _place(self, speaker: str | int) -> int:
        if isinstance(speaker, int) and 0 <= speaker < len(self.speakers):
            return speaker
        if speaker in self.speakers:
            return self.speakers.index(str(speaker))
        raise CheckpointError(
            f"speaker {speaker!r} is unknown; this model knows {', '.join(self.speakers)}"
        )


@lru_cache(maxsize=16)
def _solver(template: TriMesh) -> DeformationSolver:
    return mesh_solver(template)


def _checked(waveform: Any) -> NDArray[np.float32]:
    samples = np.asarray(waveform, dtype=np.float32)
    if samples.ndim != 1 or not len(samples) or not np.isfinite(samples).all():
        raise DataError(
            f"a waveform of shape {samples.shape} cannot be used; give one row of finite samples "
            "at 16 kHz"
        )
    return samples
