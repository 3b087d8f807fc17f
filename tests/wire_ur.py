"""A simulated UR with its servers in this process, for tests and benchmarks."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

import scancell
from scancell.live.state import ContactWatch
from scancell.wire.robot import VirtualRobot
from scancell.wire.serve import ControllerServer
from scancell.wire.ur.controller import UrController
from scancell.wire.ur.packets import Kind, outputs_request, packed, version_request
from scancell.wire.ur.ports import DashboardServer, ScriptServer
from scancell.wire.ur.rtde import RtdeServer
from scancell.wire.ur.variables import reading, written
from scancell.wire.ur.watch import UrWatch
from scancell.wire.watch import POLL, Order

RTDE, SCRIPT, DASHBOARD = 0, -1, -2
CELL = scancell.assets_dir() / "cells" / "ur5e.toml"
NAMES = ("timestamp", "actual_q", "target_q", "runtime_state", "output_int_register_0")


def own_address() -> str:
    """Loopback address of this process alone: the ports of a UR are fixed."""
    return f"127.{1 + (os.getpid() >> 8) % 254}.{1 + os.getpid() % 254}.56"


@contextlib.contextmanager
def controller_of(**settings: object) -> Iterator[UrController]:
    with scancell.Scanner(CELL, settings=settings) as scanner, scanner.session() as session:
        yield UrController(VirtualRobot(session))


@contextlib.contextmanager
def served(controller: UrController, realtime: bool = False) -> Iterator[tuple[int, int, int, ControllerServer]]:
    """Ports of RTDE, scripts and dashboard on the loopback address, and the server, which runs in a thread."""
    servers = {}
    makers = (RtdeServer, ScriptServer, DashboardServer)
    ended = threading.Event()
    with contextlib.ExitStack() as stack:
        # Every port of a server is asked for by a number of its own, and these are any free ones.
        host = own_address()
        servers = {
            number: (lambda make=make: make(controller))
            for number, make in zip((40004, 40003, 40999), makers, strict=True)
        }
        server = stack.enter_context(ControllerServer(controller, servers, host, realtime))
        thread = threading.Thread(target=server.run, args=(ended.is_set,))
        thread.start()
        try:
            yield 40004, 40003, 40999, server
        finally:
            ended.set()
            thread.join(10.0)


@contextlib.contextmanager
def command(*options: str) -> Iterator[subprocess.Popen[str]]:
    """`scancell controller ur` at `own_address`, once it listens; it is ended by SIGTERM."""
    words = [sys.executable, "-m", "scancell", "controller", "ur", str(CELL), "--host", own_address(), *options]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as process:
        assert process.stdout is not None
        try:
            line = process.stdout.readline()
            assert line.startswith("controller: ur"), line + process.stdout.read()
            yield process
        finally:
            process.send_signal(signal.SIGTERM)


def packets(names: tuple[str, ...] = NAMES) -> list[bytes]:
    """Requests of an honest client, in their order."""
    inputs = b"input_int_register_0,input_double_register_0,speed_slider_mask,speed_slider_fraction"
    data = b"\1" + np.array([1], ">i4").tobytes() + np.array([0.5], ">f8").tobytes()
    data += np.array([1], ">u4").tobytes() + np.array([0.5], ">f8").tobytes()
    return [
        packed(Kind.PROTOCOL_VERSION, version_request()),
        packed(Kind.CONTROLLER_VERSION),
        packed(Kind.OUTPUTS, outputs_request(500.0, names)),
        packed(Kind.INPUTS, inputs),
        packed(Kind.START),
        packed(Kind.DATA, data),
        packed(Kind.TEXT, b"\2hi\4test\3"),
        packed(Kind.PAUSE),
    ]


def mutated(packet: bytes, rng: np.random.Generator) -> bytes:
    """A packet with bytes changed, removed, inserted, repeated or of a wrong size."""
    changed = bytearray(packet)
    for _ in range(int(rng.integers(1, 4))):
        kind, at = int(rng.integers(6)), int(rng.integers(len(changed) + 1))
        if kind == 0 and at < len(changed):
            changed[at] = int(rng.integers(256))
        elif kind == 1:
            del changed[at : at + int(rng.integers(1, 9))]
        elif kind == 2:
            changed[at:at] = rng.bytes(int(rng.integers(1, 9)))
        elif kind == 3 and len(changed) >= 2:  # the size states what there is
            changed[:2] = min(len(changed), 65_535).to_bytes(2, "big")
        elif kind == 4 and len(changed) >= 3:
            changed[2] = int(rng.choice(list(Kind)))
        else:
            changed += changed[at:]
    return bytes(changed)


@dataclass
class WatchedRun:
    """A program beside a watch, or without one.

    Attributes
    ----------
    contacts
        Pairs of bodies that touched.
    stop
        Reason of the watch, or of the robot's watchdog; empty: neither stopped it.
    age
        Largest age of an order that the robot had, s.
    slowed
        Share of the states in which the robot was slowed down.
    """

    contacts: list[str]
    stop: str
    age: float
    slowed: float


def watched_run(
    controller: UrController,
    script: str,
    watch: UrWatch | None,
    delay: float = 0.0,
    loss: float = 0.0,
    rng: np.random.Generator | None = None,
    longest: float = 60.0,
) -> WatchedRun:
    """Run a program in simulated time, after a second in which the robot rests.

    Orders arrive `delay` (s) after their states, or never with the probability `loss`.
    """
    robot = controller.robot
    session = robot._session
    contacts = ContactWatch(session.cell, [body.name for body in session.true.bodies])
    rng = rng or np.random.default_rng(0)
    pending: list[tuple[float, Order, tuple[float, ...]]] = []
    lines: list[str] = []
    controller._show = lines.append
    stop, age, states, slowed, cycle = "", 0.0, 0, 0, 0
    every, start = round(POLL / robot.cycle), robot.time + 1.0
    while robot.time < start + longest and not contacts.pairs:
        cycle += 1
        if not lines and robot.time >= start:
            controller.run_script(script)
        elif robot.time > start and not controller.is_running and not robot.is_moving:
            break
        controller.step()
        if watch is not None and cycle % every == 0 and rng.random() >= loss:
            package = {key: tuple(np.atleast_1d(reading(controller, key)).tolist()) for key in watch.outputs}
            order, values = watch.take(package)
            age, states, slowed = max(age, watch.age), states + 1, slowed + (order.share < 1.0)
            pending.append((robot.time + delay, order, values))
        while watch is not None and pending and pending[0][0] <= robot.time + 1e-9:
            _, order, values = pending.pop(0)
            written(controller, {key: (value,) for key, value in zip(watch.inputs, values, strict=True)})
            if order.stop and controller.is_running:
                stop = order.text
                controller.stop_program()
    contacts.end()
    stop = stop or next((line for line in lines if "watchdog" in line), "")
    controller.stop_program()
    controller.set_speed_slider(1.0)
    return WatchedRun(contacts.pairs, stop, age, slowed / max(1, states))
