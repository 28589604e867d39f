"""Meshes: `deitalk animate --vertices`, and `deitalk retarget` of a take to your own face."""

import sys
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from deitalk.cli.console import (
    bar,
    console,
    curves_of,
    emit_json,
    reserve_file,
    reserve_mesh,
    reserve_sound,
    write_sound,
)
from deitalk.cli.options import Force, Json, MeshOut
from deitalk.errors import DeitalkError

if TYPE_CHECKING:
    from deitalk.cli.options import Given
    from deitalk.pipeline.performance import MeshPerformance
    from rig.retarget.retarget_files import RetargetReport


def animate_vertices(
    speech: str,
    out: str,
    given: "Given",
    *,
    mesh: Path | None,
    landmarks: Path | None,
    speaker: str,
    fps: float | None,
    force: bool,
    as_json: bool,
    **model: str,
) -> None:
    """Animate a mesh from a recording, vertex by vertex, for `deitalk animate --vertices`.

    Parameters
    ----------
    speech, out, given, mesh, landmarks, fps, force, as_json
        As for the command.
    speaker : str
        Name or number: of an embedded head, or of a speaker of an SDFA model.
    **model
        ``model`` and ``device``.
    """
    reserve_mesh(out, force=force, inputs=(speech, mesh, landmarks, *given.texts))
    if landmarks is not None and mesh is None:
        raise DeitalkError("--landmarks are points of a --mesh; give both, or neither")
    _check(fps, mesh, landmarks)
    sound = sys.stdin.buffer.read() if speech == "-" else speech
    who = int(speaker) if speaker.isdigit() else speaker
    with bar("animating") as progress:
        from deitalk.pipeline.mesh import animate_mesh, retarget_speech

        options: dict[str, Any] = {
            "acting": given.acting, "speaker": who, "fps": fps, "progress": progress, **model,
            **given.choice.settings,
        }  # fmt: skip
        if mesh is None:
            performance = animate_mesh(sound, **options)
            performance.save(out, force=force)
            summary = _described(performance)
        else:
            report, rate, notes = retarget_speech(sound, mesh, out, landmarks=landmarks, **options)
            summary = {
                "frames": report.frames, "fps": rate, "shapes": report.shapes, "notes": list(notes)
            }  # fmt: skip
    summary |= {"model": model["model"], "settings": given.acting.settings}
    _report(out, summary, as_json)


def _check(fps: float | None, mesh: Path | None, landmarks: Path | None) -> None:
    """Raise for inputs that cannot be used, before the recording is animated."""
    from rig.curves import snap_fps

    if fps is not None:
        snap_fps(fps)
    if mesh is not None and mesh.suffix.lower() != ".glb":  # a GLB may be driven without this check
        from rig.retarget.landmarks import read_landmarks
        from rig.retarget.retarget_files import read_shapes

        shapes = read_shapes(mesh)
        if landmarks is not None:
            read_landmarks(landmarks, shapes.neutral)


def _described(performance: "MeshPerformance") -> dict[str, Any]:
    frames, vertices, _ = performance.vertices.shape
    notes = list(performance.recording.warnings)
    return {"frames": frames, "fps": performance.fps, "vertices": vertices, "notes": notes}


def _report(out: str, summary: dict[str, Any], as_json: bool) -> None:
    if as_json:
        emit_json({"out": str(Path(out)), **summary})
        return
    for note in summary["notes"]:
        console().note(note)
    what = "vertices" if "vertices" in summary else "shapes"
    console().print(
        f"{Path(out)}: {summary['frames']} frames at {summary['fps']:g} per second, "
        f"{summary[what]} {what}",
    )


# `deitalk retarget`: a take on your own face.


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
    from rig.retarget.retarget_files import retarget_curves
    from rig.retarget.retarget_files import write_mapping as save

    if method not in ("displacements", "gradients"):
        raise DeitalkError(f"--method {method!r} is unknown; use displacements or gradients")
    reserve_mesh(out, force=force, inputs=(curves_of(take), mesh, landmarks, mapping), fbx=True)
    sound = reserve_sound(Path(out), take / "audio.wav", force=force)
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
    _retarget_report(report, as_json)
    if sound is not None:
        write_sound(sound, take / "audio.wav")


def _retarget_report(report: "RetargetReport", as_json: bool) -> None:
    """Print the result and its warnings."""
    if as_json:
        emit_json(asdict(report) | {"path": str(report.path)})
        return
    kind = "own shapes" if report.way == "blendshapes" else "shapes made for the mesh"
    bones = f", {report.bones} bones" if report.bones else ""
    for note in report.notes:
        console().note(note)
    console().print(f"{report.path}: {report.frames} frames, {report.shapes} {kind}{bones}")
