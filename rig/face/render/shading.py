"""Light and material, equal in GLSL and in the compiled loops of `software`.

Linear light, wrapped diffuse (red wraps further, as light that passes through skin does),
Blinn-Phong highlights (Schlick's form without a power, 1994), a sky and ground ambient, baked
occlusion whose edge is red on skin, and a gentle shoulder. sRGB is approximated by a gamma of 2.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from rig.arrays import Float32, Float64
from rig.face.mesh import CLOTH, EYE, FINE, FINE_CM, HAIR, PORES, SKIN, unit

# Cameras: position, target and projection.

NEAR, FAR = 15.0, 140.0


@dataclass(frozen=True)
class View:
    """A camera at `position` looking at `target` (cm) with a vertical field of view."""

    target: tuple[float, float, float]
    position: tuple[float, float, float]
    degrees: float

    def matrix(self, aspect: float) -> Float64:
        """World to clip space, (4, 4), for column vectors; `aspect` is width / height."""
        eye, target = np.array(self.position), np.array(self.target)
        back = unit(eye - target)
        right = unit(np.cross([0.0, 1.0, 0.0], back))
        look = np.eye(4)
        look[:3, :3] = [right, np.cross(back, right), back]
        look[:3, 3] = -look[:3, :3] @ eye
        f = 1 / np.tan(np.radians(self.degrees) / 2)
        deep = [0, 0, (FAR + NEAR) / (NEAR - FAR), 2 * FAR * NEAR / (NEAR - FAR)]
        lens = np.array([[f / aspect, 0, 0, 0], [0, f, 0, 0], deep, [0, 0, -1, 0]])
        return np.asarray(lens @ look)


VIEWS = {
    "front": View((0, -3.4, 1), (0, -2.4, 66), 30),
    "three_quarter": View((0, -3.2, 1), (38, 0.9, 52), 29),
    "side": View((0, -3.2, -0.5), (66, -2.6, 2), 29),
    "face": View((0, -2.5, 3), (0, -1.9, 62), 25.5),
    "mouth": View((0, -8.1, 8), (0, -7.2, 46), 15),
    "mouth_side": View((0, -8.1, 7.5), (30, -6.3, 36), 15.5),
    "eyes": View((0, 0.6, 6), (0, 1.0, 46), 17),
    "neck": View((0, -9.5, 2), (0, -9.0, 52), 18),
    "ear": View((7, -1, -1), (42, 0, 24), 16),
}
"""Named cameras; +x (the character's left) is on the right of the picture."""


LIGHTS = (
    # direction to the light, colour times strength
    ((-0.58, 0.58, 0.66), (1.26, 1.165, 1.06)),
    ((0.80, 0.05, 0.60), (0.30, 0.32, 0.36)),
    ((0.62, 0.42, -0.72), (0.85, 0.91, 1.00)),
)
TO_LIGHT = unit(np.array([direction for direction, _ in LIGHTS]))
LIGHT_COLORS = np.array([color for _, color in LIGHTS])
WRAPS = np.array([[0.90, 0.82, 0.74], [0.40, 0.28, 0.23], [0.45, 0.40, 0.36], [0.25, 0.22, 0.2],
                  [0.1, 0.1, 0.1], [0.35, 0.32, 0.3]])  # fmt: skip
"""How far red, green and blue light reaches round, of PLAIN, SKIN, HAIR, EYE, CLOTH and FINE."""
DEEP, DIM = (0.27, 0.08, 0.07), 0.5
"""Colour of the mouth where its shadow is 1, and how much darker that shadow makes what it still
shows."""
UNDER_LID = (0.50, 0.56, 0.60)
"""How much darker the shadow of lids makes the eye."""
CREASE_TILT = 0.85
"""How far creases tilt normals, of what their map says."""
CREASE_RED = 0.2
"""How much redder skin is where creases are darkest: flesh scatters red light into them."""
GLOW = (0.16, 0.040, 0.030)
"""Light that comes through flesh where no other does."""
CATCH = unit(np.array([-0.30, 0.30, 0.90]))
"""Where eyes reflect the soft first light."""
WINDOW_EDGE, WINDOW = (0.962, 1.0), 0.85
"""Cosines to its middle between which its soft edge lies, and its light."""
WINDOW_TURN = 0.5
"""How far it goes to the other side of a camera that goes aside, so that irises show it."""
IRIS = 0.15
"""How much lighter the dark colours of eyes are than painted."""
PORE_TILT, PORE_SHADE, PORE_GLOSS = 0.13, 0.13, 0.6
"""How far pores tilt the normals of skin, and how much they shade it and vary its gloss."""
SHEEN = 0.25
"""Light of the sky that surfaces mirror at their edges, for what they scatter there."""
STRANDS, TINT = 0.35, 5.0
"""How far the highlights of light and dark strands of hair lie apart, and their colour over that of
the hair."""
RIM, HAIR_RIM = 0.35, 0.1
"""Light of the sky at the edges of surfaces, and of hair."""
CLOTH_PORES, CLOTH_SHADE = 6, 0.2
"""How often they are repeated on cloth, whose place in the picture is small, for once on skin, and
how much they shade it as a fabric's grain."""
SKY, GROUND = (0.175, 0.19, 0.22), (0.085, 0.07, 0.065)
SOLID = 0.75
"""Coverage above which hair, brows and lashes are drawn solid on a graphics card."""
BACKDROP, CORNERS = (0.27, 0.29, 0.315), (0.075, 0.08, 0.09)
"""Colours of the backdrop behind the head and in the corners of the picture."""


def background(width: int, height: int) -> Float32:
    """Colours (height, width, 3) sRGB, between 0 and 1."""
    y, x = (np.linspace(-1, 1, n + 1)[:-1] + 1 / n for n in (height, width))
    far = np.clip(0.75 * (x**2 + (y + 0.1)[:, None] ** 2), 0, 2) / 2
    share = (far * (2 - far)).astype(np.float32)
    found = np.empty((height, width, 3), np.float32)
    for k, (middle, corner) in enumerate(zip(BACKDROP, CORNERS, strict=True)):
        found[..., k] = share * (corner - middle) + middle
    return found


def _vec(values: Iterable[float]) -> str:
    return f"vec3({', '.join(f'{v:.6f}' for v in values)})"


_VERTEX = """#version 330
in vec3 position; in vec3 normal; in vec4 paint; in vec3 light; in float accent; in vec2 place;
uniform mat4 view;
centroid out vec3 n_; centroid out vec3 p_; centroid out vec4 paint_; centroid out vec3 light_;
centroid out float accent_; centroid out vec2 uv_;
void main() {
  n_ = normal; p_ = position; paint_ = paint; light_ = light; accent_ = accent; uv_ = place;
  gl_Position = view * vec4(position, 1.0);
  if (light.z > 0.9) gl_Position.z -= NEARER / gl_Position.w;  // brows
}
""".replace("NEARER", f"{2 * FINE_CM * NEAR * FAR / (FAR - NEAR):.6f}")


def glsl() -> tuple[str, str]:
    """Vertex and fragment shader: attributes are those of a mesh, and normals and accents.

    Two drawings make a picture: what is solid, then with `soft` set, blended and without writing
    depth, what of hair, brows and lashes lets light through.
    """
    others = "min(0.35 + 0.65 * light_.x, 3.0 * light_.x)"
    lamps = "".join(
        f"  lamp({_vec(d)}, {_vec(c)}, {'light_.y' if k == 0 else others});\n"
        for k, (d, c) in enumerate(zip(TO_LIGHT, LIGHT_COLORS, strict=True))
    )
    wraps = ", ".join(_vec(wrap) for wrap in WRAPS)
    fragment = f"""#version 330
centroid in vec3 n_; centroid in vec3 p_; centroid in vec4 paint_; centroid in vec3 light_;
centroid in float accent_; centroid in vec2 uv_;
uniform vec3 eye; uniform bool soft; uniform sampler2D atlas, creases, pores;
out vec4 color_;
const float SOLID = {SOLID};
const vec3 WRAPS[{len(WRAPS)}] = vec3[{len(WRAPS)}]({wraps});
vec3 n, v, wrap, diffuse, shine; float power, strength, facing, strand; int kind;
void lamp(vec3 d, vec3 c, float seen) {{
  float k = dot(n, d), bleed = kind == {SKIN} ? seen * (1.0 - seen) : 0.0;
  vec3 lit = clamp((k + wrap) / (1.0 + wrap), 0.0, 1.0);
  diffuse += c * lit * (0.72 + 0.28 * lit) * (seen + bleed * vec3(0.3, 0.12, 0.0));
  float both = sqrt(max(2.0 + 2.0 * dot(d, v), 1e-6)), near = clamp((k + facing) / both, 0.0, 1.0);
  float gate = clamp(5.0 * k, 0.0, 1.0);
  if (kind == {HAIR}) {{  // a lamp shines across strands, which hang down along the surface
    float fall = (n.y * (k + facing) - d.y - v.y) / (both * sqrt(max(1.0 - n.y * n.y, 0.05)));
    fall += {STRANDS} * (strand - 0.6);
    near = max(1.0 - fall * fall, 0.0); gate = clamp(0.3 + k, 0.0, 1.0);
  }}
  shine += gate * c * near / (power - power * near + near) * strength * seen;
}}
void main() {{
  v = normalize(eye - p_); n = normalize(n_); kind = int(light_.z * 5.0 + 0.5);
  vec4 tint = texture(atlas, uv_);
  bool hair = kind == {HAIR} || kind == {FINE}, thin = hair || kind == {CLOTH};
  if (hair ? tint.a < 0.02 || soft == (tint.a > SOLID) : soft) discard;
  if (!thin && !gl_FrontFacing) discard;
  if (thin) n -= 2.0 * min(dot(n, v), 0.0) * v;  // as its outside near the silhouette
  vec3 albedo = paint_.rgb * tint.rgb;
  float shade = 1.0, wet = 0.0, gloss = paint_.a; strand = 1.0;
  if (kind == {SKIN}) {{
    vec3 pore = texture(pores, uv_ * {PORES:.1f}).rgb * 2.0 - 1.0;
    vec4 fold = texture(creases, uv_); float crease = max(accent_, 0.0);
    shade += {PORE_SHADE} * pore.r; gloss *= 1.0 + {PORE_GLOSS} * pore.r;
    n.xy += {PORE_TILT} * pore.gb;
    n = normalize(n + {CREASE_TILT} * crease * (2.0 * fold.rgb - 1.0));
    float dark = crease * (1.0 - fold.a);
    shade *= 1.0 - dark; albedo.r *= 1.0 + {CREASE_RED} * dark;
  }} else if (kind == {CLOTH}) {{
    shade += {CLOTH_SHADE} * (2.0 * texture(pores, uv_ * {CLOTH_PORES * PORES:.1f}).r - 1.0);
  }} else if (kind == {HAIR}) strand = min(3.0 * albedo.r, 1.0);
  else if (kind == {EYE}) {{
    strand = 0.0;  // it mirrors a window alone, the white less
    wet = clamp(2.4 - 4.5 * albedo.b, 0.2, 1.0) * (1.0 - 0.6 * accent_);
    albedo *= (1.0 - accent_ * {_vec(UNDER_LID)}) * (1.0 + {IRIS} * (1.0 - albedo));
  }}
  if (kind <= {SKIN}) {{  // inside the mouth
    float dark = max(kind == {SKIN} ? -accent_ : accent_, 0.0);
    albedo = mix(albedo * (1.0 - {DIM} * dark), {_vec(DEEP)}, dark * dark); gloss *= 1.0 - dark;
  }}
  facing = dot(n, v); wrap = WRAPS[kind];
  float rim = kind == {EYE} ? 0.0 : kind == {HAIR} ? {HAIR_RIM} : {RIM};
  rim *= pow(1.0 - max(facing, 0.0), 3.0);
  vec3 sky = {_vec(SKY)};
  diffuse = (mix({_vec(GROUND)}, sky, 0.5 + 0.5 * n.y) + rim * sky) * light_.x;
  shine = {SHEEN} * rim * light_.x * sky;
  if (kind <= {SKIN}) diffuse += (1.0 - light_.x) * (1.0 - light_.x) * {_vec(GLOW)};
  power = 14.0 + 340.0 * gloss * gloss;
  strength = (0.16 * min(gloss, 0.28) + 0.50 * gloss * gloss * sqrt(max(gloss, 0.0))) * strand;
{lamps}  if (kind == {EYE}) {{
    vec3 mirror = 2.0 * facing * n - v;
    vec3 window = normalize({_vec(CATCH)} - vec3({WINDOW_TURN} * v.x, 0.0, 0.0));
    float glow = smoothstep({WINDOW_EDGE[0]}, {WINDOW_EDGE[1]}, dot(mirror, window));
    shine += ({WINDOW} * glow * glow + 0.03 * clamp(mirror.y + 0.3, 0.0, 1.0)) * wet;
  }}
  if (kind == {HAIR}) shine *= {TINT} * albedo;
  vec3 linear = albedo * albedo * shade * diffuse + shine;
  linear = sqrt(clamp(linear * 1.12 / (1.0 + 0.12 * linear), 0.0, 1.0));
  color_ = vec4(linear, soft ? tint.a : 1.0);
}}
"""
    return _VERTEX, fragment


def glsl_background() -> tuple[str, str]:
    """Vertex and fragment shader of the backdrop, for one triangle that covers the screen."""
    vertex = """#version 330
out vec2 place;
void main() {
  vec2 p = vec2(gl_VertexID == 1 ? 3 : -1, gl_VertexID == 2 ? 3 : -1);
  place = p; gl_Position = vec4(p, 0.9999, 1);
}
"""
    fragment = f"""#version 330
in vec2 place; out vec4 color_;
void main() {{
  float far = clamp(0.375 * (place.x * place.x + (place.y - 0.1) * (place.y - 0.1)), 0.0, 1.0);
  color_ = vec4(mix({_vec(BACKDROP)}, {_vec(CORNERS)}, far * (2.0 - far)), 1);
}}
"""
    return vertex, fragment
