"""A guard for tests of the network: it looks at one joint.  ``python guard_answers.py udp|tcp [PORT]`` serves it."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

import numpy as np

from scancell.cell.driver import Mode, Operation
from scancell.config.choices import TransportProtocol
from scancell.errors import MessageError
from scancell.guard.messages import CellState, GuardMessage
from scancell.guard.server import serve_guard

SLOW_FROM, STOP_FROM = 0.5, 1.0  # rad
FAILS = -9.0  # rad: there the guard raises an exception
JOINTS = 6
HANGS = 60.0  # s
Result = TypeVar("Result")


@dataclass
class JointLimitGuard:
    """Slows the robot down where joint 1 passes an angle, and stops it at another; knows arms of six joints only."""

    states: list[CellState] = field(default_factory=list)
    resets: int = 0
    sequence: int = 0

    def answer(self, state: CellState) -> GuardMessage:
        if len(state.axes) != JOINTS + 1:
            raise MessageError(f"axes: {len(state.axes)}: expected {JOINTS + 1}")
        self.states.append(state)
        self.sequence += 1
        angle = float(state.axes[0])
        if angle <= FAILS:
            raise OverflowError("an error of the guard")
        speed = float(np.clip((STOP_FROM - angle) / (STOP_FROM - SLOW_FROM), 0, 1))
        text = f"joint 1 at {np.degrees(angle):.1f}°" if speed < 1 else ""
        return GuardMessage(
            self.sequence, state.sequence, state.time, speed, angle >= STOP_FROM, text, beep=angle >= STOP_FROM
        )

    def reset(self) -> None:
        self.states.clear()
        self.resets += 1
        self.sequence = 0


def state_at(sequence: int, angle: float = 0.0, period: float = 0.032) -> CellState:
    """State with joint 1 at an angle, rad, in manual operation."""
    axes = np.array([angle, -1.2, 0.7, 0.1, 0.4, -2.0, 0.3])
    return CellState(sequence % 2**32, sequence * period, Operation.MANUAL, Mode.JOINT_JOG, True, axes)


@dataclass
class GuardProcess:
    """A server in a process of its own."""

    process: subprocess.Popen[str]
    host: str
    port: int
    counts: dict[str, int] = field(default_factory=dict)

    def end(self, number: signal.Signals = signal.SIGTERM) -> int:
        """Send a signal; returns the exit code. What the process counted is in `counts`."""
        self.process.send_signal(number)
        out, _ = self.process.communicate(timeout=HANGS)
        if self.process.returncode == 0:
            self.counts = json.loads(out.splitlines()[-1])
        return self.process.returncode


@contextlib.contextmanager
def guard_process(protocol: str, port: int = 0) -> Iterator[GuardProcess]:
    """Start a server."""
    process = subprocess.Popen(
        [sys.executable, __file__, protocol, str(port)],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join([str(Path(__file__).parent), *sys.path])},
    )
    try:
        assert process.stdout is not None
        _, host, bound = process.stdout.readline().split()
        yield GuardProcess(process, host, int(bound))
    finally:
        if process.poll() is None:
            process.kill()
        process.communicate()


def until(act: Callable[[], Result | None]) -> Result:
    """Repeat until there is a result; fails instead of hanging."""
    start = time.monotonic()
    while time.monotonic() < start + HANGS:
        if (result := act()) is not None:
            return result
        time.sleep(1e-3)
    raise TimeoutError(f"nothing within {HANGS} s")


def main() -> None:
    protocol: TransportProtocol = "udp" if sys.argv[1] == "udp" else "tcp"
    counts = serve_guard(
        JointLimitGuard(),
        port=int(sys.argv[2]),
        protocol=protocol,
        started=lambda host, port: print(f"{protocol} {host} {port}", flush=True),
    )
    print(json.dumps(counts))


if __name__ == "__main__":
    main()
