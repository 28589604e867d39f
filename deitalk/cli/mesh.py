"""Meshes: `deitalk animate --vertices`, and `deitalk retarget` of a take to your own face."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from deitalk.cli.console import bar, emit_outcome, sound_of
from deitalk.cli.targets import reserve_mesh
from deitalk.errors import DeitalkError

if TYPE_CHECKING:
    from deitalk.cli.acting_options import Given


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
        Name or number of an embedded head, or of a speaker of a mesh model; or a head file.
    **model
        ``model`` and ``device``.
    """
    from rig.face.identity import HEAD_FILE, identity_of

    own = Path(speaker) if speaker.lower().endswith(HEAD_FILE) else None
    reserve_mesh(out, force=force, inputs=(speech, mesh, landmarks, own, *given.texts))
    if landmarks is not None and mesh is None:
        raise DeitalkError("--landmarks are points of a --mesh; give both, or neither")
    # Refuse inputs that cannot be used before the recording is animated.
    if fps is not None:
        from rig.curves import snap_fps

        snap_fps(fps)
    if mesh is not None and mesh.suffix.lower() != ".glb":  # a GLB may be driven without this check
        from rig.retarget.landmarks import read_landmarks
        from rig.retarget.retarget_files import read_shapes

        shapes = read_shapes(mesh)
        if landmarks is not None:
            read_landmarks(landmarks, shapes.neutral)
    sound = sound_of(speech)
    who = int(speaker) if speaker.isdigit() else identity_of(speaker) if own else speaker
    with bar("animating") as progress:
        from deitalk.pipeline.mesh import animate_mesh, retarget_speech

        options: dict[str, Any] = {
            "acting": given.acting, "speaker": who, "fps": fps, "progress": progress, **model,
            **given.choice.settings,
        }  # fmt: skip
        if mesh is None:
            performance = animate_mesh(sound, **options)
            performance.save(out, force=force)
            frames, vertices, _ = performance.vertices.shape
            summary = {
                "frames": frames, "fps": performance.fps, "vertices": vertices,
                "notes": list(performance.recording.warnings),
            }  # fmt: skip
        else:
            report, rate, notes = retarget_speech(sound, mesh, out, landmarks=landmarks, **options)
            summary = {
                "frames": report.frames, "fps": rate, "shapes": report.shapes, "notes": list(notes)
            }  # fmt: skip
    summary |= {"model": model["model"], "settings": given.acting.settings}
    what = "shapes" if mesh is not None else "vertices"
    line = (
        f"{Path(out)}: {summary['frames']} frames at {summary['fps']:g} per second, "
        f"{summary[what]} {what}"
    )
    emit_outcome(line, {"out": str(Path(out)), **summary}, summary["notes"], as_json=as_json)
