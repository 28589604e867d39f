"""A tiny causal model of random weights, and speech-like sound."""

import numpy as np
import pytest
import torch

from deitalk.config.curves import Config
from deitalk.models.curve_model import DEITalk
from deitalk.postprocess.control_groups import ControlGroups

RATE = 16_000
TINY = {
    "frontend": {
        "kind": "causal_whisper",
        "learns": "everything",
        "checkpoint": None,
        "n_mels": 16,
        "width": 24,
        "heads": 2,
        "intermediate": 32,
        "layers": (2, 3),
    },
    "positions": False,
    "saliency_frames": 31,
    "emotion_size": 16,
    "motion_channels": (8, 8),
    "decoder_channels": 16,
    "decoder_dilations": (1, 2),
    "decoder_residual": True,
}


LOOKS = {
    "live": ({}, 0.202),
    "short": ({"ahead": 2, "lead": 1, "rules_ahead": 0}, 0.1),
    "shortest": ({"ahead": 1, "lead": 1, "rules_ahead": 1}, 0.1),
}
"""Settings of the look-ahead, and the most of it in seconds."""


@pytest.fixture(scope="session")
def tiny() -> DEITalk:
    return model_that_looks({})


@pytest.fixture(
    scope="session",
    params=[
        pytest.param(look, id=name, marks=[pytest.mark.thorough] * (name == "shortest"))
        for name, look in LOOKS.items()
    ],
)
def looking(request) -> tuple[DEITalk, float]:
    """A tiny model of each look-ahead, and the most of it in seconds."""
    settings, most = request.param
    return model_that_looks(settings), most


def mouth_from_rest(animator, frames) -> np.ndarray:
    """Largest distance of a control of the mouth from rest, in each of some frames (n, C)."""
    controls = animator.network.controls
    return np.abs(frames - controls.rest)[:, ControlGroups(controls).follows_mouth].max(axis=1)


def model_that_looks(settings: dict[str, int]) -> DEITalk:
    torch.manual_seed(0)
    model = TINY | {"frontend": TINY["frontend"] | settings}
    config = Config.model_validate({"model": model})
    network = DEITalk(config.model, rules=config.rules).eval()
    with torch.no_grad():
        network.decoder.output.weight.normal_(0, 0.3)
    return network


@pytest.fixture(scope="session")
def voice() -> np.ndarray:
    """Syllables of 0.2 s on a glide, a pause of 0.7 s, more syllables, over faint noise."""
    rng = np.random.default_rng(1)
    t = np.arange(round(3.1 * RATE)) / RATE
    phase = 2 * np.pi * np.cumsum(120 + 40 * np.sin(2 * np.pi * 0.7 * t)) / RATE
    tone = sum(np.sin(k * phase) / k for k in range(1, 12))
    loud = np.clip(np.sin(2 * np.pi * 2.5 * t), 0, 1) * ((t < 1.2) | (t > 1.9))
    return (0.08 * tone * loud + 2e-4 * rng.standard_normal(len(t))).astype(np.float32)
