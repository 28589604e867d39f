"""Feature distillation: which weights are copied, what is trained, what stays unchanged."""

from pathlib import Path

import pandas as pd
import pytest
import torch

from deitalk.config.curves import Config
from deitalk.models.checkpoint import load_model, save_model
from deitalk.models.curve_model import DEITalk
from deitalk.research.config import read_training
from deitalk.research.training.curves import TrainingTask, train_curves
from deitalk.research.training.distillation import Teacher, read_teacher
from deitalk.training.curve_losses import start_as
from tests.dataset import write_dataset

TINY = Path(__file__).resolve().parents[4] / "configs" / "tiny.yaml"
FRONTEND = (
    "{kind: whisper, checkpoint: null, n_mels: 16, width: 32, heads: 2, intermediate: 32, "
    "layers: [0, 1], learns: everything}"
)


def student(teacher: Path | str, *overrides: str) -> Config:
    """A small Whisper encoder before tiny.yaml's decoder."""
    mine = ("train.steps=6", "train.evaluate_every=3", f"model.frontend={FRONTEND}")
    return read_training(TINY, (*mine, f"train.teacher={teacher}", *overrides))


def weights(folder: Path) -> dict[str, torch.Tensor]:
    return load_model(folder).state_dict()


@pytest.fixture(scope="module")
def data(tmp_path_factory) -> Path:
    return write_dataset(tmp_path_factory.mktemp("data"))


@pytest.fixture(scope="module")
def teacher(tmp_path_factory) -> Path:
    config = read_training(TINY)
    torch.manual_seed(7)
    folder = tmp_path_factory.mktemp("teacher") / "model"
    save_model(folder, DEITalk(config.model), config, {})
    return folder


@pytest.fixture(scope="module")
def finished(data, teacher, tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("runs") / "whole"
    train_curves(student(teacher), data, out)
    return out


def test_distance_by_hand_with_gradients_for_the_student_only(teacher):
    config = student(teacher)
    model = read_teacher(str(teacher), DEITalk(config.model))
    assert model is not None and not any(p.requires_grad for p in model.parameters())
    distilled = Teacher(model, torch.device("cpu"))
    waveform = torch.randn(2, 16000) * 0.07
    target = model.frontend(waveform, 30)
    speech = (target + 3).requires_grad_()
    distance = distilled.distance(waveform, speech)
    assert distance.item() == pytest.approx(9, rel=1e-4)
    distance.backward()
    # d/dx of the mean of (x - y)^2 is 2 (x - y) / n.
    torch.testing.assert_close(speech.grad, torch.full_like(speech, 6 / speech.numel()))
    # Errors of 1 and -1 by turns differ by 2: 1 + 4 * 2^2.
    shaken = target + (-1.0) ** torch.arange(30).unsqueeze(1)
    assert distilled.distance(waveform, shaken).item() == pytest.approx(17, rel=1e-4)


def test_weights_of_equal_shape_behind_the_frontend_are_copied(teacher):
    theirs = load_model(teacher)
    model = DEITalk(student(teacher, "model.style_size=3").model)
    before = {name: value.clone() for name, value in model.state_dict().items()}
    copied = start_as(model, theirs)
    assert {"intensity", "motion", "decoder"} == {name.split(".")[0] for name in copied}
    assert "decoder.style.weight" not in copied, "another shape"
    for name, value in model.state_dict().items():
        expected = theirs.state_dict()[name] if name in copied else before[name]
        assert torch.equal(value, expected), name
    whole = DEITalk(student(teacher).model)
    behind = {name for name in theirs.state_dict() if not name.startswith("frontend.")}
    assert set(start_as(whole, theirs)) == behind


def test_student_of_the_same_kind_has_equal_features_even_with_more_layers(teacher):
    theirs = load_model(teacher)
    deep = DEITalk(read_training(TINY, ["model.frontend.rig_layers=1"]).model).eval()
    assert set(start_as(deep, theirs)) == set(theirs.state_dict())
    sound = torch.randn(1, 16000) * 0.07
    with torch.no_grad():
        torch.testing.assert_close(deep.frontend(sound, 30), theirs.frontend(sound, 30))


def test_training_reduces_the_distance_and_leaves_the_teacher(data, teacher, tmp_path):
    before = weights(teacher)
    out = tmp_path / "run"
    options = ("train.steps=50", "train.evaluate_every=50", "train.learning_rate=3e-3")
    train_curves(student(teacher, *options), data, out)
    metrics = pd.read_csv(out / "metrics.csv")
    assert metrics["distillation"].iloc[-1] < 0.8 * metrics["distillation"].iloc[0]
    after = weights(teacher)
    assert all(torch.equal(before[name], after[name]) for name in before)


def test_total_contains_the_weighted_distance(data, teacher, tmp_path):
    totals = []
    for weight in (0, 2):
        out = tmp_path / str(weight)
        train_curves(student(teacher, "train.steps=1", f"loss.distillation={weight}"), data, out)
        totals.append(pd.read_csv(out / "metrics.csv").iloc[0])
    assert totals[0]["distillation"] == totals[1]["distillation"]
    added = totals[1]["total"] - totals[0]["total"]
    assert added == pytest.approx(2 * totals[1]["distillation"], rel=1e-4)


def test_saved_model_contains_no_teacher_and_loads_without_it(finished, teacher):
    config = student(teacher)
    names = set(DEITalk(config.model).state_dict())
    assert set(weights(finished / "best")) == names
    assert str(teacher) in (finished / "config.yaml").read_text(), "the run names the teacher"
    assert str(teacher) not in (finished / "best" / "config.yaml").read_text()


def test_weights_that_begin_as_the_teachers_learn_at_a_third(data, teacher):
    task = TrainingTask(student(teacher), data)
    task.build(torch.device("cpu"))
    groups = task.optimizer().param_groups
    rates = {id(p): group["lr"] for group in groups for p in group["params"]}
    assert len(rates) == sum(p.requires_grad for p in task.model.parameters())
    for name, parameter in task.model.named_parameters():
        if parameter.requires_grad:
            share = 1 if name.startswith("frontend.") else 1 / 3
            assert rates[id(parameter)] == pytest.approx(share * task.config.train.learning_rate)
    alone = TrainingTask(read_training(TINY), data)
    alone.build(torch.device("cpu"))
    assert len(alone.optimizer().param_groups) == 1
