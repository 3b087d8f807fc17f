"""Files of earlier versions (golden/compatibility), as their users have them: in a folder of their own."""

from __future__ import annotations

import shutil
from pathlib import Path

from scancell.config.files import assets_dir

SETS = sorted(path for path in (Path(__file__).parent / "golden" / "compatibility").iterdir() if path.is_dir())
_TEXT = {".toml", ".json", ".csv"}


def copy_of(files: Path, target: Path) -> Path:
    """A copy of a set, where the marks for absolute paths are replaced."""
    shutil.copytree(files, target)
    places = {"@SET@": str(target), "@ASSETS@": str(assets_dir())}
    for path in (path for path in target.rglob("*") if path.suffix in _TEXT):
        text = path.read_text()
        for mark, place in places.items():
            text = text.replace(mark, place)
        path.write_text(text)
    return target
