"""GLB (glTF 2.0 binary): our head with morph targets and their animation; FBX of it, by Blender.

Curves of the board move shapes of its controls, ARKit's curves the 52 shapes of `arkit_head`.
Opens in Blender, three.js, Windows' viewer and Unreal. For a face of your own, see
``deitalk retarget``, whose files `read` reads too.
"""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np

from rig.arrays import Float32, Float64
from rig.controls import ControlSet, default_controls
from rig.conversion.arkit import ARKIT_ID
from rig.conversion.convert import curves_of_shapes
from rig.curves import RigCurves, check_clip
from rig.curves.edit import hermite
from rig.errors import FormatError
from rig.face.head_pose import matrices, quaternions
from rig.face.identity import Identity
from rig.mesh.fbx import blender, fbx_to_glb, glb_to_fbx
from rig.mesh.glb import RigidMotion, WeightAnimation, read_container, write_glb
from rig.mesh.glb_reader import consistent, morphing_nodes, read_accessor
from rig.retarget.bake import control_halves
from rig.retarget.morph_head import METRES_PER_CM, baked_picture, morph_head, textured

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

LEAST_JAW = 1e-3
"""Opening below which lips together move nothing, and come back as less."""


def write(path: Path, curves: RigCurves, identity: int | str | Identity = 0) -> None:
    """Write one mesh in metres, y up, facing +z, and one animation of its weights and its node.

    ARKit's curves become weights of shapes with Apple's names, and of four correctives.

    The head track turns and shifts the whole mesh about the joint of skull and spine.
    `identity` is a head as of `rig.face.build_head`.
    """
    from rig.face import build_head

    head = build_head(identity)
    if curves.control_set == ARKIT_ID:
        from rig.retarget.head_glb import arkit_weights, write_head

        weights = WeightAnimation(arkit_weights(curves), curves.fps, motion=_motion(curves))
        write_head(path, head, animation=weights)
        return
    head.mesh  # noqa: B018, both threads use it
    with ThreadPoolExecutor(1) as pool:  # pictures leave other threads alone
        look = pool.submit(textured, head)
        rig = morph_head(identity)
        colours, surface = look.result()
    animation = WeightAnimation(rig.weights(curves), curves.fps, motion=_motion(curves))
    write_glb(
        path, rig.shapes, animation=animation, colours=colours, surface=surface,
        metres=METRES_PER_CM,
    )  # fmt: skip


def _motion(curves: RigCurves) -> RigidMotion | None:
    if curves.head is None:
        return None
    _, translation = matrices(curves.head)
    return RigidMotion(quaternions(curves.head), translation * METRES_PER_CM)


def read(path: Path, controls: ControlSet | None, fps: float | None) -> RigCurves:
    """Read the last animation of shapes, of our head or of any file with known names of shapes.

    Lips together come back from their correctives, the least of two rows times an open jaw. The
    head track is the turn and shift of our head's node, or the turn of the bones of neck and head.

    Parameters
    ----------
    path : Path
        The GLB.
    controls : ControlSet, optional
        Of a user's own shapes, by name.
    fps : float, optional
        By default the rate of the densest keys.

    Raises
    ------
    FormatError
        If it has no animated shapes, or they are of no known set.
    """
    from scipy.spatial.transform import Rotation

    document, binary = read_container(path)
    with consistent(path):
        shapes = dict(morphing_nodes(document))
        moved = tracks_of(document, binary, -1)
        driven = {node: moved[node, "weights"] for node in shapes if (node, "weights") in moved}
        if not driven:
            raise FormatError(f"{path.name} has no animated shapes")
        names = list(dict.fromkeys(name for node in driven for name in shapes[node]))
        rate, at = grid_of(moved, fps, len(names))
        weights = np.zeros((len(at), len(names)), np.float32)
        for node, track in driven.items():
            weights[:, [names.index(name) for name in shapes[node]]] = sampled(track, at)
        turns = {n: Rotation.from_quat(sampled(t, at)) for (n, p), t in moved.items()
                 if p == "rotation"}  # fmt: skip
        head = _head(document, turns, moved, at)
    return replace(_curves_of(names, weights, rate, controls, path), head=head)


Track = tuple[Float64, Float64, str]
"""Times (K,) in seconds, rows (K, columns) or (K, 3, columns), interpolation."""
Tracks = dict[tuple[int, str], Track]
"""By node and part."""


def tracks_of(document: dict[str, Any], binary: bytes, place: int) -> Tracks:
    """Return what the first (0) or the last (-1) animation of a GLB moves."""
    moved: Tracks = {}
    animation = document.get("animations", [])[place:][:1]
    for channel in animation[0]["channels"] if animation else ():
        sampler = animation[0]["samplers"][channel["sampler"]]
        times, rows = (
            np.atleast_1d(read_accessor(document, binary, sampler[part]))
            for part in ("input", "output")
        )
        way = sampler.get("interpolation", "LINEAR")
        if times.ndim != 1 or not len(times) or not np.isfinite(times).all():
            raise FormatError("times of keys must be finite numbers")
        if (np.diff(times) <= 0).any() or not np.isfinite(rows).all():
            raise FormatError("times of keys must rise, and their values be finite")
        keys = (len(times), 3) if way == "CUBICSPLINE" else (len(times),)
        target = channel["target"]
        moved[target["node"], target["path"]] = times, rows.reshape(*keys, -1), way
    return moved


def grid_of(moved: Tracks, fps: float | None, n_curves: int) -> tuple[float, Float64]:
    """Return a rate, by default that of the densest keys, and the times (T,) of its frames."""
    tracks = [track for (_, part), track in moved.items() if part != "scale"]
    steps = [float(np.diff(times).min()) for times, *_ in tracks if len(times) > 1]
    rate = 1 / min(steps, default=1.0)
    # Whole, or a 1.001th of it, where that is as near as the times are exact.
    near = [n for n in (round(rate), round(rate * 1.001) / 1.001) if abs(n / rate - 1) < 2e-4]
    rate = fps or float(min(near, key=lambda n: abs(n / rate - 1), default=rate))
    n_frames = round(max(float(times[-1]) for times, *_ in tracks) * rate) + 1
    check_clip(n_frames, n_curves)
    return rate, np.arange(n_frames) / rate


def sampled(track: Track, at: Float64) -> Float64:
    """Rows at times, seconds [shape=(T, columns)]."""
    times, rows, way = track
    if way == "CUBICSPLINE":
        return hermite(times, rows[:, 1], rows[:, 0], rows[:, 2], at)
    if way == "STEP":
        return np.asarray(rows[np.clip(np.searchsorted(times, at + 1e-6) - 1, 0, None)])
    return np.stack([np.interp(at, times, column) for column in rows.T], axis=1)


def _curves_of(
    names: list[str], weights: Float32, rate: float, controls: ControlSet | None, path: Path
) -> RigCurves:
    """Return the curves of shapes: of the board, with our correctives, or of another set."""
    board = default_controls()
    halves = [(n, d) for n, d in control_halves(board) if n in names]
    if controls is None and len(halves) > len(names) / 2:
        values = np.tile(board.rest, (len(weights), 1)).astype(np.float32)
        for name, driver in halves:
            half = driver.groups[0][0]
            i, column = board.index(half.control), weights[:, names.index(name)]
            end = board.maximum[i] if half.sign > 0 else board.minimum[i]
            values[:, i] += (end - board.rest[i]) * column.clip(0, 1)
        jaw = values[:, board.index("CTRL_C_jaw.ty")]
        for side in [side for side in "LR" if f"seal_{side}" in names]:
            together = weights[:, names.index(f"seal_{side}")] / np.maximum(jaw, LEAST_JAW)
            for row in "UD":
                lip = board.index(f"CTRL_{side}_mouth_lipsTogether{row}.ty")
                values[:, lip] = together.clip(0, 1)
        return RigCurves(values, board.names, rate)
    return curves_of_shapes(names, weights.clip(0, 1), rate, str(path), controls)


def _head(
    document: dict[str, Any], turns: "dict[int, Rotation]", moved: Tracks, at: Float64
) -> Float32 | None:
    """Head track of a mesh's node, or of bones; None if neither turns."""
    from rig.retarget.bones import head_track, turn_of_bones

    for node, turn in turns.items():
        if "mesh" in document["nodes"][node] and "skin" not in document["nodes"][node]:
            place = moved.get((node, "translation"))
            shift = None if place is None else sampled(place, at) / METRES_PER_CM
            if (track := head_track(turn, shift)) is not None:
                return track
    found = turn_of_bones(document, turns)
    return None if found is None else head_track(found)


def write_fbx(path: Path, curves: RigCurves, identity: int | str | Identity = 0) -> None:
    """Write the head as FBX (extra fbx): one key a frame, and one picture for colours."""
    from rig.face import build_head

    blender()
    with TemporaryDirectory(prefix="deitalk-") as folder:
        between = Path(folder) / "take.glb"
        write(between, curves, identity)
        glb_to_fbx(between, path, curves.fps, paint=baked_picture(build_head(identity)))


def read_fbx(path: Path, controls: ControlSet | None, fps: float | None) -> RigCurves:
    """Read the shapes and bones of an FBX; errors are those of `read`."""
    with TemporaryDirectory(prefix="deitalk-") as folder:
        between = Path(folder) / path.with_suffix(".glb").name
        fbx_to_glb(path, between)
        return read(between, controls, fps)
