"""Configurations: the papers' numbers, and messages about invalid files."""

from pathlib import Path

import pytest
import yaml

from deitalk.config.curves import Config, TrainConfig
from deitalk.config.frontends import MelConfig, Wav2VecConfig
from deitalk.config.load import load_config, load_model_config, parse_config
from deitalk.config.rules import Gates, RulesConfig
from deitalk.errors import ConfigError
from deitalk.research.config import TrainingConfig, read_training
from tests.errors import one_line

FOLDER = Path(__file__).resolve().parents[3] / "configs"
FILES = sorted(FOLDER.glob("*.yaml"))


def problem(tree):
    with one_line(ConfigError) as caught:
        parse_config(tree)
    return str(caught.value)


def written(tmp_path, text):
    path = tmp_path / "it.yaml"
    path.write_text(text)
    return path


@pytest.mark.parametrize("path", FILES)
def test_every_file_loads_under_its_name(path):
    config = read_training(path)
    assert config.name == path.stem
    assert parse_config(config.model_dump(mode="json")) == config
    assert f"`{path.name}`" in (FOLDER / "README.md").read_text()


def test_deitalk_has_the_numbers_of_the_paper():
    config = read_training(FOLDER / "deitalk.yaml")
    model, loss, data, train = config.model, config.loss, config.data, config.train
    assert isinstance(model.frontend, Wav2VecConfig)
    assert model.frontend.checkpoint == "facebook/wav2vec2-base-960h"
    assert model.frontend.freeze_stem  # §4.1: the TCN of wav2vec 2.0 is fixed
    assert (model.style_size, model.emotion_size) == (16, 128)  # §3.3, §3.4
    assert model.motion_channels == (384, 384, 768, 768)  # §4.1
    assert model.classifier_size == 64
    assert (model.decoder_channels, model.kernel_size) == (512, 3)
    assert model.decoder_dilations == (1, 2, 4, 8, 1, 2, 4, 8)
    assert model.positions
    assert model.intensity
    assert model.saliency_frames is None
    assert not model.decoder_residual
    assert config.rules == RulesConfig.none()  # those of `default` were chosen for its targets
    assert model.dropout == 0
    weights = (loss.contrast, loss.classification, loss.position, loss.velocity)
    assert weights == (0.1, 0.1, 1.0, 4.0)  # §3.5
    assert loss.temperature == 0.07
    assert (loss.intensity, loss.contact, loss.control_weights) == (0, 0, {})
    assert (data.window_frames, data.stride_frames, data.augment) == (128, 5, False)
    assert (train.optimizer, train.learning_rate, train.batch_size) == ("adam", 1e-4, 32)
    assert (train.epochs, train.steps, train.schedule) == (300, None, "constant")
    assert (train.weight_decay, train.gradient_clip, train.ema) == (0, None, None)


def test_sdfa_encoder_has_the_numbers_of_the_paper():
    config = read_training(FOLDER / "sdfa_encoder.yaml")
    mel = config.model.frontend
    assert mel == MelConfig()
    assert (mel.window_seconds, 1 / mel.frame_rate) == (0.064, 0.008)  # §4.4
    assert (mel.n_mels, mel.window_frames) == (128, 64)
    assert mel.conv_channels == (32, 64, 64)  # Table 1
    assert 2 * mel.spec_hidden * mel.n_mels // 4 == 2048
    assert mel.spectral_size == 256
    assert (2 * mel.time_hidden, mel.time_layers) == (512, 2)  # Table 2
    assert (mel.recurrence, mel.weight_norm, mel.centre) == ("window", True, False)
    assert config.model_copy(update={"name": "deitalk"}).loss == TrainingConfig().loss


@pytest.mark.parametrize(("recipe", "model"), [("measured_lips", "mel")])
def test_embedded_weights_fit_their_recipe(recipe, model):
    embedded = load_model_config(FOLDER.parent / "deitalk/models/weights" / model)
    wanted = read_training(FOLDER / f"{recipe}.yaml")
    assert (wanted.model, wanted.rules) == (embedded.model, embedded.rules)


@pytest.mark.parametrize(
    ("tree", "key", "section"),
    [
        ({"bogus": 1}, "bogus=1", Config),
        ({"train": {"batchsize": 8}}, "train.batchsize=8", TrainConfig),
        ({"model": {"frontend": {"kind": "mel", "mels": 80}}}, "model.frontend.mels=80", MelConfig),
        ({"rules": {"gates": {"open": 5}}}, "rules.gates.open=5", Gates),
    ],
)
def test_an_unknown_key_is_told_with_those_of_its_section(tmp_path, tree, key, section):
    told = f"{key}: unknown key; known are {', '.join(section.model_fields)}"
    assert problem(tree) == f"configuration: {told}"
    path = written(tmp_path, yaml.safe_dump(tree))
    with one_line(ConfigError) as caught:
        load_config(path)
    assert str(caught.value) == f"{path}: {told}"


@pytest.mark.parametrize(
    ("tree", "key"),
    [
        ({"train": {"batch_size": 0}}, "train.batch_size=0"),
        ({"train": {"learning_rate": "fast"}}, "train.learning_rate='fast'"),
        ({"train": {"learning_rate": float("inf")}}, "train.learning_rate=inf"),
        ({"train": {"learning_rate": float("nan")}}, "train.learning_rate=nan"),
        ({"train": {"optimizer": "sgd"}}, "train.optimizer='sgd'"),
        ({"loss": {"temperature": 0}}, "loss.temperature=0"),
        ({"kind": "training", "loss": {"contact": -1}}, "loss.contact=-1"),
        ({"data": {"real_fraction": 1.5}}, "data.real_fraction=1.5"),
        ({"model": {"kernel_size": 4}}, "model.kernel_size=4: must be odd"),
        ({"model": {"decoder_dilations": []}}, "model.decoder_dilations=[]"),
        ({"model": {"frontend": {"kind": "mel", "query_frames": 6}}}, "query_frames=6: must be"),
        ({"model": {"frontend": {"kind": "mel", "window_frames": 5}}}, "longer than window_frames"),
        ({"model": {"frontend": {"kind": "mel", "time_stack": 2}}}, "recurrence: segment"),
        ({"model": {"frontend": {"kind": "hubert"}}}, "hubert"),
        ({"model": 3}, "model=3"),
    ],
)
def test_invalid_value_is_in_the_message(tree, key):
    assert key in problem(tree)


def test_overrides_replace_values(tmp_path):
    path = written(tmp_path, "train: {batch_size: 16}")
    config = load_config(
        path,
        [
            "train.batch_size=8",
            "loss.intensity=2.5",
            "model.frontend.kind=mel",
            "data.augment=true",
        ],
    )
    assert config.train.batch_size == 8
    assert config.loss.intensity == 2.5
    assert config.model.frontend == MelConfig()
    assert config.data.augment is True
    assert load_config(path, ["train.steps=5", "train.steps=6"]).train.steps == 6
    assert load_config(path, ["train.learning_rate=1e-3"]).train.learning_rate == 1e-3


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("train.batch_size", "no '='"),
        ("name.first=x", "'name' is a value"),
        ("train.nonsense=1", "train.nonsense=1: unknown key"),
        ("train.steps=[1", "cannot be read as YAML"),
    ],
)
def test_load_config_rejects_invalid_overrides(tmp_path, override, message):
    with pytest.raises(ConfigError) as caught:
        load_config(written(tmp_path, "name: x"), [override])
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("text", ["- a\n- b", "just words", "a: [1", "\tx: 1"])
def test_load_config_rejects_other_files(tmp_path, text):
    with pytest.raises(ConfigError) as caught:
        load_config(written(tmp_path, text))
    assert "it.yaml" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_yaml_tags_run_no_code(tmp_path):
    with pytest.raises(ConfigError, match=r"no constructor|determine a constructor for the tag"):
        load_config(written(tmp_path, "name: !!python/object/apply:os.getcwd []"))


def test_empty_file_is_the_paper_configuration(tmp_path):
    assert load_config(written(tmp_path, "")) == Config()
