"""Tables of the embedded models: files, and what is scored of them."""

import json
from pathlib import Path

from deitalk.models.folder import READOUTS
from result_tables.common import report, short, table

WEIGHTS = Path(__file__).parents[2] / "deitalk/models/weights"
USES = {
    "default": "curves",
    "mel": "curves, without a pretrained encoder",
    "live": "curves while somebody speaks, 0.2 s behind ([docs/live.md](docs/live.md))",
    "small": "the same, 0.1 s behind ([docs/live.md](docs/live.md#the-model))",
    "sdfa": "a mesh, without curves or emotion ([docs/sdfa.md](docs/sdfa.md))",
    "mesh_head": "a mesh with emotion, on `mel`'s features "
    "([docs/sdfa.md](docs/sdfa.md#a-mesh-head-for-deitalk))",
}


def models() -> str:
    """The models of the package, for the README."""
    rows = []
    for name, use in USES.items():
        cells = ["", ""]
        if name in ("default", "live", "small"):
            people = report(f"{name}-lips")["animated"]["mean"]
            r = " / ".join(short(people[f"{measure} r"], 2) for measure in ("opening", "jaw"))
            cells = [r, ""]
        if name == "default":
            cells[-1] = short(report("default-speed")["clip"]["rtf_cpu"])
        rows.append([f"`{name}`", use, f"{megabytes(name):.1f}", *cells])
    heads = ["model", "for", "MB", "correlation with the lips of two unseen people: opening / jaw",
             "seconds of work a second"]  # fmt: skip
    return table([heads, *rows])


def sizes() -> str:
    """Files of the models."""
    rows = [[f"`{n}`", f"{numbers(n) / 1e6:.1f}", f"{megabytes(n):.1f}"] for n in USES]
    return table([["model", "million numbers", "MB"], *rows])


def megabytes(name: str) -> float:
    """Size of the arrays of a model folder."""
    files = ("model.safetensors", "encoder.safetensors", "templates.npz")
    paths = (WEIGHTS / name / file for file in files)
    return sum(path.stat().st_size for path in paths if path.is_file()) / 1e6


def numbers(name: str) -> int:
    """Numbers in the weights of a model."""
    files = ("model.safetensors", "encoder.safetensors", *READOUTS)
    paths = (WEIGHTS / name / file for file in files)
    return sum(_numbers(path) for path in paths if path.is_file())


def _numbers(path: Path) -> int:
    """Numbers in a safetensors file, from its header."""
    with path.open("rb") as file:
        header = json.loads(file.read(int.from_bytes(file.read(8), "little")))
    total = 0
    for key, tensor in header.items():
        if key != "__metadata__":
            count = 1
            for length in tensor["shape"]:
                count *= length
            total += count
    return total
