"""Start script of the plugin: Unreal runs this file of ``Content/Python`` at its start."""

import deitalk_menu  # type: ignore[import-not-found]
import unreal  # type: ignore[import-not-found]

try:
    deitalk_menu.register_when_ready()
except Exception as error:
    unreal.log_error(f"deitalk: the menu was not added: {error}")
