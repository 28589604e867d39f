"""OpenAPI of the routes that take a form or a raw recording."""

from typing import Any

from pydantic import BaseModel

from api.messages.formats import OutputFormat

BINARY = {"type": "string", "format": "binary"}
DESCRIPTIONS = {
    "recording": "Any recording: wav, flac, ogg, mp3, m4a, mp4, webm …",
    "performance": "The performance: a zipped take, or captured or keyed curves of any format.",
    "sound": "Recording of the performance, where it is no take; else its mouth gives its phrases.",
    "edited": "The edited curves, of any format; the end of its name is its format.",
    "take": "The take that was edited: zipped, or its curves.json.",
    "mesh": "Your face: .glb with morph targets, .npz, or one neutral .obj, .ply or .glb.",
    "curves": "A file of curves; the end of its name is its format.",
    "landmarks": "Points on a neutral mesh: .json or .csv.",
    "mapping": "Meaning of your own names of shapes or controls: .csv.",
    "emotion": "Keyframes as a file; or the text of the option.",
    "intensity_curve": "intensity.csv as a file; or the text of the option.",
    "voice": "A file of `deitalk data voice`; or its text.",
    "edit": "Layers of edits as a file; or the text of the option.",
    "format": "Kind of file; else that of `Accept`.",
    "script": "A script as .txt, .srt, .vtt or .ssml; or the text of the option.",
    "listen_to": "Recording of another one who speaks meanwhile; or the text of the option.",
    "after": "The take before: a zipped take, its curves.json, or another file of curves.",
    "into": "The same of the take that comes next.",
    "words": "Words as .txt, .TextGrid, .srt or .vtt; or the text of the option.",
}

PAIRS = {"performance": ("recording",), "edited": ("take",)}
"""Files that a route's first file needs."""
RESULT = "The result"


def body(
    model: type[BaseModel],
    files: tuple[str, ...],
    formats: dict[str, OutputFormat] | None = None,
    *,
    raw: bool,
) -> dict[str, Any]:
    """Return ``requestBody`` and ``parameters`` of a route.

    Parameters
    ----------
    model : type
        Of the options: fields of the form, or parameters of the query.
    files : tuple of str
        File parts of the form.
    formats : dict, optional
        Values of ``format``.
    raw : bool
        Whether the body may be the bytes of a recording.
    """
    schema = model.model_json_schema()
    options = schema.get("properties", {})
    if formats:
        about = {"type": "string", "enum": list(formats), "description": DESCRIPTIONS["format"]}
        options["format"] = about
    parts = {n: BINARY | {"description": DESCRIPTIONS[n]} for n in files if n in DESCRIPTIONS}
    required = [*files[:1], *PAIRS.get(files[0], ())]
    form = {
        "schema": {
            "type": "object",
            "properties": parts | options,
            "required": required,
            "additionalProperties": False,
        }
    }
    content: dict[str, Any] = {"multipart/form-data": form}
    if raw:
        content |= {kind: {"schema": BINARY} for kind in ("audio/wav", "application/octet-stream")}
    return {
        "requestBody": {"required": True, "content": content},
        "parameters": [
            {
                "name": name,
                "in": "query",
                "required": False,
                "schema": {k: v for k, v in option.items() if k not in ("description", "title")},
                "description": option.get("description", ""),
            }
            for name, option in options.items()
        ],
    }


def answers(
    formats: dict[str, OutputFormat], job: type[BaseModel], *, at_once: bool = True
) -> dict[int | str, Any]:
    """Return ``responses`` of a route with a file, unless `at_once` is false, or a job."""
    found: dict[int | str, Any] = {
        202: {
            "description": "A job; its path is in `Location`",
            "content": {
                "application/json": {"schema": {"$ref": f"#/components/schemas/{job.__name__}"}}
            },
        },
    }
    return found | (file_answers(formats) if at_once else {})


def file_answers(formats: dict[str, OutputFormat]) -> dict[int | str, Any]:
    """Return ``responses`` of a route with a file."""
    content: dict[str, Any] = {}
    for known in formats.values():
        content[known.media_type.partition(";")[0]] = {"schema": BINARY}
    content["application/json"] = {"schema": {"type": "object"}}
    return {200: {"description": RESULT, "content": content}}
