"""The tour of docs/workspace.md, walked step by step in a browser."""

from __future__ import annotations

import re
from pathlib import Path

from chromium import Watched, chromium
from scancell import Scanner
from scancell.browser.server.gate import address
from scancell.browser.server.workspace import WorkspaceSettings
from scancell.config.loading import load_setup
from scancell.reconstruction.cloud_files import read_ply
from scancell.views.recorded_run import open_run
from tour import PART, hosted, walk

TOUR = Path(__file__).resolve().parents[2] / "docs" / "workspace.md"


def test_first_time_user_scans_a_part(tmp_path: Path) -> None:
    """Every step succeeds, its picture is in the docs, and the run that is saved in the end opens."""
    shown: list[str] = []
    setup = load_setup(settings=["scan.max_profiles=120", "scan.sweep.enabled=false"])
    with (
        Scanner(setup=setup) as scanner,
        chromium() as browser,
        hosted(scanner, PART, WorkspaceSettings(tmp_path)) as (host, server),
    ):
        watched = Watched(browser, 1280, 900, sharpness=0.0)
        watched.opens(address(server))
        walk(watched.page, host, shown.append)
    assert watched.errors == []
    assert re.findall(r"pictures/tour_(\w+)\.jpg", TOUR.read_text()) == shown
    run = open_run(tmp_path / "scan_1")
    assert run.cloud is not None
    assert run.cloud_points == len(read_ply(tmp_path / "scan_1" / "cloud.ply")) > 10_000
