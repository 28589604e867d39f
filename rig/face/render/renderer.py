"""One interface to both backends."""

from typing import Literal, Protocol

import numpy as np

from rig.arrays import Float32, Float64
from rig.errors import RigError
from rig.face.geometry.mesh import Mesh, vertex_normals
from rig.face.render.opengl import OpenGLRenderer, has_graphics_processor, open_context
from rig.face.render.shading import Picture, View

Backend = Literal["auto", "opengl", "software"]
__all__ = ["Backend", "Picture", "Renderer", "check_backend", "make_renderer"]


class _Drawer(Protocol):
    def draw(self, vertices: Float64, normals: Float64, accents: Float32) -> Picture: ...

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

    def render(
        self,
        vertices: Float64,
        normals: Float64 | None = None,
        accents: Float32 | None = None,
    ) -> Picture:
        """Picture (height, width, 3) uint8 of the mesh with these vertices (V, 3).

        `normals` (V, 3) may be given where several views share them; `accents` (V,) are those of
        `rig.face.web_export` (none: 0).
        """
        if normals is None:
            normals = vertex_normals(vertices, self._mesh.faces)
        if accents is None:
            accents = np.zeros(len(vertices), np.float32)
        return self._drawer.draw(vertices, normals, accents)

    def close(self) -> None:
        """Free the memory of the backend."""
        self._drawer.close()


def check_backend(backend: Backend) -> None:
    """Check that a backend is known and works here.

    Raises
    ------
    RigError
        For an unknown backend, or for ``opengl`` where it is not available.
    """
    if backend not in ("auto", "opengl", "software"):
        raise RigError(f"backend {backend!r} is unknown; use auto, opengl or software")
    if backend == "opengl":
        open_context()


def make_renderer(
    mesh: Mesh, *, size: tuple[int, int], view: View, backend: Backend = "auto"
) -> Renderer:
    """Choose a backend: ``auto`` takes OpenGL where a graphics processor draws, ours elsewhere.

    Raises
    ------
    RigError
        For an unknown backend, or for ``opengl`` where it is not available.
    """
    check_backend(backend)
    if backend == "opengl" or (backend == "auto" and has_graphics_processor()):
        return Renderer(mesh, OpenGLRenderer(mesh, size, view), "opengl")
    from rig.face.render.software import SoftwareRenderer  # compiles; half a second to import

    return Renderer(mesh, SoftwareRenderer(mesh, size, view), "software")
