"""Ctrl-C at any stage of a scan: exit code 130, one word about it, and nothing left behind."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from commands import COMMAND, PARTS, PATIENCE_S, environment

# Long enough at every stage to be met in it.
SCAN = ("scan", str(PARTS / "free_form.stl"), "--out", "run", "--json", "--images")


def wait_for(what: Callable[[], bool], process: subprocess.Popen[str]) -> None:
    end = time.monotonic() + PATIENCE_S
    while not what():
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < end
        time.sleep(0.01)


def staged(folder: Path) -> bool:
    return any(folder.glob(".run.partial-*"))


def driving(folder: Path) -> bool:
    return any((folder / "tmp").glob("scancell-fmu-*"))


def sensing(folder: Path) -> bool:
    return any(folder.glob(".run.partial-*/images/*"))


@pytest.mark.parametrize(
    ("stage", "number"),
    [
        ("planning", signal.SIGINT),
        ("driving", signal.SIGINT),
        ("sensing", signal.SIGINT),
        ("planning", signal.SIGTERM),
    ],
)
def test_interrupted_scan_removes_files(tmp_path, stage, number) -> None:
    (tmp_path / "tmp").mkdir()
    process = subprocess.Popen(
        [*COMMAND, *SCAN],
        cwd=tmp_path,
        env=environment(TMPDIR=str(tmp_path / "tmp")),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        wait_for(lambda: staged(tmp_path), process)
        if stage == "planning":
            time.sleep(0.2)
        else:
            wait_for(lambda: {"driving": driving, "sensing": sensing}[stage](tmp_path), process)
        begun = time.monotonic()
        process.send_signal(number)
        out, err = process.communicate(timeout=PATIENCE_S)
        print(f"{stage}: gone after {time.monotonic() - begun:.1f} s")
    finally:
        process.kill()
        process.communicate()
    assert process.returncode == 130
    assert "Traceback" not in err
    assert err.strip() == "scancell: interrupted"
    last = json.loads(out.splitlines()[-1])
    assert last == {
        "command": "scan",
        "ok": False,
        "error": {"kind": "KeyboardInterrupt", "message": "interrupted"},
    }
    assert [path.name for path in tmp_path.iterdir()] == ["tmp"]
    assert [path.name for path in (tmp_path / "tmp").iterdir() if path.name.startswith("scancell")] == []


# Python prints and drops what a weak reference's callback raises; `import` has such callbacks.
INTERRUPTED_IN_A_CALLBACK = """
import os, signal, weakref
from scancell.cli import main
from scancell.scanning.pipeline import FmuRunner

class Referent:
    pass

def start(runner, *given, **named):
    referent = Referent()
    reference = weakref.ref(referent, lambda _: os.kill(os.getpid(), signal.SIGINT))
    del referent
    return original(runner, *given, **named)

original, FmuRunner.start = FmuRunner.start, start
main()
"""


def test_interrupt_during_a_callback_is_not_lost(tmp_path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", INTERRUPTED_IN_A_CALLBACK, *SCAN],
        cwd=tmp_path,
        env=environment(),
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
    )
    assert done.returncode == 130
    assert done.stderr.strip() == "scancell: interrupted"
    assert list(tmp_path.iterdir()) == []


def test_interrupted_scan_keeps_previous_result(tmp_path) -> None:
    earlier = tmp_path / "run"
    earlier.mkdir()
    (earlier / "cloud.ply").write_text("earlier")
    process = subprocess.Popen(
        [*COMMAND, *SCAN], cwd=tmp_path, env=environment(), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    try:
        wait_for(lambda: staged(tmp_path), process)
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=PATIENCE_S)
    finally:
        process.kill()
        process.communicate()
    assert process.returncode == 130
    assert [path.name for path in tmp_path.iterdir()] == ["run"]
    assert {path.name: path.read_text() for path in earlier.iterdir()} == {"cloud.ply": "earlier"}
