"""Segments of features that are computed once per clip, by a frozen DEITalk model.

Letters: T frames of a clip or a segment, D features.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch

from deitalk.audio.frames import frame_times
from deitalk.audio.voice_activity import normalise_level
from deitalk.emotions import parse_emotion
from deitalk.errors import DataError
from deitalk.models.mesh_model import DEITalkFeatures
from deitalk.research.meshes.folder import MeshClip
from deitalk.research.meshes.segments import ClipInMemory, Segment, SegmentBatches
from rig.arrays import Float32


class FeatureSegments(SegmentBatches):
    """Segments of a frozen model's features and the motion that belongs to them.

    The recordings are not augmented: the model was trained with noise and rooms.

    Parameters
    ----------
    clips : sequence of MeshClip
        Those of one split; the features of all are kept in memory (some 2 MB a minute).
    speakers : tuple of str
        Places of the one-hot label.
    encoder : DEITalkFeatures
        The frozen model.
    **drawing
        As for `SegmentBatches`.

    Raises
    ------
    DataError
        If a clip has no emotion.
    """

    def __init__(
        self,
        clips: Sequence[MeshClip],
        speakers: tuple[str, ...],
        encoder: DEITalkFeatures,
        **drawing: Any,
    ) -> None:
        in_memory = [
            ClipInMemory(clip_features(clip, encoder), clip.motion(), speakers.index(clip.speaker))
            for clip in clips
        ]
        super().__init__(in_memory, len(speakers), **drawing)
        self.places = torch.arange(self.n_frames)

    @property
    def rows(self) -> torch.Tensor:
        """Features of all clips, one after the other [shape=(T, D)]."""
        return torch.from_numpy(np.concatenate([clip.speech for clip in self.clips])).float()

    def item(self, number: int) -> Segment:
        """Cut the segment of a number."""
        clip, first = self.draw(self.rng(number))
        frames = first + np.arange(self.n_frames, dtype=np.float64)
        rows = clip.speech[np.clip(frames.astype(np.int64), 0, len(clip.speech) - 1)]
        features = torch.from_numpy(rows.astype(np.float32)).T.unsqueeze(0)  # (1, D, T)
        return self.with_targets(features, clip, frames)


@torch.no_grad()
def clip_features(clip: MeshClip, encoder: DEITalkFeatures) -> Float32:
    """Features of a clip in its emotion [shape=(T, D), float16]."""
    if not clip.emotion:
        raise DataError(
            f"{clip.folder}: clips.csv has no emotion for {clip.name}; fill the "
            "column emotion, or build the folder again from a dataset folder"
        )
    n_frames = len(clip.motion()["stretch"])
    sound = torch.from_numpy(normalise_level(clip.waveform()))
    emotion = torch.from_numpy(parse_emotion(clip.emotion).at(frame_times(n_frames)))
    network = encoder.network
    rows = network.describe(network.analyse(sound, n_frames), emotion)
    return np.asarray(rows.half().numpy())
