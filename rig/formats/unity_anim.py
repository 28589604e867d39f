"""A Unity ``.anim``: an AnimationClip that moves ``blendShape.<name>`` of a SkinnedMeshRenderer.

Text as the editor writes it (YAML). Weights are percent. Keys are few and cubic, within
`TOLERANCE` of every frame; Unity evaluates them with the slopes of both ends, per second. The path
of the renderer is empty: the Animator is beside it; else replace ``path:`` by its path.
"""

import re
from pathlib import Path

import numpy as np

from rig.controls import ControlSet
from rig.conversion.arkit import ARKIT_ID, apple_names
from rig.conversion.convert import curves_of_shapes
from rig.curves import RigCurves, check_clip
from rig.curves.edit import hermite
from rig.errors import FormatError
from rig.files.reading import read_text
from rig.limits import CURVES_BYTES, FRAMES
from rig.unreal.deitalk_clip import curve_keys

TOLERANCE = 5e-4
PERCENT = 100.0
_HEAD = """%YAML 1.1
%TAG !u! tag:unity3d.com,2011:
--- !u!74 &7400000
AnimationClip:
  m_ObjectHideFlags: 0
  m_Name: take
  serializedVersion: 6
  m_Legacy: 0
  m_Compressed: 0
  m_UseHighQualityCurve: 1
  m_RotationCurves: []
  m_CompressedRotationCurves: []
  m_EulerCurves: []
  m_PositionCurves: []
  m_ScaleCurves: []
  m_FloatCurves:
"""
_CURVE = """  - curve:
      serializedVersion: 2
      m_Curve:
{keys}      m_PreInfinity: 2
      m_PostInfinity: 2
      m_RotationOrder: 4
    attribute: blendShape.{name}
    path:
    classID: 137
    script: {{fileID: 0}}
"""
_KEY = """      - serializedVersion: 3
        time: {:.6g}
        value: {:.6g}
        inSlope: {:.6g}
        outSlope: {:.6g}
        tangentMode: 1
        weightedMode: 0
        inWeight: 0.33333334
        outWeight: 0.33333334
"""
_ROW = r"time: (\S+)\s+value: (\S+)\s+inSlope: (\S+)\s+outSlope: (\S+)"
_TAIL = """  m_PPtrCurves: []
  m_SampleRate: {rate:g}
  m_WrapMode: 0
  m_AnimationClipSettings:
    serializedVersion: 2
    m_StartTime: 0
    m_StopTime: {stop:.6g}
    m_LoopTime: 0
  m_Events: []
"""


def write(path: Path, curves: RigCurves) -> None:
    """Write one curve a shape; ARKit's rotations are left out."""
    names = apple_names() if curves.control_set == ARKIT_ID else curves.names
    with path.open("w", encoding="utf-8", newline="\n") as stream:
        stream.write(_HEAD)
        for column, name in enumerate(names):
            values = curves.values[:, column].astype(np.float64)
            keys = "".join(
                _KEY.format(
                    frame / curves.fps,
                    PERCENT * values[frame],
                    PERCENT * arrive * curves.fps,
                    PERCENT * leave * curves.fps,
                )
                for frame, arrive, leave in curve_keys(values.tolist(), TOLERANCE)
            )
            stream.write(_CURVE.format(keys=keys, name=name))
        stop = (len(curves) - 1) / curves.fps
        stream.write(_TAIL.format(rate=curves.fps, stop=stop))


def read(path: Path, controls: ControlSet | None = None, fps: float | None = None) -> RigCurves:
    """Read the curves ``blendShape.<name>`` of a clip in text; other curves are passed over.

    Raises
    ------
    FormatError
        If there are none, their shapes are of no known set, or keys are stepped or damaged.
    """
    blocks = read_text(path, CURVES_BYTES).split("- curve:\n")
    named = [(re.search(r"attribute: blendShape\.(.+)", block), block) for block in blocks[1:]]
    found = {match[1].strip(): np.array(re.findall(_ROW, block)) for match, block in named if match}
    rates = re.findall(r"m_SampleRate: (\S+)", blocks[-1])
    try:
        keyed = {name: rows.astype(np.float64).reshape(-1, 4) for name, rows in found.items()}
        rate = fps or float(rates[0])
        sound = all(
            len(k) and np.isfinite(k).all() and (np.diff(k[:, 0]) > 0).all() for k in keyed.values()
        )
    except (ValueError, IndexError):
        sound = False
    if not sound or not keyed or not 0 < rate <= 1000:
        raise FormatError(f"{path} has no curves of blend shapes with smooth keys at rising times")
    last = max(keys[-1, 0] for keys in keyed.values())
    if not last * rate < FRAMES:
        raise FormatError(f"{path} ends at {last:g} s; at most {FRAMES} frames are read")
    n_frames = round(last * rate) + 1
    check_clip(n_frames, len(keyed))
    at = np.arange(n_frames) / rate
    weights = np.empty((n_frames, len(keyed)), np.float32)
    for column, keys in enumerate(keyed.values()):
        rows, arrive, leave = (keys[:, i : i + 1] / PERCENT for i in (1, 2, 3))
        weights[:, column] = hermite(keys[:, 0], rows, arrive, leave, at)[:, 0].clip(0, 1)
    return curves_of_shapes(list(keyed), weights, rate, str(path), controls)
