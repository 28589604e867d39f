"""Figures drawn with matplotlib: curves, clips of a training."""

from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from deitalk.audio.frames import SAMPLE_RATE
from deitalk.errors import MissingError
from rig.arrays import Float32
from rig.files import atomic_write

MOST_COLUMNS = 2000
"""Most columns of a drawn waveform."""


def can_draw() -> bool:
    """Whether matplotlib is installed."""
    return find_spec("matplotlib") is not None


def check_drawing() -> None:
    """Check that pictures can be drawn.

    Raises
    ------
    MissingError
        If matplotlib is not installed.
    """
    if not can_draw():
        raise MissingError("pictures need matplotlib; pip install matplotlib")


@contextmanager
def drawing(path: Path, size: tuple[float, float], dpi: int = 90) -> Iterator[Any]:
    """Yield a figure; write it to `path` when the block is done.

    Parameters
    ----------
    path : Path
        .png, .svg or .pdf; its folder must exist.
    size : (float, float)
        Width and height, inches.
    dpi : int
        Pixels per inch of a .png.

    Raises
    ------
    MissingError
        If matplotlib is not installed.
    """
    check_drawing()
    import matplotlib
    from matplotlib.figure import Figure

    with matplotlib.rc_context():
        matplotlib.rcdefaults()  # not those of a matplotlibrc in the working folder
        figure = Figure(figsize=size, layout="constrained")
        yield figure
        with atomic_write(path) as beside:
            figure.savefig(beside, dpi=dpi)


def draw_waveform(axis: Any, waveform: Float32) -> None:
    """Draw the band between the lowest and the highest sample of every column, over seconds."""
    step = max(len(waveform) // MOST_COLUMNS, 1)
    blocks = waveform[: len(waveform) // step * step].reshape(-1, step)
    times = np.arange(len(blocks)) * step / SAMPLE_RATE
    axis.fill_between(times, blocks.min(axis=1), blocks.max(axis=1), color="0.6", lw=0)
