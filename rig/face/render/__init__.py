"""Pictures of a head: by OpenGL (moderngl over EGL) or in plain numpy."""

from rig.face.render.camera import VIEWS, View
from rig.face.render.renderer import Renderer, make_renderer

__all__ = ["VIEWS", "Renderer", "View", "make_renderer"]
