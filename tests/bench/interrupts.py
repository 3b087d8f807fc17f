"""Interrupts of ``scancell workspace`` in every state: ``python -m bench.interrupts [--tries N]``.  PYTHONPATH=tests.

The process must end with status 130 within 2 s, and leave no files.
"""

from __future__ import annotations

import argparse
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from remote_browser import RemoteBrowser

PART = Path(__file__).resolve().parents[2] / "assets" / "parts" / "free_form.stl"
COMMAND = [sys.executable, "-c", "from scancell.cli import main; main()"]
HANGS = 120.0  # s
PROGRAM = "def main(robot):\n    while True:\n        robot.wait(1.0)\n"
# Draws, s, of the time in a state until the signal: all of it is met.
_WITHIN = {"starting": 3.0, "at rest": 0.1, "planning": 3.0, "moving": 0.5, "program": 0.5, "closed page": 0.3}
_SCANS = {"geometric scan": 3.0, "ray-traced scan": 6.0}
STATES = (*_WITHIN, *_SCANS)


def _planning(browser: RemoteBrowser) -> None:
    browser.press("Plan the scan")


def _moving(browser: RemoteBrowser) -> None:
    browser.enter("joint 1, deg", 60.0)
    browser.shows("of the motion")


def _program(browser: RemoteBrowser) -> None:
    browser.press("Run the program")


def _scanning(browser: RemoteBrowser) -> None:
    browser.press("Scan the part")


_ENTERS: dict[str, Callable[[RemoteBrowser], None]] = {
    "planning": _planning,
    "moving": _moving,
    "program": _program,
    **dict.fromkeys(_SCANS, _scanning),
}


def interrupted(state: str, delay: float, folder: Path) -> tuple[int, float, str, list[str]]:
    """Status, time to the end (s), standard error and files left of a workspace interrupted `delay` s into a state."""
    program, temporary = folder / "endless.py", folder / "tmp"
    temporary.mkdir()
    program.write_text(PROGRAM)
    engine = "geometric" if state == "geometric scan" else "ray-traced"
    words = ["workspace", str(PART), "--port", "18400", "--engine", engine, "--program", str(program)]
    environment = {**os.environ, "TMPDIR": str(temporary)}
    process = subprocess.Popen(
        [*COMMAND, *words], cwd=folder, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    try:
        if state == "starting":
            time.sleep(0.8)  # until Python's own interrupt handler is replaced
        else:
            assert process.stdout is not None
            found = re.search(r"http://\S+", process.stdout.readline())
            assert found is not None, process.communicate()
            with RemoteBrowser(found[0]) as browser:
                browser.shows("at rest")
                _ENTERS.get(state, lambda _: None)(browser)
                if state != "closed page":
                    time.sleep(delay)
                    return _ended(process, temporary)
        time.sleep(delay)
        return _ended(process, temporary)
    finally:
        process.kill()
        process.communicate()


def _ended(process: subprocess.Popen[str], temporary: Path) -> tuple[int, float, str, list[str]]:
    start = time.monotonic()
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=HANGS)
    seconds = time.monotonic() - start
    return process.returncode, seconds, err, sorted(path.name for path in temporary.iterdir())


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m bench.interrupts", description=__doc__)
    parser.add_argument("--tries", type=int, default=50, help="of each state")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--states", nargs="*", default=STATES)
    options = parser.parse_args()
    rng = np.random.default_rng(options.seed)
    print(f"{'state':<18}{'tries':>6}{'status 130':>12}{'longest, s':>12}{'median, s':>12}{'files left':>12}")
    for state in options.states:
        statuses, times, left = [], [], 0
        for _ in range(options.tries):
            with TemporaryDirectory() as folder:
                delay = float(rng.uniform(0.0, (_WITHIN | _SCANS)[state]))
                status, seconds, err, files = interrupted(state, delay, Path(folder))
            statuses.append(status)
            times.append(seconds)
            left += bool(files)
            if status != 130 or "Traceback" in err:
                print(f"{state}, {delay:.2f} s: status {status}: {err[-1500:]}")
            if files:
                print(f"{state}, {delay:.2f} s: left {files}")
        row = f"{state:<18}{options.tries:>6}{statuses.count(130):>12}{max(times):>12.2f}{np.median(times):>12.2f}"
        print(f"{row}{left:>12}", flush=True)


if __name__ == "__main__":
    main()
