"""Reports of commands: printed, and written as Markdown or JSON."""

from pathlib import Path
from typing import Any

from deitalk.cli.console import emit
from deitalk.cli.targets import PICTURES, Inputs, reserve_file
from deitalk.errors import DataError, DeitalkError


def reserve_report(out: Path | None, picture: Path | None, *, force: bool) -> None:
    """Check the names of a report and of its picture.

    Raises
    ------
    DataError
        If the report is neither ``.md`` nor ``.json``.
    TargetError
        If a file is there and `force` is not set.
    """
    if out is not None:
        if out.suffix not in (".md", ".json"):
            raise DataError(f"{out}: a report is .md or .json")
        reserve_file(out, force=force)
    if picture is not None:
        reserve_picture(picture, force=force)


def reserve_picture(path: Path, *, force: bool, inputs: Inputs = ()) -> None:
    """Reserve a picture that matplotlib writes, as `deitalk.cli.targets.reserve_file` does."""
    if path.suffix.lower() not in PICTURES:
        raise DeitalkError(f"{path}: a picture is .png, .svg or .pdf")
    reserve_file(path, force=force, inputs=inputs)


def write_report(report: Any, markdown: str, out: Path | None, *, as_json: bool) -> None:
    """Print a report, and write it to `out`."""
    from deitalk.evaluation.report import as_json as to_json
    from rig.files import atomic_write

    emit(to_json(report) if as_json else markdown)
    if out is not None:
        with atomic_write(out) as beside:
            written = to_json(report) if out.suffix == ".json" else markdown
            beside.write_text(written, encoding="utf-8")
