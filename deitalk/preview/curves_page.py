"""The page of curves: those of a rig that has no head here, with the recording.

One HTML file that needs no player: every control that moves is a line over time, under its name,
and up to six takes lie over each other.
"""

import base64
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from deitalk.preview.source import (
    PreviewError,
    PreviewSource,
    sound_as_wav,
)
from rig.files import atomic_write

TEMPLATE = Path(__file__).with_name("curves_page.html")
MOVING = 1e-3
"""Standard deviation from which on a control is shown at first."""
_CURVES_SLOT = "<!--deitalk-curves-->"


def write_curves_page(takes: Sequence[PreviewSource], out: Path) -> None:
    """Write the page; the order of the controls is by how far they move.

    Parameters
    ----------
    takes : sequence of PreviewSource
        The recording is that of the first.
    out : Path
        ``.html``, may be replaced.

    Raises
    ------
    PreviewError
        If the takes are of different rigs.
    """
    names = takes[0].curves.names
    for take in takes:
        if take.curves.names != names:
            raise PreviewError(
                f"{take.title} is of the rig {take.curves.control_set}, {takes[0].title} of "
                f"{takes[0].curves.control_set}; compare takes of one rig"
            )
    text = json.dumps(_facts(takes)).replace("<", "\\u003c")
    page = TEMPLATE.read_text(encoding="utf-8").replace(_CURVES_SLOT, text)
    with atomic_write(out) as beside:
        beside.write_text(page, encoding="utf-8")


def _facts(takes: Sequence[PreviewSource]) -> dict[str, Any]:
    values = np.concatenate([take.curves.values for take in takes])
    spread = values.std(axis=0)
    order = np.argsort(-spread, kind="stable")
    low, high = np.minimum(values.min(axis=0), 0), np.maximum(values.max(axis=0), 0)
    return {
        "title": takes[0].title,
        "names": [takes[0].curves.names[k] for k in order],
        "moving": [bool(spread[k] > MOVING) for k in order],
        "ranges": [[float(low[k]), float(high[k])] for k in order],
        "audio": sound_as_wav(takes[0]),
        "takes": [
            {
                "title": take.title,
                "fps": take.curves.fps,
                "frames": len(take.curves),
                "values": base64.b64encode(
                    np.ascontiguousarray(take.curves.values[:, order], "<f4").tobytes()
                ).decode(),
            }
            for take in takes
        ],
    }
