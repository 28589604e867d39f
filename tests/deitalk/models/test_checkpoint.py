"""Model folders: round trips, kinds of model, and damaged files refused in one line."""

import copy
import json
from pathlib import Path

import pytest
import torch
import yaml
from safetensors.torch import load_file, save_file

from deitalk.config.curves import Config
from deitalk.config.load import load_config
from deitalk.errors import CheckpointError
from deitalk.models.checkpoint import load_model, require_model, save_model
from deitalk.models.curve_model import DEITalk
from deitalk.models.folder import (
    describe_model,
    model_folder,
    product_of,
    weights_hash,
)
from deitalk.models.mesh_head import MeshHead
from deitalk.models.mesh_model import SDFA, MeshModel
from deitalk.research.config import read_training
from rig import default_controls
from tests.errors import one_line

TINY = Path(__file__).resolve().parents[3] / "configs" / "tiny.yaml"


@pytest.fixture(scope="module")
def config() -> Config:
    return read_training(TINY)


@pytest.fixture(scope="module")
def model(config) -> DEITalk:
    torch.manual_seed(1)
    return DEITalk(config.model).eval()


@pytest.fixture
def folder(config, model, tmp_path) -> Path:
    save_model(tmp_path / "model", model, config, {"step": 3})
    return tmp_path / "model"


def predict(model: DEITalk) -> torch.Tensor:
    torch.manual_seed(0)
    waveform = 0.1 * torch.randn(8000)
    return model.decode(model.analyse(waveform, 15), torch.eye(5)[2].expand(15, -1))


def refused(folder: Path | str, match: str) -> None:
    with one_line(CheckpointError, match=match):
        load_model(folder)


def test_model_read_again_predicts_the_same_bit_for_bit(folder, model):
    read = load_model(folder)
    assert not read.training
    assert torch.equal(predict(read), predict(model))
    assert sorted(p.name for p in folder.glob("[!.]*")) == [
        "config.yaml",
        "model.json",
        "model.safetensors",
    ]
    written, wanted = load_config(folder / "config.yaml"), read_training(TINY)
    assert (written.model, written.rules) == (wanted.model, wanted.rules)
    assert yaml.safe_load((folder / "config.yaml").read_text()).keys() == {
        "kind", "name", "model", "rules",
    }, "settings of the training stay with the run"  # fmt: skip


def test_half_precision_halves_the_file_and_changes_little(folder, config, model, tmp_path):
    save_model(tmp_path / "half", model, config, {}, half=True)
    ratio = (tmp_path / "half/model.safetensors").stat().st_size / (
        folder / "model.safetensors"
    ).stat().st_size
    assert ratio < 0.75, "a tiny model's header weighs too"
    stored = load_file(tmp_path / "half/model.safetensors")
    assert {v.dtype for v in stored.values() if v.is_floating_point()} == {torch.float16}
    half = load_model(tmp_path / "half")
    assert next(half.parameters()).dtype == torch.float32
    assert (predict(half) - predict(model)).abs().max() < 5e-3


def test_saving_again_replaces_own_files_only(folder, config, model):
    (folder / "notes.txt").write_text("mine")
    save_model(folder, model, config, {"step": 9})
    assert (folder / "notes.txt").read_text() == "mine"
    assert describe_model(folder)["training"] == {"step": 9}
    assert [p.name for p in folder.parent.iterdir()] == ["model"], "nothing is left beside it"


def test_describe_model_gives_controls_training_and_hash(folder, model):
    about = describe_model(folder)
    assert about["control_set"] == "metahuman-185@mh4" and about["training"] == {"step": 3}
    assert about["parameters"] == sum(p.numel() for p in model.parameters())
    assert about["bytes"] == (folder / "model.safetensors").stat().st_size
    assert len(about["sha256"]) == 64 and "controls" not in about


@pytest.mark.parametrize("content", [b"", b"hello", b"\xff" * 64, b"\x10" + b"\0" * 7 + b"{" * 16])
def test_load_model_rejects_damaged_weights(folder, content):
    (folder / "model.safetensors").write_bytes(content)
    refused(folder, r"model\.safetensors(: no safetensors file| is empty|, its header, is no JSON)")


def test_load_model_rejects_weights_that_are_not_finite(folder):
    path = folder / "model.safetensors"
    weights = load_file(path)
    name = next(k for k, v in weights.items() if v.is_floating_point() and v.numel() > 1)
    weights[name] = weights[name] * torch.nan
    save_file(weights, path)
    refused(folder, "is not finite")


def test_load_model_rejects_weights_of_another_configuration(folder, config):
    other = config.model_copy(
        update={"model": config.model.model_copy(update={"decoder_channels": 24})}
    )
    save_model(folder.parent / "other", DEITalk(other.model), other, {})
    (folder / "model.safetensors").write_bytes(
        (folder.parent / "other/model.safetensors").read_bytes()
    )
    refused(folder, "weights do not fit .*config.yaml .*is .*, not .*; both must be of one model")


def spoil(folder: Path, **changes: object) -> None:
    about = json.loads((folder / "model.json").read_text())
    (folder / "model.json").write_text(json.dumps(about | changes))


def test_load_model_rejects_another_control_set(folder):
    spoil(folder, control_set="somebody-52@1")
    refused(folder, "made for control set 'somebody-52@1', this deitalk drives 'metahuman-185@mh4'")
    spoil(folder, control_set="metahuman-185@mh4", controls=list(default_controls().names[::-1]))
    refused(folder, "made for control set")


@pytest.mark.parametrize(
    ("name", "kind"),
    [("default", DEITalk), ("live", DEITalk), ("sdfa", SDFA), ("mesh_head", MeshHead)],
)
def test_embedded_models_load_as_their_kind(name, kind):
    model = load_model(name)
    assert type(model) is kind and not model.training
    assert product_of(name) == ("curves" if kind is DEITalk else "mesh")


def test_a_run_names_its_model(folder):
    folder.rename(folder.with_name("best"))
    with pytest.raises(CheckpointError, match=r"is a run; its model is .*best"):
        load_model(folder.parent)


def test_required_kind_rejects_another_and_names_both(folder, model):
    with pytest.raises(
        CheckpointError,
        match="model: makes curves; a mesh model is needed, such as sdfa",
    ):
        require_model(folder, MeshHead)
    with pytest.raises(CheckpointError, match="no model there"):
        require_model("nothing", MeshModel)
    with pytest.raises(CheckpointError, match="is a dict; a mesh model is needed"):
        require_model({}, MeshModel)
    assert require_model(model, DEITalk) is model
    assert isinstance(require_model(folder, DEITalk), DEITalk)


@pytest.fixture(scope="module")
def live():
    return require_model("live", DEITalk), load_config(model_folder("live") / "config.yaml")


def same_weights(folder, model):
    read, given = load_model(folder).state_dict(), model.state_dict()
    return read.keys() == given.keys() and all(torch.equal(read[k], given[k]) for k in given)


def test_encoder_of_an_embedded_model_is_named_instead_of_written(live, tmp_path):
    model, config = live
    save_model(tmp_path / "own", model, config, {}, half=True)
    save_model(tmp_path / "named", model, config, {}, half=True, encoder_of="default")
    assert (tmp_path / "own/encoder.safetensors").is_file()
    assert not (tmp_path / "named/encoder.safetensors").exists()
    assert same_weights(tmp_path / "own", model) and same_weights(tmp_path / "named", model)
    assert weights_hash(tmp_path / "own") == weights_hash(tmp_path / "named")


def test_another_encoder_is_not_named(live, tmp_path):
    model, config = copy.deepcopy(live[0]), live[1]
    with torch.no_grad():
        model.frontend.encoder.conv1.weight[0, 0, 0] += 1
    with pytest.raises(CheckpointError, match="the model has another encoder"):
        save_model(tmp_path / "m", model, config, {}, half=True, encoder_of="default")
    assert not (tmp_path / "m").exists()


@pytest.mark.parametrize("owner", ["other", "/etc/passwd", "../default", 3])
def test_encoder_of_no_embedded_model_is_refused(live, tmp_path, owner):
    model, config = live
    save_model(tmp_path / "m", model, config, {}, half=True, encoder_of="default")
    about = json.loads((tmp_path / "m/model.json").read_text())
    (tmp_path / "m/model.json").write_text(json.dumps(about | {"encoder_of": owner}))
    refused(tmp_path / "m", "is no embedded model")


def test_readout_of_the_voice_has_a_file_of_its_own_and_leaves_the_hash(config, tmp_path):
    """The hash is of what makes curves."""
    heard = config.model_copy(update={"model": config.model.model_copy(update={"effort": True})})
    model, folder = DEITalk(heard.model).eval(), tmp_path / "model"
    hashes = []
    for value in (1.0, 2.0):
        torch.nn.init.constant_(model.intensity.effort.weight, value)
        save_model(folder, model, heard, {})
        assert set(load_file(folder / "effort.safetensors")) == {
            "intensity.effort.weight",
            "intensity.effort.bias",
        }
        assert load_model(folder).intensity.effort.weight.unique() == value
        hashes.append(weights_hash(folder))
    assert hashes[0] == hashes[1]
    (folder / "effort.safetensors").unlink()
    refused(folder, "intensity.effort.weight' is absent")
