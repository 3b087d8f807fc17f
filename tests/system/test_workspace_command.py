"""`scancell workspace` as a command: where it listens, how it ends, and what it refuses."""

from __future__ import annotations

import os
import re
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from urllib.request import urlopen

import pytest
import trimesh
import viser
from commands import COMMAND, PARTS, PATIENCE_S, environment, scancell_here
from websockets.sync.client import connect

from bench.interrupts import interrupted

PART = str(PARTS / "free_form.stl")


@contextmanager
def serving(folder: Path, *words: str) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """The command in a session of its own, and the address that it says."""
    (folder / "tmp").mkdir()
    process = subprocess.Popen(
        [*COMMAND, "workspace", *words],
        cwd=folder,
        env=environment(TMPDIR=str(folder / "tmp")),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    try:
        assert process.stdout is not None
        said = process.stdout.readline()
        found = re.fullmatch(r"workspace: open (http://\S+:\d+)\n", said)
        assert found is not None, (said, process.communicate(timeout=PATIENCE_S))
        yield process, found[1]
    finally:
        process.kill()
        process.communicate()


def ended(process: subprocess.Popen[str], number: int) -> str:
    """End the command by a signal: nothing of it is left. Returns what it said on standard error."""
    process.send_signal(number)
    out, err = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 130, err
    assert out == ""
    assert err.endswith("scancell: interrupted\n")
    with pytest.raises(ProcessLookupError):
        os.killpg(process.pid, 0)
    return err.removesuffix("scancell: interrupted\n")


def files(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.rglob("*") if not path.name.startswith((".", "__")))


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signal_closes_the_workspace_with_a_browser_open(tmp_path: Path, number: int) -> None:
    protocol = f"viser-v{viser.__version__}"
    with serving(tmp_path, PART, "--port", "18200") as (process, address):
        with urlopen(address, timeout=PATIENCE_S) as page:
            assert page.status == 200
        with connect(address.replace("http", "ws"), subprotocols=[protocol], max_size=None) as browser:
            assert browser.recv(timeout=PATIENCE_S)
            assert ended(process, number) == ""
    assert files(tmp_path) == ["tmp"]


@pytest.mark.parametrize(("state", "delay"), [("planning", 0.3), ("ray-traced scan", 2.0), ("program", 0.1)])
def test_interrupt_ends_the_command_whatever_computes(tmp_path: Path, state: str, delay: float) -> None:
    """Threads that plan or sense in C++ are not ended as Python ends them, which aborts the process."""
    status, _, err, _ = interrupted(state, delay, tmp_path)
    assert status == 130, err
    assert err in ("", "scancell: interrupted\n")


def test_taken_port_takes_the_next_free_one(tmp_path: Path) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        with serving(tmp_path, "--port", str(port)) as (process, address):
            assert port < int(address.rpartition(":")[2]) < port + 100
            with urlopen(address, timeout=PATIENCE_S) as page:
                assert page.status == 200
            ended(process, signal.SIGINT)


def test_host_that_others_reach_is_warned_of(tmp_path: Path) -> None:
    with serving(tmp_path, "--port", "18240", "--host", "0.0.0.0") as (process, _):
        assert "other machines can reach the workspace" in ended(process, signal.SIGINT)


def test_name_of_the_loopback_is_not_warned_of(tmp_path: Path) -> None:
    with serving(tmp_path, "--port", "18260", "--host", "localhost") as (process, address):
        assert address == "http://localhost:18260"
        assert ended(process, signal.SIGINT) == ""


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["none.stl"], "none.stl: no such file"),
        (["broken.stl"], "broken.stl: not a readable STL mesh: 'solid x' has no 'endsolid'"),
        (["out/scan_7"], "out/scan_7: no such file"),
        (["."], "expected a run folder with resolved.toml and recording.parquet"),
        (["huge.stl"], "'base' and 'part' intersect"),
        (["--cell", "cell.toml"], "cell.toml: table.wrong_key: unknown key"),
        (["--as-built", "table.nothing=1"], "unknown perturbation 'table.nothing'"),
        (["--program", "none.py"], "none.py: no such file"),
        (["--exercise", "8"], "--exercise 8: expected a number from 1 to 7, or kinematics, grasping, sensors"),
        (
            ["--exercise", "2", "--cell", "cell.toml"],
            "--cell cell.toml: expected none: exercise 2 has a cell of its own",
        ),
        (["--exercise", "2", "out"], "part = 'out': expected none: exercise 2 has a part of its own"),
        (["--host", "192.0.2.1"], "expected an address of this machine"),  # RFC 5737: nobody's
        (["--host", "no such.host"], "--host no such.host: "),
    ],
)
def test_wrong_input_is_named_and_nothing_is_served(tmp_path: Path, words: list[str], message: str) -> None:
    trimesh.creation.box((2000, 2000, 1500)).export(tmp_path / "huge.stl")
    (tmp_path / "broken.stl").write_text("solid x\nfacet nonsense")
    (tmp_path / "cell.toml").write_text("[table]\nwrong_key = 1\n")
    done = scancell_here("workspace", *words, "--port", "18280", cwd=tmp_path)
    assert done.code == 1
    assert message in done.err
    assert "Traceback" not in done.err
    assert done.out == ""
    with socket.socket() as free:
        free.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        free.bind(("127.0.0.1", 18280))


def test_exercises_are_listed(tmp_path: Path) -> None:
    done = scancell_here("workspace", "--exercise", "list", cwd=tmp_path)
    assert done.code == 0
    assert re.findall(r"^(\d)  (\w+)", done.out, re.MULTILINE)[1] == ("2", "grasping")
    assert len(done.out.splitlines()) == 7


def test_missing_viser_names_the_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "viser", None)
    done = scancell_here("workspace", PART, cwd=tmp_path)
    assert done.code == 1
    assert 'pip install "scancell[workspace]"' in done.err
    assert done.out == ""
