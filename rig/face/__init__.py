"""The embedded head: a procedural face moved by the 185 controls.

`build_head(identity)` gives a `Head`; `Head.pose(values)` gives vertices. Nothing is loaded from
files: skull, lips, lids, teeth and hair are formulas (see docs/face.md).
"""

from rig.face.geometry.mesh import Mesh
from rig.face.head import Head, build_head
from rig.face.identity import IDENTITIES, Identity

__all__ = ["IDENTITIES", "Head", "Identity", "Mesh", "build_head"]
