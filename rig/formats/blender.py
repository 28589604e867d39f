"""The add-on for Blender as one file, which Blender loads without this package."""

import inspect
from pathlib import Path

import numpy as np

from rig.conversion import shape_fit
from rig.conversion.avatars import bare_names, known_poses
from rig.conversion.raw import raw_controls
from rig.unreal.deitalk_clip import KEYS

ADDON = Path(__file__).with_name("blender_addon.py")
RAW = bare_names()
REST: list[float] = raw_controls().rest.tolist()
VISEMES = sorted(known_poses()[1])
POSES: dict[str, dict[int, float]] = {
    key: {int(i): round(float(pose[i]), 4) for i in np.flatnonzero(pose)}
    for key, pose in known_poses()[0].items()
}
"""Raw curves of shapes by key: the column in `RAW`, and the value at weight 1."""


def addon_text() -> str:
    """Return the text of the add-on: its file with the matcher and its table for their imports."""
    own = [_table(), *(inspect.getsource(part) for part in (shape_fit, *KEYS))]
    head, rest = ADDON.read_text(encoding="utf-8").split("from rig.", 1)
    return head + "\n\n".join(own) + "\n" + rest[rest.index("\nbl_info") :]


def _table() -> str:
    table = {"RAW": RAW, "REST": REST, "VISEMES": VISEMES, "POSES": POSES}
    return "\n".join(f"{name} = {value!r}" for name, value in table.items())
