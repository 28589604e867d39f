"""/docs: the OpenAPI schema as a page without scripts; nothing is fetched from elsewhere."""

import json
from html import escape
from typing import Any

from fastapi import APIRouter, Request
from starlette.responses import HTMLResponse

router = APIRouter()
STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; max-width: 60rem; margin: 2rem auto; padding: 0 1rem;
  color-scheme: light dark; }
code, pre { font: 14px/1.5 ui-monospace, monospace; } pre { overflow-x: auto; }
h2 { border-top: 1px solid; padding-top: 1rem; margin-top: 2rem; }
table { border-collapse: collapse; } td, th { text-align: left; padding: .2rem 1rem .2rem 0;
  vertical-align: top; }
"""


@router.get("/docs", include_in_schema=False)
def docs(request: Request) -> HTMLResponse:
    """The schema as a page."""
    schema = request.app.openapi()
    routes = [
        _route(path, method, route)
        for path, methods in schema["paths"].items()
        for method, route in methods.items()
    ]
    title = escape(f"{schema['info']['title']} {schema['info']['version']}")
    return HTMLResponse(
        f"<!doctype html><html lang=en><meta charset=utf-8>"
        f"<meta name=viewport content='width=device-width'><title>{title}</title>"
        f"<style>{STYLE}</style><h1>{title}</h1><p>{escape(schema['info']['description'])}</p>"
        f"<p>The schema for programs: <a href=/openapi.json>openapi.json</a></p>{''.join(routes)}"
    )


def _route(path: str, method: str, route: dict[str, Any]) -> str:
    parts = [f"<h2><code>{method.upper()} {escape(path)}</code></h2>"]
    parts.append(f"<p>{escape(route.get('description', ''))}</p>")
    options = {option["name"]: option for option in route.get("parameters", ())}
    rows = "".join(
        f"<tr><td><code>{escape(name)}</code><td>{escape(_kind(option['schema']))}"
        f"<td>{escape(option.get('description', ''))}"
        for name, option in options.items()
    )
    if rows:
        parts.append(f"<table><tr><th>option<th>value<th>meaning{rows}</table>")
    content = route.get("requestBody", {}).get("content", {})
    if content:
        parts.append(f"<p>Body: {escape(', '.join(content))}</p>")
        parts.append(f"<pre>{escape(curl(path, method, content))}</pre>")
    statuses = ", ".join(route.get("responses", {}))
    return "".join([*parts, f"<p>Answers: {escape(statuses)}</p>"])


def curl(path: str, method: str, content: dict[str, Any]) -> str:
    """Return a command that calls a route."""
    files = content.get("multipart/form-data", {}).get("schema", {}).get("required", [])
    names = {"recording": "speech.wav", "mesh": "face.glb", "curves": "curves.csv",
             "performance": "take.zip"}  # fmt: skip
    parts = [f"-F {name}=@{names.get(name, name)}" for name in files]
    if files == ["mesh"]:
        parts.append("-F curves=@curves.csv")
    return f"curl -X {method.upper()} {' '.join(parts)} http://127.0.0.1:8000{path}"


def _kind(schema: dict[str, Any]) -> str:
    if "anyOf" in schema:
        return " or ".join(_kind(part) for part in schema["anyOf"] if part.get("type") != "null")
    kind = str(schema.get("type", ""))
    limits = [
        f"{word} {json.dumps(schema[key])}"
        for key, word in (("minimum", "from"), ("maximum", "to"), ("default", "by default"))
        if key in schema
    ]
    return " ".join([kind, *limits])
