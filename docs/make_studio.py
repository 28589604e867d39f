"""Write docs/pictures/studio.webp, a picture of the studio: ``make pictures``.

The recording docs/samples/promise.flac, happy that turns to surprised, with twice the intensity
from 3.4 s on. Needs Chromium and the built page.
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
        picture.convert("RGB").save(PICTURE, quality=82, method=6)


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


def _until(tab: Any, condition: str) -> None:
    while not tab.evaluate(condition):
        time.sleep(0.1)


if __name__ == "__main__":
    main()
