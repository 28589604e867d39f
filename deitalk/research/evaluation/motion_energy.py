"""How much each region moves: ``python -m deitalk.research.evaluation.motion_energy FILES``.

Files are curves of any format, such as takes of the five emotions and captured takes beside them.
The energy of a region at a frame is the root mean square, over its controls, of their change per
second; that of the head is its turn in degrees per second. The table gives the mean over the time,
and in brackets the standard deviation of the most moving control; ``-o`` draws the energy over the
time. ``--animate RECORDING`` adds the takes of a model in every emotion.

Letters: T frames, C controls.
"""

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from deitalk.emotions import EMOTIONS
from deitalk.errors import DataError
from deitalk.evaluation.figures import drawing
from deitalk.evaluation.report import table
from deitalk.models.load import load_network
from deitalk.pipeline.curves import animate
from deitalk.research.arguments import new_file, one_line_errors
from deitalk.research.evaluation.report import identified, write_json
from rig import read_curves
from rig.arrays import Float64
from rig.controls import DEFAULT_ID
from rig.conversion.convert import convert
from rig.curves import RigCurves

REGIONS: dict[str, tuple[str, ...]] = {
    "brows": ("_brow_",),
    "lids": ("_eye_blink.", "_eye_lidPress"),
    "inner squint": ("_eye_squintInner.",),
    "cheeks": ("_eye_cheekRaise.", "_mouth_suckBlow", "_nose_nasolabialDeepen."),
    "gaze": ("_L_eye.t", "_R_eye.t"),
    "nose": ("_nose.", "_nose_wrinkleUpper."),
    "mouth": ("_mouth_",),
    "jaw": ("_jaw",),
    "neck": ("_neck_",),
}
"""Parts of the names of a region's controls."""
HEAD = "head, °/s"
SECONDS = 10.0


def motion_energy(curves: RigCurves) -> dict[str, Float64]:
    """Energy of each region of `REGIONS`, and of the head if it has a track [shape=(T - 1,)]."""
    energy = {
        name: np.sqrt(np.square(np.diff(columns, axis=0) * curves.fps).mean(axis=1))
        for name, columns in _columns(curves).items()
    }
    if curves.head is not None:
        turns = np.diff(curves.head[:, :3].astype(np.float64), axis=0) * curves.fps
        energy[HEAD] = np.linalg.norm(turns, axis=1)
    return energy


def spreads(curves: RigCurves) -> dict[str, float]:
    """Standard deviation of the most moving control of each region."""
    found = {name: float(columns.std(axis=0).max()) for name, columns in _columns(curves).items()}
    if curves.head is not None:
        found[HEAD] = float(curves.head[:, :3].std(axis=0).max())
    return found


def _columns(curves: RigCurves) -> dict[str, Float64]:
    """Values of the controls of each region."""
    places = {
        region: [i for i, n in enumerate(curves.names) if any(part in n for part in parts)]
        for region, parts in REGIONS.items()
    }
    return {name: curves.values[:, at].astype(np.float64) for name, at in places.items() if at}


def read_takes(files: Sequence[Path], start: float, seconds: float) -> dict[str, RigCurves]:
    """Curves of the board by the name of their file, from a time on, at 30 a second.

    Raises
    ------
    DataError
        If a file has fewer than two frames there, or two files have one name.
    """
    takes: dict[str, RigCurves] = {}
    for path in files:
        if path.stem in takes:
            raise DataError(f"{path}: another file has that name; rename one")
        takes[path.stem] = _part(path, read_curves(path, control_set=None), start, seconds)
    return takes


def animated_takes(
    recording: Path, model: str, start: float, seconds: float
) -> dict[str, RigCurves]:
    """Curves of a model in every emotion, from a time on.

    Raises
    ------
    DataError
        If the recording has fewer than two frames there.
    """
    network = load_network(model)
    takes = {name: animate(recording, name, model=network).curves for name in EMOTIONS}
    return {name: _part(recording, take, start, seconds) for name, take in takes.items()}


def _part(path: Path, curves: RigCurves, start: float, seconds: float) -> RigCurves:
    board = convert(curves, DEFAULT_ID).resample(30)
    board = board.slice_seconds(start, min(start + seconds, curves.duration))
    if len(board) < 2:
        raise DataError(f"{path}: has fewer than two frames from {start:g} s on")
    return board


def summary(takes: Mapping[str, RigCurves]) -> dict[str, dict[str, tuple[float, float]]]:
    """Mean energy and spread of each region, by take."""
    found = {}
    for title, curves in takes.items():
        spread = spreads(curves)
        energy = motion_energy(curves)
        found[title] = {name: (float(e.mean()), spread[name]) for name, e in energy.items()}
    return found


def as_markdown(takes: Mapping[str, RigCurves]) -> str:
    """The table: a column for each take."""
    columns = {
        title: {name: f"{mean:.3f} ({spread:.3f})" for name, (mean, spread) in regions.items()}
        for title, regions in summary(takes).items()
    }
    return "\n".join(table("region", columns)) + "\n"


def draw(path: Path, takes: Mapping[str, RigCurves]) -> None:
    """Draw the energy over the time: a row for each region, a column for each take."""
    energies = {title: motion_energy(curves) for title, curves in takes.items()}
    names = [*REGIONS, HEAD]
    with drawing(path, (2.2 * len(takes) + 1, 1.0 * len(names) + 0.6)) as figure:
        axes = figure.subplots(len(names), len(takes), squeeze=False, sharex=True, sharey="row")
        for row, name in zip(axes, names, strict=True):
            row[0].set_ylabel(name, fontsize=8)
            for axis, (title, energy) in zip(row, energies.items(), strict=True):
                if name in energy:
                    time = np.arange(len(energy[name])) / takes[title].fps
                    axis.fill_between(time, energy[name], linewidth=0)
                axis.tick_params(labelsize=6)
        for axis, title in zip(axes[0], energies, strict=True):
            axis.set_title(title, fontsize=9)
        figure.supxlabel("seconds; change of the controls per second", fontsize=8)


@one_line_errors
def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table; draw the picture if one is asked for."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("files", type=Path, nargs="*", help="curves of any format")
    parser.add_argument("--animate", type=Path, metavar="RECORDING", help="in every emotion")
    parser.add_argument("--model", default="default", help="name or folder, for --animate")
    parser.add_argument("--json", type=new_file, help="also write the table to this file")
    parser.add_argument("-o", "--out", type=new_file, help="picture: .png, .svg or .pdf")
    parser.add_argument("--start", type=float, default=0.0, help="first second")
    parser.add_argument("--seconds", type=float, default=SECONDS, help="how many of them")
    options = parser.parse_args(arguments)
    takes = read_takes(options.files, options.start, options.seconds)
    if options.animate is not None:
        part = (options.model, options.start, options.seconds)
        takes |= animated_takes(options.animate, *part)
    if not takes:
        raise DataError("no curves; name files, or a recording to animate")
    if options.out is not None:
        draw(options.out, takes)
    sys.stdout.write(as_markdown(takes))
    known = identified(options.model) if options.animate is not None else {}
    write_json(options.json, known | {"takes": summary(takes)})


if __name__ == "__main__":
    sys.exit(main())
