"""Twenty edits by hand in the studio: to files, to the command line, and back into the studio."""

import shlex
import zipfile
from dataclasses import replace

import numpy as np
import pytest

from deitalk import animate
from deitalk.data.edited import changes_of_take
from deitalk.postprocess.control_groups import ControlGroups
from rig import default_controls, read_curves, write_curves
from rig.curves.edit import clamp
from rig.curves.layer_files import read_layers
from tests.api.server import ROOT
from tests.api.test_studio import command, download, drop, spoken, studio, until
from tests.browser import chromium, numbers
from tests.deitalk.preview.test_page import drag

BOARD = default_controls()
TARGETS = (
    "CTRL_C_jaw.ty", "CTRL_L_brow_raiseOut.ty", "brow", "CTRL_L_mouth_cornerPull.ty", "nose",
    "CTRL_R_mouth_upperLipRaise.ty", "CTRL_L_eye_blink.ty", "CTRL_L_mouth_lipsTogetherU.ty",
    "CTRL_R_eye_squintInner.ty", "CTRL_R_brow_down.ty",
)  # fmt: skip


@pytest.fixture(scope="module")
def browser():
    with chromium() as running:
        yield running


def curves_of_page(tab) -> np.ndarray:
    rows = "Float32Array.from(Array.from({ length: deitalk.page.take.frames }, (_, k) => [...deitalk.page.take.frame(k)]).flat())"
    return numbers(tab, rows).reshape(-1, 185)


def edit_at_twenty_places(tab, seconds: float) -> None:
    for k in range(20):
        tab.evaluate(
            "name => deitalk.page.workbench.layers.choose(name)", TARGETS[k % len(TARGETS)]
        )
        lane = tab.locator("#layer-lane")
        lane.scroll_into_view_if_needed()
        box = lane.bounding_box()
        time = 0.3 + (k * 0.37) % (seconds - 0.8)
        x = box["x"] + time / seconds * box["width"]
        line = tab.evaluate(
            "t => deitalk.page.workbench.layers.levelOf(deitalk.page.workbench.layers.shownAt(t))",
            tab.evaluate("([x, w]) => deitalk.page.span.time(x, w)", [x - box["x"], box["width"]]),
        )
        y = box["y"] + 10 + (1 - line) * (box["height"] - 20)
        drag(tab, (x, y), (x, y - (35 if line < 0.5 else -35)))


def test_twenty_edits_of_the_studio_come_back_through_every_door(
    browser, server, tmp_path, monkeypatch
):
    speech = ROOT / "docs/samples/amiable.flac"
    with spoken(browser, server, speech) as tab:
        seconds = tab.evaluate("deitalk.page.take.seconds")
        plain = curves_of_page(tab)
        edit_at_twenty_places(tab, seconds)
        n_edits = tab.evaluate("deitalk.page.history.edit.layers[0].edits.length")
        n_keys = tab.evaluate(
            "deitalk.page.history.edit.layers[0].edits.flatMap((e) => e.keys).length"
        )
        assert n_keys >= 35 and n_edits >= 10  # drags near each other share an edit
        shown = curves_of_page(tab)
        assert (np.abs(shown - plain).max(axis=0) > 0.05).sum() > len(TARGETS)
        exported = download(tab, "CSV", tmp_path)
        zipped = download(tab, "Take", tmp_path)
        with tab.expect_download(lambda d: d.suggested_filename == "fixes.edit.json"):
            tab.on("download", lambda d: d.save_as(tmp_path / d.suggested_filename))
            tab.get_by_role("button", name="Edits", exact=True).click()
        until(
            tab, "document.getElementById('notice').textContent.includes('--edit fixes.edit.json')"
        )
        words = shlex.split(tab.inner_text("#notice"))
        # The take goes back into a studio with its layers.
        drop(tab, zipped)
        until(tab, "deitalk.studio.isSettled && deitalk.page.history.edit.layers.length === 1")
        again = curves_of_page(tab)
        assert tab.complaints == []
    given = read_curves(exported)
    assert np.abs(given.values - shown).max() < 0.01
    assert np.abs(again - shown).max() < 0.01
    text = (tmp_path / "fixes.edit.json").read_text()
    assert len(text) <= 20_000
    with zipfile.ZipFile(zipped) as archive:
        archive.extractall(tmp_path / "take")
    (folder,) = {path.parent for path in (tmp_path / "take").rglob("take.json")}
    (kept,) = read_layers(folder)
    assert kept.sound is not None and len(kept.edits) == n_edits
    # The command line, Python with the take's layers, and `diff` of the exported file give the same.
    monkeypatch.chdir(tmp_path)
    command("animate", speech, *words[3:-1], "again.csv")
    # Sessions that are kept round otherwise than one for a single run, and contacts enlarge it.
    assert np.abs(read_curves("again.csv").values - given.values).max() < 1e-4
    emotion = tmp_path / "emotion.csv"
    acted = animate(speech, emotion, edit=folder)
    assert np.abs(acted.curves.values - given.values).max() < 1e-4
    base = animate(speech, emotion).save(tmp_path / "base")
    layer = changes_of_take(exported, base).layer
    found = animate(speech, emotion, edit=layer).curves
    assert np.abs(found.values - given.values).max() < 0.01
    assert len(layer.text.encode()) <= 20_000
    together = ControlGroups(BOARD).together
    met = [
        (v[:, together].mean(axis=1) >= 0.9)
        for v in (read_curves(base / "curves.csv").values, found.values)
    ]
    assert not (met[0] & ~met[1]).any()  # lips that met still meet


def test_edited_file_becomes_the_last_layer_of_the_studio(browser, server, tmp_path):
    """An exported file that was edited by hand, over a layer of the studio; undo; refusals."""
    with studio(browser, server) as tab:
        assert tab.is_disabled("#from-edited")
        drop(tab, ROOT / "docs/samples/promise.flac")
        until(tab, "deitalk.page.take?.seconds > 1")
        until(tab, "deitalk.studio.isSettled")
        tab.evaluate("deitalk.page.workbench.layers.choose('CTRL_L_nose.ty')")
        tab.evaluate("deitalk.page.seek(1.0)")
        tab.click("#add-edit")
        for _ in range(9):
            tab.keyboard.press("ArrowUp")
        until(tab, "deitalk.studio.isSettled")
        exported = download(tab, "CSV", tmp_path)
        tab.set_input_files("#edited", exported)  # nothing is changed
        until(tab, "document.getElementById('notice').textContent.includes('no more than noise')")
        assert tab.evaluate("deitalk.page.history.edit.layers.length") == 1
        base = read_curves(exported)
        values = base.values.copy()
        for name, change in (("CTRL_L_brow_raiseOut.ty", 0.4), ("CTRL_C_jaw.ty", 0.3)):
            values[40:70, BOARD.index(name)] += change * np.hanning(30)
        edited, _ = clamp(replace(base, values=values))
        write_curves(tmp_path / "anna v2.csv", edited)
        tab.set_input_files("#edited", tmp_path / "anna v2.csv")
        until(tab, "deitalk.page.history.edit.layers.length === 2")
        assert tab.evaluate("deitalk.page.history.edit.layers[1].name") == "anna v2"
        assert tab.evaluate("deitalk.page.history.edit.layers[1].sound.seconds") > 1
        assert "anna v2.csv is the last layer" in tab.inner_text("#notice")
        assert tab.inner_text("#layers li:last-child").startswith("anna v2")
        assert np.abs(curves_of_page(tab) - edited.values).max() < 0.011
        again = download(tab, "JSON", tmp_path)
        tab.click("#undo")
        assert np.abs(curves_of_page(tab) - base.values).max() < 1e-3
        assert not [line for line in tab.complaints if "422" not in line]
    assert np.abs(read_curves(again).values - edited.values).max() < 0.011


def test_dropped_curves_are_a_reference_and_can_become_a_layer(browser, server, tmp_path):
    """A file that was exported with a delay and handles, edited, and dropped into the page."""
    with spoken(browser, server, ROOT / "docs/samples/promise.flac") as tab:
        plain = curves_of_page(tab)
        assert tab.is_hidden("#other-changes")
        tab.fill("#delay", "2")
        tab.fill("#handles", "8")
        base = read_curves(download(tab, "CSV", tmp_path))
        values, column = base.values.copy(), BOARD.index("CTRL_L_brow_raiseOut.ty")
        values[50:80, column] += 0.4 * np.hanning(30)
        edited, _ = clamp(replace(base, values=values))
        write_curves(tmp_path / "anna.csv", edited)
        drop(tab, tmp_path / "anna.csv")
        until(tab, "deitalk.page.takes.length === 2")
        assert tab.evaluate("deitalk.page.history.edit.layers.length") == 0
        tab.click("#other-changes")
        until(tab, "deitalk.page.history.edit.layers.length === 1")
        assert tab.evaluate("deitalk.page.takes.length") == 1 and tab.is_hidden("#other-changes")
        wanted = plain.copy()
        wanted[40:70] = edited.values[50:80]
        assert np.abs(curves_of_page(tab) - wanted).max() < 0.011
        assert tab.complaints == []
