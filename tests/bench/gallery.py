"""Pictures of docs/gallery.md by its own lines: ``PYTHONPATH=tests python -m bench.gallery DIR``.

The blocks of the page run in DIR in their order; then the files that the page names above its pictures replace these.
"""

from __future__ import annotations

import argparse
import re
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from PIL import Image

from page_blocks import blocks, enter, run

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "gallery.md"
LINKS = ("assets", "docs", "tests")
LARGEST = 150_000  # bytes of a picture
_WIDTH = 1000  # px
_PICTURE = re.compile(r"^`(\S+)`:\n\n!\[[^\]]+\]\((\S+)\)$", re.MULTILINE)


@dataclass(frozen=True)
class Picture:
    """A picture of the page, and the file in DIR of which it is made."""

    made: str
    shown: Path


def pictures(text: str) -> list[Picture]:
    """The pictures of the page or of a part of it."""
    return [Picture(match[1], PAGE.parent / match[2]) for match in _PICTURE.finditer(text)]


def shrink(made: Path, shown: Path) -> None:
    """Write a picture as WebP of at most `_WIDTH` px and `LARGEST` bytes."""
    image = Image.open(made).convert("RGB")
    image.thumbnail((_WIDTH, 4 * _WIDTH))
    for quality in range(90, 20, -10):
        image.save(shown, quality=quality, method=6)
        if shown.stat().st_size <= LARGEST:
            return
    raise ValueError(f"{made}: expected a picture that fits into {LARGEST} bytes")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, metavar="DIR")
    parser.add_argument("--section", default="", help="only sections whose heading contains this text")
    given = parser.parse_args()
    given.folder.mkdir(parents=True, exist_ok=True)
    for name in LINKS:
        if not (given.folder / name).exists():
            (given.folder / name).symlink_to(ROOT / name)
    enter(given.folder)
    names: dict[str, Any] = {"__name__": "__main__"}
    for section in PAGE.read_text(encoding="utf-8").split("\n## ")[1:]:
        heading = section.partition("\n")[0]
        if given.section.lower() not in heading.lower():
            continue
        began = time.monotonic()
        for block in blocks(section):
            run(block, heading, names)
        for picture in pictures(section):
            picture.shown.parent.mkdir(exist_ok=True)
            shrink(Path(picture.made), picture.shown)
            print(f"{heading}: {picture.shown.name}, {picture.shown.stat().st_size} bytes")
        print(f"  {time.monotonic() - began:.0f} s", flush=True)


if __name__ == "__main__":
    main()
