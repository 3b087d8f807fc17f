"""Pages of the documentation: links lead to files, the index lists every page, code that is not run has a reason."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from page_blocks import KINDS, PAGES, ROOT, blocks

LINK = re.compile(r"\]\(([^)#\s]+)(?:#[^)]*)?\)")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_to_files(page: Path) -> None:
    targets = [target for target in LINK.findall(page.read_text(encoding="utf-8")) if "://" not in target]
    assert [target for target in targets if not (page.parent / target).exists()] == []


def test_index_lists_every_page() -> None:
    index = ROOT / "docs" / "README.md"
    listed = {(index.parent / target).resolve() for target in LINK.findall(index.read_text(encoding="utf-8"))}
    assert set((ROOT / "docs").rglob("*.md")) <= listed | {index}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_code_that_is_not_run_has_a_reason(page: Path) -> None:
    """`make docs-test` runs all other blocks; output and drawings have no language, or are text."""
    text = page.read_text(encoding="utf-8")
    found = blocks(text)
    assert {block.language for block in found} <= {"", "sh", "python", "toml", "json", "yaml", "text"}
    reasons = [block.reason for block in found if block.is_code and block.reason]
    assert len(reasons) == text.count("<!-- not run: ") - text.count("`<!-- not run: ")
    assert [reason for reason in reasons if not reason.startswith(KINDS)] == []
    assert [
        block.code for block in found if not block.language and re.search("^(scancell [a-z]|python)", block.code)
    ] == []


def test_validation_names_every_measurement() -> None:
    """Only pictures have no figures."""
    named = {page: set(re.findall(r"bench\.([a-z_]+)", page.read_text(encoding="utf-8"))) for page in PAGES}
    validation = named.pop(ROOT / "docs" / "validation.md")
    assert set().union(*(names for page, names in named.items() if page.parent != ROOT)) - validation == {
        "gallery",
        "presets",
        "tour_pictures",
    }


def test_results_of_the_first_page_are_those_of_validation() -> None:
    first, validation = ((ROOT / "docs" / name).read_text(encoding="utf-8") for name in ("README.md", "validation.md"))
    rows = re.findall(
        r"^\| (.+) \| .+ \|$", first.partition("| result | judge |")[2].partition("\n\n")[0], re.MULTILINE
    )
    figures = [re.findall(r"\d+(?:[.,]\d+)+|\d{3,}", row) for row in rows[1:]]
    assert len(figures) == 5
    assert all(figures)
    assert [figure for row in figures for figure in row if figure not in validation] == []
