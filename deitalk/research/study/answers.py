"""Answers of raters: files of the page, checked, and those that must be left out."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from deitalk.errors import DataError
from deitalk.research.study.design import CHECK, PRACTICE, TASKS
from rig.errors import quoted
from rig.files.reading import read_json

SCHEMA = "deitalk.answers/1"
KEY_BYTES = ANSWER_BYTES = 8_000_000
FASTEST_SECONDS = 1.0
"""Median time of a trial under which nobody can have looked at the clips."""


@dataclass(frozen=True)
class Choice:
    """What one rater chose of the systems side by side."""

    rater: str
    task: str
    item: str
    systems: tuple[str, ...]
    """From left to right."""
    chosen: str


@dataclass(frozen=True)
class Answers:
    """Choices that count, and who was left out."""

    choices: tuple[Choice, ...]
    raters: int
    excluded: dict[str, str]
    """Reason, by the name of the file."""


def read_key(path: Path) -> dict[str, Any]:
    """Read the key of a study.

    Raises
    ------
    DataError
        If it is no key.
    """
    key = read_json(path, KEY_BYTES, error=DataError)
    if not isinstance(key, dict) or key.get("schema") != "deitalk.study/1":
        raise DataError(f"{path} is no key of a study; name the key.json of `study build`")
    clips, systems = key.get("clips"), key.get("systems")
    if (
        not isinstance(clips, dict)
        or not isinstance(systems, list)
        or not all(
            isinstance(clip, dict) and {"item", "system"} <= set(clip) for clip in clips.values()
        )
    ):
        raise DataError(f"{path}: clips and systems are not as `study build` wrote them")
    return key


def read_answers(folder: Path, key: Mapping[str, Any], *, failed_checks: int = 0) -> Answers:
    """Read every ``.json`` of a folder.

    Left out are raters who failed more checks than allowed, who took less than `FASTEST_SECONDS` a
    trial, who answered nothing, and second files of one rater or one code.

    Parameters
    ----------
    folder : Path
        Files that the page saved or sent.
    key : mapping
        From `read_key`.
    failed_checks : int
        Wrong answers to checks that a rater may have.

    Raises
    ------
    DataError
        If there is no file, or one is not of this study.
    """
    paths = sorted(folder.glob("*.json")) if folder.is_dir() else []
    if not paths:
        raise DataError(f"{folder} has no .json of answers; put the raters' files into one folder")
    choices: list[Choice] = []
    excluded: dict[str, str] = {}
    seen: set[str] = set()
    raters = 0
    for path in paths:
        tree = _read(path, key)
        rows = tree["answers"]
        reason = _reason(rows, key, failed_checks) or _repeated(tree, seen)
        if reason:
            excluded[path.name] = reason
            continue
        raters += 1
        choices += [_choice(path, row, key) for row in rows if row["kind"] == "trial"]
    return Answers(tuple(choices), raters, excluded)


def _read(path: Path, key: Mapping[str, Any]) -> dict[str, Any]:
    """A file of answers whose rows are as the page writes them."""
    tree = read_json(path, ANSWER_BYTES, error=DataError)
    if not isinstance(tree, dict) or tree.get("schema") != SCHEMA:
        raise DataError(f"{path} holds no answers of a study page; take it out of the folder")
    if tree.get("study") != key.get("study"):
        raise DataError(f"{path} is of another study than the key; take it out of the folder")
    rows = tree.get("answers")
    if not isinstance(rows, list) or not all(_is_row(row, key["clips"]) for row in rows):
        raise DataError(f"{path}: answers are not as the page writes them")
    return tree


def _is_row(row: Any, clips: Mapping[str, Any]) -> bool:
    return (
        isinstance(row, dict)
        and row.get("kind") in ("trial", CHECK, PRACTICE)
        and row.get("task") in TASKS
        and isinstance(row.get("clips"), list)
        and 2 <= len(row["clips"]) <= 3
        and all(isinstance(name, str) and name in clips for name in row["clips"])
        and row.get("choice") in row["clips"]
        and isinstance(row.get("seconds"), int | float)
    )


def _reason(
    rows: Sequence[Mapping[str, Any]], key: Mapping[str, Any], failed_checks: int
) -> str | None:
    """Why a rater's answers do not count, or None."""
    trials = [row for row in rows if row["kind"] == "trial"]
    if not trials:
        return "no trial answered"
    wrong = sum(
        key["clips"][row["choice"]]["system"] is None for row in rows if row["kind"] == CHECK
    )
    if wrong > failed_checks:
        return f"{wrong} checks failed"
    seconds = sorted(row["seconds"] for row in trials)[len(trials) // 2]
    if seconds < FASTEST_SECONDS:
        return f"median of {seconds:.1f} s a trial"
    return None


def _repeated(tree: Mapping[str, Any], seen: set[str]) -> str | None:
    """Whether a rater or a code was counted before; both are noted as seen."""
    marks = {f"id {tree.get('id')}"} | ({f"code {tree['code']}"} if tree.get("code") else set())
    if marks & seen:
        return "second file of one rater"
    seen |= marks
    return None


def _choice(path: Path, row: Mapping[str, Any], key: Mapping[str, Any]) -> Choice:
    systems = tuple(key["clips"][name]["system"] for name in row["clips"])
    if None in systems:
        raise DataError(f"{path}: a trial of {quoted(row['item'])} shows the clip of a check")
    item = str(key["clips"][row["choice"]]["item"])
    return Choice(path.stem, row["task"], item, systems, key["clips"][row["choice"]]["system"])
