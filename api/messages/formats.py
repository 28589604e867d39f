"""Files that a request can be answered with: names, suffixes, media types.

A request names one by ``?format=`` or by its ``Accept`` header.
"""

from dataclasses import dataclass
from importlib.util import find_spec

from api.errors import Problem
from rig.curves.layers import SUFFIX
from rig.errors import quoted
from rig.formats import FORMATS

MEDIA_TYPES = {
    ".csv": "text/csv; charset=utf-8",
    ".json": "application/json",
    ".npz": "application/x-npz",
    ".txt": "text/plain; charset=utf-8",
    ".tsv": "text/tab-separated-values; charset=utf-8",
    ".anim": "application/yaml",
    ".vrma": "model/gltf-binary",
    ".py": "text/x-python; charset=utf-8",
    ".glb": "model/gltf-binary",
    ".fbx": "application/octet-stream",
    ".usd": "model/vnd.usd",
    ".zip": "application/zip",
    ".mp4": "video/mp4",
    ".html": "text/html; charset=utf-8",
    ".gz": "application/gzip",
}


@dataclass(frozen=True)
class OutputFormat:
    """A kind of file, with the text on it in the documentation."""

    name: str
    suffix: str
    description: str
    cost: float = 0.1
    """Seconds of one processor for a second of sound, rounded up (`python -m tests.api.load
    --formats`); what takes longer than a client should wait for becomes a job."""

    def at_once_seconds(self, work_seconds: float) -> float:
        """Longest recording, seconds, that takes a twelfth of the longest work on a request."""
        return work_seconds / 12 / self.cost

    @property
    def media_type(self) -> str:
        """Value of ``Content-Type``."""
        return MEDIA_TYPES["." + self.suffix.rpartition(".")[2]]


COSTS = {"glb": 1.0, "fbx": 2.0, "usd": 0.2}
"""Costs of formats of curves that draw a head; others have the default."""
PACKAGES = {"usd": "pxr", "fbx": "bpy"}
"""Optional ones that a format needs."""
CURVE_FORMATS = {
    known.name: OutputFormat(
        known.name, known.suffixes[0], known.description, COSTS.get(known.name, 0.1)
    )
    for known in FORMATS
    if known.write and find_spec(PACKAGES.get(known.name, "numpy"))
}
_READ = [known for known in FORMATS if known.read and known.name != "fbx"]
CURVE_SUFFIXES = tuple(sorted((s for known in _READ for s in known.suffixes), key=len))[::-1]
"""Suffixes of curves that are read, longer ones first. No FBX: Blender would open it, unlimited."""
ANIMATION_FORMATS = CURVE_FORMATS | {
    "take": OutputFormat("take", ".zip", "the take folder of `deitalk animate`, zipped"),
    "mp4": OutputFormat("mp4", ".mp4", "review video, 960 x 720", cost=3.0),
    "page": OutputFormat("page", ".html", "preview page in one file, offline"),
    "packed": OutputFormat("packed", ".packed.gz", "arrays that the studio shows, and the sound"),
}
LAYER = OutputFormat("layer", SUFFIX, "a layer of edits")
MESH_FORMATS = {
    "glb": OutputFormat("glb", ".glb", "morph targets and their animation", cost=0.7),
    "npz": OutputFormat("npz", ".npz", "vertices (T, V, 3) and triangles", cost=0.4),
    "ply": OutputFormat("ply", ".zip", "one PLY file a frame, zipped", cost=0.8),
}


def choose_format(
    formats: dict[str, OutputFormat], name: str | None, accept: str | None, default: str
) -> OutputFormat:
    """Return the format that a request is to be answered in.

    Parameters
    ----------
    formats : dict
        `ANIMATION_FORMATS` or `MESH_FORMATS`.
    name : str or None
        Of ``?format=``; it goes before `accept`.
    accept : str or None
        The header: the first media type that fits, in the order of ``q``.
    default : str
        Name of the format for ``*/*`` or no header.

    Raises
    ------
    Problem
        400 if there is no such format.
    """
    known = ", ".join(formats)
    if name is not None:
        if name not in formats:
            raise Problem(400, f"format {quoted(name)} is none of {known}", "format_unknown")
        return formats[name]
    # Media types of an ``Accept`` header, the most wanted first.
    header = accept or "*/*"
    found = []
    for part in header[:1000].split(","):
        media_type, *options = (piece.strip().lower() for piece in part.split(";"))
        weight = next((o[2:] for o in options if o.startswith("q=")), "1")
        try:
            found.append((-float(weight), media_type))
        except ValueError:
            continue
    wanted = [media_type for weight, media_type in sorted(found, key=lambda w: w[0]) if weight < 0]
    for media_type in wanted:
        if media_type in ("*/*", "application/*") or media_type == "application/problem+json":
            return formats[default]
        for known_format in formats.values():
            own = known_format.media_type.partition(";")[0]
            if media_type == own or media_type == own.partition("/")[0] + "/*":
                return known_format
    raise Problem(
        400, f"Accept {quoted(accept)} fits none of the formats {known}", "format_unknown"
    )
