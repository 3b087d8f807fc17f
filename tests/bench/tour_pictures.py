"""Pictures of the tour of docs/workspace.md: ``python -m bench.tour_pictures docs/pictures``."""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path
from typing import Any

from chromium import Watched, chromium
from scancell import Scanner
from scancell.browser.server.gate import address
from scancell.browser.server.workspace import WorkspaceSettings
from tour import PART, hosted, walk

_DRAWS_MS, _OPENS_MS = 8000, 40_000  # until the processor has drawn what is shown; all of a new page
_WINDOW = (1280, 800)
_WINDOWS = ((1280, 720), (1920, 1080), (800, 900))  # in which the sensor over the part is shown, too


def main(folder: Path) -> None:
    """Walk the tour, and write a picture of each step to a folder."""
    with (
        tempfile.TemporaryDirectory() as out,
        Scanner() as scanner,
        chromium() as browser,
        hosted(scanner, PART, WorkspaceSettings(Path(out))) as (host, server),
    ):

        def opened(width: int, height: int) -> Any:
            page = Watched(browser, width, height).page
            page.goto(address(server))
            page.locator("#webgl-software-rendering button").click()
            return page

        def write(page: Any, name: str) -> None:
            page.wait_for_timeout(_DRAWS_MS)
            page.screenshot(path=folder / f"{name}.jpg", type="jpeg", quality=80)

        def shoot(name: str) -> None:
            write(page, f"tour_{name}")
            for width, height in _WINDOWS if name == "profile" else ():
                other = opened(width, height)
                other.wait_for_timeout(_OPENS_MS)
                other.get_by_text("cell", exact=True).click()
                write(other, f"workspace_{width}x{height}")
                other.close()

        page = opened(*_WINDOW)
        walk(page, host, shoot)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
