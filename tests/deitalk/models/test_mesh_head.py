"""A mesh head on DEITalk's features: features, emotion, intensity, training, its folder."""

from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch

from deitalk.acting import Acting
from deitalk.config.curves import Config
from deitalk.config.load import parse_config
from deitalk.emotions import EMOTIONS
from deitalk.emotions.tracks import IntensityCurve
from deitalk.errors import CheckpointError, ConfigError
from deitalk.models.checkpoint import load_model, save_model
from deitalk.models.curve_model import DEITalk
from deitalk.models.deformation_decoder import InversePCA
from deitalk.pipeline import speech as speech_module
from deitalk.pipeline.mesh import animate_mesh, mesh_coefficients
from deitalk.research.config import read_training
from deitalk.research.meshes import emotion_scores
from deitalk.research.meshes.folder import MeshSequence, read_mesh_folder, write_mesh_folder
from deitalk.research.meshes.predict import predict_mesh
from deitalk.research.meshes.scores import as_markdown, evaluate_mesh
from deitalk.research.meshes.sources import act, acted_clips, head_templates
from deitalk.research.meshes.training import new_mesh_model, train_mesh
from tests.dataset import write_dataset
from tests.deitalk.models.test_mesh_model import LIPS, RATE, noise, sheet, spoken
from tests.errors import one_line

pytestmark = pytest.mark.usefixtures("empty_pictures")

CONFIGS = Path(__file__).resolve().parents[3] / "configs"
STYLES = {"happy": 1.0, "sad": -0.8}


def write_network(folder, seed=0):
    """A tiny DEITalk model of new weights."""
    torch.manual_seed(seed)
    config = read_training(CONFIGS / "tiny.yaml")
    assert isinstance(config, Config)
    save_model(folder, DEITalk(config.model, pretrained=False), config, {})
    return folder


@pytest.fixture(scope="module")
def network(tmp_path_factory):
    return write_network(tmp_path_factory.mktemp("network") / "m")


@pytest.fixture
def no_gates(monkeypatch):
    """Gates open and intensity as the network predicts it, for tones, which are no speech."""
    monkeypatch.setattr(
        speech_module, "expression_share", lambda activity, *rest: np.ones_like(activity)
    )
    monkeypatch.setattr(speech_module, "voice_intensity", lambda strength, *rest: strength)


def tiny(network, **train):
    return parse_config(
        {
            "kind": "sdfa_training",
            "model": {
                "frontend": {"kind": "deitalk", "model": str(network)},
                "shared_size": 48,
                "branch_sizes": [48, 32],
                "weight_norm": False,
            },
            "data": {"fps": 30, "augment": False},
            "train": {"segment_frames": 8, "batch_size": 16, "steps": 4, **train},
        }
    )


def head(network, templates=None, layers=None):
    torch.manual_seed(1)
    if layers is None:
        layers = {"stretch": InversePCA(3, 6 * 18), "rotation": InversePCA(4, 3 * 18)}
        for layer in layers.values():
            layer.components.normal_(std=0.05)
            layer.mean.normal_(std=0.01)
    templates = templates or {"ann": sheet(4)}
    config = tiny(network).model
    return new_mesh_model(config, layers, templates, fps=30, unit_mm=10).eval()


def whole(model, sound, emotion="neutral", intensity=1.0):
    acting = Acting.of(emotion=emotion, intensity=intensity)
    rows = list(mesh_coefficients(model, sound, 0, acting))
    return torch.cat([torch.cat((row["stretch"], row["rotation"]), dim=1) for row in rows])


def test_described_features_are_the_input_of_the_last_layer(network):
    """The last layer on the described features gives the decoded curves."""
    curve_model = head(network).encoder.network
    analysis = curve_model.analyse(torch.from_numpy(noise(1.0)), 30)
    emotion = torch.eye(5)[torch.arange(30) % 5]
    described = curve_model.describe(analysis, emotion)
    torch.testing.assert_close(
        curve_model.decoder.output(described), curve_model.decode(analysis, emotion)
    )
    assert described.std(dim=0).max() > 1e-3


def test_network_is_frozen_and_not_part_of_the_weights(network):
    model = head(network)
    assert not any(p.requires_grad for p in model.encoder.network.parameters())
    weights = {name for name in model.state_dict() if not name.startswith("decoder.")}
    assert weights == {"encoder.mean", "encoder.deviation"}
    model.train()
    assert not model.encoder.network.training


def test_intensity_scales_the_expression(network, no_gates):
    model, sound = head(network), noise(1.0)
    plain, once, twice = (whole(model, sound, "angry", amount) for amount in (0.0, 1.0, 2.0))
    torch.testing.assert_close(plain, whole(model, sound, "neutral"))
    torch.testing.assert_close(twice - plain, 2 * (once - plain), rtol=1e-3, atol=1e-5)
    assert (once - plain).abs().max() > 1e-3
    other = whole(model, sound, "happy")
    assert (other - once).abs().max() > 1e-3


def test_mesh_in_silence_is_the_template(network):
    """Also where the mean shape of the basis is not at rest."""
    model = head(network)
    for branch in model.decoder.branches.values():  # a mean that the components can undo
        layer = branch.inverse_pca
        layer.mean = 0.3 * layer.components.sum(dim=0)
    silent = predict_mesh(model, np.zeros(RATE, np.float32), acting=Acting.of(emotion="happy"))
    np.testing.assert_allclose(silent, np.tile(sheet(4).vertices, (30, 1, 1)), atol=1e-4)


def emotional_sheets(folder, emotions=STYLES):
    """One speaker and one sound; the mesh goes outwards for happy, inwards for sad."""
    template = sheet()
    sequences = [
        MeshSequence(e, "ann", "train", partial(spoken, template, STYLES.get(e, 0)), emotion)
        for e, emotion in zip(STYLES, emotions, strict=True)
    ]
    write_mesh_folder(
        folder, {"ann": template}, sequences, fps=30, unit_mm=10, lips=LIPS, basis_frames=24,
        basis_error_mm=0.2,
    )  # fmt: skip
    return folder


AS_CAPTURED = IntensityCurve(np.array([0.0, 60.0]), np.ones(2))


def test_training_separates_emotions_of_one_sound(network, tmp_path, no_gates):
    """The sound is the same, so the motion can follow from the emotion only."""
    data = emotional_sheets(tmp_path / "meshes")
    assert [clip.emotion for clip in read_mesh_folder(data).clips] == list(STYLES)
    config = tiny(
        network, steps=250, learning_rate=3e-3, evaluate_every=250, lip_weight=1.0, ema=0.9
    )
    train_mesh(config, data, tmp_path / "run")
    model = load_model(tmp_path / "run/best")
    template = model.template(0)
    for emotion, style in STYLES.items():
        waveform, truth = spoken(template, style)
        acting = Acting.of(emotion=emotion, intensity_curve=AS_CAPTURED)
        given = predict_mesh(model, waveform, acting=acting)
        error, motion = (np.linalg.norm(truth - x, axis=-1) for x in (given, template.vertices))
        assert error.mean() < 0.25 * motion.mean()


def test_folder_stores_the_hash_of_the_decoded_network(tmp_path):
    network = write_network(tmp_path / "network")
    model, sound = head(network), noise(0.5)
    save_model(tmp_path / "m", model, tiny(network), {}, half_bases=False)
    back = load_model(tmp_path / "m")
    acting = Acting.of(emotion="sad")
    np.testing.assert_array_equal(
        predict_mesh(back, sound, acting=acting),
        predict_mesh(model, sound, acting=acting),
    )
    (network / "model.safetensors").unlink()
    with pytest.raises(CheckpointError, match="no model there"):
        load_model(tmp_path / "m")
    write_network(network, seed=5)
    with pytest.raises(CheckpointError, match=r"other weights than those of .*train it again"):
        load_model(tmp_path / "m")


@pytest.mark.parametrize(
    "section", [{"data": {"fps": 60, "augment": False}}, {"data": {"fps": 30}}]
)
def test_configuration_rejects_augmentation_and_other_rates(section):
    tree = {"kind": "sdfa_training", "model": {"frontend": {"kind": "deitalk"}}}
    with one_line(ConfigError, match=r"data\.fps=30, data\.augment=false"):
        parse_config(tree | section)


def test_animate_mesh_applies_the_emotion_of_a_mesh_head(network, tmp_path, no_gates):
    save_model(tmp_path / "m", head(network), tiny(network), {})
    from deitalk.audio.load import write_wav

    write_wav(tmp_path / "a.wav", noise(1.0))
    happy, plain = (animate_mesh(tmp_path / "a.wav", e, model=tmp_path / "m") for e in
                    ("happy", "neutral"))  # fmt: skip
    assert happy.vertices.shape == plain.vertices.shape == (30, 16, 3)
    assert np.abs(happy.vertices - plain.vertices).max() > 1e-3


def test_evaluation_scores_every_emotion_and_the_curves(network, tmp_path, monkeypatch):
    """A model that never moves: its errors are the motion itself, and no landmark rises."""
    monkeypatch.setattr(emotion_scores, "MOST", 1)
    monkeypatch.setattr(emotion_scores, "INTENSITIES", (1.0,))
    data = write_dataset(tmp_path / "d", 1, 5, 1.1)
    templates = head_templates((0,))
    count = len(next(iter(templates.values())).faces)
    layers = {"stretch": InversePCA(1, 6 * count), "rotation": InversePCA(1, 3 * count)}
    model = head(network, templates, layers)
    for layer in layers.values():
        layer.components[:] = 1e-6
    report = evaluate_mesh(model, data, split="validation", most=2)
    clips = acted_clips(data, "validation", None, 2)
    assert set(report["groups"]) == {"all", *(clip.emotion for clip in clips)}
    assert report["groups"]["all"]["clips"] == len(clips) == 2
    clip = clips[0]
    scores, (_, truth) = report["groups"][clip.emotion], act(clip, 0, 30)
    moved = np.linalg.norm(truth - model.template(0).vertices, axis=-1)
    assert scores["mesh_mm"] == pytest.approx(10 * moved.mean(), rel=0.01)
    assert scores["lips_mm"] == pytest.approx(scores["still_mm"], rel=0.01)
    assert scores["curves_lips_mm"] > 0
    corners = report["expression"]["corners"]
    assert set(corners) == set(EMOTIONS[1:])
    assert np.abs(corners["happy"]["model"]).max() < 0.05
    assert "| corners | happy |" in as_markdown(report)
