"""A GLB in the preview page: animation on the page's clock, sliders of shapes, refused files."""

import base64
import json
import struct

import numpy as np
import pytest
from typer.testing import CliRunner

from deitalk.cli import app
from deitalk.preview import page as page_module
from deitalk.preview.page import render_page
from deitalk.preview.source import PreviewSource
from rig import RigCurves, default_controls, write_curves
from rig.face import build_head
from rig.mesh.glb import GlbBuilder, WeightAnimation, write_container, write_glb
from rig.mesh.glb_reader import read_glb
from rig.mesh.shapes import ShapeSet
from rig.mesh.trimesh import TriMesh
from tests.browser import chromium, numbers, opened

CORNERS = np.array([[-1, 0, 0], [1, 0, 0], [0, 1.5, 0], [0, 0.5, 0.5]], float)
FACES = np.array([[0, 1, 3], [1, 2, 3], [2, 0, 3]])
OPEN, SMILE = np.zeros((4, 3)), np.zeros((4, 3))
OPEN[0], SMILE[1] = (0, -0.5, 0), (0.25, 0.25, 0)
SHAPES = ShapeSet(TriMesh(CORNERS, FACES), ("jaw_drop", "mouthSmile_L"), np.stack([OPEN, SMILE]))
WEIGHTS = np.array([[0, 0], [1, 0], [0, 1], [0.5, 0.5]])
FPS = 2.0
"""Frames at 0, 0.5, 1 and 1.5 s."""


@pytest.fixture(scope="module")
def browser():
    with chromium() as running:
        yield running


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A page with a take of 3 s and one without; GLBs with and without an animation."""
    folder = tmp_path_factory.mktemp("glb")
    controls = default_controls()
    curves = RigCurves(np.tile(controls.rest, (90, 1)), controls.names, 30.0)
    render_page(PreviewSource("still", curves, np.zeros(0, np.float32), 0), folder / "take.html")
    (folder / "bare.html").write_text(page_module.BUNDLE.read_text())
    write_glb(folder / "moving.glb", SHAPES, animation=WeightAnimation(WEIGHTS, FPS))
    write_glb(folder / "still.glb", SHAPES)
    return folder


@pytest.fixture(scope="module")
def tab(browser, folder):
    with opened(browser, folder / "take.html") as tab:
        yield tab


@pytest.fixture
def page(tab):
    """The page with the take, without a GLB."""
    tab.evaluate("deitalk.page.opener.close()")
    tab.complaints.clear()
    return tab


def open_glb(page, path) -> None:
    page.set_input_files("#file", path)
    page.wait_for_selector("figure.model canvas", timeout=120_000)


def vertices(page) -> np.ndarray:
    """Shown vertices from the page's state, (V, 3) in metres."""
    return numbers(page, "deitalk.page.state().model.vertices").reshape(-1, 3)


def seek(page, seconds: float) -> None:
    page.evaluate("s => deitalk.page.seek(s)", seconds)


def test_animation_follows_the_pages_clock(page, folder):
    open_glb(page, folder / "moving.glb")
    for seconds, jaw, smile in (
        (0, 0, 0), (0.25, 0.5, 0), (0.5, 1, 0), (0.75, 0.5, 0.5), (1.5, 0.5, 0.5), (2.9, 0.5, 0.5),
    ):  # fmt: skip
        seek(page, 1.2)  # the result must not depend on earlier seeks
        seek(page, seconds)
        assert np.abs(vertices(page) - (CORNERS + jaw * OPEN + smile * SMILE)).max() < 1e-6, seconds
        assert page.evaluate("deitalk.page.state().shown") == pytest.approx(seconds)
    assert "1.50 s of animation" in page.inner_text("figure.model figcaption")
    assert page.complaints == []


def test_without_animation_every_shape_has_a_slider(page, folder):
    open_glb(page, folder / "still.glb")
    assert page.locator(".sliders span").all_inner_texts() == ["jaw_drop", "mouthSmile_L"]
    page.locator(".sliders input").nth(1).fill("0.4")
    assert np.abs(vertices(page) - (CORNERS + 0.4 * SMILE)).max() < 1e-6
    seek(page, 1.0)
    assert np.abs(vertices(page) - (CORNERS + 0.4 * SMILE)).max() < 1e-6  # independent of time


def test_another_file_replaces_the_first_and_close_removes_it(page, folder):
    open_glb(page, folder / "moving.glb")
    page.set_input_files("#file", folder / "still.glb")
    page.wait_for_selector(".sliders")
    assert page.locator("#faces canvas").count() == 2  # the take's head and one GLB
    page.click("figure.model button")
    assert page.locator("#faces canvas").count() == 1
    assert page.evaluate("deitalk.page.state().model") is None


def test_a_dropped_file_opens(page, folder):
    data = base64.b64encode((folder / "moving.glb").read_bytes()).decode()
    page.evaluate(
        """data => {
             const bytes = Uint8Array.from(atob(data), c => c.charCodeAt(0));
             const dataTransfer = new DataTransfer();
             dataTransfer.items.add(new File([bytes], 'dropped.glb'));
             document.body.dispatchEvent(new DragEvent('drop', { dataTransfer, bubbles: true })); }""",
        data,
    )
    page.wait_for_selector("figure.model")
    assert page.inner_text("figure.model figcaption").startswith("dropped.glb: 2 shapes")


def test_shape_of_several_meshes_is_one_slider(page, tmp_path):
    """Face and teeth have shapes of the same names; the node is moved too."""
    builder = GlbBuilder()
    position = builder.dense(CORNERS, "VEC3", 34962)
    primitive = {
        "attributes": {"POSITION": position},
        "indices": builder.dense(FACES.astype(np.uint32).ravel(), "SCALAR", 34963),
        "targets": [{"POSITION": builder.sparse(len(OPEN), np.arange(len(OPEN)), OPEN)}],
    }
    named = {"primitives": [primitive], "extras": {"targetNames": ["jawOpen"]}}
    builder.json |= {
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0, 1]}],
        "meshes": [named, named],
        "nodes": [{"mesh": 0, "name": "face"}, {"mesh": 1, "translation": [3, 0, 0]}],
    }  # fmt: skip
    path = tmp_path / "two.glb"
    write_container(path, builder.json, bytes(builder.binary))
    open_glb(page, path)
    assert page.locator(".sliders input").count() == 1
    page.locator(".sliders input").fill("1")
    expected = np.concatenate([CORNERS + OPEN, CORNERS + OPEN + [3, 0, 0]])
    assert np.abs(vertices(page) - expected).max() < 1e-6


def glb_of(document: dict | bytes, binary: bytes = b"") -> bytes:
    """A container whose JSON chunk may be anything."""
    text = document if isinstance(document, bytes) else json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text
    chunks += struct.pack("<II", len(binary), 0x004E4942) + binary
    return struct.pack("<III", 0x46546C67, 2, 12 + len(chunks)) + chunks


ASSET = {"asset": {"version": "2.0"}, "meshes": [{"primitives": []}], "scenes": [{"nodes": []}]}
BAD = {
    "text": (b"this is a text, not a mesh", "is not a binary glTF 2.0 file"),
    "empty": (b"", "is not a binary glTF 2.0 file"),
    "old": (struct.pack("<III", 0x46546C67, 1, 20) + b" " * 8, "is not a binary glTF 2.0 file"),
    "json": (glb_of(b"{broken"), "has no readable JSON chunk"),
    "null": (glb_of(b"null"), "holds no mesh"),
    "outside": (glb_of(ASSET | {"buffers": [{"uri": "https://example.org/a.bin", "byteLength": 4}]}),
                "keeps its data in other files"),
    "picture": (glb_of(ASSET | {"images": [{"uri": "a.png"}]}), "keeps its data in other files"),
    "draco": (glb_of(ASSET | {"extensionsRequired": ["KHR_draco_mesh_compression"]}),
              "uses Draco compression"),
    "huge": (glb_of(ASSET | {"accessors": [{"count": 10**9, "type": "VEC3"}]}), "unpacks to"),
    "endless": (glb_of(ASSET | {"accessors": [{"count": "many", "type": "VEC3"}]}), "unpacks to"),
    "dangling": (glb_of(ASSET | {"scene": 0, "scenes": [{"nodes": [7]}], "nodes": []}),
                 "is inconsistent"),
    "nothing": (glb_of({"asset": {"version": "2.0"}}), "holds no mesh"),
}  # fmt: skip


@pytest.mark.parametrize(("data", "message"), BAD.values())
def test_bad_files_are_refused_in_one_line(page, tmp_path, data, message):
    page.evaluate("deitalk.page.opener.close()")
    page.evaluate("document.querySelector('#notice').textContent = ''")
    path = tmp_path / "bad.glb"
    path.write_bytes(data)
    page.set_input_files("#file", path)
    page.wait_for_function(
        "m => document.querySelector('#notice').textContent.includes(m)",
        arg=message,
        timeout=20_000,
    )
    notice = page.inner_text("#notice")
    assert notice.startswith("bad.glb") and "\n" not in notice
    assert page.locator("figure.model").count() == 0
    assert page.complaints == []


def test_file_cut_short_is_refused(page, folder, tmp_path):
    whole = (folder / "moving.glb").read_bytes()
    for share in (0.3, 0.9):
        path = tmp_path / f"cut{share}.glb"
        path.write_bytes(whole[: int(share * len(whole))])
        page.set_input_files("#file", path)
        page.wait_for_function(
            "n => document.querySelector('#notice').textContent == n + ' is cut short'",
            arg=path.name,
        )
        assert page.locator("figure.model").count() == 0 and page.complaints == []


def test_player_without_a_take_shows_a_glb(browser, folder):
    with opened(browser, folder / "bare.html") as tab:
        assert not tab.is_visible("#workbench")
        assert "drop a GLB" in tab.inner_text("#notice")
        open_glb(tab, folder / "moving.glb")
        seek(tab, 9)  # the duration is that of the file
        assert tab.evaluate("deitalk.page.state().shown") == pytest.approx(1.5, abs=1e-3)
        assert np.abs(vertices(tab) - (CORNERS + 0.5 * OPEN + 0.5 * SMILE)).max() < 1e-6
        tab.select_option("#speed", "0.25")  # a slow machine draws a frame a second
        tab.click("#play")
        tab.wait_for_function("deitalk.page.state().shown > 0.1 && deitalk.page.state().shown < 1")
        assert tab.complaints == []


@pytest.mark.slow
def test_take_and_head_of_our_own_writers_are_shown(page, tmp_path):
    """Files of `deitalk convert` and `deitalk face export` in the page."""
    controls, run = default_controls(), CliRunner()
    values = np.tile(controls.rest, (61, 1))
    for name, speed in (("CTRL_C_jaw.ty", 3.0), ("CTRL_L_eye_blink.ty", 5.0)):
        values[:, controls.index(name)] = 0.5 - 0.5 * np.cos(speed * np.arange(61) / 30)
    write_curves(tmp_path / "curves.json", RigCurves(values, controls.names, 30.0))
    files = [tmp_path / "take.glb", tmp_path / "head.glb"]
    convert = ["convert", str(tmp_path / "curves.json"), str(files[0])]
    for command in (convert, ["face", "export", "-o", str(files[1])]):
        assert run.invoke(app, command).exit_code == 0

    open_glb(page, files[0])
    head, seen = build_head(0), []
    for frame in (0, 20, 31, 60):
        seek(page, frame / 30)
        expected = head.pose(values[frame]) / 100
        assert np.linalg.norm(vertices(page) - expected, axis=1).max() < 2e-3  # straight lines
        page.wait_for_timeout(500)
        seen.append(page.locator("figure.model canvas").screenshot())
    assert len(set(seen)) == 4

    page.set_input_files("#file", files[1])
    page.wait_for_selector(".sliders", timeout=120_000)
    shapes = read_glb(files[1])
    assert page.locator(".sliders span").all_inner_texts() == list(shapes.names)
    page.locator(".sliders input").nth(list(shapes.names).index("jawOpen")).fill("1")
    opened_jaw = shapes.neutral.vertices + shapes.delta("jawOpen")
    assert np.abs(vertices(page) - opened_jaw).max() < 1e-6
    assert page.complaints == []
