"""Pages of the documentation: links lead to files, and the index lists every page."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")])
LINK = re.compile(r"\]\(([^)#\s]+)(?:#[^)]*)?\)")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_to_files(page: Path) -> None:
    targets = [target for target in LINK.findall(page.read_text(encoding="utf-8")) if "://" not in target]
    assert [target for target in targets if not (page.parent / target).exists()] == []


def test_index_lists_every_page() -> None:
    index = ROOT / "docs" / "README.md"
    listed = {(index.parent / target).resolve() for target in LINK.findall(index.read_text(encoding="utf-8"))}
    assert set((ROOT / "docs").rglob("*.md")) <= listed | {index}


def test_validation_names_every_measurement() -> None:
    """Only pictures have no figures."""
    named = {page: set(re.findall(r"bench\.([a-z_]+)", page.read_text(encoding="utf-8"))) for page in PAGES}
    validation = named.pop(ROOT / "docs" / "validation.md")
    assert set().union(*(names for page, names in named.items() if page.parent != ROOT)) - validation == {
        "gallery",
        "presets",
        "tour_pictures",
    }
