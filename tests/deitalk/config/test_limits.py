"""Limits of configurations: of every field, then of the network's size before it is built."""

import shutil
import time

import pytest

from deitalk.config.curves import Config
from deitalk.config.load import load_config, parse_config
from deitalk.errors import CheckpointError, ConfigError
from deitalk.models.checkpoint import load_model, save_model
from deitalk.models.curve_model import DEITalk
from deitalk.models.weight_file import network_shapes
from deitalk.research.config import read_training
from rig import limits
from tests.errors import one_line


def refused(tree):
    start = time.process_time()
    with one_line(ConfigError) as caught:
        parse_config(tree)
    assert time.process_time() - start < 1
    return str(caught.value)


def frontend(**settings):
    return {"model": {"frontend": settings}}


FIELDS = [
    (lambda v: frontend(kind="mel", rig_layers=v), limits.RECURRENT_LAYERS),
    (lambda v: frontend(kind="mel", time_hidden=v), limits.WIDTH),
    (lambda v: frontend(kind="mel", time_layers=v), limits.RECURRENT_LAYERS),
    (lambda v: frontend(kind="mel", n_mels=v), limits.MEL_BINS),
    (lambda v: frontend(kind="mel", tapers=v), limits.TAPERS),
    (lambda v: frontend(kind="mel", window_frames=v), limits.WINDOW_FRAMES),
    (lambda v: frontend(kind="mel", frame_rate=v), limits.SPECTRA_PER_SECOND),
    (lambda v: frontend(kind="mel", window_seconds=v), limits.WINDOW_SECONDS),
    (lambda v: frontend(kind="whisper", layers=[v]), limits.LAYERS),
    (lambda v: frontend(kind="whisper", width=v, heads=1), limits.WIDTH),
    (lambda v: frontend(kind="wav2vec", encoder={"num_hidden_layers": v}), limits.LAYERS),
    (lambda v: frontend(kind="wav2vec", encoder={"hidden_size": v}), limits.WIDTH),
    (lambda v: frontend(kind="wav2vec", encoder={"conv_dim": [v]}), limits.WIDTH),
    (lambda v: frontend(kind="wav2vec", encoder={"conv_dim": [1] * v}), limits.LAYERS),
    (lambda v: {"model": {"saliency_frames": v}}, limits.SALIENCY_FRAMES),
    (lambda v: {"model": {"decoder_channels": v}}, limits.WIDTH),
    (lambda v: {"model": {"decoder_dilations": [1] * v}}, limits.LAYERS),
    (lambda v: {"model": {"decoder_dilations": [v]}}, limits.DILATION),
    (lambda v: {"model": {"motion_channels": [8] * v}}, limits.MOTION_LAYERS),
    (lambda v: {"model": {"kernel_size": v}}, limits.KERNEL),
    (lambda v: {"data": {"window_frames": v}}, limits.TRAINING_FRAMES),
    (lambda v: {"train": {"batch_size": v}}, limits.BATCH),
    (lambda v: {"train": {"steps": v}}, limits.TRAINING_STEPS),
    (lambda v: {"train": {"workers": v}}, limits.WORKERS),
    (lambda v: {"train": {"seed": v}}, limits.SEED),
    (lambda v: {"train": {"epochs": v}}, limits.TRAINING_PASSES),
    (lambda v: {"kind": "sdfa", "model": {"branch_sizes": [v]}}, limits.WIDTH),
    (lambda v: {"kind": "sdfa_training", "data": {"identities": [0] * v}}, limits.SPEAKERS),
]  # fmt: skip


@pytest.mark.parametrize(("tree", "most"), FIELDS)
def test_field_at_its_limit_is_read_and_above_is_not(tree, most):
    parse_config(tree(most))
    assert "configuration: " in refused(tree(most + (2 if most == limits.KERNEL else 1)))


@pytest.mark.parametrize(
    "tree",
    [
        frontend(kind="mel", rig_layers=1_000_000),
        frontend(kind="wav2vec", encoder={"hidden_size": 10**30}),
        frontend(kind="wav2vec", encoder={"hidden_size": float("inf")}),
        frontend(kind="wav2vec", encoder={"hidden_act": "x" * 10**6}),
        frontend(kind="wav2vec", encoder={str(i): 1 for i in range(2000)}),
        {"model": {"saliency_frames": 10**9}},
        {"train": {"seed": -1}},
        {"x" * 10**6: 1},
        {str(i): 1 for i in range(10_000)},
    ],
)
def test_configuration_rejects(tree):
    refused(tree)


def test_oversized_network_is_refused_before_it_is_built():
    wide = parse_config({"model": {
        "frontend": {"kind": "mel"}, "decoder_channels": 8192, "decoder_dilations": [1] * 32,
        "kernel_size": 255,
    }})  # fmt: skip
    start = time.process_time()
    with pytest.raises(ConfigError, match=r"[\d,]+ million numbers; at most 500 million"):
        network_shapes(lambda: DEITalk(wide.model, pretrained=False))
    assert time.process_time() - start < 5


@pytest.mark.parametrize("name", ["mel", "default", "tiny"])
def test_shapes_without_memory_are_those_of_the_network(name):
    from pathlib import Path

    path = Path(__file__).resolve().parents[3] / "configs" / f"{name}.yaml"
    config = read_training(path)
    assert isinstance(config, Config)
    real = DEITalk(config.model, pretrained=False).state_dict()
    assert network_shapes(lambda: DEITalk(config.model, pretrained=False)) == {
        key: tuple(value.shape) for key, value in real.items()
    }


@pytest.mark.parametrize(
    "override",
    ["model.decoder_channels=*a", "a" * 100_000, ".".join("a" * 40) + "=1", "train.steps=" + "[" * 999],
)  # fmt: skip
def test_override_rejects(tmp_path, override):
    (tmp_path / "c.yaml").write_text("")
    with pytest.raises(ConfigError) as caught:
        load_config(tmp_path / "c.yaml", [override])
    assert len(str(caught.value)) <= limits.MESSAGE_CHARACTERS


@pytest.fixture(scope="module")
def tiny(tmp_path_factory):
    from pathlib import Path

    config = read_training(Path(__file__).resolve().parents[3] / "configs" / "tiny.yaml")
    assert isinstance(config, Config)
    folder = tmp_path_factory.mktemp("model") / "tiny"
    save_model(folder, DEITalk(config.model), config, {})
    return folder


@pytest.fixture
def folder(tiny, tmp_path):
    shutil.copytree(tiny, tmp_path / "tiny")
    return tmp_path / "tiny"


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("rig_layers: 0", "rig_layers: 1000000"),
        ("tapers: 1", "tapers: 100000"),
        ("saliency_frames: 31", "saliency_frames: 1000000000"),
        ("decoder_channels: 32", "decoder_channels: 8192"),
        ("decoder_channels: 32", "decoder_channels: 99999999"),
        ("name: tiny", "name: &a [" + "*a," * 100 + "1]"),
    ],
)
def test_oversized_model_folder_takes_no_memory(tiny, tmp_path, before, after):
    folder = shutil.copytree(tiny, tmp_path / "tiny")
    path = folder / "config.yaml"
    text = path.read_text()
    assert before in text
    path.write_text(text.replace(before, after))
    start = time.process_time()
    with pytest.raises((CheckpointError, ConfigError)) as caught:
        load_model(folder)
    assert len(str(caught.value)) <= limits.MESSAGE_CHARACTERS
    assert time.process_time() - start < 3


@pytest.mark.parametrize(
    ("header", "words"),
    [
        (b"{}", "absent, not"),
        (b"[]", "no tensors"),
        (b'{"a": {"dtype": "F32", "shape": [1000000000, 1000], "data_offsets": [0, 4]}}', "differ"),
        (b'{"a": {"dtype": "F32", "shape": [-1], "data_offsets": [0, -4]}}', "whole numbers"),
        (b'{"a": {"dtype": "F99", "shape": [1], "data_offsets": [0, 4]}}', "F99"),
        (b'{"a": {"dtype": "F32", "shape": [1], "data_offsets": [0, 4, 8]}}', "does not fit"),
        (b'{"a": {"dtype": "F32", "shape": [true], "data_offsets": [0, 4]}}', "whole numbers"),
        (b"[" * 5000, "nests 5000 levels"),
    ],
)
def test_weights_header_rejects(folder, header, words):
    path = folder / "model.safetensors"
    path.write_bytes(len(header).to_bytes(8, "little") + header + bytes(4))
    with pytest.raises(CheckpointError, match=words):
        load_model(folder)
