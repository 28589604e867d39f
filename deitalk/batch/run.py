"""`animate_batch`: all lines of a manifest or a folder, in processes, begun again where they were.

::

    source -> lines -> references of actors -> orders -> workers -> files at their names
                                                                 -> journal -> tables
"""

import os
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from functools import partial
from pathlib import Path
from time import monotonic
from typing import Any

from deitalk.acting import Acting, acted_as
from deitalk.batch.cloud import AnyOutputs, opened_cloud
from deitalk.batch.lines import Line, Written, parse_formats
from deitalk.batch.orders import Batch, model_identity
from deitalk.batch.outputs import opened_folder
from deitalk.batch.performer import Performer
from deitalk.batch.processes import Make, Pool, Workers
from deitalk.batch.report import FAILED, BatchReport, Progress, failed_text, summary_text
from deitalk.batch.source import FAILED as FAILED_TABLE
from deitalk.batch.source import SUMMARY, read_source
from deitalk.batch.storage import is_url
from deitalk.emotions import EmotionTrack
from deitalk.errors import DeitalkError
from deitalk.models.folder import check_device, require_device
from deitalk.models.load import Backend
from rig.errors import TargetError


def animate_batch(
    source: str | Path,
    out: str | Path,
    emotion: str | Path | Mapping[str, float] | EmotionTrack = "neutral",
    *,
    acting: Acting | None = None,
    actor: str = "",
    formats: str = "csv",
    fps: float | None = None,
    digits: int | None = None,
    timecode: str = "zero",
    model: str | Path = "default",
    backend: Backend = "torch",
    device: str = "cpu",
    workers: int | None = None,
    ray: str | None = None,
    force: bool = False,
    progress: Progress = lambda share, text: None,
    **fields: Any,
) -> BatchReport:
    """Animate many recordings; a run that was ended goes on where it was.

    Outputs follow from the recording's bytes, its settings and the model: lines whose outputs are
    there already are left. Processes are spawned, so a script needs
    ``if __name__ == "__main__":``.

    Parameters
    ----------
    source : str or Path
        A manifest (`deitalk.batch.source`), or a folder of recordings, whose subfolders are
        kept.
    out : str or Path
        Folder of the results: new, empty, or one that was begun from the same source.
    emotion, acting, fields
        As for `deitalk.animate`, of lines whose manifest does not give them.
    actor : str
        Who speaks, of lines whose manifest does not say: lines of one actor share a measured voice.
    formats : str
        A list such as ``"csv;take"``.
    fps, digits, timecode
        Of the written curves; see `deitalk.batch.lines.Written`.
    model : str or Path
        Name or folder of a curve model, or an ``.onnx`` file.
    backend : str
        ``torch``, or ``onnx`` for ONNX Runtime.
    device : str
        ``cpu``, ``cuda``, ``cuda:N`` or ``mps``: where the networks of all processes are.
    workers : int, optional
        Processes; by default one for each processor of this machine, or of the cluster.
    ray : str, optional
        Address of a Ray cluster whose machines do the work, or ``local`` (extra ``ray``). Paths
        must be URLs, or on a disk that all machines have.
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
    written = Written(parse_formats(formats), fps, digits, timecode).checked()
    defaults = Line(0, "", "", acted_as(emotion, acting, fields), written, actor)
    # Refuse a device that this machine lacks; those of a cluster are checked there.
    if device == "cpu" or ray is not None:
        check_device(device)
    else:
        require_device(device)
    identity, count = model_identity(model, backend), _processes(workers, ray)
    plan = read_source(source, out, defaults)
    with _opened(out, source, force=force) as outputs:
        outputs.begin()
        batch = Batch(plan.lines, outputs, identity)
        make = partial(Performer, str(model), outputs.stage, outputs.url, backend, device)
        with _pool(count, make, ray) as pool:
            batch.prepare(pool.run)
            batch.perform(pool.run, progress)
        failed = [row for row in batch.rows if row.status == FAILED]
        outputs.write_table(SUMMARY, summary_text(batch.rows))
        if failed or outputs.has_table(FAILED_TABLE):
            outputs.write_table(FAILED_TABLE, failed_text(failed))
    notes = (*plan.notes, *batch.notes)
    return BatchReport(batch.rows, str(out), monotonic() - began, notes)


def _processes(workers: int | None, ray: str | None) -> int | None:
    """Number of processes; None: as many as a cluster has processors."""
    if workers is not None:
        if workers < 1:
            raise DeitalkError(f"workers {workers} must be 1 or more")
        return workers
    if ray is not None:
        return None
    is_linux = hasattr(os, "sched_getaffinity")
    return len(os.sched_getaffinity(0)) if is_linux else os.cpu_count() or 1


def _pool(count: int | None, make: Make, ray: str | None) -> AbstractContextManager[Pool]:
    if ray is not None:
        from deitalk.batch.cluster import Cluster

        return Cluster(ray, count, make)
    return Workers(count or 1, make)


@contextmanager
def _opened(out: str | Path, source: str | Path, *, force: bool) -> Iterator[AnyOutputs]:
    """The output folder, if it was begun from this source."""
    opened = opened_cloud(str(out)) if is_url(out) else opened_folder(Path(out))
    with opened as outputs:
        name = str(source) if is_url(source) else os.path.realpath(source)
        known = outputs.journal.about("source")
        if known not in (None, name) and not force:
            raise TargetError(
                f"{out} was made from {known}, not from {name}; name another folder, or set "
                "`force=True`",
                parameter="force",
            )
        with outputs.journal.transaction():
            outputs.journal.describe("source", name)
        yield outputs
