"""Debian's chromium for tests of the preview page: no network, no GPU."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from deitalk.preview import page as page_module

_FLAGS = [
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--no-sandbox",
    "--disable-dev-shm-usage",
    "--autoplay-policy=no-user-gesture-required",
]


def needs_player() -> None:
    """Skip the test where the page's player is not built."""
    if not page_module.BUNDLE.is_file():
        pytest.skip("needs the built player: npm install && npm run build in deitalk/preview/web/")


@contextmanager
def chromium() -> Iterator[Any]:
    """A running browser; the test is skipped where there is none, or no built player."""
    sync_api = pytest.importorskip("playwright.sync_api", reason="needs playwright")
    program = shutil.which("chromium") or shutil.which("chromium-browser")
    if program is None:
        pytest.skip("needs Debian's chromium")
    needs_player()
    with sync_api.sync_playwright() as playwright:
        launched = playwright.chromium.launch(executable_path=program, args=_FLAGS)
        yield launched
        launched.close()


@contextmanager
def opened(browser: Any, path: Path, **context: Any) -> Iterator[Any]:
    """A tab that shows a page; its console's errors and warnings are in ``tab.complaints``."""
    context = {"viewport": {"width": 1280, "height": 860}, **context}
    # the page forbids eval, which Playwright's wait_for_function needs
    with browser.new_context(offline=True, bypass_csp=True, **context) as window:
        tab = window.new_page()
        tab.complaints = []
        tab.on(
            "console", lambda m: m.type in ("error", "warning") and tab.complaints.append(m.text)
        )
        tab.on("pageerror", lambda error: tab.complaints.append(str(error)))
        tab.goto(path.as_uri())
        tab.wait_for_function("window.deitalk?.ready", timeout=120_000)
        yield tab
