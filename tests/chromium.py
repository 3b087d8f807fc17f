"""Chromium without a display, for tests of pages.

The processor draws: all waits are generous, and one browser runs at a time.
"""

from __future__ import annotations

import fcntl
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

HANGS_MS = 300_000  # a busy machine takes long; only a hang takes longer
# A page that redraws as often as it can leaves the processor no time for anything else.
_FEWER_FRAMES = """
  const asked = window.requestAnimationFrame.bind(window);
  window.requestAnimationFrame = (draw) => setTimeout(() => asked(draw), 250);
  window.cancelAnimationFrame = clearTimeout;
"""
# Chromium draws nothing of a transparent page, whose panels change ten times a second; clicks reach it all the same.
_UNDRAWN = """
  document.addEventListener("DOMContentLoaded", () => { document.body.style.opacity = "0"; });
  for (const name of ["drawArrays", "drawArraysInstanced", "drawElements", "drawElementsInstanced", "clear"]) {
    WebGL2RenderingContext.prototype[name] = () => {};
  }
"""
EXECUTABLE = shutil.which("chromium") or shutil.which("google-chrome")
_FLAGS = [
    "--no-sandbox",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--autoplay-policy=no-user-gesture-required",
]


_LEAST_SHARPNESS = 0.25


@contextmanager
def chromium() -> Iterator[Any]:
    """A browser of Playwright; skips the test where there is none."""
    if EXECUTABLE is None:
        pytest.skip("no Chromium")
    from playwright.sync_api import sync_playwright  # noqa: PLC0415

    lock = Path(tempfile.gettempdir()) / "scancell-test-chromium.lock"
    with lock.open("w") as held, sync_playwright() as player:
        fcntl.flock(held, fcntl.LOCK_EX)  # until the file is closed
        browser = player.chromium.launch(executable_path=EXECUTABLE, args=_FLAGS)
        yield browser
        browser.close()


class Watched:
    """A page whose requests and errors are recorded; a `sharpness` below 1 draws fewer pixels, 0 none.

    A page of viser draws a pixel for each of the window's at least, whatever the sharpness, unless its address says
    otherwise: see `opens`.
    """

    def __init__(self, browser: Any, width: int, height: int, sharpness: float = 1.0) -> None:
        scale = sharpness or _LEAST_SHARPNESS
        self.page = browser.new_page(viewport={"width": width, "height": height}, device_scale_factor=scale)
        self.page.set_default_timeout(HANGS_MS)
        self.page.add_init_script(_FEWER_FRAMES if sharpness else _FEWER_FRAMES + _UNDRAWN)
        self._sharpness = scale
        self.requests: list[str] = []
        self.errors: list[str] = []
        self.page.on("request", lambda request: self.requests.append(request.url))
        self.page.on("websocket", lambda socket: self.requests.append(socket.url))
        self.page.on("pageerror", lambda error: self.errors.append(str(error)))

    def opens(self, address: str) -> None:
        """Go to a page of viser, and close what it says of rendering by software, which covers what a test clicks."""
        self.page.goto(f"{address}/?fixedDpr={self._sharpness}")
        self.page.locator("#webgl-software-rendering button").click()
