"""What all tests of the package share."""

from pathlib import Path

import pytest


def write_small_model(folder: Path) -> None:
    """Write a small network of random weights."""
    import torch

    from deitalk.config.curves import Config
    from deitalk.models.checkpoint import save_model
    from deitalk.models.curve_model import DEITalk
    from tests.deitalk.pipeline.test_curves import SMALL

    torch.manual_seed(0)
    save_model(folder, DEITalk(SMALL), Config(name="small", model=SMALL), {"steps": 0})


@pytest.fixture(scope="session", autouse=True)
def _opened_once(opened_once):
    """Graphs and the model of phones are opened once in a process."""


@pytest.fixture(scope="session")
def model(tmp_path_factory):
    """The folder of a small network of random weights."""
    folder = tmp_path_factory.mktemp("model") / "small"
    write_small_model(folder)
    return str(folder)


@pytest.fixture(scope="session")
def default():
    """The embedded model of whole recordings."""
    from deitalk.models.checkpoint import load_model

    return load_model("default")
