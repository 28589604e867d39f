"""EmoTalk: whose voice gives the emotion, and what the decoder is given of it."""

from pathlib import Path

import pytest
import torch
from torch.nn import functional as F

from deitalk import animate
from deitalk.audio.load import Recording
from deitalk.config.frontends import MelConfig
from deitalk.models.checkpoint import load_model, network_class, save_model
from deitalk.research.comparison.emotalk import EmoTalk, emotion_sources
from deitalk.research.config import ComparedConfig, ComparedModelConfig, read_training
from deitalk.research.evaluation.benchmark_curves import speechlike
from deitalk.research.training.ablation import read_variants
from tests.deitalk.models.test_curve_model import MEL

CONFIGS = Path(__file__).resolve().parents[4] / "configs"
OWN = {
    "decoder": "emotalk",
    "decoder_channels": 16,
    "decoder_heads": 2,
    "style_size": 4,
    "emotion_size": 8,
    "classifier_size": 4,
    "positions": False,
    "intensity": False,
}


def build(**settings):
    torch.manual_seed(5)
    model = EmoTalk(ComparedModelConfig(frontend=MelConfig(**MEL), **(OWN | settings))).eval()
    with torch.no_grad():
        model.decoder.output.weight.normal_(std=0.3)
    return model


def styles(*indices):
    return F.one_hot(torch.tensor(indices), 5).float()


def batch(n):
    torch.manual_seed(7)
    return torch.randn(n, 10, 16), torch.arange(10).expand(n, -1), torch.full((n,), 10)


def test_sources_of_a_batch_by_hand():
    shown, voices = styles(0, 1, 2, 0, 1), styles(0, 0, 1, 0, 1)
    source, found = emotion_sources(shown, voices)
    # 0: its own voice. 1: the next voice of emotion 1. 2: nobody acts 2. 3 is odd: another voice
    # of emotion 0, after 4 comes 0. 4: its own.
    assert [source[i].item() for i in (0, 1, 3, 4)] == [0, 2, 0, 4]
    assert found.tolist() == [1, 1, 0, 1, 1]


def test_odd_row_takes_itself_where_no_other_voice_has_the_emotion():
    source, found = emotion_sources(styles(3, 4), styles(0, 4))
    assert source[1] == 1 and found.tolist() == [0, 1]


@torch.no_grad()
def test_batch_is_predicted_from_the_emotion_of_the_sources():
    model = build()
    speech, frames, total = batch(3)
    shown, voices = styles(0, 1, 2), styles(1, 0, 0)
    out, found = model(speech, shown, frames, total, None, voices)
    features = model.emotion(speech)
    assert found.tolist() == [1, 1, 0]
    for row, source in ((0, 1), (1, 0)):
        expected = model.decoder(speech[row : row + 1], shown[row : row + 1], features[[source]])
        torch.testing.assert_close(out.curves[row], expected[0])
    torch.testing.assert_close(out.emotion_logits, model.emotion.classify(features))
    alone = model(speech, shown, frames, total)
    torch.testing.assert_close(alone.curves, model.decoder(speech, shown, features))


@pytest.mark.parametrize("labelled", [False, True])
@torch.no_grad()
def test_label_has_an_effect_only_where_it_is_given(labelled):
    model = build(decoder_labelled=labelled)
    analysis = model.analyse(0.1 * torch.randn(16_000), 30)
    sad, happy = (model.decode(analysis, styles(i).expand(30, -1)) for i in (2, 3))
    assert bool((sad - happy).abs().max() > 0.01) == labelled


@torch.no_grad()
def test_clip_is_read_as_a_batch_of_one():
    model = build()
    sound = 0.1 * torch.randn(16_000)
    analysis = model.analyse(sound, 30)
    frames, total = torch.arange(30).unsqueeze(0), torch.tensor([30])
    whole = model(analysis.speech.unsqueeze(0), styles(1), frames, total)
    torch.testing.assert_close(model.decode(analysis, styles(1).expand(30, -1)), whole.curves[0])


def test_saved_network_is_read_and_animates(tmp_path):
    model = build()
    save_model(tmp_path / "m", model, ComparedConfig(name="m", model=model.config), {"steps": 0})
    read = load_model(tmp_path / "m")
    assert isinstance(read, EmoTalk)
    speech = Recording(speechlike(1.0), "test", 16_000, 1)
    curves = [animate(speech, "happy", model=m).curves.values for m in (model, read)]
    assert (curves[0] == curves[1]).all()


def test_configurations_share_the_frontend_of_one_model():
    shared = load_model("mel").config.frontend
    for variant in read_variants(CONFIGS / "comparison"):
        config = variant.config(0, None)
        assert config.model.frontend == shared and config.train.frozen_frontend == "mel"
        assert network_class(config.model).__name__ == (
            {"deitalk": "DEITalk", "faceformer": "FaceFormer"}.get(variant.name, "EmoTalk")
        )


def test_comparison_differs_in_network_and_its_own_losses_only():
    configs = {v.name: v.config(0, 300) for v in read_variants(CONFIGS / "comparison")}
    ours = configs.pop("deitalk")
    for other in configs.values():
        assert other.data == ours.data
        assert other.train.model_dump(exclude={"workers", "evaluate_every"}) == (
            ours.train.model_dump(exclude={"workers", "evaluate_every"})
        )
        assert other.loss.control_weights == ours.loss.control_weights
        assert other.loss.contact == ours.loss.contact


@pytest.mark.parametrize("name", ["faceformer", "emotalk"])
def test_configurations_have_the_losses_of_their_papers(name):
    loss = read_training(CONFIGS / f"{name}.yaml").loss
    expected = {"faceformer": (0, 0.1, 0, 0), "emotalk": (0.5, 1, 0, 0)}[name]
    assert (loss.velocity, loss.classification, loss.contrast, loss.intensity) == expected
