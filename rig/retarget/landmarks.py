"""Named points of a face that two meshes share, and files of them.

Left and right are the subject's; left is +x.
"""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import KDTree

from rig.arrays import Float64, Int64
from rig.errors import FormatError, MeshError, quoted
from rig.files.reading import load_json, read_text
from rig.files.text_rows import rows_of_text
from rig.limits import COORDINATE, POINT_NAMES, POINTS_BYTES
from rig.mesh.trimesh import TriMesh

UPPER_RIM = ("upper_rim", "upper_rim_left", "upper_rim_right")
LOWER_RIM = ("lower_rim", "lower_rim_left", "lower_rim_right")
CORNERS = ("mouth_corner_left", "mouth_corner_right")

LANDMARKS = (
    "eye_outer_left", "eye_inner_left", "eye_upper_left", "eye_lower_left",
    "eye_outer_right", "eye_inner_right", "eye_upper_right", "eye_lower_right",
    "brow_left", "brow_right",
    "nose_bridge", "nose_tip", "nose_base", "nose_wing_left", "nose_wing_right",
    *CORNERS, "upper_lip_top", "lower_lip_bottom", *UPPER_RIM, *LOWER_RIM,
    "chin",
)  # fmt: skip
"""The 26 points. `upper_rim` and `lower_rim` are the middles of the edges where the lips meet,
their `_left` and `_right` half way to the corners; `upper_lip_top` and `lower_lip_bottom` the
middle of the red's outer edge; `brow_*` the middle of the brow; `nose_wing_*` where the wing of the
nose meets the upper lip's base."""

NEEDED = (
    *CORNERS,
    "upper_rim",
    "lower_rim",
    "nose_tip",
    "chin",
    "eye_outer_left",
    "eye_outer_right",
)
"""The eight that registration requires."""


def read_landmarks(path: Path | str, mesh: TriMesh) -> dict[str, int]:
    """Read the landmarks of a mesh from a file.

    JSON: ``{"nose_tip": 1225, "chin": [0.0, -9.8, 8.1]}``; CSV: ``name,vertex`` or ``name,x,y,z``
    with that header. A position means the nearest vertex.

    Returns
    -------
    landmarks : dict of str to int
        Vertex of each name.

    Raises
    ------
    FormatError
        If the file cannot be read.
    MeshError
        If a name or vertex is unknown, or a needed one of the points is missing.
    """
    path = Path(path)
    if path.suffix.lower() not in (".json", ".csv"):
        raise FormatError(f"{path.name}: landmarks come as .json or .csv")
    text = read_text(path, POINTS_BYTES)
    given = load_json(text, path.name) if path.suffix.lower() == ".json" else None
    try:
        wanted = (
            _from_csv(text, path.name) if given is None else {str(k): v for k, v in given.items()}
        )
    except (ValueError, KeyError, AttributeError, TypeError):
        raise FormatError(
            f'{path.name} is no landmark file; write {{"nose_tip": 12, ...}} as JSON, '
            "or CSV with the header name,vertex or name,x,y,z"
        ) from None
    check_names(wanted)
    landmarks = {name: _vertex(name, where, mesh) for name, where in wanted.items()}
    check_landmarks(landmarks, len(mesh.vertices))
    return landmarks


def _from_csv(text: str, where: str) -> dict[str, Any]:
    header, rows = rows_of_text(text, where, needed=("name",), most=POINT_NAMES, lower=True)
    if "vertex" in header:
        return {row["name"]: int(row["vertex"]) for row in rows}
    return {row["name"]: [float(row[axis].replace(",", ".")) for axis in "xyz"] for row in rows}


def _vertex(name: str, where: Any, mesh: TriMesh) -> int:
    if isinstance(where, int) and not isinstance(where, bool):
        return where
    try:
        point = np.array(where, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        point = np.zeros(0)
    if point.shape != (3,) or not (np.abs(point) <= COORDINATE).all():
        raise MeshError(
            f"landmark {quoted(name)} is {quoted(where)}; give a vertex number or [x, y, z], each "
            f"within ±{COORDINATE:g}"
        )
    used = np.unique(mesh.faces)
    return int(used[nearest(KDTree(mesh.vertices[used]), point)[1]])


def check_landmarks(landmarks: Mapping[str, int], count: int) -> None:
    """Raise MeshError unless names are known, vertices exist, and `NEEDED` are all there."""
    check_names(landmarks)
    missing = [name for name in NEEDED if name not in landmarks]
    if missing:
        raise MeshError(f"landmarks lack {', '.join(missing)}; at least {', '.join(NEEDED)}")
    for name, vertex in landmarks.items():
        if not 0 <= vertex < count:
            raise MeshError(f"landmark {name!r} is vertex {quoted(vertex)}; the mesh has {count}")


def check_names(names: Iterable[str]) -> None:
    """Raise MeshError unless all names are among `LANDMARKS`."""
    unknown = sorted(set(names) - set(LANDMARKS))
    if unknown:
        raise MeshError(f"unknown landmark {quoted(unknown[0])}; known: {', '.join(LANDMARKS)}")


def nearest(tree: KDTree, points: Float64) -> tuple[Float64, Int64]:
    """Distance of the nearest point of a tree to each of some, and its number."""
    distance, index = tree.query(points)
    return np.asarray(distance), np.asarray(index, dtype=np.int64)
