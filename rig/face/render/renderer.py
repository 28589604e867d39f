"""One interface to both backends, and that of OpenGL."""

from functools import lru_cache
from importlib import import_module
from typing import Any, Literal, Protocol

import numpy as np

from rig.arrays import Float32, Float64
from rig.errors import RigError
from rig.face.geometry.mesh import Mesh, vertex_normals
from rig.face.render.shading import Picture, View, glsl, glsl_background

# Rendering by OpenGL 3.3 without a window (moderngl over EGL); moderngl is optional.


SUPERSAMPLE = 1.5
"""Side of the picture that is drawn, by the side of the one that is given back.

Mesa's software driver, where most videos are made, takes 45 ms for a frame of video this way and
62 ms with four samples a pixel.
"""
_WHOLE = """#version 330
out vec2 place;
void main() {
  vec2 p = vec2(gl_VertexID == 1 ? 3 : -1, gl_VertexID == 2 ? 3 : -1);
  place = 0.5 * p + 0.5; gl_Position = vec4(p, 0, 1);
}
"""
_SHRINK = """#version 330
in vec2 place; uniform sampler2D large; out vec4 color_;
void main() { color_ = texture(large, place); }
"""


class OpenGLRenderer:
    """Draws one mesh's poses on the GPU (or Mesa's software driver), supersampled.

    Raises
    ------
    RigError
        If moderngl is not installed or no OpenGL context can be made.
    """

    def __init__(self, mesh: Mesh, size: tuple[int, int], view: View) -> None:
        self.size, self.view = size, view
        self._context = open_context()
        self._things: list[Any] = []
        self._textures: list[Any] = []
        context, n, own = self._context, len(mesh.vertices), self._own
        vertex, fragment = glsl()
        self._program = own(context.program(vertex_shader=vertex, fragment_shader=fragment))
        self._points = own(context.buffer(reserve=n * 28))
        still = [mesh.colors, mesh.gloss, mesh.light, mesh.kind / 4, mesh.uv]
        paint = own(context.buffer(np.column_stack(still).astype("f4").tobytes()))
        index = own(context.buffer(mesh.faces.astype("i4").tobytes()))
        parts = [
            (self._points, "3f 3f 1f", "position", "normal", "accent"),
            (paint, "4f 3f 2f", "paint", "light", "place"),
        ]
        self._array = own(context.vertex_array(self._program, parts, index))
        for slot, name in enumerate(("atlas", "creases", "pores"), start=1):
            self._program[name].value = slot
            map_ = getattr(mesh.maps, name)
            texture = own(
                context.texture(map_.shape[1::-1], map_.shape[2], map_.tobytes(), alignment=1)
            )
            texture.build_mipmaps()
            texture.filter = context.LINEAR_MIPMAP_LINEAR, context.LINEAR
            self._textures.append(texture)
        large = (round(SUPERSAMPLE * size[0]), round(SUPERSAMPLE * size[1]))
        self._large = own(context.texture(large, 4))  # read with linear filtering, the default
        self._large.repeat_x = self._large.repeat_y = False
        depth = own(context.depth_renderbuffer(large))
        self._many = own(context.framebuffer([self._large], depth))
        self._one = own(context.framebuffer([own(context.renderbuffer(size, 4))]))
        self._shrink = self._whole_picture(_WHOLE, _SHRINK)
        self._sky = self._whole_picture(*glsl_background())

    def _own(self, thing: Any) -> Any:
        """Note what `close` has to release: moderngl releases nothing by itself."""
        self._things.append(thing)
        return thing

    def _whole_picture(self, vertex: str, fragment: str) -> Any:
        """Return a program over the whole picture."""
        program = self._own(self._context.program(vertex_shader=vertex, fragment_shader=fragment))
        return self._own(self._context.vertex_array(program, []))

    def draw(self, vertices: Float64, normals: Float64, accents: Float32) -> Picture:
        """Picture (height, width, 3) uint8 of the mesh with these vertices and normals."""
        width, height = self.size
        self._points.write(np.column_stack([vertices, normals, accents]).astype("f4").tobytes())
        matrix = self.view.matrix(width / height)
        self._program["view"].write(matrix.T.astype("f4").tobytes())
        self._program["eye"].value = tuple(float(x) for x in self.view.position)
        context = self._context
        self._many.use()
        context.enable(context.DEPTH_TEST)
        self._many.clear(0.0, 0.0, 0.0, 1.0)
        self._sky.render(vertices=3)
        context.enable(context.CULL_FACE)
        for slot, texture in enumerate(self._textures, start=1):
            texture.use(slot)
        self._array.render()
        context.disable(context.CULL_FACE | context.DEPTH_TEST)
        self._one.use()
        self._large.use(0)
        self._shrink.render(vertices=3)
        raw = np.frombuffer(self._one.read(components=3, alignment=1), np.uint8)
        return np.ascontiguousarray(raw.reshape(height, width, 3)[::-1])

    def close(self) -> None:
        """Free this renderer's buffers; the context stays for the next one."""
        while self._things:
            self._things.pop().release()


def has_graphics_processor() -> bool:
    """Whether OpenGL works and is not drawn by the main processor (Mesa's slower drivers)."""
    try:
        name = open_context().info["GL_RENDERER"].lower()
    except RigError:
        return False
    return not any(driver in name for driver in ("llvmpipe", "softpipe", "swrast", "swiftshader"))


@lru_cache(maxsize=1)
def open_context() -> Any:
    """The one OpenGL context of the process, so that none has to be made current."""
    try:
        moderngl: Any = import_module("moderngl")
    except ImportError as error:
        raise RigError(
            "OpenGL pictures need moderngl, which is not installed; "
            "pip install 'deitalk[preview]', or give `backend=software`",
            parameter="backend",
        ) from error
    try:
        return moderngl.create_context(standalone=True, backend="egl")
    except Exception as error:  # moderngl raises bare Exception when EGL or a driver is missing
        raise RigError(
            f"no OpenGL context could be made ({error}); install Mesa's EGL "
            "(Debian: libegl1 libgl1-mesa-dri), or give `backend=software`",
            parameter="backend",
        ) from error


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
