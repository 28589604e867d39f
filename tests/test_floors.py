"""The floors of both packages: a file imports from lower floors or its own folder only."""

import ast
import functools
import re
from collections.abc import Iterator
from pathlib import Path

from tests.each import each

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
        models
        frontends postprocess
        audio emotions
        config array_functions
        installed workers
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
        limits arrays emotions
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
PUBLIC = ("__init__", "__main__")
"""Modules that export names; `deitalk.__version__` is imported from there."""


def floors(package: str) -> dict[str, int]:
    lines = [line.split() for line in FLOORS[package].strip().splitlines()]
    return {name: len(lines) - i for i, names in enumerate(lines) for name in names}


def files(package: str) -> list[Path]:
    return [p for p in sorted((ROOT / package).rglob("*.py")) if "web" not in p.parts]


@functools.cache
def tree_of(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


@functools.cache
def nodes(tree: ast.AST) -> tuple[ast.AST, ...]:
    return tuple(ast.walk(tree))


def module_of(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imports(tree: ast.AST) -> Iterator[tuple[str, int]]:
    """Modules imported anywhere in a tree, with their lines."""
    for node in nodes(tree):
        if isinstance(node, ast.Import):
            yield from ((alias.name, node.lineno) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            for alias in node.names:
                yield _submodule(node.module or "", alias.name), node.lineno


def _submodule(module: str, name: str) -> str:
    path = ROOT.joinpath(*module.split("."), name)
    return f"{module}.{name}" if path.with_suffix(".py").is_file() or path.is_dir() else module


def room(module: str) -> str:
    parts = module.split(".")
    return parts[1] if len(parts) > 1 else "__init__"


@each("package", FLOORS)
def test_every_folder_has_a_floor(package):
    rooms = {room(module_of(path)) for path in files(package)} - set(PUBLIC)
    assert rooms - {"unreal"} == set(
        floors(package)
    )  # the script in Unreal imports nothing of the package


@each("package", FLOORS)
def test_files_import_from_lower_floors_only(package):
    level = floors(package) | {"__init__": 99 if package == "rig" else -1, "unreal": 0}
    wrong = []
    for path in files(package):
        here = room(module_of(path))
        if here in (*PUBLIC, "unreal"):
            continue
        for module, line in imports(tree_of(path)):
            there = room(module)
            if module.split(".")[0] == package and there != here and level[there] >= level[here]:
                wrong.append(f"{path.relative_to(ROOT)}:{line} imports {module}")
    assert not wrong, "\n".join(wrong)


def test_modules_form_no_circle():
    """Circles of imports anywhere: at the load of a module, in functions, for types."""
    graph = {module_of(path): imported_by(path) for package in FLOORS for path in files(package)}
    assert not list(circles(graph))


def test_circles_are_found():
    graph = {"a": {"b"}, "b": {"c"}, "c": {"a", "d"}, "d": set(), "e": {"d"}}
    assert list(circles(graph)) == [("a", "b", "c", "a")]


def imported_by(path: Path) -> set[str]:
    """Modules that a file imports, also within functions and under `TYPE_CHECKING`."""
    return {module for module, _ in imports(tree_of(path))} - {module_of(path)}


def circles(graph: dict[str, set[str]]) -> Iterator[tuple[str, ...]]:
    """Paths that end where they begin, at least one of each set of modules that has any."""
    done: set[str] = set()

    def visit(module: str, above: tuple[str, ...]) -> Iterator[tuple[str, ...]]:
        if module in above:
            yield (*above[above.index(module) :], module)
        elif module not in done:
            for other in sorted(graph.get(module, ())):
                yield from visit(other, (*above, module))
            done.add(module)

    for module in graph:
        yield from visit(module, ())


def kinds_asked(tree: ast.AST) -> list[int]:
    """Lines of `isinstance` by a class of a configuration, a frontend or a model."""
    homes = ("deitalk.config", "deitalk.frontends", "deitalk.models")
    classes = {
        alias.asname or alias.name
        for node in nodes(tree)
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith(homes)
        for alias in node.names
        if alias.name != "TemporalConv"  # a layer
    }
    asked = [
        node
        for node in nodes(tree)
        if isinstance(node, ast.Call)
        and getattr(node.func, "id", "") in ("isinstance", "issubclass")
    ]
    return [
        call.lineno
        for call in asked
        if {name.id for name in ast.walk(call.args[1]) if isinstance(name, ast.Name)} & classes
    ]


def test_no_module_asks_for_the_class_of_a_model_or_its_configuration():
    """`kind`, `product` and methods decide; a new kind of model needs no change elsewhere."""
    wrong = [
        f"{path.relative_to(ROOT)}:{line}"
        for path in files("deitalk") + files("api")
        if "research" not in path.parts
        for line in kinds_asked(tree_of(path))
    ]
    assert not wrong, "\n".join(wrong)


def test_asking_for_a_kind_is_found():
    text = "from deitalk.models.curve_model import DEITalk\nisinstance(x, str | DEITalk)\n"
    assert kinds_asked(ast.parse(text)) == [2]


def test_array_types_have_one_home():
    """`rig.arrays` names them by their numbers; no module has a name of its own."""
    plain = re.compile(r"NDArray\[np\.(float32|float64|int32|int64|bool_)\]")
    wrong = [
        f"{path.relative_to(ROOT)}:{number}"
        for package in FLOORS
        for path in files(package)
        if path.relative_to(ROOT) != Path("rig/arrays.py") and "unreal" not in path.parts
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1)
        if plain.search(line)
    ]
    assert not wrong, "\n".join(wrong)
