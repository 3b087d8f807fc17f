"""The `scancell` command in a process of its own, as a person or a program runs it, or, much faster, in this one."""

from __future__ import annotations

import contextlib
import io
import json
import os
import signal
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from scancell import cli
from scancell import sensor as sensor_rt
from scancell.config.loading import assets_dir

PARTS = assets_dir() / "parts"
COMMAND = [sys.executable, "-c", "from scancell.cli import main; main()"]
PATIENCE_S = 300  # a busy machine takes long; only a hang takes longer
# Small, fast, and a scan all the same.
QUICK = ("--engine", "geometric", "--ideal", "--set", "scan.max_profiles=60")


@dataclass(frozen=True)
class Finished:
    """What a command left behind on its streams."""

    code: int
    out: str
    err: str

    @property
    def last_line(self) -> dict[str, Any]:
        """The JSON object in the last line of standard output; NaN and Infinity are no JSON."""
        found: dict[str, Any] = json.loads(self.out.splitlines()[-1], parse_constant=_refuse)
        return found

    @property
    def message(self) -> str:
        return str(self.last_line["error"]["message"])


def _refuse(word: str) -> None:
    raise ValueError(f"{word} is not JSON")


def environment(**changes: str) -> dict[str, str]:
    """The environment in which the command finds the packages that this process has found."""
    native = Path(sensor_rt.__file__).parents[1]
    package = assets_dir().parent
    paths = [str(native), str(package), *filter(None, [os.environ.get("PYTHONPATH")])]
    return {**os.environ, "PYTHONPATH": os.pathsep.join(paths), **changes}


def scancell(*words: str | Path, cwd: Path, **changes: str) -> Finished:
    """Run a command to its end in `cwd`."""
    done = subprocess.run(
        [*COMMAND, *map(str, words)],
        cwd=cwd,
        env=environment(**changes),
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
    )
    return Finished(done.returncode, done.stdout, done.stderr)


def scancell_here(*words: str | Path, cwd: Path) -> Finished:
    """The same in this process. An exception other than the end of a command reaches the test."""
    out, err = io.StringIO(), io.StringIO()
    arguments, handlers = sys.argv, {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    sys.argv = ["scancell", *map(str, words)]
    on_dropped = sys.unraisablehook
    code: Any = 0
    try:
        with contextlib.chdir(cwd), contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            cli.main()
    except SystemExit as ended:
        code = ended.code or 0
    finally:
        sys.argv, sys.unraisablehook = arguments, on_dropped
        for number, handler in handlers.items():
            signal.signal(number, handler)
    return Finished(int(code), out.getvalue(), err.getvalue())
