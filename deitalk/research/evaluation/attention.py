"""Temporal attention of a model over recordings (SDFA §3.3, §5.2.3).

Letters: T frames, L spectra of a window, D features.
"""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional as F

from deitalk.audio.frames import frame_count
from deitalk.audio.load import load_audio
from deitalk.audio.mel import nearest_spectra
from deitalk.config.frontends import MelConfig
from deitalk.data.clips import Clip, read_clips, read_phones
from deitalk.errors import CheckpointError, DataError
from deitalk.frontends.base import window_index
from deitalk.frontends.sdfa_encoder import WINDOWS_AT_ONCE, SDFAEncoder
from deitalk.pipeline.speech import Speech
from deitalk.postprocess.phones import PLOSIVES, VOWELS
from deitalk.research.evaluation.attention_figure import AttentionMap, attention_at
from rig.arrays import Float32

NO_ATTENTION = (
    "this model has no temporal attention over spectra; use one with it, such as sdfa or mel"
)


@torch.no_grad()
def weights_of(network: Any, sound: Tensor) -> Tensor:
    """Attention of each frame over its window [shape=(T, W)]; rows sum to 1 (Fig. 9).

    Parameters
    ----------
    network : DEITalk or SDFA
        In evaluation mode.
    sound : Tensor [shape=(S,)]
        16 kHz, level-normalised.

    Raises
    ------
    CheckpointError
        If this model has no attention.
    """
    config = network.config.frontend
    if config.kind != "mel" or getattr(config, "summary", "attention") != "attention":
        raise CheckpointError(NO_ATTENTION)
    if network.product == "curves":
        return frontend_weights(network.frontend, sound, frame_count(len(sound)))
    rows = [
        encoder_weights(network.encoder, features, places)[kept]
        for features, places, kept in network.feature_chunks(sound)
    ]
    return torch.cat(rows)


@torch.no_grad()
def frontend_weights(frontend: Any, waveform: Tensor, n_frames: int) -> Tensor:
    """Attention of each frame over its window [shape=(T, W)]; 0 outside the recording.

    Parameters
    ----------
    frontend : MelFrontend
        In evaluation mode.
    waveform : Tensor [shape=(S,)]
        16 kHz, level-normalised.
    n_frames : int
        T.

    Raises
    ------
    CheckpointError
        If the Time-BiLSTM runs once per window.
    """
    config = frontend.config
    if config.recurrence == "window":
        raise CheckpointError("maps are drawn for recurrence: segment; this model has window")
    device = next(frontend.parameters()).device
    centres = nearest_spectra(n_frames, config.frame_rate, config.time_stack)
    length = int(centres[-1]) + 1
    mel = frontend.mel(waveform.unsqueeze(0).to(device), length * config.time_stack, 0)
    spectral = frontend.spectral(mel)
    memory = frontend.recurrent(spectral.reshape(1, length, -1))[0][0]  # (K, D)
    window, half = config.window_frames // config.time_stack, config.query_frames // 2
    index = centres.unsqueeze(1) + torch.arange(window) - window // 2
    about = centres.unsqueeze(1) + torch.arange(-half, half + 1)
    silent = F.pad(memory, (0, 0, half, half))  # keys are 0 outside the recording
    inside = (index >= 0) & (index < length)
    rows = [
        frontend.attention.windows(memory[part.clamp(0, length - 1)], silent[queries + half])[1]
        for part, queries in zip(torch.split(index, 256), torch.split(about, 256), strict=True)
    ]
    weights = torch.cat(rows) * inside.to(device)
    shares: Tensor = weights / weights.sum(dim=1, keepdim=True)
    return shares


@torch.no_grad()
def encoder_weights(encoder: SDFAEncoder, features: Tensor, places: Tensor) -> Tensor:
    """Attention weights [shape=(T, W)] of each place in features (1, 3, F, L)."""
    spectral = encoder.frontend.spectral(features)[0]
    index = torch.split(
        window_index(places, encoder.config.window_frames, len(spectral)), WINDOWS_AT_ONCE
    )
    if encoder.config.recurrence == "window":
        return torch.cat([encoder.attend(spectral[part])[1] for part in index])
    memory = encoder.frontend.recurrent(spectral)[0]
    return torch.cat([encoder.attend_in(memory[part])[1] for part in index])


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
    weights = weights_of(network, torch.from_numpy(Speech.of(waveform).sound))
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
