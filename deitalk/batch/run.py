"""`animate_batch`: all lines of a manifest or a folder, in processes, begun again where they were.

::

    source -> lines -> references of actors -> orders -> workers -> files at their names
                                                                 -> journal -> tables
"""

import os
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from functools import partial
from pathlib import Path
from time import monotonic

from deitalk.batch.journal import Journal
from deitalk.batch.lines import Settings, check_settings, parse_formats
from deitalk.batch.orders import Batch, model_identity
from deitalk.batch.outputs import PRIVATE, Outputs
from deitalk.batch.performer import Performer
from deitalk.batch.processes import Workers
from deitalk.batch.progress import Progress
from deitalk.batch.report import BatchReport, Row, failed_text, summary_text
from deitalk.batch.source import FAILED, SUMMARY, read_source
from deitalk.errors import DeitalkError
from rig.errors import TargetError
from rig.files import begin_folder, claim, replace_recorded

KIND = "batch"
"""Kind of the output folder in its manifest."""


def animate_batch(
    source: str | Path,
    out: str | Path,
    *,
    emotion: str = "neutral",
    intensity: float = 1.0,
    actor: str = "",
    formats: str = "csv",
    fps: float | None = None,
    idle: bool = True,
    raw: bool = False,
    seed: int = 0,
    model: str | Path = "default",
    workers: int | None = None,
    force: bool = False,
    progress: Progress = lambda share, text: None,
) -> BatchReport:
    """Animate many recordings; a run that was ended goes on where it was.

    Outputs follow from the recording's bytes, its settings and the model: lines whose outputs are
    there already are left. Processes are spawned, so a script needs
    ``if __name__ == "__main__":``.

    Parameters
    ----------
    source : str or Path
        A manifest (`deitalk.batch.manifest`), or a folder of recordings, whose subfolders are
        kept.
    out : str or Path
        Folder of the results: new, empty, or one that was begun from the same source.
    emotion, intensity, actor, formats, fps, idle, raw, seed
        Of lines whose manifest does not give them; see `deitalk.batch.lines.Settings`. `formats`
        is a list such as ``"csv;take"``.
    model : str or Path
        Name or folder of a curve model.
    workers : int, optional
        Processes; one for each processor by default.
    force : bool
        Go on in a folder that was begun from another source.
    progress : callable
        Called with the share done, 0 to 1, and a text on rate and time left.

    Returns
    -------
    BatchReport
        Failed lines are in it, and in ``batch-failed.csv``; they are no error.

    Raises
    ------
    UserError
        If the source cannot be read, a default is wrong, the model cannot be loaded, or `out`
        must not or cannot be written.
    """
    began = monotonic()
    defaults = Settings(
        emotion, intensity, actor=actor, formats=parse_formats(formats), fps=fps, idle=idle,
        raw=raw, seed=seed,
    )  # fmt: skip
    check_settings(defaults)
    identity, source, out = model_identity(model), Path(source), Path(out)
    count = _processes(workers)
    plan = read_source(source, out, defaults)
    with _opened(out, source, force=force) as journal:
        outputs = Outputs(out, journal)
        outputs.begin()
        batch = Batch(plan.lines, journal, outputs, identity)
        with Workers(count, partial(Performer, str(model), str(outputs.stage))) as pool:
            batch.prepare(pool.run)
            batch.perform(pool.run, progress)
        _write_tables(out, batch.rows)
    failed = any(row.status == "failed" for row in batch.rows)
    table = out / FAILED if failed else None
    notes = (*_unused(plan.unused), *batch.notes)
    return BatchReport(batch.rows, out / SUMMARY, table, monotonic() - began, notes)


def _processes(workers: int | None) -> int:
    if workers is None:
        is_linux = hasattr(os, "sched_getaffinity")
        return len(os.sched_getaffinity(0)) if is_linux else os.cpu_count() or 1
    if workers < 1:
        raise DeitalkError(f"workers {workers} must be 1 or more")
    return workers


@contextmanager
def _opened(out: Path, source: Path, *, force: bool) -> Iterator[Journal]:
    """The journal of an output folder that no other process writes to."""
    with claim(out):
        begin_folder(out, kind=KIND)
        (out / PRIVATE).mkdir(exist_ok=True)
        with closing(Journal(out / PRIVATE / "journal.sqlite")) as journal:
            name, known = os.path.realpath(source), journal.about("source")
            if known not in (None, name) and not force:
                raise TargetError(
                    f"{out} was made from {known}, not from {name}; name another folder, or set "
                    "`force=True`",
                    parameter="force",
                )
            with journal.transaction():
                journal.describe("source", name)
            yield journal


def _write_tables(out: Path, rows: Sequence[Row]) -> None:
    failed = [row for row in rows if row.status == "failed"]
    replace_recorded(out, SUMMARY, summary_text(rows))
    if failed or (out / FAILED).is_file():
        replace_recorded(out, FAILED, failed_text(failed))


def _unused(columns: tuple[str, ...]) -> tuple[str, ...]:
    shown = ", ".join(columns[:5]) + (" …" if len(columns) > 5 else "")
    return (f"columns of the manifest that are not used: {shown}",) if columns else ()
