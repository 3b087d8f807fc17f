"""From a command in a page to the moved arm on its screen, in a Chromium without a display that draws by processor."""

from __future__ import annotations

import base64
import statistics
import time
from collections.abc import Iterator
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from chromium import EXECUTABLE, Watched, chromium
from scancell.browser.server.workspace import Workspace
from scancell.live.state import MoveJoints

from .table import Row

_REPEATS, _TURN = 5, 0.3  # rad of joint 1 away from home, where the command leads
_SIZE = (1280, 720)
_PATIENCE_S = 60.0
_ARM = np.s_[180:600, 420:860]  # of a picture, with no panel before it
_CHANGED, _LEAST = 40, 30  # grey levels by which a pixel counts as changed, and number of such pixels
_CLICK = """() => {
  const button = [...document.querySelectorAll("button")].find((one) => one.innerText === "Move to home position");
  button.click();
  return Date.now() / 1000;
}"""

Image = NDArray[np.uint8]


def display_rows(workspace: Workspace, url: str) -> Iterator[Row]:
    """Median time from a click on ``Move to home position`` to the first picture in which the arm has moved."""
    if EXECUTABLE is None:
        return
    workspace.scene.options.ghost = workspace.scene.options.trace = False  # which move at once
    with chromium() as browser:
        page = Watched(browser, *_SIZE).page
        page.goto(url)
        page.get_by_role("tab", name="Joints").wait_for()
        page.locator("#webgl-software-rendering button").click()
        screen = _Screen(page)
        seconds = [_command_to_display(workspace, page, screen) for _ in range(_REPEATS)]
    spread = statistics.median(seconds) / min(seconds) - 1
    yield Row("command to display in Chromium", statistics.median(seconds), "s", "fastest", min(seconds), spread)


class _Screen:
    """Pictures of a page with their times, s since 1970, as Chromium hands them out when something has changed."""

    def __init__(self, page: Any) -> None:
        self.shown: list[tuple[float, Image]] = []
        self._session = page.context.new_cdp_session(page)
        self._session.on("Page.screencastFrame", self._take)
        self._session.send("Page.startScreencast", {"format": "jpeg", "quality": 80})

    def _take(self, event: Any) -> None:
        self._session.send("Page.screencastFrameAck", {"sessionId": event["sessionId"]})
        content = np.frombuffer(base64.b64decode(event["data"]), np.uint8)
        picture = cv2.imdecode(content, cv2.IMREAD_GRAYSCALE)
        assert picture is not None
        self.shown.append((event["metadata"]["timestamp"], np.asarray(picture, np.uint8)[_ARM]))


def _command_to_display(workspace: Workspace, page: Any, screen: _Screen) -> float:
    live, away = workspace.live, workspace.nominal.home.copy()
    away[0] += _TURN
    live.submit(MoveJoints(away))
    while live.state.moving or not np.allclose(live.state.joints, away, atol=1e-4):
        page.wait_for_timeout(100)
    before = _still_picture(page, screen)
    begun, end = page.evaluate(_CLICK), time.monotonic() + _PATIENCE_S
    while time.monotonic() < end:
        for at, picture in screen.shown:
            if at > begun and _differ(picture, before):
                return float(at - begun)
        screen.shown.clear()
        page.wait_for_timeout(20)
    raise TimeoutError("the arm was not seen to move")


def _still_picture(page: Any, screen: _Screen) -> Image:
    """What is shown once the last motion has been drawn: the clock in the panel goes on, the arm does not."""
    end = time.monotonic() + _PATIENCE_S
    while time.monotonic() < end:
        screen.shown.clear()
        page.wait_for_timeout(3000)
        pictures = [picture for _, picture in screen.shown]
        if len(pictures) > 1 and not any(_differ(picture, pictures[-1]) for picture in pictures):
            return pictures[-1]
    raise TimeoutError("the arm was not seen to rest")


def _differ(one: Image, other: Image) -> bool:
    return np.count_nonzero(cv2.absdiff(one, other) > _CHANGED) > _LEAST
