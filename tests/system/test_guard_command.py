"""`scancell guard serve` as a process."""

from __future__ import annotations

import json
import signal
import subprocess

import numpy as np
import pytest
from commands import COMMAND, PATIENCE_S, environment, scancell_here

from guard_answers import HANGS, until
from scancell.cell.driver import Mode, Operation
from scancell.config.cell import CellDescription
from scancell.config.choices import LOOPBACK
from scancell.guard.messages import CellState
from scancell.guard.transport import Link, TcpTransport, UdpTransport
from scancell.scanning.session import guard_of


@pytest.mark.parametrize(("protocol", "transport"), [("udp", UdpTransport), ("tcp", TcpTransport)])
def test_guard_of_the_default_cell_answers_until_a_signal(protocol, transport):
    home = np.radians([*CellDescription.default().robot.home_deg, 0.0])
    process = subprocess.Popen(
        [*COMMAND, "guard", "serve", "--transport", protocol, "--json"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=environment(),
    )
    try:
        assert process.stderr is not None
        name, host, port = process.stderr.readline().removeprefix("guard: ").split()
        assert (name, host) == (protocol, LOOPBACK)
        link = Link(transport(host, int(port)), age_limit=HANGS)
        for i in range(5):
            state = CellState(i, 0.032 * i, Operation.MANUAL, Mode.JOINT_JOG, False, home)
            link.send(state, state.time)
            answers = until(lambda state=state: link.poll(state.time) or None)
            assert [(answer.state_sequence, answer.emergency_stop) for answer in answers] == [(i, False)]
        link.close()
        process.send_signal(signal.SIGTERM)
        out, err = process.communicate(timeout=PATIENCE_S)
    finally:
        process.kill()
        process.wait()
    assert process.returncode == 0, err
    assert json.loads(out)["figures"] == {"packets": {"accepted": 5}}
    assert err.split() == ["5", "packets", "accepted"]


def test_wrong_cell_and_wrong_address(tmp_path):
    done = scancell_here("guard", "serve", "none.toml", "--json", cwd=tmp_path)
    assert done.code == 1
    assert "none.toml" in done.message
    done = scancell_here("guard", "serve", "--host", "no host", "--json", cwd=tmp_path)
    assert done.code == 1
    assert "expected an address to listen on" in done.message


def test_the_longest_age_is_that_of_the_command_line(tmp_path):
    assert guard_of(max_age=0.25).settings.max_age == 0.25
    done = scancell_here("guard", "serve", "--max-age", "0", cwd=tmp_path)
    assert done.code != 0
    assert "--max-age" in done.err
