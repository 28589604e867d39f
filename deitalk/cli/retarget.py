"""`deitalk retarget`: a take on your own face."""

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from deitalk.errors import DeitalkError


def retarget(
    take: Annotated[
        Path, typer.Argument(help="Take folder, or a curve file (CSV, JSON, NPZ, Live Link CSV).")
    ],
    mesh: Annotated[
        Path,
        typer.Option(
            help="Your face: GLB with morph targets, folder of OBJ shapes, NPZ; "
            "or one neutral OBJ, PLY or GLB."
        ),
    ],
    out: Annotated[
        Path,
        typer.Option("--out", "-o", help=".glb, .npz (vertices) or a folder for .ply files."),
    ],
    landmarks: Annotated[
        Path | None,
        typer.Option(
            help="JSON or CSV: where the landmarks of a neutral mesh are; found by themselves if not given."
        ),
    ] = None,
    mapping: Annotated[
        Path | None,
        typer.Option(help="CSV shape,control,value: what your own shape names stand for."),
    ] = None,
    method: Annotated[
        str,
        typer.Option(help="Shapes for a neutral mesh by displacements or gradients (slower)."),
    ] = "displacements",
    as_neutral: Annotated[
        bool, typer.Option("--as-neutral", help="Ignore the mesh's own shapes and make new ones.")
    ] = False,
    force: Annotated[
        bool, typer.Option("--force", help="Replace the output if it exists.")
    ] = False,
) -> None:
    """Put a take on your own face: drive its blendshapes, or make it some.

    A mesh with shapes named as ARKit, Live Link Face, ICT-FaceKit or MetaHuman name them is driven
    by name. A single neutral mesh of any topology gets the shapes of the embedded head, laid over
    it by landmarks: nose_tip, chin, the corners of mouth and eyes, the rims of both lips ...

    Examples
    --------
    deitalk retarget take/ --mesh my_arkit_face.glb -o out.glb

    deitalk retarget take/ --mesh scan.obj --landmarks scan.json -o out.glb
    """
    from rig import read_curves
    from rig.mesh.apply import retarget_curves

    if method not in ("displacements", "gradients"):
        raise DeitalkError(f"method {method!r} is unknown; use displacements or gradients")
    if out.exists() and not force:
        raise DeitalkError(f"{out} exists; choose another name or give --force")
    source = take / "curves.csv" if take.is_dir() else take
    if not source.is_file():
        raise DeitalkError(f"{source} is not a file; give a take folder or a curve file")
    words = Console(stderr=True)
    with words.status("retargeting"):
        report = retarget_curves(
            read_curves(source),
            mesh,
            out,
            landmarks=landmarks,
            mapping=mapping,
            method="gradients" if method == "gradients" else "displacements",
            as_neutral=as_neutral,
        )
    lost = "" if report.lost is None else f", {report.lost:.0%} of the movement has no shape"
    kind = "own shapes" if report.way == "blendshapes" else "shapes made for the mesh"
    said = f"{report.path}: {report.frames} frames, {report.shapes} {kind}{lost}"
    words.print(said, soft_wrap=True, markup=False, highlight=False)
    for note in report.notes:
        words.print(f"note: {note}", style="yellow", soft_wrap=True, markup=False)
