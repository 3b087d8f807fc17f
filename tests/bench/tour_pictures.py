"""Pictures of the tour of docs/workspace.md: ``python -m bench.tour_pictures docs/pictures``."""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from chromium import Watched, chromium
from scancell import Scanner
from scancell.browser.server.quiet import address
from scancell.browser.server.workspace import WorkspaceSettings
from tour import PART, hosted, walk

_DRAWS_MS = 8000  # until the processor has drawn what is shown


def main(folder: Path) -> None:
    """Walk the tour, and write a picture of each step to a folder."""
    with (
        tempfile.TemporaryDirectory() as out,
        Scanner() as scanner,
        chromium() as browser,
        hosted(scanner, PART, WorkspaceSettings(Path(out))) as (host, server),
    ):
        page = Watched(browser, 1280, 800).page
        page.goto(address(server))
        page.locator("#webgl-software-rendering button").click()

        def shoot(name: str) -> None:
            page.wait_for_timeout(_DRAWS_MS)
            page.screenshot(path=folder / f"tour_{name}.jpg", type="jpeg", quality=80)

        walk(page, host, shoot)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
