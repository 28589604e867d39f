"""`deitalk retarget`: a take on your own face."""

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from deitalk.cli.console import console, emit_outcome
from deitalk.cli.options import Force, Json, MeshOut
from deitalk.cli.targets import curves_of, reserve_file, reserve_mesh, reserve_sound, write_sound
from deitalk.errors import DeitalkError


def retarget(
    take: Annotated[
        Path, typer.Argument(help="Take folder, or a file of curves (CSV, JSON, NPZ, Live Link).")
    ],
    mesh: Annotated[
        Path,
        typer.Option(
            help="Your face: GLB with morph targets, folder of OBJ shapes, NPZ; "
            "or one neutral OBJ, PLY or GLB."
        ),
    ],
    out: MeshOut,
    landmarks: Annotated[
        Path | None,
        typer.Option(help="JSON or CSV of points on a neutral mesh (guessed if not given)."),
    ] = None,
    mapping: Annotated[
        Path | None,
        typer.Option(help="CSV shape,control,value: controls of your own shape names."),
    ] = None,
    write_mapping: Annotated[
        Path | None,
        typer.Option(help="CSV to write: what each shape was taken for; edit it for --mapping."),
    ] = None,
    method: Annotated[
        str,
        typer.Option(help="Shapes for a neutral mesh by displacements or gradients (slower)."),
    ] = "displacements",
    keys: Annotated[
        float, typer.Option(min=0, max=0.1, help="Few keys in a GLB or FBX, this near: .01.")
    ] = 0.0,
    as_neutral: Annotated[
        bool, typer.Option("--as-neutral", help="Ignore the mesh's own shapes and make new ones.")
    ] = False,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Retarget a take to your own face: drive its blendshapes, or make new ones.

    A mesh with shapes of the names of ARKit, Live Link Face, ICT-FaceKit, MetaHuman or a common
    avatar (VRM, VRChat, Ready Player Me, Character Creator, Daz, MMD) is driven by name. A single
    neutral mesh of any topology, mouth closed and eyes open, gets the shapes of the embedded head,
    laid over it by landmarks. Curves of a rig of your own drive the shapes of their names.

    Examples
    --------
    deitalk retarget take/ --mesh my_arkit_face.glb -o out.glb

    deitalk retarget take/ --mesh scan.obj --landmarks scan.json -o out.glb
    """
    from rig.formats import read_known_or_own
    from rig.retarget.mapping_files import write_mapping as save
    from rig.retarget.retarget_files import retarget_curves

    if method not in ("displacements", "gradients"):
        raise DeitalkError(f"--method {method!r} is unknown; use displacements or gradients")
    reserve_mesh(out, force=force, inputs=(curves_of(take), mesh, landmarks, mapping), fbx=True)
    audio = take / "audio.wav"
    sound = reserve_sound(Path(out), force=force, inputs=(audio,)) if audio.is_file() else None
    if write_mapping is not None:
        reserve_file(write_mapping, force=force, inputs=(curves_of(take), mesh, mapping))
    curves = read_known_or_own(curves_of(take))
    with console().status("retargeting"):
        report = retarget_curves(
            curves,
            mesh,
            out,
            landmarks=landmarks,
            mapping=mapping,
            method="gradients" if method == "gradients" else "displacements",
            as_neutral=as_neutral,
            keys=keys,
        )
    if write_mapping is not None:
        save(write_mapping, report.mapping)
    kind = "own shapes" if report.way == "blendshapes" else "shapes made for the mesh"
    bones = f", {report.bones} bones" if report.bones else ""
    line = f"{report.path}: {report.frames} frames, {report.shapes} {kind}{bones}"
    summary = asdict(report) | {"path": str(report.path)}
    emit_outcome(line, summary, report.notes, as_json=as_json)
    if sound is not None:
        write_sound(sound, audio)
