"""Temporal attention of a model over recordings (SDFA §3.3, §5.2.3).

Letters: T frames, L spectra of a window, D features.
"""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch

from deitalk.audio.load import load_audio
from deitalk.config.frontends import MelConfig
from deitalk.data.clips import Clip, read_clips, read_phones
from deitalk.errors import CheckpointError, DataError
from deitalk.frontends.base import NO_ATTENTION
from deitalk.phones import PLOSIVES, VOWELS
from deitalk.pipeline.speech import Speech
from deitalk.research.evaluation.attention_figure import AttentionMap, attention_at
from rig.arrays import Float32


class Attention(NamedTuple):
    """Attention over one recording."""

    weights: Float32
    """Weights of every frame on its window [shape=(T, L)]; rows sum to 1, the centre is L // 2."""
    fps: float
    """Frames per second."""
    frame_rate: float
    """Spectra per second."""


def attention_of(network: Any, waveform: Float32) -> Attention:
    """Attention of a model over a recording.

    Parameters
    ----------
    network : DEITalk or SDFA
        From `deitalk.models.checkpoint.load_model`, with SDFA's encoder.
    waveform : array [shape=(S,)]
        16 kHz, any level.

    Raises
    ------
    CheckpointError
        If the model has no temporal attention.
    """
    rate = spectra_per_second(network)
    weights = network.attention_weights(torch.from_numpy(Speech.of(waveform).sound))
    return Attention(weights.cpu().numpy(), network.fps, rate)


def spectra_per_second(network: Any) -> float:
    """Rate of the spectra over which a model's attention runs.

    Raises
    ------
    CheckpointError
        If the model has no temporal attention.
    """
    config = network.config.frontend
    if not isinstance(config, MelConfig):
        raise CheckpointError(NO_ATTENTION)
    return config.frame_rate / config.time_stack


def corpus_attention(
    network: Any, folder: Path, *, split: str = "validation", n_clips: int = 20
) -> tuple[AttentionMap, AttentionMap]:
    """Attention at every vowel and plosive of some recordings of a dataset folder.

    Parameters
    ----------
    network : DEITalk or SDFA
        From `deitalk.models.checkpoint.load_model`.
    folder : Path
        A dataset folder whose clips have phones.
    split : str
        train, validation or test.
    n_clips : int
        Number of recordings, evenly spread over the split.

    Returns
    -------
    vowels, plosives : AttentionMap

    Raises
    ------
    DataError
        If the split has no clip with phones, or these have no vowel or no plosive.
    """
    clips = {clip.audio: clip for clip in read_clips(folder, split) if clip.phones is not None}
    if not clips:
        raise DataError(f"{folder}: no clip of split {split!r} has phones; name another split")
    known = list(clips.values())
    chosen = np.unique(np.linspace(0, len(known) - 1, n_clips).round().astype(int))
    kinds = zip(*(_maps(network, known[i]) for i in chosen), strict=True)
    vowels, plosives = (
        AttentionMap(
            np.concatenate([m.rows for m in maps]), tuple(p for m in maps for p in m.phones)
        )
        for maps in kinds
    )
    if not vowels.phones or not plosives.phones:
        raise DataError(f"{folder}: the phones of {len(chosen)} clips have no vowel or no plosive")
    return vowels, plosives


def _maps(network: Any, clip: Clip) -> tuple[AttentionMap, AttentionMap]:
    assert clip.phones is not None
    attention = attention_of(network, load_audio(clip.audio).waveform)
    phones = read_phones(clip.phones)
    vowels, plosives = (
        attention_at(attention.weights, phones, attention.fps, names)
        for names in (VOWELS, PLOSIVES)
    )
    return vowels, plosives
