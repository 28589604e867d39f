"""`python -m deitalk.research lips`: dataset folders of measured lips."""

from pathlib import Path
from typing import Annotated

import typer

from deitalk.cli.console import bar, console, emit
from deitalk.cli.options import MAX_COUNT, Force
from deitalk.cli.targets import reserve_folder
from deitalk.errors import DeitalkError
from deitalk.research.cli.options import Most
from rig.errors import as_line


def lips(
    folder: Annotated[Path, typer.Argument(help="Measured lips (docs/dataset.md).")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Dataset folder.")],
    model: Annotated[
        str, typer.Option(help="Model whose curves are fitted to the measures.")
    ] = "default",
    listener: Annotated[
        str | None,
        typer.Option(help="Model whose speech features correct the corpus; by default MODEL."),
    ] = None,
    validation: Annotated[
        list[str] | None, typer.Option(help="Speaker of the validation split; repeatable.")
    ] = None,
    test: Annotated[
        list[str] | None, typer.Option(help="Speaker of the test split; repeatable.")
    ] = None,
    corpus: Annotated[
        list[Path] | None,
        typer.Option(help="Dataset folder whose clips are added, lips corrected; repeatable."),
    ] = None,
    corpus_clips: Annotated[
        int, typer.Option(min=1, max=MAX_COUNT, help="Clips of each corpus.")
    ] = 1000,
    as_rig: Annotated[
        bool,
        typer.Option("--as-rig", help="The measures are the curves, of the rig in OUT/rig.yaml."),
    ] = False,
    most: Most = None,
    force: Force = False,
) -> None:
    """Write a dataset folder of measured lips: curves fitted to them on the embedded head.

    The curves of the model are changed by the smallest amount with which opening, jaw, width, lips
    and corners of the head equal the measures. Other speakers are in the training split.

    Examples
    --------
    python -m deitalk.research lips grid_lips/ --validation s02 --test s03 -o lips_data/

    python -m deitalk.research lips grid_lips/ --corpus corpus/ -o lips_data/

    python -m deitalk.research lips grid_lips/ --as-rig --most 20 -o lips_rig/
    """
    corpora = tuple(corpus or ())
    reserve_folder(out, kind="dataset", force=force, inputs=(folder, *corpora))
    if as_rig:
        _write_measures(folder, out, corpora, validation, test, most, force)
        return
    with console().status("loading"):
        from deitalk.models.checkpoint import require_model
        from deitalk.models.curve_model import DEITalk
        from deitalk.research.lips.dataset import write_lip_dataset

        network = require_model(model, DEITalk)
        heard = None if listener is None else require_model(listener, DEITalk)
    with bar("fitting") as progress:
        count = write_lip_dataset(
            folder,
            out,
            network,
            listener=heard,
            validation=validation or (),
            test=test or (),
            most=most,
            corpora=corpora,
            corpus_clips=corpus_clips,
            force=force,
            progress=progress,
        )
    emit(as_line(f"{out}: {count} clips"))


def _write_measures(
    folder: Path,
    out: Path,
    corpora: tuple[Path, ...],
    validation: list[str] | None,
    test: list[str] | None,
    most: int | None,
    force: bool,
) -> None:
    """Write the measures as curves of a rig of their own."""
    if corpora:
        raise DeitalkError("--corpus: its curves are of the board; leave out --as-rig")
    from deitalk.research.lips.own_rig import write_measure_dataset

    with bar("writing") as progress:
        count = write_measure_dataset(
            folder,
            out,
            validation=validation or (),
            test=test or (),
            most=most,
            force=force,
            progress=progress,
        )
    emit(as_line(f"{out}: {count} clips; {out / 'rig.yaml'}: their controls"))
