"""The embedded heads: four people moved by the 185 controls.

`build_head(identity)` gives a `Head`; `Head.pose(values)` gives vertices. The heads are files of
``data``, made from open material (see docs/face.md).
"""

from rig.face.head import Head, build_head
from rig.face.identity import IDENTITIES, Identity
from rig.face.mesh import Mesh

__all__ = ["IDENTITIES", "Head", "Identity", "Mesh", "build_head"]
