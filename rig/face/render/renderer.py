"""One way to ask for a picture, whichever backend draws it."""

from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from rig.errors import RigError
from rig.face.mesh import Array, Mesh, vertex_normals
from rig.face.render.camera import View
from rig.face.render.opengl import OpenGLRenderer
from rig.face.render.software import SoftwareRenderer

Backend = Literal["auto", "opengl", "software"]
Picture = NDArray[np.uint8]


class _Drawer(Protocol):
    def draw(self, vertices: Array, normals: Array) -> Array: ...

    def close(self) -> None: ...


class Renderer:
    """Draws poses of one mesh from one view.

    Attributes
    ----------
    backend : str
        ``opengl`` or ``software``, whichever is in use.
    """

    def __init__(self, mesh: Mesh, drawer: _Drawer, backend: str) -> None:
        self._mesh, self._drawer, self.backend = mesh, drawer, backend

    def render(self, vertices: Array) -> Picture:
        """Picture (height, width, 3) uint8 of the mesh with these vertices (V, 3)."""
        picture = self._drawer.draw(vertices, vertex_normals(vertices, self._mesh.faces))
        return (picture * 255 + 0.5).astype(np.uint8)

    def close(self) -> None:
        """Free what the backend holds."""
        self._drawer.close()


def make_renderer(
    mesh: Mesh, *, size: tuple[int, int], view: View, backend: Backend = "auto"
) -> Renderer:
    """Choose a backend: ``auto`` takes OpenGL where it works and numpy elsewhere.

    Raises
    ------
    RigError
        For an unknown backend, or where ``opengl`` is asked for and is not there.
    """
    if backend not in ("auto", "opengl", "software"):
        raise RigError(f"backend {backend!r} is unknown; use auto, opengl or software")
    if backend != "software":
        try:
            return Renderer(mesh, OpenGLRenderer(mesh, size, view), "opengl")
        except RigError:
            if backend == "opengl":
                raise
    return Renderer(mesh, SoftwareRenderer(mesh, size, view), "software")
