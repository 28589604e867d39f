"""Building the page when the package is installed: with npm, without it, and without a network."""

import importlib.util
import os
import sys
from pathlib import Path
from types import ModuleType

import pytest

HOOK = Path(__file__).resolve().parents[3] / "deitalk/preview/web/hatch_build.py"
pytestmark = pytest.mark.skipif(os.name == "nt", reason="npm is a shell script here")


class Interface:
    """What hatchling gives a hook."""

    def __init__(self, root, target="wheel"):
        self.root, self.target_name, self.app, self.warnings = str(root), target, self, []

    def display_warning(self, text):
        self.warnings.append(text)


@pytest.fixture
def hook(monkeypatch):
    """The class of the hook; hatchling need not be installed."""
    for name in ("hatchling", "builders", "hooks", "plugin", "interface"):
        path = "hatchling.builders.hooks.plugin.interface".partition(name)
        module = ModuleType(path[0] + path[1])
        module.BuildHookInterface = Interface
        monkeypatch.setitem(sys.modules, path[0] + path[1], module)
    spec = importlib.util.spec_from_file_location("hatch_build", HOOK)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def source(tmp_path):
    web = tmp_path / "source/deitalk/preview/web"
    web.mkdir(parents=True)
    (web / "package.json").write_text("{}")
    return tmp_path / "source"


@pytest.fixture
def npm(tmp_path, monkeypatch):
    """Put an npm on the path that runs a script."""
    folder = tmp_path / "bin"
    folder.mkdir()
    monkeypatch.setenv("PATH", f"{folder}{os.pathsep}/bin{os.pathsep}/usr/bin")

    def written(script):
        (folder / "npm").write_text(f"#!/bin/sh\n{script}\n")
        (folder / "npm").chmod(0o755)

    return written


def test_page_is_built_and_added_to_the_wheel(hook, source, npm):
    npm('[ "$1" = install ] || { mkdir -p ../app; echo page > ../app/index.html; }')
    built, data = hook.PreviewPageHook(source), {"artifacts": [], "force_include": {}}
    assert built.dependencies() == []
    built.initialize("editable", data)
    assert data["artifacts"][0] == str(hook.PAGE) and not built.warnings
    beside = {Path(path).name for path in data["artifacts"][1:]}
    assert beside == {
        "engine.js", "ort.wasm.bundle.min.mjs", "ort-wasm-simd-threaded.wasm"
    }, "a site without a service"  # fmt: skip
    assert (source / hook.PAGE).read_text() == "page\n"
    npm("exit 1")
    built.initialize("standard", {"artifacts": [], "force_include": {}})
    assert not built.warnings, "a page that is there is not built again"


def test_without_npm_node_is_a_requirement_of_the_build(hook, source, monkeypatch):
    monkeypatch.setenv("PATH", str(source))
    assert hook.PreviewPageHook(source).dependencies() == [hook.NODE]
    assert hook.PreviewPageHook(source, "sdist").dependencies() == [hook.NODE]


@pytest.mark.parametrize("script", ["echo no network; exit 1", "exit 0"])
def test_package_is_installed_without_a_page_where_npm_fails(hook, source, npm, script):
    npm(script)
    built, data = hook.PreviewPageHook(source), {"artifacts": [], "force_include": {}}
    built.initialize("editable", data)
    assert data["artifacts"] == []
    assert not built.warnings or "no network" in built.warnings[0]
