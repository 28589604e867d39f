"""The add-on for Blender as one file, which Blender loads without this package."""

import inspect
from pathlib import Path

from rig.retarget.blendshapes import shape_key
from rig.unreal.deitalk_clip import key_frames

ADDON = Path(__file__).with_name("blender_addon.py")
_IMPORTS = (
    "from rig.retarget.blendshapes import shape_key\n"
    "from rig.unreal.deitalk_clip import key_frames\n"
)


def addon_text() -> str:
    """Return the text of the add-on: its file with two functions in place of their imports."""
    own = "\n\n".join(inspect.getsource(function) for function in (shape_key, key_frames))
    return ADDON.read_text(encoding="utf-8").replace(_IMPORTS, f"import re\n\n\n{own}\n")
