"""Mesh models from waveform to vertices: sizes, windows, training, folders, the lip seal."""

import math
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import torch
import yaml
from typer.testing import CliRunner

from deitalk.audio.voice_activity import normalise_level
from deitalk.cli import app
from deitalk.config import (
    SDFAConfig,
    SDFAMelConfig,
    SDFAModelConfig,
    load_config,
    parse_config,
)
from deitalk.data.mesh_folder import Lips, MeshSequence, read_mesh_folder, write_mesh_folder
from deitalk.errors import AudioError, CheckpointError, ConfigError, DataError
from deitalk.frontends.windows import window_index
from deitalk.models import mesh_model as sdfa_module
from deitalk.models.checkpoint import load_model, new_mesh_model, save_model
from deitalk.models.curve_model import DEITalk
from deitalk.models.deformation_decoder import Deformation, InversePCA, Offsets
from deitalk.pipeline.mesh import mesh_coefficients, predict_mesh
from deitalk.pipeline.speech import Speech
from deitalk.training import mesh as train_module
from deitalk.training import trainer as trainer_module
from deitalk.training.lip_regression import LipRegression
from deitalk.training.mesh import train_mesh, validate_mesh
from rig.face.identity import IDENTITIES
from rig.mesh import TriMesh
from tests.dataset import write_dataset

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
    "no Spec-BiLSTM": SEGMENT | {"gathering": "convolution"},
    "no attention": FRONTEND | {"summary": "convolution"},
    "karras": KARRAS,
    "voca": VOCA,
}


def tiny(frontend=FRONTEND, motion="gradients", **train):
    return parse_config(
        {
            "kind": "sdfa",
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


@pytest.fixture(scope="module")
def sequences(tmp_path_factory):
    """A mesh folder of two speakers with one sound and opposite motion."""
    out = tmp_path_factory.mktemp("meshes") / "folder"
    template = sheet()
    both = [
        MeshSequence(speaker, speaker, "train", partial(spoken, template, style))
        for speaker, style in STYLES.items()
    ]
    write_mesh_folder(
        out, dict.fromkeys(STYLES, template), both, fps=30, unit_mm=10, lips=LIPS,
        basis_frames=24, basis_error_mm=0.2,
    )  # fmt: skip
    return out


def model(fps=60, frontend=FRONTEND, motion="gradients", **changes):
    torch.manual_seed(0)
    template = sheet(4)
    sizes = {"stretch": (3, 6 * 18), "rotation": (4, 3 * 18)}
    sizes = sizes if motion == "gradients" else {"offsets": (5, 3 * 16)}
    layers = {name: InversePCA(*size) for name, size in sizes.items()}
    for layer in layers.values():
        layer.components.normal_(std=0.02)
    config = SDFAModelConfig(
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
    assert isinstance(config, SDFAConfig)
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
    assert len(config.data.identities) == 8


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
        parse_config({"kind": "sdfa", **tree})
    assert said in str(caught.value)


@pytest.mark.parametrize("name", ["sdfa_small", "karras", "voca"])
def test_configurations_of_one_comparison_share_data_and_schedule(name):
    config, reference = (load_config(CONFIGS / f"{n}.yaml") for n in (name, "sdfa_small"))
    assert config.data == reference.data
    train, wanted = config.train, reference.train
    assert (train.schedule, train.lip_weight, train.ema) == (
        wanted.schedule,
        wanted.lip_weight,
        wanted.ema,
    )


def test_forward_has_the_shapes_of_fig_1():
    sdfa = model()
    rows = sdfa(torch.randn(2, 3, 16, 40), torch.tensor([8, 12, 16]), torch.eye(2))
    assert {name: row.shape for name, row in rows.items()} == {
        "stretch": (2, 3, 3),
        "rotation": (2, 3, 4),
    }
    s, r = sdfa.decoder.expand({name: row[0] for name, row in rows.items()})
    assert (s.shape, r.shape) == ((3, 6 * 18), (3, 3 * 18))


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


def test_offsets_are_added_to_the_template():
    sdfa = model(motion="offsets")
    motion = motion_of(sdfa, noise(0.2), "bob")
    assert isinstance(motion, Offsets) and isinstance(motion_of(model(), noise(0.2)), Deformation)
    vertices = predict_mesh(sdfa, noise(0.2), "bob")
    expected = sdfa.template("bob").vertices + motion.offsets.numpy().reshape(12, 16, 3)
    np.testing.assert_allclose(vertices, expected, atol=1e-5)
    assert np.ptp(vertices, axis=0).max() > 1e-3


def test_window_index_repeats_the_ends():
    index = window_index(torch.tensor([0, 3, 9]), 4, 10)
    assert index.tolist() == [[0, 0, 0, 1], [1, 2, 3, 4], [7, 8, 9, 9]]


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


def test_prediction_does_not_depend_on_the_level():
    sdfa = model()
    for weight in sdfa.parameters():
        weight.data.div_(3)
    one, two = (predict_mesh(sdfa, gain * noise(0.5)) for gain in (1.0, 0.2))
    np.testing.assert_allclose(one, two, atol=1e-3)


@pytest.mark.parametrize(
    "bad", [np.zeros(0), np.zeros((2, 100)), np.array([0.0, np.nan]), np.float32(1)]
)
def test_prediction_rejects_what_is_no_row_of_finite_samples(bad):
    with pytest.raises(AudioError, match="16 kHz"):
        predict_mesh(model(), bad)


def test_prediction_rejects_an_unknown_speaker():
    with pytest.raises(CheckpointError, match=r"'eve' is unknown.*ann, bob"):
        predict_mesh(model(), noise(0.1), "eve")


@pytest.mark.parametrize(
    ("frontend", "motion", "steps", "more"),
    [
        (FRONTEND, "gradients", 400, {"schedule": "one_cycle"}),
        (SEGMENT, "gradients", 200, {"segment_frames": 8, "lip_weight": 1.0, "ema": 0.9}),
        (KARRAS, "offsets", 200, {"segment_frames": 8, "schedule": "one_cycle"}),
        (VOCA, "offsets", 300, {"segment_frames": 8, "batch_size": 32}),
    ],
    ids=["as printed", "segment", "karras", "voca"],
)
def test_a_tiny_model_learns_two_speakers_by_heart(
    sequences, tmp_path, frontend, motion, steps, more
):
    """The sound is the same, so the motion can follow from the label only."""
    config = tiny(frontend, motion, steps=steps, learning_rate=1e-2, evaluate_every=steps, **more)
    best = train_mesh(config, sequences, tmp_path / "run")
    sdfa, errors_mm = load_model(tmp_path / "run/best"), []
    for speaker, style in STYLES.items():
        template = sdfa.template(speaker)
        waveform, truth = spoken(template, style)
        error_mm = 10 * np.linalg.norm(predict_mesh(sdfa, waveform, speaker) - truth, axis=-1)
        motion_mm = 10 * np.linalg.norm(truth - template.vertices, axis=-1)
        assert error_mm.mean() < 0.5
        assert error_mm.mean() < 0.25 * motion_mm.mean()  # standing still would cost all of it
        errors_mm.append(error_mm.mean())
    assert best["development"]["mean_mm"] == pytest.approx(np.mean(errors_mm), rel=0.1, abs=0.05)
    losses = pd.read_csv(tmp_path / "run/metrics.csv")
    value = "stretch_value" if motion == "gradients" else "offsets_value"
    assert losses[value].iloc[-1] < 0.3 * losses[value].iloc[0]
    assert ("lips" in losses) == ("lip_weight" in more)


def test_resumed_is_as_uninterrupted(sequences, tmp_path):
    whole, halved = tmp_path / "whole", tmp_path / "halved"
    config = tiny(ema=0.9, schedule="one_cycle", lip_weight=0.5)
    train_mesh(config, sequences, whole)
    update = trainer_module.Trainer.update

    def killed(trainer, *rest):
        if trainer.step == 3:  # after the evaluation and save of step 2, and one step more
            raise KeyboardInterrupt
        return update(trainer, *rest)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(trainer_module.Trainer, "update", killed)
        with pytest.raises(KeyboardInterrupt):
            train_mesh(config, sequences, halved)
    train_mesh(config, sequences, halved, resume=True)
    one, two = (load_model(run / "last").state_dict() for run in (whole, halved))
    assert all(torch.equal(one[name], two[name]) for name in one)


def test_attention_rows_sum_to_one():
    for recurrence in ("window", "segment"):
        weights = model(recurrence=recurrence).attention_weights(Speech.of(noise(0.5)).sound)
        assert weights.shape == (30, 16)
        np.testing.assert_allclose(weights.sum(axis=1), 1, atol=1e-5)
        assert (weights >= 0).all()
    for other in (KARRAS, FRONTEND | {"summary": "convolution"}):
        with pytest.raises(CheckpointError, match="no temporal attention"):
            model(frontend=other).attention_weights(Speech.of(noise(0.5)).sound)


def test_command_trains_on_our_heads(tmp_path):
    data = write_dataset(tmp_path / "data", 2, 1)  # both train on what one emotion has
    settings = tmp_path / "tiny.yaml"
    settings.write_text(yaml.safe_dump(tiny(steps=2).model_dump(mode="json")))
    run = tmp_path / "run"
    result = CliRunner().invoke(
        app, ["train", str(settings), "--data", str(data), "-o", str(run), "--set", "train.seed=1"]
    )
    assert result.exit_code == 0, result.output
    sdfa = load_model(run / "best")
    assert sdfa.speakers == tuple(sorted(IDENTITIES[i].name for i in (0, 3)))
    scores, _ = validate_mesh(sdfa, read_mesh_folder(run / "meshes"))
    assert math.isfinite(scores["lively_mm"]) and scores["lively_mm"] > scores["mean_mm"] > 0
    assert load_config(run / "config.yaml").train.seed == 1


def test_command_refuses_weights_to_start_from(tmp_path):
    arguments = ["train", str(CONFIG), "--data", str(tmp_path), "-o", str(tmp_path / "run")]
    result = CliRunner().invoke(app, [*arguments, "--from", "default"])
    assert isinstance(result.exception, ConfigError | CheckpointError)
    result = CliRunner().invoke(app, arguments)
    assert isinstance(result.exception, DataError)
    assert "neither" in str(result.exception)
    assert not (tmp_path / "run/metrics.csv").exists()


def test_lips_that_are_not_known_cannot_be_weighed(tmp_path):
    template = sheet()
    one = MeshSequence("a", "ann", "train", partial(spoken, template))
    write_mesh_folder(tmp_path / "m", {"ann": template}, [one], fps=30, unit_mm=10)
    with pytest.raises(ConfigError, match=r"train\.lip_weight=1: .* where the lips"):
        train_mesh(tiny(lip_weight=1.0), tmp_path / "m", tmp_path / "run")


def test_a_start_encoder_must_fit(sequences, tmp_path):
    with pytest.raises(ConfigError, match="its encoder is not of"):
        train_mesh(tiny(start_encoder="default"), sequences, tmp_path / "run")


def test_parts_that_an_ablation_replaces_start_new(tmp_path):
    """All else is the start's; a part of another kind must be named."""
    start = load_config(CONFIGS / "tiny.yaml", ["model.frontend.rig_layers=1"])
    save_model(tmp_path / "m", DEITalk(start.model, pretrained=False), start, {})
    sizes = start.model.frontend.model_dump() | {"rig_layers": 0}  # which SDFA has none of
    copy, name = train_module.copy_encoder, str(tmp_path / "m")
    wanted = load_model(name).frontend.state_dict()
    sdfa = model(frontend=sizes)
    before = {k: v.clone() for k, v in sdfa.encoder.frontend.state_dict().items()}
    copy(sdfa, name, ("attention",))
    for key, value in sdfa.encoder.frontend.state_dict().items():
        is_new = key.startswith("attention.")
        assert torch.equal(value, (before if is_new else wanted)[key]), key
    convolved = model(frontend=sizes, gathering="convolution")
    copy(convolved, name, ("spectral",))
    with pytest.raises(ConfigError, match=r"name what differs in train\.start_new"):
        copy(convolved, name, ())
    without = model(frontend=sizes, centre=False)
    copy(without, name, ())
    recurrent = without.encoder.frontend.recurrent.state_dict()
    assert all(torch.equal(v, wanted[f"recurrent.{k}"]) for k, v in recurrent.items())


def test_lip_reader_is_exact_where_motion_is_linear(sequences):
    """Offsets to lips is linear by definition; what is left is float16 and the basis."""
    folder = read_mesh_folder(sequences)
    clips = [(c.motion(), folder.training_speakers.index(c.speaker)) for c in folder.clips]
    reader = LipRegression.fit(clips, folder, motion="offsets")
    assert reader.residual_mm < 0.1
    motion, place = clips[1]
    rows = torch.from_numpy(motion["offsets"])[None]
    read = reader({"offsets": rows}, torch.eye(2)[[place]])[0]
    np.testing.assert_allclose(read, 10 * motion["lips"], atol=0.5)  # mm
    rest = folder.templates["ann"].vertices
    parting = 10 * (rest[LIPS.upper] - rest[LIPS.lower])
    np.testing.assert_allclose(reader.rest_parting(torch.eye(2)[:1])[0, 0], parting, atol=1e-4)
