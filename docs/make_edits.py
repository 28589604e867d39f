"""Write docs/pictures/dub.webp and join.webp: what a dub shows when, and a join: ``make pictures``.

Of the recordings in docs/samples: a performance of three phrases that speaks three others, and
promise.flac cut in a pause.
"""

import io
import tempfile
from pathlib import Path

import matplotlib as mpl
import numpy as np
from PIL import Image

mpl.use("Agg")
from matplotlib.figure import Figure
from matplotlib.patches import Polygon

from deitalk import animate
from deitalk.audio.load import load_audio
from deitalk.data.dub import Dubbed, dub
from rig import RigCurves

DOCS = Path(__file__).parent
PROMISE, AMIABLE = (DOCS / f"samples/{name}.flac" for name in ("promise", "amiable"))
DUB, JOIN = DOCS / "pictures/dub.webp", DOCS / "pictures/join.webp"
BROW, JAW = "CTRL_L_brow_raiseIn.ty", "CTRL_C_jaw.ty"
SMILE = "CTRL_L_mouth_cornerPull.ty"
KEPT, STRETCHED, VOICE = "#4c9a6a", "#d98c3f", "#3f6fb5"
CUT_SECONDS = 4.55
"""A pause of the sample."""


def main() -> None:
    """Animate, and draw both pictures."""
    rate = 16_000
    whole, other = load_audio(PROMISE).waveform, load_audio(AMIABLE).waveform
    pause = np.zeros(2 * rate // 3, np.float32)
    acted = np.concatenate((whole[: 3 * rate], pause, other[: 3 * rate], pause, whole[5 * rate :]))
    spoken = np.concatenate((other[: 3 * rate], pause, pause, other[: 4 * rate], pause, whole))
    spoken = spoken[: 12 * rate]
    with tempfile.TemporaryDirectory() as folder:
        face = animate(acted, "surprised", sample_rate=rate)
        found = dub(face.save(Path(folder) / "face"), spoken, sample_rate=rate)
    draw_dub(found, face.curves, spoken, rate)
    at = round(CUT_SECONDS * rate)
    first = animate(whole[:at], "happy", sample_rate=rate)
    alone = animate(whole[at:], "happy", sample_rate=rate)
    after = animate(whole[at:], "happy", sample_rate=rate, after=first)
    draw_join(first.curves, alone.curves, after.curves)


def draw_dub(found: Dubbed, face: RigCurves, spoken: np.ndarray, rate: int) -> None:
    """The pieces of the performance under those of the new sound; a brow, and the jaw."""
    figure = Figure((9, 4.6))
    pieces, brow, jaw = figure.subplots(3, 1, sharex=True, height_ratios=(1.3, 1, 1))
    for piece in found.pieces:
        colour = KEPT if piece.rate == 1 and not piece.turned else STRETCHED
        ends = [(piece.start, 1), (piece.end, 1), (piece.source_end, 0), (piece.source_start, 0)]
        is_phrase = piece.kind == "phrase"
        pieces.add_patch(Polygon(ends, color=colour, alpha=0.75 if is_phrase else 0.25, lw=0))
        if is_phrase:
            middle = (piece.start + piece.end + piece.source_start + piece.source_end) / 4
            label = "as it is" if piece.rate == 1 else f"× {piece.rate:.2f}"
            pieces.text(middle, 0.5, label, ha="center", va="center", fontsize=8)
    pieces.set_ylim(0, 1)
    pieces.set_yticks([0, 1], ["performance", "new sound"])
    curves = found.performance.curves
    brow.plot(face.times, face[BROW], color="0.7", lw=1, label="brow of the performance")
    brow.plot(curves.times, curves[BROW], color=KEPT, lw=1.4, label="brow of the dub")
    jaw.plot(curves.times, curves[JAW], color=VOICE, lw=1.4, label="jaw, by the new sound")
    level = np.abs(spoken) / np.abs(spoken).max() * 0.4
    jaw.plot(np.arange(len(spoken))[::80] / rate, level[::80], color="0.8", lw=0.5)
    for axes in (brow, jaw):
        axes.margins(y=0.25)
        axes.legend(loc="upper center", fontsize=8, frameon=False, ncols=2)
    jaw.set_xlabel("seconds")
    jaw.set_xlim(0, max(curves.duration, face.duration))
    _save(figure, DUB)


def draw_join(first: RigCurves, alone: RigCurves, after: RigCurves) -> None:
    """The smile and the turn of the head around the end of the first take."""
    figure = Figure((9, 3.4))
    smile, head = figure.subplots(2, 1, sharex=True)
    for axes, read, name in (
        (smile, lambda curves: curves[SMILE], "smile"),
        (head, lambda curves: curves.head[:, 1], "head, degrees"),
    ):
        axes.plot(first.times, read(first), color="0.4", lw=1.4)
        for curves, colour, label in (
            (alone, STRETCHED, "next line alone"), (after, KEPT, "next line --after"),
        ):  # fmt: skip
            times = np.append(first.times[-1], first.duration + curves.times)
            values = np.append(read(first)[-1], read(curves))
            axes.plot(times, values, color=colour, lw=1.4, label=label)
        axes.axvline(first.duration, color="0.8", lw=0.8)
        axes.set_ylabel(name, fontsize=9)
    smile.legend(loc="upper left", fontsize=8, frameon=False)
    head.set_xlabel("seconds")
    head.set_xlim(first.duration - 1.5, first.duration + 2.5)
    head.set_ylim(-3, 3)
    _save(figure, JOIN)


def _save(figure: Figure, path: Path) -> None:
    for axes in figure.axes:
        axes.spines[["top", "right"]].set_visible(False)
        axes.tick_params(labelsize=8)
    figure.tight_layout()
    buffer = io.BytesIO()
    figure.savefig(buffer, dpi=110)
    Image.open(buffer).convert("RGB").save(path, quality=85, method=6)


if __name__ == "__main__":
    main()
