"""The add-on for Blender as one file, which Blender loads without this package."""

import inspect
from pathlib import Path

from rig.retarget.blendshapes import shape_key

ADDON = Path(__file__).with_name("blender_addon.py")
_IMPORT = "from rig.retarget.blendshapes import shape_key\n"


def addon_text() -> str:
    """Return the text of the add-on: its file with the matcher of names in place of the import."""
    matcher = f"import re\n\n\n{inspect.getsource(shape_key)}\n"
    return ADDON.read_text(encoding="utf-8").replace(_IMPORT, matcher)
