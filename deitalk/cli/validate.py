"""`deitalk validate`: errors and warnings of importers for a file."""

from collections import Counter
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from deitalk.cli.acting_options import Given, acting_options
from deitalk.cli.console import emit, emit_json
from deitalk.errors import DeitalkError
from rig.errors import as_line


@partial(acting_options, fields=("words", "language"), of_recording=False)
def validate(
    path: Annotated[Path, typer.Argument(help="A file of curves, or a take folder.")],
    given: Given,
    strict: Annotated[bool, typer.Option("--strict", help="Exit code 1 on warnings too.")] = False,
    audio: Annotated[
        Path | None, typer.Option(help="Recording of a file of curves, for its words.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the findings as JSON.")] = False,
) -> None:
    """Check a file or a take by the rules of the importing programs; exit code 1 on errors.

    Cell counts, time codes, ranges, NaN, constant curves, jumps, open mouths at the end, and
    effects in Unreal. With the words of the recording: closures that the lips miss.

    Examples
    --------
    deitalk validate take/

    deitalk validate MySlate_1_iPhone.csv --json

    deitalk validate take/ --words "My promise is big."
    """
    from rig.validation.files import validate as check

    if given.acting.words is None and (given.acting.settings or audio is not None):
        raise DeitalkError("--audio and --language are of --words, which are not given; add them")
    validation = check(path)
    findings = list(validation.findings)
    if validation.ok and given.acting.words is not None:
        from deitalk.pipeline.words.closures import check_closures
        from deitalk.pipeline.words.transcript import Transcript

        words = Transcript.of(given.acting.words, given.acting.language)
        findings += check_closures(path, words, audio)
    is_warned = strict and any(finding.level == "warning" for finding in findings)
    is_valid = validation.ok and not is_warned
    if as_json:
        rows = [{"level": f.level, "path": str(f.path), "text": f.text} for f in findings]
        emit_json({"ok": validation.ok, "findings": rows}, indent=1)
    else:
        for finding in findings:
            emit(as_line(f"{finding.level:8} {finding.path.name or finding.path}: {finding.text}"))
        counts = Counter(finding.level for finding in findings)
        found = [f"{counts[level]} {level}{'s' * (counts[level] > 1)}"
                 for level in ("error", "warning") if counts[level]]  # fmt: skip
        verdict = "valid" if is_valid else "not valid"
        emit(as_line(f"{path}: {verdict}, {' and '.join(found) or 'no error or warning'}"))
    if not is_valid:
        raise typer.Exit(1)
