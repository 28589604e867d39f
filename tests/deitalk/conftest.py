"""What all tests of the package share."""

import pytest


@pytest.fixture(scope="session", autouse=True)
def _opened_once(opened_once):
    """Graphs and the model of phones are opened once in a process."""
