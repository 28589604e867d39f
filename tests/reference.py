"""Outputs of the embedded models on the bundled sample, for comparison after a restructuring.

::

    python -m tests.reference write before.npz       # before the first move
    python -m tests.reference compare before.npz     # after every step; exit code 1 if they differ

Curves are compared to 1e-5 of each control's range, vertices to 1e-5 of the head's size.
"""

import sys
from pathlib import Path

import numpy as np

from deitalk import animate
from deitalk.pipeline.mesh import animate_mesh
from rig import default_controls

SAMPLE = Path(__file__).parents[1] / "docs/samples/promise.flac"
TOLERANCE = 1e-5


def outputs() -> dict[str, np.ndarray]:
    """Curves (T, 185) and intensity (T,) of the curve models, vertices (T, V, 3) of the others."""
    found = {}
    for model in ("default", "live"):
        for emotion in ("happy", "neutral"):
            performance = animate(SAMPLE, emotion, model=model)
            found[f"{model}/{emotion}/curves"] = performance.curves.values
            found[f"{model}/{emotion}/neutral"] = performance.neutral.values
            found[f"{model}/{emotion}/intensity"] = performance.predicted
    for model in ("sdfa", "mesh_head", "default"):
        emotion = "neutral" if model == "sdfa" else "angry"
        mesh = animate_mesh(SAMPLE, emotion, model=model)
        found[f"{model}/{emotion}/vertices"] = mesh.vertices[::5].astype(np.float32)
    return found


def difference(name: str, before: np.ndarray, after: np.ndarray) -> float:
    """Largest difference as a share of the range (curves) or of the head's size (vertices)."""
    if before.shape != after.shape:
        return np.inf
    controls = default_controls()
    scale: np.ndarray | float = 1.0
    if before.ndim == 2:
        scale = controls.maximum - controls.minimum
    elif before.ndim == 3:
        scale = float(np.ptp(before[0], axis=0).max())
    return float(np.abs((after - before) / scale).max())


def main(verb: str, path: str) -> int:
    """Write or compare; the exit code is 1 if outputs differ."""
    now = outputs()
    if verb == "write":
        np.savez_compressed(path, **now)  # type: ignore[arg-type]
        return 0
    with np.load(path) as stored:
        before = dict(stored)
    worst = {name: difference(name, before[name], now[name]) for name in before}
    for name, value in worst.items():
        sys.stdout.write(f"{name:28} {value:.2e}\n")
    return int(max(worst.values()) > TOLERANCE)


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
