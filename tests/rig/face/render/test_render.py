"""Pictures: light and edges as of OpenGL, sheets, letters and PNG."""

from dataclasses import replace
from io import BytesIO

import numpy as np
import pytest
from PIL import Image
from scipy.spatial import Delaunay, cKDTree

from deitalk.research.contact_sheet import SHEETS, Tile, draw_sheet, sheet_tiles
from deitalk.research.poses import pose_values
from rig.face import IDENTITIES, build_head
from rig.face.accents import accents
from rig.face.mesh import FINE, HAIR, Mesh
from rig.face.render import VIEWS, View
from rig.face.render.picture import png, text_width, write_text
from rig.face.render.shading import background, glsl, glsl_background
from rig.face.render.software import Renderer, Screen, front_faces, nearest_faces

PEOPLE = [identity.name for identity in IDENTITIES]
SIZE = (72, 80)
FROM_FRONT = View((0, 0, 0), (0, 0, 60), 20)


def square(z: float, color: tuple[float, float, float], half: float = 4.0) -> Mesh:
    corner = np.array([[-half, -half, z], [half, -half, z], [half, half, z], [-half, half, z]])
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    return Mesh(corner, faces, np.tile(color, (4, 1)).astype(float), np.zeros(4))


def draw(mesh: Mesh, size=SIZE, view=FROM_FRONT) -> np.ndarray:
    return Renderer(mesh, size, view).render(mesh.vertices)


@pytest.fixture(scope="module")
def head():
    return build_head(0)


def test_square_covers_its_projected_pixels():
    # 8 cm at 60 cm under 20 degrees of 80 pixels: 80 * 8 / (2 * 60 * tan 10 deg) = 30.2 pixels
    red = draw(square(0, (1, 0, 0)))[..., 0] > 120
    assert red.sum(0).max() == pytest.approx(30.2, abs=1.5)
    assert red.any(0).sum() == pytest.approx(30.2, abs=1.5)
    assert red[40, 36]
    assert not red[5, 5]


def test_nearer_square_hides_the_farther():
    near, far = square(5, (0, 1, 0), 2), square(-5, (1, 0, 0), 6)
    both = Mesh(
        np.concatenate([near.vertices, far.vertices]),
        np.concatenate([far.faces + 4, near.faces]),
        np.concatenate([near.colors, far.colors]),
        np.zeros(8),
    )
    picture = draw(both).astype(int)
    assert picture[40, 36, 1] > picture[40, 36, 0] + 50  # green in the middle
    assert picture[40, 36 + 16, 0] > picture[40, 36 + 16, 1] + 50  # red beside it


def test_back_faces_are_not_drawn():
    front = square(0, (1, 0, 0))
    back = Mesh(front.vertices, front.faces[:, ::-1], front.colors, front.gloss)
    empty = background(72, 80) * 255
    assert np.abs(draw(back) - empty).max() < 2


def test_characters_left_is_on_the_right_of_the_picture(head):
    shut = pose_values({"CTRL_L_eye_blink.ty": 1})
    renderer = Renderer(head.mesh, (160, 120), VIEWS["eyes"])
    change = np.abs(
        renderer.render(head.pose(shut)).astype(int)
        - renderer.render(head.mesh.vertices).astype(int)
    ).sum(2)
    assert change[:, 80:].sum() > 20 * max(change[:, :80].sum(), 1)


def drawn_by_opengl(
    mesh: Mesh, size: tuple[int, int], view: View, accent: np.ndarray | float = 0
) -> np.ndarray:
    """The mesh by the shaders of the page, four samples a pixel."""
    moderngl = pytest.importorskip("moderngl")
    try:
        context = moderngl.create_context(standalone=True, backend="egl")
    except Exception as error:  # moderngl raises bare Exception when EGL or a driver is missing
        pytest.skip(str(error))
    vertex, fragment = glsl()
    program = context.program(vertex_shader=vertex, fragment_shader=fragment)
    n, normals = len(mesh.vertices), mesh.normals(mesh.vertices)
    columns = [mesh.vertices, normals, mesh.colors, mesh.gloss, mesh.light, mesh.kind / 5]
    table = np.column_stack([*columns, np.broadcast_to(accent, n), mesh.uv]).astype("f4")
    names = ("position", "normal", "paint", "light", "accent", "place")
    parts = [(context.buffer(table.tobytes()), "3f 3f 4f 3f 1f 2f", *names)]
    array = context.vertex_array(program, parts, context.buffer(mesh.faces.astype("i4").tobytes()))
    for slot, name in enumerate(("atlas", "creases", "pores")):
        map_ = getattr(mesh.maps, name)
        texture = context.texture(map_.shape[1::-1], map_.shape[2], map_.tobytes(), alignment=1)
        texture.build_mipmaps()
        texture.use(slot)
        program[name].value = slot
    program["view"].write(view.matrix(size[0] / size[1]).T.astype("f4").tobytes())
    program["eye"].value = tuple(map(float, view.position))
    many = context.simple_framebuffer(size, samples=4)
    many.use()
    many.clear()
    backdrop = context.program(*glsl_background())
    context.vertex_array(backdrop, []).render(vertices=3)
    context.enable(context.DEPTH_TEST)
    for soft in (False, True):
        program["soft"].value = soft
        if soft:
            context.enable(context.BLEND)
            many.depth_mask = False
        array.render()
    one = context.simple_framebuffer(size)
    context.copy_framebuffer(one, many)
    raw = np.frombuffer(one.read(components=3, alignment=1), np.uint8)
    context.release()
    return raw.reshape(*size[::-1], 3)[::-1].astype(int)


@pytest.mark.parametrize(
    ("parts", "most", "most_of_97"), [("face", 1.6, 8), ("face and hair", 3.0, 12)]
)
def test_face_is_drawn_as_by_the_shaders_of_the_page(head, parts, most, most_of_97):
    """Strands of hair are narrower than a pixel: both renderers sample them differently."""
    size, mesh = (300, 330), head.mesh
    if parts == "face":
        is_hair = np.isin(mesh.kind[mesh.faces[:, 0]], (HAIR, FINE))
        mesh = replace(mesh, faces=mesh.faces[~is_hair])
    pictures = [
        draw(mesh, size, VIEWS["face"]).astype(int),
        drawn_by_opengl(mesh, size, VIEWS["face"]),
    ]
    # Means of 3 x 3 pixels: edges of single hairs are sampled differently.
    blocks = [p.reshape(110, 3, 100, 3, 3).mean((1, 3)) for p in pictures]
    backdrop = np.round(255 * background(*size))
    is_head = (np.abs(pictures[1] - backdrop) > 2).any(axis=2)
    inside = is_head.reshape(110, 3, 100, 3).all((1, 3))
    assert 0.3 < inside.mean() < 0.9
    difference = np.abs(blocks[0] - blocks[1]).mean(2)[inside]
    assert difference.mean() < most
    assert np.percentile(difference, 97) < most_of_97


def shown(person: str, view: View, size=(360, 300), **raised):
    """Brightness (h, w) of a person in a pose, and a function from vertices to (column, row)."""
    head, values = build_head(person), pose_values(raised)[None]
    pose = head.pose(values)
    renderer = Renderer(head.mesh, size, view)
    picture = renderer.render(pose[0].astype(float), accents=accents(head, values, pose)[0])

    def place(vertices):
        points = np.c_[pose[0, vertices], np.ones(len(vertices))]
        x, y, _, w = view.matrix(size[0] / size[1]) @ points.T
        return np.stack([(x / w + 1) * size[0] / 2, (1 - y / w) * size[1] / 2], 1).astype(int)

    return head, picture.mean(2), place


def test_shadows_and_creases_are_drawn_as_by_the_shaders_of_the_page(head):
    """With eyes half shut, a raised brow and an open mouth, all of which accents darken."""
    raised = {"*eye_blink.ty": 0.3, "*brow_raiseIn.ty": 1, "CTRL_C_jaw.ty": 0.5}
    values, size = pose_values(raised)[None], (300, 330)
    pose = head.pose(values)
    accent = accents(head, values, pose)[0]
    is_hair = np.isin(head.mesh.kind[head.mesh.faces[:, 0]], (HAIR, FINE))
    mesh = replace(head.mesh, vertices=pose[0].astype(float), faces=head.mesh.faces[~is_hair])
    for view in (VIEWS["eyes"], VIEWS["mouth"]):
        ours = Renderer(mesh, size, view).render(mesh.vertices, accents=accent)
        theirs = drawn_by_opengl(mesh, size, view, accent)
        blocks = [p.astype(int).reshape(110, 3, 100, 3, 3).mean((1, 3)) for p in (ours, theirs)]
        difference = np.abs(blocks[0] - blocks[1]).mean(2)[theirs.any(2)[::3, ::3]]
        assert difference.mean() < 1.6
        assert np.percentile(difference, 97) < 8


@pytest.mark.parametrize("person", PEOPLE)
def test_closed_lips_meet_in_one_smooth_line(person):
    """Lips that pass through one another in front of their contact make steps in the line."""
    head, light, place = shown(person, VIEWS["mouth"], (540, 450))
    columns, rows = place(head.lip_rims[0]).T
    first, last, middle = columns.min() + 25, columns.max() - 25, int(rows.mean())
    line = light[middle - 15 : middle + 16, first:last].argmin(0)  # darkest row of each column
    assert np.abs(np.diff(line)).max() <= 2


@pytest.mark.parametrize("person", PEOPLE)
def test_reflections_leave_the_pupils_dark(person):
    """A sharp reflection lies beside a dark pupil; a wide faint one covers it like a film."""
    head, light, place = shown(person, VIEWS["eyes"], (600, 500))
    for column, row in place([head.slices[f"eye_{s}"].start for s in "LR"]):
        assert np.percentile(light[row - 5 : row + 6, column - 5 : column + 6], 75) < 43


@pytest.mark.parametrize("person", PEOPLE)
def test_hair_has_strands_before_its_edge(person):
    """Strands that stand on the bare skin of the forehead or the temples make the hairline soft."""
    head = build_head(person)
    hair = head.mesh.vertices[head.slices["hair"]]
    high = cKDTree(head.skin.vertices).query(hair)[0]
    rooted = hair[(high < 0.3) & (hair[:, 2] > 0) & (hair[:, 1] > 0)]
    before_hair = cKDTree(hair[high >= 0.3]).query(rooted)[0] > 0.25
    assert before_hair.sum() > 40


def random_screen(rng, count: int = 60, size: int = 48) -> tuple[Screen, np.ndarray]:
    """Triangles all over a small picture, some beyond its edges, seen from their outside."""
    x, y = rng.uniform(-8, size + 8, (2, 3 * count)).astype(np.float32)
    screen = Screen(size, size, x, y, rng.random(3 * count).astype(np.float32))
    faces = np.arange(3 * count).reshape(-1, 3)
    return screen, front_faces(screen, np.concatenate([faces, faces[:, ::-1]]))


def test_nearest_face_equals_that_of_exhaustive_search(rng):
    screen, faces = random_screen(rng)
    assert len(faces) == 60  # of each triangle and its back exactly one is in front
    face, depth = nearest_faces(screen, faces)
    y, x = np.mgrid[0 : screen.height, 0 : screen.width] + 0.5
    best, first = np.full(x.shape, np.inf), np.full(x.shape, -1)
    for k, corners in enumerate(faces):
        matrix = np.stack([screen.x[corners], screen.y[corners], np.ones(3)]).astype(float)
        weights = np.linalg.solve(matrix, np.stack([x.ravel(), y.ravel(), np.ones(x.size)]))
        z = (screen.depth[corners] @ weights).reshape(x.shape)
        closer = (weights.min(0).reshape(x.shape) > 0) & (z < best)
        best[closer], first[closer] = z[closer], k
    assert (face == first).mean() > 0.998  # a sample on an edge may fall to either side
    same = (face == first) & (face >= 0)
    assert same.sum() > 500
    assert np.abs(depth[same] - best[same]).max() < 1e-4
    assert np.isinf(depth[face < 0]).all()


def test_faces_behind_what_is_filled_first_are_left_out_and_no_other(rng):
    """A face that covers the picture at half of the depth, before others at any depth."""
    screen, faces = random_screen(rng)
    x, y = np.append(screen.x, [-99, -99, 200]), np.append(screen.y, [-99, 200, -99])
    depth = np.append(screen.depth, [0.4, 0.5, 0.6])
    screen = Screen(48, 48, *(part.astype(np.float32) for part in (x, y, depth)))
    last = np.arange(len(x) - 3, len(x))
    cover = front_faces(screen, np.stack([last, last[::-1]]))
    order = np.concatenate([cover, faces])
    found, wanted = nearest_faces(screen, order, 1), nearest_faces(screen, order)
    assert 5 < len(np.unique(wanted[0])) < 60  # some lie in front of it, some behind
    np.testing.assert_array_equal(found[0], wanted[0])
    np.testing.assert_array_equal(found[1], wanted[1])


def test_neighbouring_triangles_leave_no_crack_and_share_no_sample(rng):
    corners = np.array([[0, 0], [48, 0], [48, 48], [0, 48]], np.float32)
    inner = rng.uniform(1, 47, (80, 2)).astype(np.float32)
    points = np.concatenate([corners, inner])
    depth = np.zeros(len(points), np.float32)
    screen = Screen(48, 48, points[:, 0], points[:, 1], depth)
    faces = Delaunay(points).simplices.astype(np.int64)
    faces = front_faces(screen, np.concatenate([faces, faces[:, ::-1]]))
    face, _ = nearest_faces(screen, faces)
    assert (face >= 0).all()
    alone = sum((nearest_faces(screen, f[None])[0] >= 0).astype(int) for f in faces)
    assert (alone == 1).all()


@pytest.mark.parametrize("name", SHEETS)
def test_every_sheet_has_named_tiles(name):
    tiles = sheet_tiles(name)
    assert len({tile.title for tile in tiles}) == len(tiles) >= 2
    assert all(tile.view in VIEWS for tile in tiles)


def test_sheet_places_tiles_row_by_row(head):
    tiles = [Tile(str(k), pose_values({"CTRL_C_jaw.ty": k / 3}), "mouth") for k in range(3)]
    picture = draw_sheet(head, tiles, columns=2, size=(64, 48))
    assert picture.shape == (96, 128, 3)
    assert not picture[48:, 64:].any()  # the fourth place is empty
    assert (picture[:48, :64] != picture[48:, :64]).any()


@pytest.mark.parametrize("mode", ["RGB", "RGBA"])
def test_png_holds_the_picture_unchanged(rng, mode):
    picture = rng.integers(0, 256, (5, 7, len(mode))).astype(np.uint8)
    with Image.open(BytesIO(png(picture))) as read:
        assert (read.format, read.size, read.mode) == ("PNG", (7, 5), mode)
        np.testing.assert_array_equal(np.asarray(read), picture)


def test_letters_differ_and_stand_at_their_place():
    blank = np.zeros((20, 60, 3), np.uint8)
    pictures = {c: write_text(blank, c, (2, 3)) for c in "ABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789"}
    for picture in pictures.values():
        rows = np.flatnonzero(picture.any(axis=(1, 2)))
        assert rows[0] in (2, 3, 4) and rows[-1] - rows[0] in (10, 11, 12)
    assert len({picture.tobytes() for picture in pictures.values()}) == len(pictures)
    assert not blank.any()


def test_text_is_cut_off_at_the_edge_and_fits_its_width():
    blank = np.zeros((20, 60, 3), np.uint8)
    cut = write_text(blank, "WIDE TEXT THAT RUNS OUT", (50, 15), color=(9, 8, 7))
    assert cut.shape == blank.shape and cut[:, :49].max() == 0 and cut.max() == 9
    width = text_width("jaw", 9)
    assert np.flatnonzero(write_text(blank, "jaw", (0, 3), height=9).any(axis=(0, 2)))[-1] <= width


@pytest.mark.parametrize("identity", [0, 1, 3])
def test_face_view_holds_the_chin_of_an_open_jaw(identity):
    head = build_head(identity)
    posed = head.pose(pose_values({"CTRL_C_jaw.ty": 1.0}))
    jaw = posed[[head.landmarks["chin"], head.landmarks["lower_lip_bottom"]]]
    clip = np.c_[jaw, np.ones(len(jaw))] @ VIEWS["face"].matrix(540 / 480).T
    height = clip[:, 1] / clip[:, 3]
    assert height.min() > -0.98
