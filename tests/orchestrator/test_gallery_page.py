"""docs/gallery.md: each section has the lines that write its pictures, and small pictures that the page shows."""

from __future__ import annotations

import shlex
from pathlib import Path

import pytest

from bench.gallery import LARGEST, PAGE, pictures
from page_blocks import blocks
from scancell.cli.common import GROUPS

TEXT = PAGE.read_text(encoding="utf-8")
SECTIONS = TEXT.split("\n## ")[1:]
TOTAL = 2_000_000  # bytes
COMMANDS = {name for names in GROUPS.values() for name in names}


def test_gallery_has_fifteen_small_pictures_and_shows_all_of_its_folder() -> None:
    shown = [picture.shown for picture in pictures(TEXT)]
    assert len(shown) >= 15
    assert set(shown) == set((PAGE.parent / "pictures" / "gallery").iterdir())
    sizes = [file.stat().st_size for file in shown]
    assert max(sizes) <= LARGEST
    assert sum(sizes) <= TOTAL


@pytest.mark.parametrize("section", SECTIONS, ids=lambda text: text.partition("\n")[0])
def test_lines_of_a_section_write_its_pictures(section: str) -> None:
    code = "\n".join(block.code for block in blocks(section))
    made = [picture.made for picture in pictures(section)]
    assert made
    for name in made:
        file = Path(name)
        # A file itself, or one that a command writes into the folder of `--out`.
        assert file.name in code or str(file.parent) in shlex.split(code.replace("\\\n", " "), comments=True), name


@pytest.mark.parametrize("section", SECTIONS, ids=lambda text: text.partition("\n")[0])
def test_lines_of_a_section_are_python_or_known_commands(section: str) -> None:
    for block in blocks(section):
        if block.language == "python":
            compile(block.code, section.partition("\n")[0], "exec")
        else:
            assert block.language == "sh"
            words = [line.split() for line in block.code.splitlines() if line.startswith("scancell ")]
            assert {line[1] for line in words} <= COMMANDS
