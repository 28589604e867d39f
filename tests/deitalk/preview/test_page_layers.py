"""Layers of edits in the page: the same curves as in Python, dragging, the list, undo, files."""

import json
from dataclasses import replace

import numpy as np
import pytest

from deitalk.config.rules import KeepContacts
from deitalk.postprocess.control_groups import ControlGroups
from deitalk.preview.page import render_page
from rig import default_controls
from rig.curves.apply_layers import apply_layers
from rig.curves.layer_files import parse_layers, read_layers
from rig.curves.layers import Edit, Layer
from tests.browser import chromium, needs_player, numbers, opened
from tests.deitalk.preview.test_page import RESET, drag, make_source

BOARD = default_controls()
CLOSURES = ControlGroups(BOARD).closures(KeepContacts())
JAW, BROW = "CTRL_C_jaw.ty", "CTRL_L_brow_raiseOut.ty"


@pytest.fixture(scope="module")
def source():
    made = make_source("first")
    head = np.linspace(0, 6, 90 * 6).reshape(90, 6).astype(np.float32)
    return replace(made, curves=replace(made.curves, head=head))


@pytest.fixture(scope="module")
def tab(source, tmp_path_factory):
    needs_player()
    folder = tmp_path_factory.mktemp("layers")
    render_page([source], folder / "one.html")
    with chromium() as browser, opened(browser, folder / "one.html") as tab:
        yield tab


@pytest.fixture
def page(tab):
    tab.complaints.clear()
    tab.evaluate(RESET)
    tab.evaluate("deitalk.page.workbench.layers.choose('CTRL_C_jaw.ty')")
    return tab


def shown(page) -> np.ndarray:
    """Curves of all frames as the page has them."""
    rows = numbers(
        page,
        "Float32Array.from(Array.from({ length: 90 }, (_, k) => [...deitalk.page.take.frame(k)]).flat())",
    )
    return rows.reshape(90, 185)


def layers_of(page) -> tuple[Layer, ...]:
    return parse_layers(page.evaluate("JSON.stringify(deitalk.page.history.edit.layers)"))


def python(source, layers):
    return apply_layers(source.curves, layers, closures=CLOSURES)[0]


KEYS = ((0.5, 0.1, 0.0, 1.0), (1.0, 0.6, -0.5, 0.2), (1.6, -0.3, 0.0, 0.0))
CASES = {
    "offset": (Edit(JAW, KEYS, "offset", (0.5, 1.6), (0.2, 0.3)),),
    "scale": (Edit("mouth", KEYS, "scale", (0.4, 2.0), (0.1, 0.0)),),
    "own": (Edit("CTRL_L_mouth_lipsTogetherU.ty", ((0.0, 0.0, 0, 0),), "own", (0.2, 2.5)),),
    "owned offset": (Edit(JAW, KEYS, "offset", (0.5, 1.6), owns=True),),
    "seals": (Edit("mouth", ((0.0, -0.5, 0, 0),), "offset", (0.0, 3.0)),),
    "set": (Edit("left", KEYS, "offset", (0.5, 2.9)),),
    "several": (
        Edit(BROW, KEYS, "own", (0.5, 1.6)),
        Edit("brow", KEYS, "scale", (0.0, 1.2)),
        Edit(BROW, KEYS, "offset", (1.0, 3.0), (0.5, 0.5)),
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_the_page_applies_layers_as_python_does(page, source, case):
    layer = Layer(CASES[case], "one")
    page.evaluate("layers => deitalk.page.history.change({ layers })", [layer.tree()])
    found, wanted = shown(page), python(source, [layer]).values
    assert np.abs(found - wanted).max() < 1e-5
    assert np.abs(found - source.curves.values).max() > 0.02
    muted = replace(layer, muted=True)
    page.evaluate("layers => deitalk.page.history.change({ layers })", [muted.tree()])
    assert np.abs(shown(page) - source.curves.values).max() < 1e-6


def test_the_head_follows_its_edits(page, source):
    layer = Layer((Edit("head.pitch", ((0.0, 5.0, 0, 0),), "offset", (1.0, 2.0), (0.5, 0.0)),))
    page.evaluate("layers => deitalk.page.history.change({ layers })", [layer.tree()])
    found = numbers(
        page, "Float32Array.from([1.2, 1.9].flatMap((t) => [...deitalk.page.take.headAt(t)]))"
    )
    head = python(source, [layer]).head[[36, 57]]
    assert np.abs(found.reshape(2, 6) - head).max() < 1e-4


def place(page, source, seconds, value, target=JAW):
    """Where the lane has a time and a value of its control."""
    box = page.locator("#layer-lane").bounding_box()
    column = BOARD.index(target)
    low, high = BOARD.minimum[column], BOARD.maximum[column]
    level = float((value - low) / (high - low))
    return box["x"] + seconds / 3 * box["width"], box["y"] + 10 + (1 - level) * (box["height"] - 20)


def test_a_curve_is_dragged_at_a_frame_and_undone(page, source, tmp_path):
    before = shown(page)
    jaw = before[45, BOARD.index(JAW)]
    page.locator("#layer-lane").scroll_into_view_if_needed()
    drag(page, place(page, source, 1.5, jaw), place(page, source, 1.5, jaw + 0.3))
    (layer,) = layers_of(page)
    (edit,) = layer.edits
    assert edit.target == JAW and edit.mode == "offset" and len(edit.keys) == 3
    assert edit.keys[1][:2] == pytest.approx((1.5, 0.3), abs=0.03)
    found = shown(page)
    assert np.abs(found - python(source, [layer]).values).max() < 1e-5
    changed = np.flatnonzero(np.abs(found - before).max(axis=1) > 1e-6)
    assert 36 <= changed.min() and changed.max() <= 54  # a quarter of a second to either side
    with page.expect_download() as download:
        page.click("#save-layers")
    download.value.save_as(tmp_path / "fixes.edit.json")
    assert read_layers(tmp_path / "fixes.edit.json") == (layer,)
    page.keyboard.press("Control+z")
    assert np.abs(shown(page) - before).max() < 1e-6
    assert page.locator("#layer-lane circle").count() == 0
    page.keyboard.press("Control+y")
    assert page.locator("#layer-lane circle").count() == 3
    assert page.complaints == []


def test_a_single_frame_is_dragged_alone_and_within_another_edit(page, source):
    """With a reach of one frame a drag moves no other frame, of a control or a region."""
    before, column = shown(page), BOARD.index(JAW)
    lane = page.locator("#layer-lane")
    lane.scroll_into_view_if_needed()
    page.fill("#edit-reach", "1")
    drag(page, place(page, source, 1.51, before[45, column]), place(page, source, 1.51, 0.9))
    change = shown(page) - before
    assert np.flatnonzero(np.abs(change).max(axis=1) > 1e-6).tolist() == [45]
    assert change[45, column] == pytest.approx(0.9 - before[45, column], abs=0.03)
    # Within a longer edit the frames beside it keep that edit's curve.
    page.keyboard.press("Control+z")
    longer = Layer(
        (Edit(JAW, ((0.5, 0, 0, 0), (1.5, 0.4, 0, 0.1), (2.5, 0, 0, 0)), "offset", (0.5, 2.5)),)
    )
    page.evaluate("layers => deitalk.page.history.change({ layers })", [longer.tree()])
    was = shown(page)
    drag(
        page,
        place(page, source, 1.0, was[30, column]),
        place(page, source, 1.0, was[30, column] - 0.1),
    )
    (layer,) = layers_of(page)
    (edit,) = layer.edits
    assert len(edit.keys) == 6 and edit.span == (0.5, 2.5)
    change = shown(page) - was
    assert np.flatnonzero(np.abs(change).max(axis=1) > 1e-4).tolist() == [30]
    assert np.abs(shown(page) - python(source, [layer]).values).max() < 1e-5
    # A region, and a drag to either side, go from frame to frame.
    page.keyboard.press("Control+z")
    page.evaluate("deitalk.page.workbench.layers.choose('nose')")
    page.evaluate("deitalk.page.seek(2.0)")
    page.click("#add-edit")
    for _ in range(6):
        page.keyboard.press("ArrowUp")
    change = shown(page) - was
    assert np.flatnonzero(np.abs(change).max(axis=1) > 1e-4).tolist() == [60]
    assert set(np.flatnonzero(np.abs(change[60]) > 1e-4)) <= set(BOARD.subset("nose"))
    page.fill("#edit-reach", "8")


def test_an_edit_with_a_span_of_its_own_keeps_it(page, source):
    given = Layer((Edit(JAW, ((1.0, 0.3, 0, 0),), "offset", (0.5, 2.0), (0.2, 0.2)),))
    page.evaluate("layers => deitalk.page.history.change({ layers })", [given.tree()])
    page.locator("#layer-lane circle").nth(0).focus()
    page.keyboard.press("ArrowUp")
    (edit,) = layers_of(page)[0].edits
    assert edit.span == (0.5, 2.0) and edit.keys[0][1] > 0.3 and edit.ease == (0.2, 0.2)


def test_points_are_moved_and_removed_by_keys(page, source):
    page.evaluate("deitalk.page.seek(1)")
    page.click("#add-edit")
    assert page.locator("#layer-lane circle").count() == 3
    for _ in range(5):
        page.keyboard.press("ArrowUp")
    (edit,) = layers_of(page)[0].edits
    assert edit.keys[1][1] == pytest.approx(0.1, abs=0.011)
    page.keyboard.press("ArrowRight")
    assert layers_of(page)[0].edits[0].keys[1][0] == pytest.approx(1 + 1 / 30, abs=1e-4)
    for left in (2, 1, 0):
        page.locator("#layer-lane circle").nth(0).focus()
        page.keyboard.press("Delete")
        assert page.locator("#layer-lane circle").count() == left
    assert layers_of(page)[0].edits == ()


def test_a_region_is_dragged(page, source):
    page.fill("#edit-target", "brow")
    page.keyboard.press("Enter")
    columns = BOARD.subset("brow")
    page.locator("#layer-lane").scroll_into_view_if_needed()
    box = page.locator("#layer-lane").bounding_box()
    low, high = BOARD.minimum[columns].min(), BOARD.maximum[columns].max()
    level = float((shown(page)[60, columns].mean() - low) / (high - low))
    x, y = box["x"] + 2 / 3 * box["width"], box["y"] + 10 + (1 - level) * (box["height"] - 20)
    drag(page, (x, y), (x, y - 0.3 * (box["height"] - 20)))
    (layer,) = layers_of(page)
    assert layer.edits[0].target == "brow" and layer.edits[0].keys[1][1] > 0.2
    assert np.abs(shown(page) - python(source, [layer]).values).max() < 1e-5


def test_an_unknown_target_is_said_and_the_lane_stays(page):
    page.fill("#edit-target", "CTRL_C_jaws")
    page.keyboard.press("Enter")
    assert "no control or region has this name" in page.inner_text("#notice")


def names(page) -> list[str]:
    return page.locator("#layers li > button:first-child").all_inner_texts()


def test_layers_are_listed_muted_reordered_and_removed(page, source):
    first = Layer((Edit(BROW, ((0, 0.2, 0, 0),), "own", (0, 3)),), "first")
    second = Layer((Edit(BROW, ((0, 0.5, 0, 0),), "scale", (0, 3)),), "second")
    trees = [first.tree(), second.tree()]
    page.evaluate("layers => deitalk.page.history.change({ layers })", trees)
    assert names(page) == ["first", "second"]
    column = BOARD.index(BROW)
    assert shown(page)[10, column] == pytest.approx(0.1)
    page.get_by_role("button", name="second earlier").click()
    assert names(page) == ["second", "first"] and shown(page)[10, column] == pytest.approx(0.2)
    mute = page.get_by_role("button", name="Mute first")
    mute.click()
    assert page.get_by_role("button", name="Mute first").get_attribute("aria-pressed") == "true"
    half = source.curves.values[10, column] * 0.5
    assert shown(page)[10, column] == pytest.approx(half, abs=1e-6)
    for _ in range(2):
        page.keyboard.press("Control+z")
    assert names(page) == ["first", "second"] and shown(page)[10, column] == pytest.approx(0.1)
    page.get_by_role("button", name="Remove second").click()
    page.get_by_role("button", name="New layer").click()
    assert names(page) == ["first", "edits 2"]
    page.get_by_role("button", name="Edit in first").click()
    pressed = page.locator("#layers li > button:first-child").evaluate_all(
        "all => all.map((b) => b.getAttribute('aria-pressed'))"
    )
    assert pressed == ["true", "false"]


DROP = """([name, text]) => {
  const data = new DataTransfer();
  data.items.add(new File([text], name));
  document.body.dispatchEvent(new DragEvent("drop", { dataTransfer: data, bubbles: true, cancelable: true }));
}"""


def test_a_file_of_layers_is_dropped(page, source):
    layer = Layer((Edit(BROW, KEYS, "offset", (0.5, 1.6)),), words=(("a", 0.5, 1.0),))
    page.evaluate(DROP, ["fixes.edit.json", layer.text])
    page.wait_for_timeout(200)
    assert layers_of(page) == (replace(layer, name="fixes"),)
    assert np.abs(shown(page) - python(source, [layer]).values).max() < 1e-5
    page.evaluate(DROP, ["bad.edit.json", json.dumps({"schema": "x"})])
    page.locator("#notice", has_text="it is no layer of edits").wait_for()
