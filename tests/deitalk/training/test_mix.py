"""Weights between two models: a line, its ends, and networks that do not fit one another."""

import pytest
import torch
from typer.testing import CliRunner

from deitalk.cli import app
from deitalk.config.load import parse_config
from deitalk.errors import CheckpointError
from deitalk.models.checkpoint import load_model, save_model
from deitalk.models.curve_model import DEITalk
from deitalk.models.folder import describe_model, weights_hash
from deitalk.research.config import read_training
from deitalk.training.tuning.mix import mix_models
from rig.errors import ExistsError
from tests.command import ran
from tests.deitalk.training.test_finetuning import TINY


def model(seed: int, **settings) -> DEITalk:
    torch.manual_seed(seed)
    return DEITalk(read_training(TINY).model.model_copy(update=settings)).eval()


@pytest.mark.parametrize("share", [0, 0.25, 1])
def test_every_weight_lies_on_the_line_between_the_two(share):
    before, after = model(0), model(1)
    kept = {name: value.clone() for name, value in after.state_dict().items()}
    mixed = mix_models(before, after, share).state_dict()
    for name, old in before.state_dict().items():
        if old.is_floating_point():
            wanted = (1 - share) * old + share * kept[name]
            assert torch.allclose(mixed[name], wanted, atol=1e-6 * (0 < share < 1)), name
        else:
            assert torch.equal(mixed[name], kept[name])
        assert torch.equal(after.state_dict()[name], kept[name])


def test_models_that_do_not_fit_are_refused():
    with pytest.raises(CheckpointError, match=r"share 1\.5 is beyond 0 to 1"):
        mix_models(model(0), model(1), 1.5)
    with pytest.raises(CheckpointError, match=r"the networks differ: .* of the same actors"):
        mix_models(model(0, actors=("anna", "ben")), model(1, actors=("anna", "ben", "carl")), 0.5)
    before, after = model(0), model(0)
    after.frontend.__class__ = type("Other", (type(after.frontend),), {})
    with pytest.raises(CheckpointError, match=r"the networks differ: .* and Other"):
        mix_models(before, after, 0.5)


def test_styles_of_new_actors_begin_at_zero():
    after = model(1, actors=("anna", "ben"))
    name = "decoder.actors.weight"
    mixed = mix_models(model(0), after, 0.25).state_dict()[name]
    torch.testing.assert_close(mixed, 0.25 * after.state_dict()[name])


def test_last_layers_that_a_tuning_widened_begin_at_zero():
    before, after = model(0), model(1, decoder_direct=True)
    wide = mix_models(before, after, 0.25).state_dict()["decoder.output.weight"]
    old, new = (m.decoder.output.weight.detach() for m in (before, after))
    size = old.shape[1]
    torch.testing.assert_close(wide[:, :size], 0.75 * old + 0.25 * new[:, :size])
    torch.testing.assert_close(wide[:, size:], 0.25 * new[:, size:])


def test_command_writes_a_model_that_names_both(tmp_path):
    config = read_training(TINY)
    other = parse_config({**config.model_dump(), "rules": {"dead_zone": None}})
    for name, seed, settings in (("before", 0, config), ("after", 1, other)):
        save_model(tmp_path / name, model(seed), settings, {"steps": 7, "base": str(tmp_path)})
    folders = [str(tmp_path / name) for name in ("before", "after")]
    command = ["model", "mix", *folders, "--share", "0.25", "-o", str(tmp_path / "out")]
    ran(*command)
    mixed = load_model(tmp_path / "out").state_dict()
    first, second = (m.state_dict() for m in map(load_model, folders))
    for name, value in mixed.items():
        assert torch.allclose(
            value, torch.lerp(first[name].float(), second[name].float(), 0.25).to(value), atol=2e-3
        )
    about = describe_model(tmp_path / "out")
    assert about["rules"]["dead_zone"] is None
    assert about["training"]["steps"] == 7 and about["training"]["base"] == tmp_path.name
    hashes = [weights_hash(tmp_path / name) for name in ("before", "after")]
    assert about["training"]["mixed"] == {"share": 0.25, "sha256": hashes}
    again = CliRunner().invoke(app, command)
    assert isinstance(again.exception, ExistsError)
