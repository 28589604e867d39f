"""A Unity ``.anim``: an AnimationClip that moves ``blendShape.<name>`` of a SkinnedMeshRenderer.

Text as the editor writes it (YAML). Weights are percent. Keys are few and cubic, within
`TOLERANCE` of every frame; Unity evaluates them with the slopes of both ends, per second. The path
of the renderer is empty: the Animator is beside it; else replace ``path:`` by its path.
"""

from pathlib import Path

import numpy as np

from rig.conversion.arkit import ARKIT_ID
from rig.curves import RigCurves
from rig.unreal.deitalk_clip import curve_keys

TOLERANCE = 5e-4
PERCENT = 100.0
N_SHAPES = 52
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
    is_arkit = curves.control_set == ARKIT_ID
    shapes = list(enumerate(curves.names))[: N_SHAPES if is_arkit else None]
    with path.open("w", encoding="utf-8", newline="\n") as stream:
        stream.write(_HEAD)
        for column, name in shapes:
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
            shape = name[0].lower() + name[1:] if is_arkit else name
            stream.write(_CURVE.format(keys=keys, name=shape))
        stop = (len(curves) - 1) / curves.fps
        stream.write(_TAIL.format(rate=curves.fps, stop=stop))
