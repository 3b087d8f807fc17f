"""The tour of docs/workspace.md, step by step, as a person walks it in a browser."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from threading import Event, Thread
from typing import Any

import numpy as np

from scancell import Scanner
from scancell.browser.server.gate import quiet_server
from scancell.browser.server.serve import Host, PartFile
from scancell.browser.server.workspace import WorkspaceSettings
from scancell.live.camera import CameraFrame
from scancell.scanning.session import ScanSession

PART = Path(__file__).resolve().parents[1] / "assets" / "parts" / "free_form.stl"
POSE = ((450, 0, 250), (180, 0, 0))  # mm, deg

Shoot = Callable[[str], None]

_STARTS = 600.0  # s: only a hang takes longer
_SCANS_MS = 300_000
_FRAMES = """left => new Promise(done => {
  const next = () => left-- > 0 ? requestAnimationFrame(next) : done();
  next();
})"""
_NEAR = 1e-3  # rad, with the noise of the encoders


@contextmanager
def hosted(scanner: Scanner, part: Path | None, settings: WorkspaceSettings) -> Iterator[tuple[Host, Any]]:
    """A workspace that runs in this process, and its server."""

    def open_session(file: PartFile | None) -> AbstractContextManager[ScanSession]:
        path, unit = (None, "mm") if file is None else (file.path, file.unit)
        return scanner.session(path, unit=unit, guarded=True)

    stop, started = Event(), Event()
    with quiet_server(port=0) as server:
        host = Host(server, open_session, settings)
        first = None if part is None else PartFile(part)
        running = Thread(target=host.run, args=(first, stop, started.set))
        running.start()
        try:
            assert started.wait(_STARTS)
            yield host, server
        finally:
            stop.set()
            running.join()


def entry(page: Any, label: str, number: int = 0) -> Any:
    """The input (the `number`-th of them) beside a label that is shown."""
    shown = page.locator("label", has_text=re.compile(f"^{re.escape(label)}$")).locator("visible=true")
    row = shown.locator("xpath=ancestor::*[.//input][1]")
    return row.locator("input:not([type=hidden])").nth(number)


def fill(page: Any, label: str, value: float, number: int = 0) -> None:
    """Type a number."""
    entry(page, label, number).fill(f"{value:g}")
    entry(page, label, number).press("Enter")


def choose(page: Any, label: str, option: str) -> None:
    """Choose from a list."""
    entry(page, label).click()
    page.get_by_role("option", name=option, exact=True).click()


def tab(page: Any, name: str) -> None:
    """Open a tab of the panel on the right."""
    page.get_by_role("tab", name=name, exact=True).last.click()


def press(page: Any, name: str) -> None:
    """Press a button."""
    page.get_by_role("button", name=name).click()


def says(page: Any, text: str) -> None:
    """Wait until the page says something."""
    page.get_by_text(text).first.wait_for()


def waits(page: Any, condition: Callable[[], object], what: str) -> None:
    """Wait for a state of the program while the page goes on."""
    for _ in range(round(_STARTS / 0.05)):
        if condition():
            return
        page.wait_for_timeout(50)
    raise AssertionError(f"{what} never came")


def draws(page: Any, frames: int = 6) -> None:
    """Wait until the page has drawn so many frames: then it shows, and can be pointed at, what it was sent before."""
    page.evaluate(_FRAMES, frames)


def moves(page: Any, host: Host, act: Callable[[], None]) -> None:
    """Act, and wait until the robot is where that leads."""
    assert host.workspace is not None
    live = host.workspace.live
    before = live.state.destination[:-1]
    act()
    waits(page, lambda: not np.array_equal(live.state.destination[:-1], before), "the motion")

    def is_there() -> bool:
        state = live.state
        return not state.moving and bool(np.abs(state.joints - state.destination[:-1]).max() < _NEAR)

    waits(page, is_there, "the end of the motion")


def walk(page: Any, host: Host, shoot: Shoot = lambda _: None) -> None:
    """Walk the tour on a page that shows the workspace with `PART`; `shoot` gets the name of each picture."""
    shoot("open")
    moves(page, host, lambda: fill(page, "joint 1, deg", 10))

    go_over_the_part(page, host)
    says(page, "points,")
    shoot("profile")

    tab(page, "Jog")
    choose(page, "axis", "tool along z")
    page.get_by_role("button", name="Hold to jog -").hover()
    page.mouse.down()
    says(page, "The guard permits no jog in this direction")
    shoot("stopped")
    page.mouse.up()
    says(page, "at rest")
    tab(page, "Joints")
    moves(page, host, lambda: press(page, "Move to home position"))

    go_over_the_part(page, host)
    tab(page, "Sensor")
    fill(page, "laser turn z, deg", 1)
    waits(page, lambda: shown_frame(host).as_built == ("sensor.laser.turn_z_deg=1",), "the turned laser")
    draws(page)
    shoot("perturbed")
    press(page, "All nominal")

    tab(page, "Scan")
    choose(page, "engine", "geometric")
    press(page, "Scan the part")
    page.locator("b", has_text=re.compile("^done$")).wait_for(timeout=_SCANS_MS)
    shoot("scan")
    press(page, "Save the run folder")
    says(page, "saved: ")


def shown_frame(host: Host) -> CameraFrame:
    """The last pair of images."""
    assert host.workspace is not None
    frame = host.workspace.feed.frame
    assert frame is not None
    return frame


def go_over_the_part(page: Any, host: Host) -> None:
    """The third step."""
    tab(page, "Move")
    tab(page, "Pose")
    for label, values in zip(("x, y, z, mm", "XYZ' angles, deg"), POSE, strict=True):
        for number, value in enumerate(values):
            fill(page, label, value, number)
    moves(page, host, lambda: press(page, "Move to this pose"))
