"""Mesh models from waveform to vertices: sizes, windows, training, folders, the lip seal."""

from pathlib import Path

import numpy as np
import pytest
import torch

from deitalk.audio.voice_activity import normalise_level
from deitalk.config.frontends import SDFAMelConfig
from deitalk.config.load import load_config, parse_config
from deitalk.errors import AudioError, CheckpointError, ConfigError
from deitalk.models import mesh_model as sdfa_module
from deitalk.models.deformation_decoder import InversePCA
from deitalk.pipeline.mesh import mesh_coefficients
from deitalk.pipeline.speech import Speech
from deitalk.research.config import ComparedSDFAModelConfig, MeshTrainingConfig
from deitalk.research.evaluation.attention import weights_of
from deitalk.research.meshes.folder import Lips
from deitalk.research.meshes.predict import predict_mesh
from deitalk.research.meshes.training import new_mesh_model
from rig.mesh import TriMesh

CONFIGS = Path(__file__).resolve().parents[3] / "configs"
CONFIG = CONFIGS / "sdfa.yaml"
RATE = 16_000
STYLES = {"ann": 1.0, "bob": -0.8}
LIPS = Lips(np.array([30, 31, 32, 33]), np.array([23, 24, 25, 26]))
FRONTEND = {
    "kind": "mel",
    "window_seconds": 0.032,
    "frame_rate": 60,
    "n_mels": 16,
    "conv_channels": [4, 4, 4],
    "spec_hidden": 8,
    "spectral_size": 24,
    "time_hidden": 24,
    "time_layers": 1,
    "window_frames": 16,
    "query_frames": 3,
    "attention_size": 8,
}
SEGMENT = FRONTEND | {"recurrence": "segment", "centre": True, "weight_norm": False}
KARRAS = {"kind": "karras", "frame_rate": 60, "window_frames": 16, "lags": 16,
          "formant_channels": [8, 8, 8, 8], "articulation_channels": [12, 12, 12, 12]}  # fmt: skip
VOCA = {"kind": "voca", "n_mels": 16, "n_mfcc": 10, "channels": [8, 8, 12, 12]}
ENCODERS = {
    "window": FRONTEND,
    "segment": SEGMENT,
    "no Spec-BiLSTM": SEGMENT | {"kind": "mel_ablated", "gathering": "convolution"},
    "no attention": FRONTEND | {"kind": "mel_ablated", "summary": "convolution"},
    "karras": KARRAS,
    "voca": VOCA,
}


def tiny(frontend=FRONTEND, motion="gradients", **train):
    return parse_config(
        {
            "kind": "sdfa_training" if frontend.get("kind", "mel") == "mel" else "sdfa_compared",
            "name": "tiny",
            "model": {
                "frontend": frontend,
                "motion": motion,
                "shared_size": 48,
                "branch_sizes": [48, 32],
            },
            "data": {
                "fps": 30,
                "identities": [0, 3],
                "basis_frames": 24,
                "basis_error_mm": 0.2,
                "augment": False,
            },
            "train": {"batch_size": 16, "steps": 4, "evaluate_every": 2, **train},
        }
    )


def sheet(n=7, size=10.0):
    """A bent sheet of n x n vertices, `size` cm wide."""
    x, y = np.meshgrid(np.linspace(0, size, n), np.linspace(0, size, n))
    vertices = np.stack([x.ravel(), y.ravel(), -0.05 * (x.ravel() - size / 2) ** 2], axis=1)
    corner = np.arange(n * n).reshape(n, n)
    a, b, c, d = (corner[i : n - 1 + i, j : n - 1 + j].ravel() for i in (0, 1) for j in (0, 1))
    return TriMesh(vertices, np.concatenate([np.stack([a, b, c], 1), np.stack([b, d, c], 1)]))


def spoken(template, style=1.0, seconds=1.0, fps=30):
    """A sweep of tones; the sheet's middle rises and falls by up to 2 cm, or as `style` has it."""
    t = np.arange(int(seconds * RATE)) / RATE
    waveform = (0.2 * np.sin(2 * np.pi * (200 * t + 1000 * t**2))).astype(np.float32)
    frame = np.arange(round(seconds * fps)) / fps
    opening = np.sin(2 * np.pi * 1.5 * frame) ** 2 + 0.3 * np.cos(2 * np.pi * frame)
    x, y, _ = template.vertices.T
    middle = np.exp(-((x - 5) ** 2 + (y - 5) ** 2) / 6)
    shift = np.stack([0.3 * middle * (y - 5), -0.5 * middle, 1.5 * middle], axis=1)
    return waveform, (template.vertices + style * opening[:, None, None] * shift).astype(np.float32)


def model(fps=60, frontend=FRONTEND, motion="gradients", **changes):
    torch.manual_seed(0)
    template = sheet(4)
    sizes = {"stretch": (3, 6 * 18), "rotation": (4, 3 * 18)}
    sizes = sizes if motion == "gradients" else {"offsets": (5, 3 * 16)}
    layers = {name: InversePCA(*size) for name, size in sizes.items()}
    for layer in layers.values():
        layer.components.normal_(std=0.02)
    config = ComparedSDFAModelConfig(
        frontend=frontend | changes, motion=motion, shared_size=48, branch_sizes=(48, 32)
    )
    speakers = {"ann": template, "bob": sheet(4, 12.0)}
    sdfa = new_mesh_model(config, layers, speakers, fps=fps, unit_mm=10).eval()
    with torch.no_grad():  # fresh weights hardly tell one moment from another
        for weight in sdfa.parameters():
            weight.mul_(3)
    return sdfa


def motion_of(sdfa, sound, speaker=0):
    """Gradients or offsets of a whole recording."""
    parts = list(sdfa.expand(mesh_coefficients(sdfa, sound, speaker)))
    return type(parts[0])(*(torch.cat(rows) for rows in zip(*parts, strict=True)))


def noise(seconds, seed=0):
    rng = np.random.default_rng(seed)
    return (0.1 * rng.standard_normal(int(seconds * RATE))).astype(np.float32)


def test_configuration_sdfa_is_the_paper():
    config = load_config(CONFIG)
    assert isinstance(config, MeshTrainingConfig)
    assert config.model.frontend == SDFAMelConfig()  # Tables 1-2 are tested with the frontend
    assert (config.model.shared_size, config.model.branch_sizes) == (512, (512, 256))
    assert config.model.weight_norm
    train = config.train
    assert (train.learning_rate, train.batch_size, train.epochs) == (1e-4, 100, 50)
    assert (train.segment_frames, train.schedule, train.lip_weight) == (2, "constant", 0)
    assert train.ema is None and train.start_encoder is None
    assert config.model.motion == "gradients"
    assert config.data.augment
    assert config.data.fps == 60
    assert len(config.data.identities) == 4  # all embedded heads


@pytest.mark.parametrize(
    ("tree", "said"),
    [
        ({"model": {"frontend": SEGMENT | {"time_stack": 2}}}, "uses every spectrum"),
        ({"model": {"frontend": {"kind": "deepspeech"}}}, "model.frontend"),
        ({"train": {"batch_size": 7}}, "train.segment_frames=2: must divide batch_size, 7"),
        ({"train": {"momentum": 0.9}}, "unknown key"),
        ({"data": {"identities": []}}, "data.identities=[]"),
    ],
)
def test_bad_configuration(tree, said):
    with pytest.raises(ConfigError) as caught:
        parse_config({"kind": "sdfa_training", **tree})
    assert said in str(caught.value)


def test_prediction_of_a_clip_equals_its_windows_one_by_one():
    """Spectra are computed once; every frame must equal that of its own window."""
    sdfa, (sound, _) = model(fps=25, frame_rate=125), spoken(sheet(), seconds=0.8)
    whole = motion_of(sdfa, sound, "bob")
    mel = sdfa.encoder.features(torch.from_numpy(normalise_level(sound))[None], 140, 0)[0]
    mel = torch.cat((mel[..., :1].expand(-1, -1, 100) * 0 + silence(sdfa), mel), dim=-1)
    rows = []
    for frame in range(3, 20):  # every fifth spectrum; the first windows reach before the sound
        place = 100 + 5 * frame
        window = mel[None, ..., place - 8 : place + 8]
        with torch.no_grad():
            rows.append(sdfa(window, torch.tensor([8]), sdfa.label("bob")))
    single = sdfa.decoder.expand(
        {name: torch.cat([row[name][0] for row in rows]) for name in rows[0]}
    )
    torch.testing.assert_close(whole.s[3:20], single.s, atol=1e-5, rtol=1e-4)
    torch.testing.assert_close(whole.r[3:20], single.r, atol=1e-5, rtol=1e-4)
    assert whole.s.std(dim=0).max() > 1e-2
    assert (whole.s[2:19] - single.s).abs().max() > 1e-3  # a frame too late would be seen


def silence(sdfa):
    """A spectrum of silence [shape=(3, F, 1)]."""
    return sdfa.encoder.features(torch.zeros(1, 1000), 1, 0)[0]


@pytest.mark.parametrize("name", list(ENCODERS))
def test_prediction_in_pieces_equals_the_whole_clip(name, monkeypatch):
    """Pieces of 20 frames with their context, against all at once."""
    sdfa, sound = model(fps=30, frontend=ENCODERS[name]), noise(3.0)
    has_context = sdfa.encoder.context_seconds > 0
    if has_context:  # with weights as large as the others' it would never forget
        for weight in sdfa.encoder.parameters():
            weight.data.div_(3)
    whole = motion_of(sdfa, sound)
    monkeypatch.setattr(sdfa_module, "FRAMES_AT_ONCE", 20)
    pieces = motion_of(sdfa, sound)
    tolerance = 0.02 * float(whole.s.std(dim=0).max()) if has_context else 2e-4
    torch.testing.assert_close(pieces.s, whole.s, atol=tolerance, rtol=0)
    assert whole.s.std(dim=0).max() > (1e-4 if has_context else 2e-3)


@pytest.mark.parametrize("name", list(ENCODERS))
def test_encoders_depend_on_nearby_sound_only(name):
    """A click 1 s away changes nothing (a recurrence along the clip: little); one near does."""
    sdfa, sound = model(fps=30, frontend=ENCODERS[name]), noise(3.0)
    near, far = sound.copy(), sound.copy()
    near[RATE + 200 : RATE + 1000] *= -3
    far[2 * RATE + 8000 :] = far[2 * RATE + 8000 :][::-1]  # the level stays
    frame = 30
    before, moved, still = (motion_of(sdfa, x).s[frame] for x in (sound, near, far))
    assert (moved - before).abs().max() > 20 * (still - before).abs().max()


@pytest.mark.parametrize(
    ("samples", "frames"), [(1, 1), (RATE // 60, 1), (RATE, 60), (RATE + 1, 61)]
)
def test_number_of_frames_covers_the_recording(samples, frames):
    vertices = predict_mesh(model(), noise(2)[:samples])
    assert vertices.shape == (frames, 16, 3)
    assert vertices.dtype == np.float32


def test_gradients_at_rest_give_the_template():
    sdfa = model()
    for branch in sdfa.decoder.branches.values():
        branch.inverse_pca.components.zero_()
    out = predict_mesh(sdfa, noise(0.1), "bob")
    np.testing.assert_allclose(out, np.tile(sdfa.template("bob").vertices, (6, 1, 1)), atol=1e-5)


def test_another_template_of_the_same_triangles_is_moved():
    sdfa, face = model(), sheet(4, 20.0)
    moved = predict_mesh(sdfa, noise(0.2), "ann", template=face)
    np.testing.assert_allclose(np.ptp(moved[..., 0], axis=1), 20, atol=4)


@pytest.mark.parametrize(
    "bad", [np.zeros(0), np.zeros((2, 100)), np.array([0.0, np.nan]), np.float32(1)]
)
def test_prediction_rejects_what_is_no_row_of_finite_samples(bad):
    with pytest.raises(AudioError, match="16 kHz"):
        predict_mesh(model(), bad)


def test_attention_rows_sum_to_one():
    for recurrence in ("window", "segment"):
        weights = weights_of(
            model(recurrence=recurrence), torch.from_numpy(Speech.of(noise(0.5)).sound)
        )
        assert weights.shape == (30, 16)
        np.testing.assert_allclose(weights.sum(axis=1), 1, atol=1e-5)
        assert (weights >= 0).all()
    for other in (KARRAS, FRONTEND | {"kind": "mel_ablated", "summary": "convolution"}):
        with pytest.raises(CheckpointError, match="no temporal attention"):
            weights_of(model(frontend=other), torch.from_numpy(Speech.of(noise(0.5)).sound))
