"""The journal of a batch: what is refused is closed."""

import sqlite3

import pytest

from deitalk.batch.journal import Journal
from rig.errors import TargetError


def test_refused_journal_is_closed_at_once(tmp_path):
    """Not when its object is collected: the error that is kept here keeps it alive."""
    path = tmp_path / "journal.sqlite"
    journal = Journal(path, tmp_path)
    journal.describe("format", "99")
    journal.close()
    with pytest.raises(TargetError, match="another version") as caught:
        Journal(path, tmp_path)
    assert caught.value.__traceback__ is not None
    with sqlite3.connect(path, timeout=0) as other:
        other.execute("BEGIN EXCLUSIVE")
    other.close()
