"""Debian's chromium for tests of the preview page: no network, no GPU."""

import base64
import math
import shutil
import statistics
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from deitalk.preview import page as page_module

_FLAGS = [
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--no-sandbox",
    "--disable-dev-shm-usage",
    "--autoplay-policy=no-user-gesture-required",
    "--use-fake-device-for-media-stream",
]


def needs_player() -> None:
    """Skip the test where the page's player is not built."""
    if not page_module.BUNDLE.is_file():
        pytest.skip("needs the built player: make page")


@contextmanager
def chromium(*flags: str, player: bool = True) -> Iterator[Any]:
    """A running browser with more flags; the test is skipped where there is none, or no built player, unless not needed."""
    sync_api = pytest.importorskip("playwright.sync_api", reason="needs playwright")
    program = shutil.which("chromium") or shutil.which("chromium-browser")
    if program is None:
        pytest.skip("needs Debian's chromium")
    if player:
        needs_player()
    with sync_api.sync_playwright() as playwright:
        launched = playwright.chromium.launch(executable_path=program, args=[*_FLAGS, *flags])
        yield launched
        launched.close()


PATIENCE = 300_000
"""Milliseconds for what a browser is asked to do, on a busy machine too."""
SHARPNESS = 0.25
"""Drawn pixels by CSS pixel: software draws 16 times fewer of them, in a fifth of the time."""


@contextmanager
def opened(browser: Any, path: Path, **context: Any) -> Iterator[Any]:
    """A tab that shows a page; its console's errors and warnings are in ``tab.complaints``."""
    context = {
        "viewport": {"width": 1280, "height": 860},
        "device_scale_factor": SHARPNESS,
        **context,
    }
    # the page forbids eval, which Playwright's wait_for_function needs
    with browser.new_context(offline=True, bypass_csp=True, **context) as window:
        window.set_default_timeout(PATIENCE)
        tab = window.new_page()
        tab.complaints = []
        tab.on(
            "console", lambda m: m.type in ("error", "warning") and tab.complaints.append(m.text)
        )
        tab.on("pageerror", lambda error: tab.complaints.append(str(error)))
        tab.goto(path.as_uri())
        tab.wait_for_function("window.deitalk?.ready")
        yield tab


def numbers(tab: Any, array: str, given: Any = None) -> np.ndarray:
    """A numeric array of the page, in which an argument is ``given``.

    Playwright would send it number by number: seconds for the vertices of a head.
    """
    script = f"""given => {{
      const bytes = new Uint8Array(Float64Array.from({array}).buffer), parts = [];
      for (let i = 0; i < bytes.length; i += 4096)
        parts.push(String.fromCharCode(...bytes.subarray(i, i + 4096)));
      return btoa(parts.join(""));
    }}"""
    return np.frombuffer(base64.b64decode(tab.evaluate(script, given)))


FRAME = """() => new Promise(done => requestAnimationFrame(() => setTimeout(() => {
  const s = deitalk.page.state(); done([s.time, s.shown]); }, 0)))"""


PATIENCE_SECONDS = 60


def lateness(tab: Any, enough: float) -> float:
    """Median of the seconds between the sound and the shown frame, while a page plays.

    A busy machine may delay a play, a wrong clock is late in all: the best counts of three, and of
    all within `PATIENCE_SECONDS`; one that is good `enough` is the last.
    """
    medians: list[float] = []
    end = time.monotonic() + PATIENCE_SECONDS
    while (len(medians) < 3 or time.monotonic() < end) and min(medians, default=math.inf) > enough:
        tab.evaluate("deitalk.page.seek(0)")
        tab.click("#play")
        states = []
        for _ in range(6):
            tab.wait_for_timeout(200)
            states.append(tab.evaluate(FRAME))
        tab.click("#play")
        if states[-1][0] <= 1.0 or states[-1][1] <= states[0][1]:  # it does not play yet
            medians.append(math.inf)
            continue
        medians.append(statistics.median(abs(at - shown) for at, shown in states))
    return min(medians)
