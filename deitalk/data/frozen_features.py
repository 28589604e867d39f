"""The frozen frontend of another model: only the layers behind it are trained.

The paper trains behind a published encoder, ours may train behind that of another model. Without
augmentation the features of a clip never change, so that they are computed once per clip and a step
costs a fraction: captures can be fitted, or variants compared, in minutes.

Letters: S samples, T rig frames, D width of the features.
"""

from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from deitalk.audio.frames import FRAME_RATE, SAMPLE_RATE
from deitalk.data.clips import Clip
from deitalk.errors import ConfigError
from deitalk.models.checkpoint import require_model
from deitalk.models.curve_model import DEITalk
from rig.arrays import Float32


class FrozenFeatures:
    """The frontend of a trained model, and its features of each clip.

    Parameters
    ----------
    name : str
        An embedded model or a model folder.

    Raises
    ------
    CheckpointError
        If there is no such model.

    Attributes
    ----------
    owner : DEITalk
        The model.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self.owner = require_model(name, DEITalk)
        self._features: dict[Path, NDArray[np.float16]] = {}

    def copy_into(self, model: DEITalk) -> None:
        """Copy the frontend into `model`; no gradient reaches it there.

        Raises
        ------
        ConfigError
            If the model's frontend is built otherwise.
        """
        if model.config.frontend != self.owner.config.frontend:
            raise ConfigError(
                f"train.frozen_frontend={self.name!r} is built otherwise than model.frontend; "
                "use that model's own config.yaml"
            )
        frontend = model.get_submodule("frontend").requires_grad_(False)
        frontend.load_state_dict(self.owner.get_submodule("frontend").state_dict())

    def features(self, clip: Clip, waveform: Float32, n_frames: int) -> NDArray[np.float16]:
        """Features of a whole clip, computed once for all clips of its recording.

        Parameters
        ----------
        clip : Clip
            Its recording is the key of the cache.
        waveform : ndarray [shape=(S,)]
            16 kHz, level-normalised.
        n_frames : int
            Rig frames T; beyond the recording there is silence.

        Returns
        -------
        ndarray [shape=(T, D)]
        """
        known = self._features.get(clip.audio)
        if known is None or len(known) < n_frames:
            length = n_frames * SAMPLE_RATE // FRAME_RATE
            padded = np.pad(waveform, (0, max(length - len(waveform), 0)))
            features = self.owner.frontend.encode(torch.from_numpy(padded), n_frames)
            known = self._features[clip.audio] = features.numpy().astype(np.float16)
        return known
