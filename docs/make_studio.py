"""Write docs/pictures/studio.webp and layers.webp, pictures of the studio: ``make pictures``.

The recording docs/samples/promise.flac, happy that turns to surprised, with twice the intensity
from 3.4 s on; and the lane of edits with two layers. Needs Chromium and the built page.
"""

import io
import tempfile
import time
from pathlib import Path
from typing import Any

from PIL import Image

from tests.api.server import serving
from tests.browser import chromium

DOCS = Path(__file__).parent
RECORDING, PICTURE = DOCS / "samples/promise.flac", DOCS / "pictures/studio.webp"
LAYERS = DOCS / "pictures/layers.webp"
SIZE = {"width": 1280, "height": 860}
SHOWN_SECONDS = 3.27


def main() -> None:
    """Serve, edit as a user does, and write what the browser shows."""
    with (
        tempfile.TemporaryDirectory() as data,
        serving(Path(data)) as server,
        chromium() as browser,
        browser.new_context(viewport=SIZE, color_scheme="dark") as window,
    ):
        tab = window.new_page()
        tab.goto(server.url + "/")
        _until(tab, "!!window.deitalk?.ready")
        _edit(tab)
        picture = Image.open(io.BytesIO(tab.screenshot()))
        picture.convert("RGB").save(PICTURE, quality=76, method=6)
        _edit_layers(tab)
        first, last = (tab.locator(f"#{name}").bounding_box() for name in ("edit-target", "layers"))
        lane = tab.locator("#layer-lane").bounding_box()
        top, end = first["y"] - 10, last["y"] + last["height"] + 10
        part = {"x": lane["x"] - 10, "y": top, "width": lane["width"] + 20, "height": end - top}
        picture = Image.open(io.BytesIO(tab.screenshot(clip=part)))
        picture.convert("RGB").save(LAYERS, quality=76, method=6)


def _edit(tab: Any) -> None:
    tab.set_input_files("#file", RECORDING)
    _until(tab, "deitalk.page.clock.playing")
    tab.keyboard.press("Space")
    tab.get_by_role("button", name="happy", exact=True).click()
    for seconds in (2.0, 3.4):
        tab.evaluate("s => deitalk.page.seek(s)", seconds)
        tab.keyboard.press("p")
    for _ in range(14):
        tab.keyboard.press("ArrowUp")
    tab.evaluate("deitalk.page.seek(6)")
    tab.click("#add-key")
    tab.get_by_role("button", name="surprised", exact=True).click()
    time.sleep(0.5)
    _until(tab, "deitalk.studio.isSettled && !deitalk.page.take.isBlend")
    tab.evaluate("document.activeElement.blur()")
    tab.evaluate("s => deitalk.page.seek(s)", SHOWN_SECONDS)
    time.sleep(2)  # the page draws with all pixels once it is at rest


def _edit_layers(tab: Any) -> None:
    """Raise a brow and open the jaw where the curves are dragged, in two layers."""
    names = "deitalk.page.workbench.layers"
    for target, times in (("CTRL_L_brow_raiseOut.ty", (1.1, 3.5)), ("CTRL_C_jaw.ty", (2.2, 5.4))):
        tab.click("#add-layer")
        tab.evaluate(f"name => {names}.choose(name)", target)
        tab.locator("#layer-lane").scroll_into_view_if_needed()
        box = tab.locator("#layer-lane").bounding_box()
        for seconds in times:
            x = tab.evaluate("([t, w]) => deitalk.page.span.x(t, w)", [seconds, box["width"]])
            level = tab.evaluate(f"t => {names}.levelOf({names}.shownAt(t))", seconds)
            y = box["y"] + 10 + (1 - level) * (box["height"] - 20)
            tab.mouse.move(box["x"] + x, y)
            tab.mouse.down()
            tab.mouse.move(box["x"] + x, y - 30, steps=4)
            tab.mouse.up()
    tab.evaluate("document.activeElement.blur()")
    tab.locator("#layers").scroll_into_view_if_needed()


def _until(tab: Any, condition: str) -> None:
    while not tab.evaluate(condition):
        time.sleep(0.1)


if __name__ == "__main__":
    main()
