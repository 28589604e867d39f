"""Pictures of a head; `rig.face.render.software` draws them."""

from rig.face.render.shading import VIEWS, View

__all__ = ["VIEWS", "View"]
