import os
import sys

import pytest

from tests.each import each


def test_all_rows_run_and_all_failures_are_named():
    seen = []

    @each(("a", "b"), [(1, 1), (1, 2), (3, 3), (3, 4)])
    def check(a, b):
        seen.append((a, b))
        assert a == b

    with pytest.raises(ExceptionGroup, match="2 of 4 rows") as caught:
        check()
    assert len(seen) == 4
    assert [e.__notes__ for e in caught.value.exceptions] == [
        ["row 1: a=1, b=2"],
        ["row 3: a=3, b=4"],
    ]


@each("number", [0, 1])
def test_rows_have_fixtures_of_their_own(tmp_path, monkeypatch, capsys, number):
    assert not list(tmp_path.iterdir()) and "EACH" not in os.environ
    assert capsys.readouterr().out == ""
    (tmp_path / "a").touch()
    monkeypatch.setenv("EACH", "1")
    sys.stdout.write(str(number))


def test_a_test_is_skipped_if_all_rows_are():
    @each("why", ["a", "b"])
    def check(why):
        pytest.skip(why)

    with pytest.raises(pytest.skip.Exception):
        check()


def test_names_are_those_of_the_test():
    with pytest.raises(AssertionError, match="takes no"):
        each("absent", [1])(lambda: None)
