"""Blocks of code of the pages, and how they run.

    python tests/page_blocks.py             # a table: blocks that run, and why others do not
    python tests/page_blocks.py PAGE [DIR]  # run the blocks of a page in DIR, in their order

A block that cannot run has ``<!-- not run: REASON -->`` above it. A `toml` block is written to the file that the text
before it names ("Save this file as `NAME`"). A block in an HTML comment runs, but the site does not show it: it makes
what the page presumes. Python blocks of a page share their names.
"""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")])
# Reasons begin with one of these.
KINDS = (
    "installs",  # on this machine
    "needs a download",
    "needs another program",
    "needs a device",
    "shows a form",  # a pattern to fill in, not code
    "takes long",
)
_FENCE = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
_LEFT_OUT = re.compile(r"<!-- not run: (.+?) -->\s*\Z")
_FILE = re.compile(r"Save this file as `([^`]+)`:\s*\Z")
_SERVES = re.compile(r"^(?=scancell (?:workspace|guard serve|controller \w+)\b[^&\n]*$)", re.MULTILINE)
_ENDED_BY_CTRL_C = 130  # also by Ctrl-C before the command handles it


@dataclass(frozen=True)
class Block:
    """A block of code of a page, its line, and the text above it since the block before."""

    language: str
    code: str
    before: str
    line: int

    @property
    def is_code(self) -> bool:
        """Whether it holds commands or Python."""
        return self.language in ("sh", "python")

    @property
    def reason(self) -> str | None:
        """Why the page leaves the block out."""
        found = _LEFT_OUT.search(self.before)
        return found[1] if found else None

    @property
    def file(self) -> str | None:
        """Name of the file that the text before the block gives it."""
        found = _FILE.search(self.before)
        return found[1] if found else None


def blocks(text: str) -> list[Block]:
    """The blocks of a page, in their order."""
    found, end = [], 0
    for match in _FENCE.finditer(text):
        line = text.count("\n", 0, match.start(2)) + 1
        found.append(Block(match[1], match[2], text[end : match.start()], line))
        end = match.end()
    return found


def enter(folder: Path) -> None:
    """Make a folder the current one, and `scancell` and `python` those of this Python's environment."""
    os.chdir(folder)
    os.environ["PATH"] = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])


def run(block: Block, page: str, names: dict[str, Any]) -> None:
    """Run a block in the current folder, unless it is left out; raises what Python or a command that fails raises.

    Parameters
    ----------
    names
        Of the Python blocks before; those of this one are added.
    """
    if block.file:
        Path(block.file).write_text(block.code, encoding="utf-8")
    elif block.is_code and not block.reason:
        print(f"{page}:{block.line}", flush=True)
        if block.language == "python":
            exec(compile("\n" * (block.line - 1) + block.code, page, "exec"), names)
        else:
            _run_commands(block.code)


def _run_commands(code: str) -> None:
    """Run lines of a shell; what they leave running ends with them."""
    # `pip install "scancell[…]"` finds its extras installed.
    code = re.sub(r"^pip install .*$", "", code, flags=re.MULTILINE)
    code = _SERVES.sub(f"python {__file__} --served ", code)
    lines = f"trap 'kill $(jobs -p) 2>/dev/null || true' EXIT\n{code}"
    subprocess.run(["bash", "-euo", "pipefail", "-c", lines], check=True)


def _run_until_served(command: list[str]) -> int:
    """Run a command that serves until Ctrl-C, which it gets when it has told its address."""
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    served = any(re.search(r"https?://|\d+\.\d+\.\d+\.\d+", line) for line in process.stdout)
    process.send_signal(signal.SIGINT)
    process.communicate()
    return 0 if served and process.returncode in (0, _ENDED_BY_CTRL_C) else 1


def counts() -> str:
    """A line for each page with code, the blocks that run and the reasons of others, and a line of the totals."""
    lines, total = [], Counter[str]()
    for page in PAGES:
        code = [block for block in blocks(page.read_text(encoding="utf-8")) if block.is_code]
        kinds = (next((kind for kind in KINDS if (block.reason or "").startswith(kind)), "run") for block in code)
        found = Counter(kinds)
        total += found
        if found:
            lines.append(f"{page.relative_to(ROOT)}: {_listed(found)}")
    return "\n".join([*lines, f"all: {_listed(total)}"])


def _listed(found: Counter[str]) -> str:
    return ", ".join(f"{number} {kind}" for kind, number in sorted(found.items()))


def main(page: str = "", folder: str = ".") -> None:
    """Print the table, or run a page."""
    if not page:
        print(counts())
        return
    text = Path(page).read_text(encoding="utf-8")
    enter(Path(folder))
    names: dict[str, Any] = {"__name__": "__main__"}
    for block in blocks(text):
        run(block, page, names)


if __name__ == "__main__":
    if sys.argv[1:2] == ["--served"]:
        sys.exit(_run_until_served(sys.argv[2:]))
    main(*sys.argv[1:])
