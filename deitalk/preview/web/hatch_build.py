"""Build the preview page into the wheel; without Node.js the wheel is built without the page."""

import shutil
import subprocess
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

PAGE = Path("deitalk/preview/app/index.html")


class PreviewPageHook(BuildHookInterface):  # type: ignore[type-arg]
    """Run ``npm install && npm run build`` beside this file unless the page exists."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Build the page if npm is installed, and add it to the wheel."""
        root = Path(self.root)
        web = root / "deitalk/preview/web"
        if version == "standard" and not (root / PAGE).is_file():
            self._build(web)
        if (root / PAGE).is_file():
            build_data["artifacts"].append(str(PAGE))

    def _build(self, web: Path) -> None:
        npm = shutil.which("npm")
        if npm is None or not (web / "package.json").is_file():
            self.app.display_warning(
                "no npm: the package is built without its preview page; "
                "`deitalk preview -o page.html` gives the steps to build it"
            )
            return
        for command in (["install", "--no-audit", "--no-fund"], ["run", "build"]):
            done = subprocess.run([npm, *command], cwd=web, capture_output=True, text=True)
            if done.returncode:
                lines = (done.stdout or done.stderr).strip().splitlines() or ["no message"]
                self.app.display_warning(f"npm {command[0]} failed ({lines[-1]}); no preview page")
                return
