"""Simulated controllers of ABB and KUKA, which send to a sensor, in this process or as a command."""

from __future__ import annotations

import contextlib
import select
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from typing import Any

import numpy as np

import scancell
from scancell.config.choices import LOOPBACK
from scancell.wire.abb.controller import EgmController
from scancell.wire.kuka.controller import RsiController
from scancell.wire.robot import VirtualRobot
from scancell.wire.serve import ControllerServer, Peer

CELLS = {
    maker: scancell.assets_dir() / "cells" / f"{name}.toml"
    for maker, name in (("abb", "irb1200"), ("kuka", "kr6_r900"))
}
RESOLUTION = np.radians(0.0002)  # of the encoders
_WAIT = 20.0  # s


@contextlib.contextmanager
def robot_of(maker: str, **settings: object) -> Iterator[VirtualRobot]:
    with scancell.Scanner(CELLS[maker], settings=settings) as scanner, scanner.session() as session:
        yield VirtualRobot(session)


@contextlib.contextmanager
def abb_controller(**settings: object) -> Iterator[EgmController]:
    with robot_of("abb", **settings) as robot:
        yield EgmController(robot)


@contextlib.contextmanager
def kuka_controller(is_absolute: bool = False, **settings: object) -> Iterator[RsiController]:
    with robot_of("kuka", **settings) as robot:
        yield RsiController(robot, is_absolute=is_absolute)


class SensorSocket:
    """A sensor of our own: receives what the controller sends, and answers to where it came from."""

    def __init__(self, port: int = 0) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind((LOOPBACK, port))
        self._socket.settimeout(_WAIT)
        self._controller: Any = None

    @property
    def address(self) -> tuple[str, int]:
        host, port = self._socket.getsockname()
        return host, port

    def receive(self) -> bytes:
        received, self._controller = self._socket.recvfrom(65_536)
        return received

    def waiting(self) -> Iterator[bytes]:
        """What has come."""
        while select.select([self._socket], [], [], 0.0)[0]:
            yield self.receive()

    def answer(self, payload: bytes) -> None:
        self._socket.sendto(payload, self._controller)

    def close(self) -> None:
        self._socket.close()


@contextlib.contextmanager
def served(controller: Any, peer: Peer, realtime: bool = False) -> Iterator[tuple[SensorSocket, ControllerServer]]:
    """A sensor to which the controller sends; its server runs in a thread."""
    ended = threading.Event()
    with (
        contextlib.closing(SensorSocket()) as sensor,
        ControllerServer(controller, {}, LOOPBACK, realtime, {sensor.address: peer}) as server,
    ):
        thread = threading.Thread(target=server.run, args=(ended.is_set,))
        thread.start()
        try:
            yield sensor, server
        finally:
            ended.set()
            thread.join(10.0)


def free_port() -> int:
    with contextlib.closing(SensorSocket()) as sensor:
        return sensor.address[1]


@contextlib.contextmanager
def command(maker: str, port: int, *options: str) -> Iterator[subprocess.Popen[str]]:
    """`scancell controller`, once it runs; it is ended by SIGTERM."""
    words = ["-m", "scancell", "controller", maker, str(CELLS[maker]), "--port", str(port), *options]
    with subprocess.Popen(
        [sys.executable, *words], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    ) as process:
        assert process.stdout is not None
        try:
            line = process.stdout.readline()
            assert line.startswith(f"controller: {maker}"), line + process.stdout.read()
            yield process
        finally:
            process.send_signal(signal.SIGTERM)


def mutated(packet: bytes, rng: np.random.Generator) -> bytes:
    """A packet with bytes changed, removed, inserted, repeated or cut off."""
    changed = bytearray(packet)
    for _ in range(int(rng.integers(1, 4))):
        kind, at = int(rng.integers(5)), int(rng.integers(len(changed) + 1))
        if kind == 0 and at < len(changed):
            changed[at] = int(rng.integers(256))
        elif kind == 1:
            del changed[at : at + int(rng.integers(1, 9))]
        elif kind == 2:
            changed[at:at] = rng.bytes(int(rng.integers(1, 9)))
        elif kind == 3:
            del changed[at:]
        else:
            changed += changed[at:]
    return bytes(changed[:2000])
