"""A base model of random weights and captures of seconds, for tests of tuning."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import torch

from deitalk.config.finetuning import FinetuneConfig
from deitalk.models.checkpoint import save_model
from deitalk.models.curve_model import DEITalk
from deitalk.models.rig_decoder import RigDecoder
from deitalk.research.config import read_training
from deitalk.training.trainer import Trainer
from deitalk.training.tuning.recipe import read_recipe
from rig import RigCurves, default_controls, read_curves, write_curves
from tests.dataset import JAW, write_dataset

CONTROLS = default_controls()


class Killed(Exception):
    pass


@contextmanager
def killed_at(step: int) -> Iterator[None]:
    """Trainings end when so many steps are taken."""
    update = Trainer.update

    def killed(trainer: Trainer[Any], *rest: Any) -> Any:
        if trainer.step == step:
            raise Killed
        return update(trainer, *rest)

    with pytest.MonkeyPatch.context() as patch, pytest.raises(Killed):
        patch.setattr(Trainer, "update", killed)
        yield


def small_decoder(**options: Any) -> RigDecoder:
    """A decoder of two controls for five emotions and two actors."""
    sizes: dict[str, Any] = {
        "in_size": 3, "style_size": 2, "guidance_size": 0, "channels": 4, "dilations": (1,),
        "kernel_size": 3, "n_emotions": 5, "n_actors": 2,
    }  # fmt: skip
    return RigDecoder(**sizes, rest=torch.zeros(2), **options)


TINY = Path(__file__).resolve().parents[3] / "configs" / "tiny.yaml"


def recipe(base: str, *overrides: str) -> FinetuneConfig:
    """Four steps on small windows, an evaluation before and after."""
    mine = ("train.steps=4", "train.evaluate_every=4", "train.batch_size=4", "train.workers=0")
    return read_recipe(None, (*mine, "data.window_frames=32", *overrides), base=base)


@pytest.fixture(scope="module")
def base(tmp_path_factory) -> str:
    """A network of random weights whose curves move."""
    folder = tmp_path_factory.mktemp("base") / "model"
    torch.manual_seed(0)
    config = read_training(TINY)
    model = DEITalk(config.model)
    with torch.no_grad():
        model.decoder.output.weight.normal_(std=0.05)
        model.decoder.style.weight.normal_(std=1.0)
    save_model(folder, model, config, {"steps": 0})
    return str(folder)


@pytest.fixture(scope="module")
def data(tmp_path_factory) -> Path:
    """Clips in all emotions but surprised, of which the jaw alone is known in the first two.

    Every control moves, for a dead channel counts as not captured.
    """
    folder = write_dataset(tmp_path_factory.mktemp("data"))
    for path in (folder / "curves").iterdir():
        curves = read_curves(path)
        wave = 0.02 * np.sin(np.arange(len(curves)) / 3)[:, None]
        inward = np.where(CONTROLS.rest > CONTROLS.minimum, -1, 1)
        values = curves.values + (wave + 0.02) * inward
        write_curves(path, RigCurves(values.astype(np.float32), curves.names, fps=curves.fps))
    (folder / "known.txt").write_text(f"{JAW}\n")
    table = pd.read_csv(folder / "clips.csv", dtype=str).assign(known="", speaker="anna")
    table.loc[:1, "known"] = "known.txt"
    table.to_csv(folder / "clips.csv", index=False)
    return folder


def relabelled(data: Path, folder: Path, **columns: Any) -> Path:
    """A copy of a dataset with other cells in these columns."""
    shutil.copytree(data, folder)
    table = pd.read_csv(folder / "clips.csv", dtype=str, keep_default_na=False)
    table.assign(**columns).to_csv(folder / "clips.csv", index=False)
    return folder


@pytest.fixture(autouse=True, scope="module")
def no_pictures(empty_pictures) -> None:
    """Pictures of runs are not what these tests are about."""
