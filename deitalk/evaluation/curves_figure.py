"""Figure of curves against the waveform: ``deitalk animate -o curves.png``."""

from pathlib import Path

from deitalk.evaluation.figures import draw_waveform, drawing
from rig import RigCurves
from rig.arrays import Float32

ROWS = (
    ("jaw", ("CTRL_C_jaw.ty",)),
    ("lips together", ("CTRL_L_mouth_lipsTogetherD.ty",)),
    ("rounding", ("CTRL_L_mouth_funnelU.ty", "CTRL_L_mouth_purseU.ty")),
    ("lip on teeth", ("CTRL_L_mouth_lipBiteD.ty",)),
    ("expression", ("CTRL_L_mouth_cornerPull.ty", "CTRL_L_mouth_cornerDepress.ty",
                    "CTRL_L_brow_down.ty", "CTRL_L_brow_raiseIn.ty", "CTRL_L_eye_cheekRaise.ty")),
    ("lids", ("CTRL_L_eye_blink.ty",)),
)  # fmt: skip
"""Rows of the picture: a title and the controls drawn."""


def draw_curves(curves: RigCurves, waveform: Float32, path: Path, title: str) -> None:
    """Draw curves against the sound: waveform with intensity, then a row per group of controls.

    Parameters
    ----------
    curves : RigCurves
        Board curves with the intensity track.
    waveform : array [shape=(S,)]
        Mono at 16 kHz.
    path : Path
        .png, .svg or .pdf.
    title : str
        Printed above the waveform.

    Raises
    ------
    MissingError
        If matplotlib is not installed.
    """
    with drawing(path, (12, 1.3 * (len(ROWS) + 1.6))) as figure:
        axes = figure.subplots(
            len(ROWS) + 1, 1, sharex=True, height_ratios=[1.6, *([1.0] * len(ROWS))]
        )
        axis = axes[0]
        draw_waveform(axis, waveform)
        strength = axis.twinx()
        strength.plot(curves.times, curves.intensity, color="crimson")
        strength.set_ylim(0, 1.05)
        strength.set_ylabel("intensity", color="crimson")
        axis.set_title(title, loc="left")
        times = curves.times
        for axis, (label, names) in zip(axes[1:], ROWS, strict=True):
            for name in names:
                short = name.removeprefix("CTRL_").removesuffix(".ty")
                axis.plot(times, curves[name], lw=1.2, label=short)
            axis.set_ylabel(label, rotation=0, ha="right", va="center")
            axis.set_ylim(-0.05, 1.05)
            axis.legend(loc="upper right", fontsize=7, ncols=len(names), frameon=False)
        axes[-1].set_xlabel("seconds")
