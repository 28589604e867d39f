"""What all tests of the package share."""

import pytest


@pytest.fixture(scope="session", autouse=True)
def _opened_once(opened_once):
    """Graphs and the model of phones are opened once in a process."""


@pytest.fixture(scope="session")
def default():
    """The embedded model of whole recordings."""
    from deitalk.models.checkpoint import load_model

    return load_model("default")
