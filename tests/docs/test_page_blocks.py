"""Pages: every command and every Python snippet runs, in the order of the page, in a new folder.

Start pages begin with nothing but the part of the first scan. Other pages begin in a folder like a clone, with files
that a reader has: a small part, and copies of shipped descriptions.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import trimesh

import page_blocks
from page_blocks import PAGES, ROOT, blocks

START = ROOT / "docs" / "start"
RUN = [page for page in PAGES if any(b.is_code and not b.reason for b in blocks(page.read_text(encoding="utf-8")))]
LINKS = ("assets", "benchmarks", "fmu", "tests", "docs/examples")
FILES = {
    "my_cell.toml": "cells/default.toml",
    "my_sensor.toml": "sensors/two_camera_probe.toml",
    "my_scan.toml": "scans/default.toml",
    "my_path.toml": "paths/spiral.toml",
    "ball.toml": "artefacts/sphere.toml",
}
STUDY = """\
name = "my_study"
part = "my_part.stl"
engine = "geometric"
set = ["scan.max_profiles=60"]

[design]
kind = "latin_hypercube"
trials = 18

[[factor]]
path = "as_built.tool.z_mm"
distribution = { kind = "normal", std = 0.05 }
"""
TIMEOUT_S = 3600  # a busy machine takes long; only a hang takes longer

pytestmark = pytest.mark.docs


def prepare(page: Path, folder: Path) -> None:
    """What a reader of the page has in a folder."""
    if page.parent == START:
        if page.stem != "first_scan":
            names = {"__name__": "__main__"}
            exec(blocks((START / "first_scan.md").read_text(encoding="utf-8"))[0].code, names)
        return
    (folder / "docs" / "pictures").mkdir(parents=True)
    for name in LINKS:
        (folder / name).symlink_to(ROOT / name)
    for name, asset in FILES.items():
        shutil.copy(ROOT / "assets" / asset, folder / name)
    for name in ("my_part.stl", "part.stl", "my_parts/block.stl"):
        (folder / name).parent.mkdir(exist_ok=True)
        trimesh.creation.box((12, 10, 6)).apply_translation((0, 0, 3)).export(folder / name)
    (folder / "my_study.toml").write_text(STUDY, encoding="utf-8")


@pytest.mark.parametrize("page", RUN, ids=lambda page: str(page.relative_to(ROOT).with_suffix("")))
def test_page_runs(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if "chromium " in page.read_text(encoding="utf-8") and not shutil.which("chromium"):
        pytest.skip("needs Chromium")
    monkeypatch.chdir(tmp_path)
    prepare(page, tmp_path)
    done = subprocess.run(
        [sys.executable, page_blocks.__file__, page],
        env={**os.environ, "MPLBACKEND": "agg"},
        capture_output=True,
        text=True,
        timeout=TIMEOUT_S,
        check=False,
    )
    assert done.returncode == 0, f"{done.stdout[-2000:]}\n{done.stderr[-4000:]}"


def test_blocks_are_counted() -> None:
    """Shown by ``pytest -s`` and ``python tests/page_blocks.py``."""
    print(f"\n{page_blocks.counts()}")
    assert " run" in page_blocks.counts().splitlines()[-1]
