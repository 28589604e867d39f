"""Rows of one fact as one test: all are run, and all failures are reported."""

import inspect
from collections.abc import Callable, Iterable
from copy import deepcopy
from functools import wraps
from typing import Any

import pytest
from numpy.random import Generator


def each(names: str | tuple[str, ...], rows: Iterable[Any]) -> Callable:
    """As `pytest.mark.parametrize`, in one item.

    Every row has what it would have in an item of its own: an empty `tmp_path`, a `monkeypatch`
    that is undone after it, a `capsys` that has read nothing, a generator of random numbers at its
    start. Other fixtures are shared.
    """
    words = [word.strip() for word in names.split(",")] if isinstance(names, str) else [*names]
    rows = list(rows)
    assert not any(hasattr(row, "marks") for row in rows), "marks belong to items: parametrize"
    table = [(row,) if len(words) == 1 else tuple(row) for row in rows]

    def decorate(test: Callable[..., None]) -> Callable[..., None]:
        signature = inspect.signature(test)

        @wraps(test)
        def run(**fixtures: Any) -> None:
            failures = [f for i, row in enumerate(table) if (f := _failure(i, row, fixtures))]
            if failures and len(failures) == len(table) and isinstance(failures[0], SKIPPED):
                raise failures[0]
            if wrong := [f for f in failures if not isinstance(f, SKIPPED)]:
                raise BaseExceptionGroup(f"{len(wrong)} of {len(table)} rows", wrong)

        def _failure(i: int, row: tuple[Any, ...], fixtures: dict[str, Any]) -> Any:
            own = {n: deepcopy(f) if isinstance(f, Generator) else f for n, f in fixtures.items()}
            if "tmp_path" in own:
                own["tmp_path"] = own["tmp_path"] / f"row{i}"
                own["tmp_path"].mkdir()
            if "capsys" in own:
                own["capsys"].readouterr()
            try:
                with pytest.MonkeyPatch.context() as patch:
                    if "monkeypatch" in own:
                        own["monkeypatch"] = patch
                    test(**own, **dict(zip(words, row, strict=True)))
            except (Exception, SKIPPED, pytest.fail.Exception) as error:
                error.add_note(
                    f"row {i}: " + ", ".join(f"{n}={v!r}" for n, v in zip(words, row, strict=True))
                )
                return error
            return None

        missing = {*words} - {*signature.parameters}
        assert not missing, f"{test.__name__} takes no {missing}"
        kept = [p for name, p in signature.parameters.items() if name not in words]
        run.__signature__ = signature.replace(parameters=kept)
        return run

    return decorate


SKIPPED = pytest.skip.Exception
