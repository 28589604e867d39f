"""Write docs/pictures/architecture.svg, the stages from recording to face: ``make pictures``."""

from pathlib import Path
from typing import NamedTuple

from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch, FancyBboxPatch

PICTURE = Path(__file__).parent / "pictures/architecture.svg"
WIDTH, HEIGHT = 2.2, 0.92
COLUMN, ROW = 2.55, 1.3
"""Width and height of a box, and the distance between centres, inches."""
FILLS = {"data": "#f1ead8", "curves": "#d6e6f7", "mesh": "#d9efdc"}
EDGES = {"data": "#a08a4f", "curves": "#3f78b3", "mesh": "#4c9a5b"}
ARROW = "#8a94a0"


class Stage(NamedTuple):
    """A box: its title, the module and name of what computes it, its family and its place."""

    title: str
    module: str
    name: str
    family: str
    column: int
    row: int


STAGES = {
    "recording": Stage("recording", "deitalk.audio.load", "load_audio", "data", 0, 1),
    "features": Stage("speech features", "deitalk.frontends", "build_frontend", "curves", 1, 1),
    "positions": Stage(
        "positional encoding", "deitalk.models.curve_model", "dynamic_positions", "curves", 2, 1
    ),
    "intensity": Stage(
        "emotional intensity", "deitalk.models.intensity", "DynamicIntensity", "curves", 2, 0
    ),
    "emotion": Stage("emotion", "deitalk.emotions", "EmotionTrack", "data", 4, 0),
    "decoder": Stage(
        "emotion-guided decoder", "deitalk.models.rig_decoder", "RigDecoder", "curves", 3, 1
    ),
    "curves": Stage("185 curves, 30 Hz", "rig.curves", "RigCurves", "data", 4, 1),
    "rules": Stage("rules", "deitalk.postprocess.curve_pass", "CurvePass", "curves", 4, 2),
    "take": Stage("take folder", "deitalk.pipeline.performance", "write_take", "data", 3, 2),
    "deformation": Stage(
        "deformation decoder", "deitalk.models.deformation_decoder", "MotionDecoder", "mesh", 1, 2
    ),
    "mesh": Stage("mesh", "rig.mesh.deformation", "DeformationSolver", "mesh", 2, 2),
}
ARROWS = (
    ("recording", "features"),
    ("features", "positions"),
    ("positions", "decoder"),
    ("decoder", "curves"),
    ("curves", "rules"),
    ("rules", "take"),
    ("features", "deformation"),
    ("deformation", "mesh"),
    ("features", "intensity"),
    ("intensity", "decoder"),
    ("emotion", "decoder"),
)


def main() -> None:
    """Draw the boxes and arrows on a transparent ground."""
    options = {"svg.fonttype": "path", "svg.hashsalt": "deitalk", "path.simplify": False}
    with rc_context(options):
        figure = Figure(figsize=(4 * COLUMN + WIDTH + 0.1, 2 * ROW + HEIGHT + 0.1))
        axes = figure.add_axes((0, 0, 1, 1))
        axes.set_xlim(-WIDTH / 2 - 0.05, 4 * COLUMN + WIDTH / 2 + 0.05)
        axes.set_ylim(-2 * ROW - HEIGHT / 2 - 0.05, HEIGHT / 2 + 0.05)
        axes.axis("off")
        for start, end in ARROWS:
            _arrow(axes, STAGES[start], STAGES[end])
        for stage in STAGES.values():
            _box(axes, stage)
        figure.savefig(PICTURE, transparent=True, metadata={"Date": None})


def _box(axes: Axes, stage: Stage) -> None:
    x, y = stage.column * COLUMN, -stage.row * ROW
    axes.add_patch(
        FancyBboxPatch(
            (x - WIDTH / 2, y - HEIGHT / 2),
            WIDTH,
            HEIGHT,
            linewidth=1.4,
            boxstyle="round,pad=0,rounding_size=0.1",
            fc=FILLS[stage.family],
            ec=EDGES[stage.family],
        )
    )
    style = {"ha": "center", "va": "center", "color": "#1b1f24"}
    axes.text(x, y + 0.24, stage.title, fontsize=10.8, fontweight="bold", **style)
    axes.text(x, y - 0.04, stage.name, fontsize=10.5, family="monospace", **style)
    place = stage.module.removeprefix("deitalk.")
    axes.text(x, y - 0.28, place, fontsize=8.5, family="monospace", **style)


def _arrow(axes: Axes, start: Stage, end: Stage) -> None:
    """Draw a straight arrow within a row or a column, else one with a corner in the upper row."""
    x, y = start.column * COLUMN, -start.row * ROW
    to_x, to_y = end.column * COLUMN, -end.row * ROW
    right = 1 if to_x > x else -1
    if start.row == end.row:
        ends, bend = ((x + right * WIDTH / 2, y), (to_x - right * WIDTH / 2, to_y)), "arc3"
    elif start.column == end.column:
        ends, bend = ((x, y - HEIGHT / 2), (to_x, to_y + HEIGHT / 2)), "arc3"
    elif end.row < start.row:
        ends, bend = ((x, y + HEIGHT / 2), (to_x - WIDTH / 2, to_y)), "angle,angleA=90,angleB=0"
    else:
        down = (to_x - right * 0.3, to_y + HEIGHT / 2)
        ends, bend = ((x + right * WIDTH / 2, y), down), "angle,angleA=0,angleB=90"
    axes.add_patch(
        FancyArrowPatch(
            *ends,
            connectionstyle=bend,
            arrowstyle="-|>",
            mutation_scale=16,
            color=ARROW,
            linewidth=2,
            shrinkA=0,
            shrinkB=1,
        )
    )


if __name__ == "__main__":
    main()
