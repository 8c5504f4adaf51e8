"""A headless Chromium for tests of pages, where one is installed."""

import io
import shutil
import time
from contextlib import contextmanager
from pathlib import Path

import pytest
from PIL import Image

NAMES = ("chromium-headless-shell", "chromium", "chromium-browser", "google-chrome")


@contextmanager
def chromium():
    """A browser of playwright's; skips the test, saying why, where there is none."""
    api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    with api.sync_playwright() as player:
        own = player.chromium.executable_path
        path = next(filter(None, map(shutil.which, NAMES)), own if Path(own).exists() else None)
        if path is None:
            pytest.skip(f"no headless browser: none of {', '.join(NAMES)} is installed")
        browser = player.chromium.launch(
            executable_path=path, args=["--no-sandbox", "--hide-scrollbars"]
        )
        yield browser
        browser.close()


class Told(list):
    """What a page asked for beyond itself, and its errors; performance hints are not errors."""

    def __init__(self, page):
        page.on("request", lambda r: self.append(r.url) if not r.is_navigation_request() else None)
        page.on("pageerror", lambda error: self.append(str(error)))
        page.on(
            "console",
            lambda m: (
                self.append(m.text)
                if m.type in ("error", "warning") and "GPU stall" not in m.text
                else None
            ),
        )


def wait_until(page, condition):
    """Wait, at most ten seconds, until an expression holds in the page."""
    page.evaluate(
        f"""() => new Promise((done, fail) => {{
        const end = performance.now() + 10000;
        (function look() {{
          if ({condition}) done();
          else if (performance.now() > end) fail(new Error("never: {condition}"));
          else requestAnimationFrame(look);
        }})(); }})"""
    )


def screenshot_once(page, holds, seconds=10.0):
    """The first screenshot of which something holds, or the last one after some seconds.

    A canvas may reach the screen some frames after it was drawn, later on a busy machine.
    """
    end = time.monotonic() + seconds
    while True:
        picture = Image.open(io.BytesIO(page.screenshot())).convert("RGB")
        if holds(picture) or time.monotonic() > end:
            return picture
