"""Write docs/api.md from the docstrings: ``make docs``.

Names and parameters are those of the source, so that the page is the same on every Python.
"""

import ast
import importlib
import inspect
import json
import re
import textwrap
from pathlib import Path
from typing import Any

PAGE = Path(__file__).with_name("api.md")
SCHEMA = Path(__file__).parents[1] / "deitalk/preview/web/src/data/acting.json"
"""Fields of an acting, from which the page is built."""
HEAD = """# Python API

Written by `make docs` from the docstrings. `help(deitalk.animate)` prints shapes, units, ranges and
errors of one of these names; both packages export type hints (`py.typed`).

```python
import numpy as np
from deitalk import animate, animate_mesh
from rig import read_curves

performance = animate("docs/samples/promise.flac", "happy", intensity=1.2)
performance.save("take/", force=True)  # or curves.csv, .json, .npz, face.glb
sound = np.random.default_rng(0).normal(0, 0.1, 16_000).astype(np.float32)
animate(sound, {"happy": 0.7}, sample_rate=16_000)
animate_mesh("docs/samples/promise.flac", "happy").save("face.glb", force=True)
print(read_curves("take/curves.csv").resample(24)[0].shape)  # (185,), the first frame
table = performance.curves.to_pandas()  # a row per frame, over seconds
```
"""
ERRORS = ("deitalk.errors", "rig.errors")
MOST = 10
"""Members of a class that the page names."""


def page() -> str:
    """Return the whole page."""
    parts = [HEAD]
    for name in ("deitalk", "rig"):
        package = importlib.import_module(name)
        rows = [_row(n, getattr(package, n)) for n in package.__all__ if n != "__version__"]
        parts.append("\n".join([f"## `{name}`", "", "| name | what it is |", "|---|---|", *rows]))
    parts.append(_options())
    parts.append("## Errors\n\n" + "\n\n".join(_errors(name) for name in ERRORS))
    return "\n\n".join(part.strip("\n") for part in parts) + "\n"


def acting_schema() -> str:
    """Fields of an acting as JSON schema."""
    from deitalk.acting import Acting

    return json.dumps(Acting.model_json_schema(), indent=1, ensure_ascii=False) + "\n"


def _options() -> str:
    """Fields of an acting, with their defaults as text."""
    fields = json.loads(acting_schema())["properties"]
    rows = [
        f"| `{n}` | `{json.dumps(f['default'])}` | {f['description']} |" for n, f in fields.items()
    ]
    text = "The fields of `Acting`, and keyword arguments of every function that takes `**fields`:"
    return "\n".join(["## Options", "", text, "", "| field | default | |", "|---|---|---|", *rows])


def _errors(module: str) -> str:
    doc = inspect.getdoc(importlib.import_module(module)) or ""
    tree = textwrap.dedent(doc.partition("::\n")[2]).strip("\n")
    return f"`{module}`:\n\n```\n{tree}\n```"


def _row(name: str, value: Any) -> str:
    """A name with its parameters or members, and the first line of its docstring."""
    if not callable(value):
        return f"| `{name}` | `{value!r}` |"
    text = re.sub(r"``([^`]*)``", r"`\1`", (inspect.getdoc(value) or "").split("\n")[0])
    if not inspect.isclass(value):
        return f"| `{signature(value)}` | {text} |"
    found = [f"`{member}`" for member in _members(value)]
    members = ", ".join(found[:MOST] + ["…"] * (len(found) > MOST))
    return f"| `{name}` | {text}{f' Members: {members}.' if members else ''} |"


def signature(function: Any) -> str:
    """A function with the names of its parameters."""
    node = ast.parse(textwrap.dedent(inspect.getsource(function))).body[0]
    assert isinstance(node, ast.FunctionDef)
    arguments = node.args
    for argument in (*arguments.args, *arguments.kwonlyargs, arguments.kwarg):
        if argument is not None:
            argument.annotation = None
    arguments.defaults, arguments.kw_defaults = [], [None] * len(arguments.kwonlyargs)
    return f"{node.name}({ast.unparse(arguments)})"


def _members(kind: type) -> list[str]:
    """Public methods, properties and fields of a class, in the order of the source."""
    shown = [*inspect.get_annotations(kind)] if not hasattr(kind, "model_fields") else []
    for name, value in vars(kind).items():
        is_member = isinstance(value, property | classmethod | staticmethod)
        if is_member or hasattr(value, "func") or inspect.isfunction(value):
            shown.append(name)
    return [name for name in dict.fromkeys(shown) if not name.startswith("_")]


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
    SCHEMA.write_text(acting_schema(), encoding="utf-8")
