"""The tour of docs/workspace.md, step by step, as a person walks it in a browser."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from threading import Event, Thread
from typing import Any

from scancell import Scanner
from scancell.scanning.session import ScanSession
from scancell.workspace.browser.quiet import quiet_server
from scancell.workspace.browser.serve import Host, PartFile
from scancell.workspace.browser.workspace import WorkspaceSettings

PART = Path(__file__).resolve().parents[1] / "assets" / "parts" / "free_form.stl"
POSE = ((450, 0, 250), (180, 0, 0))  # mm, deg

Shoot = Callable[[str], None]

_STARTS = 120.0  # s
_SCANS_MS = 300_000
_BEGINS_MS = 3000


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
    """The input (the `number`-th of them) beside a label."""
    row = page.locator("label", has_text=re.compile(f"^{re.escape(label)}$")).locator("xpath=ancestor::*[.//input][1]")
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


def is_at_rest(page: Any) -> None:
    """Wait until the robot has had time to begin, and rests."""
    page.wait_for_timeout(_BEGINS_MS)
    page.get_by_text("% of the motion").first.wait_for(state="hidden")


def walk(page: Any, shoot: Shoot = lambda _: None) -> None:
    """Walk the tour on a page that shows the workspace with `PART`; `shoot` gets the name of each picture."""
    tab(page, "Joints")
    shoot("open")
    fill(page, "joint 1, deg", 10)
    is_at_rest(page)

    go_over_the_part(page)
    says(page, "points,")
    shoot("profile")

    tab(page, "Jog")
    choose(page, "axis", "tool z")
    page.get_by_role("button", name="Hold to jog -").hover()
    page.mouse.down()
    says(page, "guard:")
    says(page, "emergency stop")
    page.mouse.up()
    shoot("stopped")
    tab(page, "Cell")
    press(page, "Reset after a stop")
    says(page, "at rest")
    tab(page, "Joints")
    press(page, "Move to home position")
    is_at_rest(page)

    go_over_the_part(page)
    tab(page, "Sensor")
    fill(page, "laser turn z, deg", 1)
    page.wait_for_timeout(2000)
    shoot("perturbed")
    press(page, "All nominal")

    tab(page, "Scan")
    choose(page, "engine", "geometric")
    press(page, "Scan the part")
    page.locator("b", has_text=re.compile("^done$")).wait_for(timeout=_SCANS_MS)
    shoot("scan")
    press(page, "Save the run folder")
    says(page, "saved: ")


def go_over_the_part(page: Any) -> None:
    """The third step."""
    tab(page, "Pose")
    for label, values in zip(("x, y, z, mm", "XYZ' angles, deg"), POSE, strict=True):
        for number, value in enumerate(values):
            fill(page, label, value, number)
    press(page, "Move to this pose")
    is_at_rest(page)
