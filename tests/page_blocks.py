"""Blocks of code of the pages in `docs/`, and how they are run."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

_FENCE = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
_LEFT_OUT = re.compile(r"<!-- not run: (.+?) -->\s*\Z")
_FILE = re.compile(r"Save this file as `([^`]+)`:\s*\Z")
_TIMEOUT_S = 900  # a busy machine takes long; only a hang takes longer


@dataclass(frozen=True)
class Block:
    """A block of code of a page; `before` is the text above it."""

    language: str
    code: str
    before: str

    @property
    def is_run(self) -> bool:
        """Whether the block is a command, snippet or file that is not left out with a reason."""
        return self.language in ("sh", "python", "toml") and not _LEFT_OUT.search(self.before)


def blocks(text: str) -> list[Block]:
    """The blocks of a page, in their order."""
    found, end = [], 0
    for match in _FENCE.finditer(text):
        found.append(Block(match[1], match[2], text[end : match.start()]))
        end = match.end()
    return found


def run(block: Block, folder: Path) -> None:
    """Run a block in a folder; `AssertionError` with its output if it fails.

    A `toml` block is written to the file that the text before it names ("Save this file as `NAME`").
    """
    if block.language == "toml":
        named = _FILE.search(block.before)
        assert named, f"no file is named before\n{block.code}"
        (folder / named[1]).write_text(block.code, encoding="utf-8")
        return
    # `pip install "scancell[…]"` finds its extras installed; the commands are those of this Python's environment.
    code = re.sub(r"^pip install .*$", "", block.code, flags=re.MULTILINE)
    command = ["bash", "-euo", "pipefail", "-c", code] if block.language == "sh" else [sys.executable, "-c", code]
    paths = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    environment = {**os.environ, "PATH": paths}
    done = subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, timeout=_TIMEOUT_S, check=False
    )
    assert done.returncode == 0, f"{block.code}\n{done.stdout[-2000:]}\n{done.stderr[-2000:]}"
