"""Imports of each file: from lower floors or its own folder only, and none of research."""

import ast
import graphlib
import re
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
FLOORS = {
    "deitalk": """
        research
        cli
        agents preview training batch
        evaluation export
        data
        live
        pipeline
        acting
        acting_fields
        models
        frontends postprocess
        audio emotions
        config array_functions
        installed workers
        safe_path signals
        errors
    """,
    "rig": """
        validation livelink
        formats
        retarget
        conversion
        curves face
        mesh controls
        files
        errors
        limits arrays emotions written_number
    """,
    "api": """
        commands
        serving
        app
        routes
        live
        messages
        service
        jobs
        compute
        guard
        settings
        errors
    """,
}
"""Names of folders and modules, the highest floor first; `deitalk` may import all of `rig`, `api` of
both."""
PACKAGES = {"rig": {"rig"}, "deitalk": {"deitalk", "rig"}, "api": {"api", "deitalk", "rig"}}
HEAVY = {"torch", "transformers", "librosa", "fastapi", "soundfile", "accelerate", "safetensors"}
"""Packages that `rig` never imports."""
SERVICE = {
    "fastapi", "starlette", "uvicorn", "pydantic_settings", "multipart", "sqlalchemy",
    "prometheus_client", "fsspec", "httpx", "websockets",
}  # fmt: skip
"""Packages of the service: nothing below `api` imports them."""
CLOUD = (Path("deitalk/batch/cloud.py"), "fsspec")
"""The one file below the service that uses fsspec, which torch needs too."""
FILES = [
    path.relative_to(ROOT)
    for package in FLOORS
    for path in sorted((ROOT / package).rglob("*.py"))
    if not {"web", "tests"} & {*path.parts[len(ROOT.parts) :]}
]


def module_of(path: Path) -> str:
    parts = path.with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


@cache
def imports(path: Path) -> list[tuple[str, int]]:
    """Modules imported anywhere in a file, also within functions and for types, with their lines."""
    found: list[tuple[str, int]] = []
    for node in ast.walk(ast.parse((ROOT / path).read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found += [(alias.name, node.lineno) for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0 and node.module, f"{path}: a relative import hides its floor"
            for alias in node.names:
                inner = Path(*node.module.split("."), alias.name)
                is_module = inner.with_suffix(".py") in KNOWN or inner / "__init__.py" in KNOWN
                module = f"{node.module}.{alias.name}" if is_module else node.module
                found.append((module, node.lineno))
    return found


KNOWN = {*FILES}


def room(module: str) -> str:
    return [*module.split("."), "__init__"][1]


@pytest.mark.parametrize("package", FLOORS)
def test_files_import_from_lower_floors_only(package):
    lines = [line.split() for line in FLOORS[package].strip().splitlines()]
    level = {name: len(lines) - i for i, names in enumerate(lines) for name in names}
    rooms = {room(module_of(path)) for path in FILES if path.parts[0] == package}
    # The script in Unreal imports nothing of the package; modules in Python's words export names.
    assert rooms - {"unreal", "__init__", "__main__"} == set(level)
    own = level | {"__init__": 99, "__main__": 99, "unreal": 99}
    level |= {"__init__": 98 if package == "rig" else -1, "unreal": 0}
    forbidden = {*FLOORS} - PACKAGES[package]
    forbidden |= {"rig": HEAVY | SERVICE, "deitalk": SERVICE, "api": set()}[package]
    wrong = []
    for path in (path for path in FILES if path.parts[0] == package):
        here = room(module_of(path))
        for module, line in imports(path):
            top, there = module.split(".")[0], room(module)
            is_above = top == package and there != here and own[here] <= level[there]
            if is_above or (top in forbidden and (path, top) != CLOUD):
                wrong.append(f"{path}:{line} imports {module}")
    assert not wrong, "\n".join(wrong)


def test_modules_form_no_circle():
    graph = {module_of(path): {m for m, _ in imports(path)} - {module_of(path)} for path in FILES}
    graphlib.TopologicalSorter(graph).prepare()


def test_product_names_nothing_of_research():
    """A wheel lacks it."""
    product = [path for path in FILES if "research" not in path.parts]
    assert not [p for p in product if re.search(r"deitalk[./]research", (ROOT / p).read_text())]
