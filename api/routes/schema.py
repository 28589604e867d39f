"""Parts of the OpenAPI schema that routes do not declare: headers, keys, models, messages."""

from typing import Any, Literal

from fastapi import FastAPI
from pydantic import BaseModel

from api.live.messages import Start
from api.messages.views import ProblemView
from deitalk.acting import LIVE_FIELDS, Acting

_TEXT: dict[str, Any] = {"schema": {"type": "string"}}
REQUEST_ID = {"X-Request-ID": _TEXT | {"description": "The request's own, or a new one"}}
RETRY = {"Retry-After": {"schema": {"type": "integer"}, "description": "Seconds to wait"}}
RESULT = {
    "Content-Disposition": _TEXT | {"description": "Name of the file"},
    "Deitalk-Notes": _TEXT | {"description": "JSON list of notes; absent if there are none"},
}
PART = {"ETag": _TEXT, "Accept-Ranges": _TEXT}
HEADERS: dict[str, dict[str, Any]] = {
    "202": {"Location": _TEXT | {"description": "Path of the job"}},
    "206": RESULT | PART | {"Content-Range": _TEXT},
    "304": PART,
    "401": {"WWW-Authenticate": _TEXT},
    "416": {"Content-Range": _TEXT},
    "429": RETRY,
    "503": RETRY,
    "507": RETRY,
}


def complete_schema(app: FastAPI) -> None:
    """Have an application's schema say it all."""
    make = app.openapi

    def openapi() -> dict[str, Any]:
        if app.openapi_schema:
            return app.openapi_schema
        schema = make()
        parts = schema.setdefault("components", {})
        parts.setdefault("schemas", {})["Problem"] = ProblemView.model_json_schema()
        parts["securitySchemes"] = {"key": {"type": "http", "scheme": "bearer"}}
        schema["security"] = [{"key": []}, {}]
        schema["x-websockets"] = {"/v1/live": live_messages()}
        models = list(app.state.service.settings.known_models)
        for methods in schema["paths"].values():
            for route in methods.values():
                _complete(route, models)
        return schema

    app.openapi = openapi  # type: ignore[method-assign]


def _complete(route: dict[str, Any], models: list[str]) -> None:
    """Add headers of the answers and the names of the models."""
    for status, answer in route["responses"].items():
        kinds = answer.get("content", {})
        is_file = answer["description"] == RESULT or "application/octet-stream" in kinds
        answer["headers"] = REQUEST_ID | HEADERS.get(status, RESULT if is_file else {})
    for parameter in route.get("parameters", ()):
        if parameter["name"] == "model":
            parameter["schema"]["enum"] = models
    for body in route.get("requestBody", {}).get("content", {}).values():
        if "model" in body["schema"].get("properties", {}):
            body["schema"]["properties"]["model"]["enum"] = models


class Header(BaseModel):
    """First answer of a session."""

    type: Literal["header"]
    names: list[str]
    control_set: str
    head: list[str]
    fps: float
    lookahead_seconds: float
    record: str


class Frame(BaseModel):
    """A frame in JSON."""

    index: int
    time: float
    late: float
    values: list[float]
    head: list[float] | None = None


class Frames(BaseModel):
    """Frames in JSON; in binary they are records as `Header.record` says."""

    type: Literal["frames"]
    frames: list[Frame]


class Interrupted(BaseModel):
    """Between the frames before and after an interruption."""

    type: Literal["interrupted"]
    frame: int
    next: int


class End(BaseModel):
    """Last answer of a session."""

    type: Literal["end"]
    frames: int


def live_messages() -> dict[str, Any]:
    """Return JSON schemas of the messages of `WS /v1/live`."""
    acting = Acting.model_json_schema()["properties"]

    def sent(kind: str, fields: dict[str, Any]) -> dict[str, Any]:
        properties = {"type": {"const": kind}} | fields
        return {"type": "object", "properties": properties, "required": ["type"]}

    begin = {name: acting[name] for name in LIVE_FIELDS}
    change = {name: acting[name] for name, when in LIVE_FIELDS.items() if when == "change"}
    samples = {"description": "mono samples of any number, little-endian", "format": "binary"}
    return {
        "description": "Subprotocols `deitalk` and, for browsers, `deitalk.key.<key>`.",
        "client": {
            "start": sent("start", Start.model_json_schema()["properties"] | begin),
            "samples": {"type": "string"} | samples,
            "set": sent("set", change),
            "interrupt": sent("interrupt", {"frame": {"type": "integer", "minimum": 0}}),
            "stop": sent("stop", {}),
        },
        "server": {
            "header": Header.model_json_schema(),
            "frames": Frames.model_json_schema(),
            "interrupted": Interrupted.model_json_schema(),
            "end": End.model_json_schema(),
            "problem": sent("problem", ProblemView.model_json_schema()["properties"]),
        },
    }
