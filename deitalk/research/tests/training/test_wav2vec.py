"""The paper's configuration on a tiny local checkpoint: train, move the checkpoint away, animate."""

from pathlib import Path

import numpy as np
import pytest
import torch

from deitalk import animate
from deitalk.audio.load import Recording
from deitalk.config.frontends import Wav2VecConfig
from deitalk.models.checkpoint import load_model
from deitalk.research.config import read_training
from deitalk.research.evaluation.benchmark_curves import speechlike
from deitalk.research.training.curves import train_curves
from tests.dataset import write_dataset

PAPER = Path(__file__).resolve().parents[4] / "configs" / "deitalk.yaml"
SMALL = (
    "model.decoder_channels=8",
    "model.motion_channels=[8]",
    "model.emotion_size=8",
    "data.window_frames=32",
    "train.batch_size=2",
    "train.steps=2",
    "train.evaluate_every=2",
)


def test_frontend_without_a_kind_is_the_papers():
    config = read_training(PAPER, ["model.frontend.checkpoint=some/folder"])
    assert config.model.frontend == Wav2VecConfig(checkpoint="some/folder")


def test_saved_model_needs_no_checkpoint(tmp_path, monkeypatch):
    transformers = pytest.importorskip("transformers")
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    torch.manual_seed(0)
    shape = transformers.Wav2Vec2Config(
        conv_dim=(16,) * 7,
        hidden_size=16,
        num_hidden_layers=1,
        num_attention_heads=2,
        intermediate_size=16,
        num_conv_pos_embeddings=8,
        num_conv_pos_embedding_groups=2,
    )
    checkpoint = tmp_path / "checkpoint"
    transformers.Wav2Vec2Model(shape).save_pretrained(checkpoint)
    data = write_dataset(tmp_path / "data", 2, 1)
    config = read_training(PAPER, [f"model.frontend.checkpoint={checkpoint}", *SMALL])
    train_curves(config, data, tmp_path / "run")
    speech = Recording(speechlike(1.0), "test", 16_000, 1)
    before = animate(speech, "happy", model=tmp_path / "run" / "best").curves.values
    checkpoint.rename(tmp_path / "away")
    after = animate(speech, "happy", model=tmp_path / "run" / "best").curves.values
    np.testing.assert_array_equal(before, after)
    stem = "frontend.encoder.feature_extractor.conv_layers.0.conv.weight"
    trained = load_model(tmp_path / "run" / "best").state_dict()[stem]
    whole = transformers.Wav2Vec2Model.from_pretrained(tmp_path / "away").state_dict()
    assert torch.equal(trained, whole[stem.removeprefix("frontend.encoder.")]), "the stem is fixed"
