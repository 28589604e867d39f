"""Errors that a user can cause: one line of bounded length, in the words of its rule."""

from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from rig.limits import MESSAGE_CHARACTERS


@contextmanager
def one_line(
    kind: type[Exception] | tuple[type[Exception], ...], *words: str, match: str | None = None
) -> Iterator[pytest.ExceptionInfo[Exception]]:
    """A block that must end with an error of a kind, which holds the words and fits the pattern."""
    with pytest.raises(kind, match=match) as caught:
        yield caught
    told = str(caught.value)
    assert "\n" not in told and len(told) <= MESSAGE_CHARACTERS, told
    for word in words:
        assert word in told, told
