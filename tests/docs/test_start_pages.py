"""Start pages: every command and every Python snippet of a page runs in an empty folder, in their order.

`<!-- not run: REASON -->` before a block leaves it out. A `toml` block is written to the file that the text before it
names ("Save this file as `NAME`"). Pages that use the part of the first scan get it from the snippet that makes it.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from page_blocks import blocks, run

START = Path(__file__).resolve().parents[2] / "docs" / "start"
PAGES = sorted(START.glob("*.md"))

pytestmark = pytest.mark.docs


def test_there_are_four_start_pages() -> None:
    assert [page.stem for page in PAGES] == ["first_fmu", "first_scan", "first_study", "first_workspace"]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_page_runs_in_an_empty_folder(page: Path, tmp_path: Path) -> None:
    own = blocks(page.read_text(encoding="utf-8"))
    assert any(block.is_run for block in own)
    if page.stem != "first_scan":
        run(blocks((START / "first_scan.md").read_text(encoding="utf-8"))[0], tmp_path)
    for block in own:
        if block.is_run:
            run(block, tmp_path)
