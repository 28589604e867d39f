"""Light and material, equal in numpy and GLSL.

Linear light, wrapped diffuse (red wraps further, as in skin), Blinn-Phong highlights, a sky and
ground ambient, and a gentle shoulder. sRGB is approximated by a gamma of 2.
"""

import numpy as np

from rig.arrays import Float32, Float64
from rig.face.geometry.mesh import unit

LIGHTS = (
    # direction to the light, colour times strength
    ((0.62, 0.62, 0.70), (1.02, 0.96, 0.89)),
    ((-0.85, 0.15, 0.55), (0.24, 0.28, 0.35)),
    ((-0.55, 0.45, -0.75), (0.70, 0.80, 0.95)),
    ((0.85, 0.10, -0.50), (0.40, 0.34, 0.30)),
)
WRAP = (0.38, 0.22, 0.16)
SKY, GROUND = (0.22, 0.24, 0.27), (0.10, 0.085, 0.08)
BACKGROUND_TOP, BACKGROUND_BOTTOM = (0.30, 0.33, 0.37), (0.15, 0.165, 0.19)


def _column(values: tuple[float, ...]) -> Float32:
    return np.array(values, np.float32)[:, None]


_WRAP, _SKY, _GROUND = _column(WRAP), _column(SKY), _column(GROUND)
_TO_LIGHT = unit(np.array([direction for direction, _ in LIGHTS])).astype(np.float32)
_LIGHT = [_column(color) for _, color in LIGHTS]


def shade(albedo: Float32, normals: Float32, to_eye: Float32, gloss: Float32) -> Float32:
    """Colour of surface points, as the shader of `glsl` gives it.

    Parameters
    ----------
    albedo : ndarray [shape=(3, n)]
        sRGB in 0..1.
    normals, to_eye : ndarray [shape=(3, n)]
        Normals of any length, and unit vectors towards the camera.
    gloss : ndarray [shape=(n,)]
        0..1.

    Returns
    -------
    color : ndarray [shape=(3, n)], float32, sRGB in 0..1
    """
    n = normals / np.sqrt(np.einsum("cn,cn->n", normals, normals) + np.float32(1e-12))
    up = 0.5 + 0.5 * n[1]
    diffuse = _GROUND + (_SKY - _GROUND) * up
    highlight = np.zeros_like(albedo)
    power, strength = 10 + 240 * gloss**2, 0.16 * np.minimum(gloss, 0.28)
    strength += 0.50 * gloss**2 * np.sqrt(np.maximum(gloss, 0))
    along_eye, cosines, eyes = np.einsum("cn,cn->n", n, to_eye), _TO_LIGHT @ n, _TO_LIGHT @ to_eye
    for cosine, eye, color in zip(cosines, eyes, _LIGHT, strict=True):
        lit = np.clip((cosine + _WRAP) / (1 + _WRAP), 0, 1)
        diffuse += color * lit * (0.72 + 0.28 * lit)
        shine = np.exp(power * _log_half_cosine(cosine + along_eye, eye)) * strength * (cosine > 0)
        highlight += shine * color
    linear = albedo * albedo * diffuse + highlight
    return np.asarray(np.sqrt((linear * 1.12 / (1 + 0.12 * linear)).clip(0, 1)))


def _log_half_cosine(total: Float32, eye: Float32) -> Float32:
    """Logarithm of n.(d + v) / |d + v|, of normal and half vector (exp and log beat a power)."""
    return np.asarray(np.log(np.clip(total / np.sqrt(np.maximum(2 + 2 * eye, 1e-6)), 1e-3, 1)))


def background(height: int) -> Float64:
    """One column (height, 1, 3) sRGB, top to bottom."""
    t = np.linspace(0, 1, height)[:, None, None]
    return np.array(BACKGROUND_TOP) * (1 - t) + np.array(BACKGROUND_BOTTOM) * t


def _vec(values: tuple[float, ...]) -> str:
    return f"vec3({', '.join(f'{v:.6f}' for v in values)})"


def glsl() -> tuple[str, str]:
    """Vertex and fragment shader of the same light."""
    lamps = "".join(
        f"  lamp({_vec(tuple(unit(np.array(d))))}, {_vec(c)}, n, v, paint_.a, diffuse, shine);\n"
        for d, c in LIGHTS
    )
    vertex = """#version 330
in vec3 position; in vec3 normal; in vec4 paint;
uniform mat4 view;
centroid out vec3 n_; centroid out vec3 p_; centroid out vec4 paint_;
void main() {
  n_ = normal; p_ = position; paint_ = paint; gl_Position = view * vec4(position, 1.0);
}
"""
    fragment = f"""#version 330
centroid in vec3 n_; centroid in vec3 p_; centroid in vec4 paint_;
uniform vec3 eye; out vec4 color_;
void lamp(vec3 d, vec3 c, vec3 n, vec3 v, float g, inout vec3 diffuse, inout vec3 shine) {{
  float k = dot(n, d); vec3 w = {_vec(WRAP)};
  vec3 lit = clamp((k + w) / (1.0 + w), 0.0, 1.0);
  diffuse += c * lit * (0.72 + 0.28 * lit);
  if (k > 0.0) shine += c * pow(clamp(dot(n, normalize(d + v)), 0.0, 1.0), 10.0 + 240.0 * g * g)
    * (0.16 * min(g, 0.28) + 0.50 * pow(g, 2.5));
}}
void main() {{
  vec3 v = normalize(eye - p_), n = normalize(n_);
  vec3 diffuse = mix({_vec(GROUND)}, {_vec(SKY)}, 0.5 + 0.5 * n.y), shine = vec3(0.0);
{lamps}  vec3 linear = paint_.rgb * paint_.rgb * diffuse + shine;
  color_ = vec4(sqrt(clamp(linear * 1.12 / (1.0 + 0.12 * linear), 0.0, 1.0)), 1.0);
}}
"""
    return vertex, fragment


def glsl_background() -> tuple[str, str]:
    """Vertex and fragment shader of the backdrop, for one triangle that covers the screen."""
    vertex = """#version 330
out float top;
void main() {
  vec2 p = vec2(gl_VertexID == 1 ? 3 : -1, gl_VertexID == 2 ? 3 : -1);
  top = 0.5 * p.y + 0.5; gl_Position = vec4(p, 0.9999, 1);
}
"""
    fragment = f"""#version 330
in float top; out vec4 color_;
void main() {{
  color_ = vec4(mix({_vec(BACKGROUND_BOTTOM)}, {_vec(BACKGROUND_TOP)}, top), 1);
}}
"""
    return vertex, fragment
