"""Pictures of a head: by OpenGL (moderngl over EGL) or in plain numpy."""

from rig.face.render.renderer import Renderer, make_renderer
from rig.face.render.shading import VIEWS, View

__all__ = ["VIEWS", "Renderer", "View", "make_renderer"]
