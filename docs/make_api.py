"""Write docs/api.md from the docstrings: ``make docs``.

Signatures are those of the source, so that the page is the same on every Python and NumPy.
"""

import ast
import importlib
import inspect
import json
import re
import textwrap
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

PAGE = Path(__file__).with_name("api.md")
HEAD = """# Python API

Written by `make docs` from the docstrings; change those instead. Letters in shapes: T frames,
C controls or channels, V vertices, S samples, K keys.

`Audio` is a path, bytes, a binary file, a `Recording`, an array or a tensor; `Samples` an array or
a tensor; `SAMPLE_RATE` 16,000 Hz; `MAX_SECONDS` 10,800 s.

Every error that a caller can correct is a `rig.errors.UserError` (a `ValueError`) with a
message of one line: the value, the rule and the way out. `parameter` names the one to set.
"""
PACKAGES = (("deitalk", "deitalk"), ("rig", "rig"))
ERRORS = ("deitalk.errors", "rig.errors")
SECTIONS = ("Parameters", "Attributes", "Returns", "Yields", "Raises", "Notes")


def page() -> str:
    """Return the whole page."""
    parts = [HEAD]
    for name, title in PACKAGES:
        package = importlib.import_module(name)
        parts.append(f"## `{title}`\n\n{_paragraphs(_first_part(package.__doc__))}")
        parts += [_entry(n, getattr(package, n)) for n in package.__all__ if n != "__version__"]
    parts.append("## Errors\n\n" + "\n\n".join(_errors(name) for name in ERRORS))
    return "\n\n".join(part.strip("\n") for part in parts) + "\n"


def _errors(module: str) -> str:
    doc = inspect.getdoc(importlib.import_module(module)) or ""
    tree = textwrap.dedent(doc.partition("::\n")[2]).strip("\n")
    return f"`{module}`:\n\n```\n{tree}\n```"


def _fields(value: type) -> str:
    """Described fields of a model, with their defaults as text."""
    if not hasattr(value, "model_json_schema"):
        return ""
    shown = value.model_json_schema()["properties"]
    rows = (f"- `{n}` ({json.dumps(f['default'])}): {f['description']}" for n, f in shown.items())
    return "**Fields**\n\n" + "\n".join(rows)


def _entry(name: str, value: Any) -> str:
    """A heading, the signature and the docstring of a function, class or constant."""
    if inspect.isclass(value):
        fields = _fields(value)
        signature = f"{name}(**fields)" if fields else _class_signature(value)
        parts = [f"### `{name}`", _code(signature), _docstring(value), fields]
        parts += [_member(name, *member) for member in _members(value)]
        return "\n\n".join(filter(None, parts))
    if callable(value):
        signature = _code(_signature(value, name))
        return f"### `{name}`\n\n{signature}\n\n{_docstring(value)}"
    return f"### `{name}`\n\n{_code(f'{name} = {value!r}')}"


def _members(kind: type) -> Iterator[tuple[str, Any]]:
    """Public methods and properties in the order of the source."""
    for name, value in vars(kind).items():
        is_shown = isinstance(value, property | classmethod | staticmethod) or hasattr(
            value, "func"
        )
        if not name.startswith("_") and (is_shown or inspect.isfunction(value)):
            yield name, value


def _member(owner: str, name: str, value: Any) -> str:
    """One method or property: its signature, and its docstring indented as a list item."""
    function = getattr(value, "fget", None) or getattr(value, "func", None)
    if function is not None:
        line = f"`{owner}.{name}`"
    else:
        function = getattr(value, "__func__", value)
        line = f"`{owner}.{_signature(function, name, is_method=True)}`"
    text = textwrap.indent(_docstring(function), "  ")
    return f"- {' '.join(line.split())}\n\n{text}"


def _node(value: Any) -> Any:
    return ast.parse(textwrap.dedent(inspect.getsource(value))).body[0]


def _signature(function: Callable[..., Any], name: str, *, is_method: bool = False) -> str:
    node = _node(function)
    arguments = node.args
    if is_method:
        arguments.args = arguments.args[1:]
    for argument in (*arguments.args, *arguments.kwonlyargs):
        argument.annotation = _plain(argument.annotation)
    arguments.kw_defaults = [_default(value) for value in arguments.kw_defaults]
    result = f" -> {ast.unparse(_plain(node.returns))}" if node.returns else ""
    return f"{name}({ast.unparse(arguments)}){result}"


def _class_signature(kind: type) -> str:
    """The fields of a dataclass as its constructor takes them."""
    fields = []
    for node in _node(kind).body:
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            default = "" if node.value is None else f" = {ast.unparse(_default(node.value))}"
            fields.append(f"{node.target.id}: {ast.unparse(_plain(node.annotation))}{default}")
    return f"{kind.__name__}({', '.join(fields)})" if fields else ""


def _plain(annotation: Any) -> Any:
    """An annotation without the quotes of a forward reference."""
    if isinstance(annotation, ast.Constant) and isinstance(annotation.value, str):
        return ast.parse(annotation.value, mode="eval").body
    return annotation


def _default(value: Any) -> Any:
    """Default value of a signature; ``...`` for values created per call."""
    if isinstance(value, ast.Lambda | ast.Call):
        return ast.Constant(...)
    return value


def _code(text: str) -> str:
    """A signature as code, with one argument per line if it is long."""
    if not text:
        return ""
    if len(text) > 88:
        name, _, rest = text.partition("(")
        inner, closing, result = rest.rpartition(")")
        lines = re.split(r", (?=\w+:|\*)", inner)
        lines = [re.sub(r"^(\w+: [^=]*[^= ])=(?! )", r"\1 = ", line) for line in lines]
        text = f"{name}(\n" + "".join(f"    {line},\n" for line in lines) + f"{closing}{result}"
    return f"```\n{text}\n```"


def _first_part(doc: str | None) -> str:
    return inspect.cleandoc(doc or "").partition("\n>>>")[0]


def _docstring(value: Any) -> str:
    """A numpy docstring as Markdown: sections in bold, their entries as lists."""
    doc = inspect.getdoc(value) or ""
    pattern = rf"^({'|'.join(SECTIONS)})\n-+\n"
    text, *sections = re.split(pattern, doc, flags=re.M)
    parts = [_paragraphs(text)]
    for title, body in zip(sections[::2], sections[1::2], strict=True):
        content = _paragraphs(body) if title == "Notes" else _items(body)
        parts.append(f"**{title}**\n\n{content}")
    return "\n\n".join(filter(None, parts))


def _paragraphs(text: str) -> str:
    return re.sub(r"``([^`]*)``", r"`\1`", text.strip())


def _items(body: str) -> str:
    """``name : type`` and its indented text as one item each."""
    items: list[list[str]] = []
    for line in body.strip("\n").splitlines():
        if line and not line.startswith(" "):
            name, colon, kind = line.partition(" : ")
            items.append([f"- `{name}`{f' ({kind})' if colon else ''}"])
        elif line.strip() and items:
            items[-1].append(line.strip())
    joined = (f"{item[0]}: {' '.join(item[1:])}" if item[1:] else item[0] for item in items)
    return _paragraphs("\n".join(joined))


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
