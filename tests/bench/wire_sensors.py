"""The simulated ABB and KUKA over UDP: ``python -m bench.wire_sensors MAKER [--minutes M] [--real S] [--packets N]``.

PYTHONPATH=tests:tests/orchestrator. A sensor of our own moves the robot to and fro and receives every cycle of
simulated time; in real time, beside the command, the share of cycles that began more than a cycle late; mutants of
answers over UDP, between which the robot answers.
"""

from __future__ import annotations

import argparse
import contextlib
import functools
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from scancell.config.choices import LOOPBACK
from scancell.wire.abb.controller import EgmServer
from scancell.wire.abb.packets import ROBOT, SENSOR, Message, packed, unpacked
from scancell.wire.kuka.controller import RsiServer
from scancell.wire.kuka.packets import AXIS_CORRECTION, POSE_CORRECTION, Answer, answer_packet, state_from
from scancell.wire.serve import ControllerServer
from wire_sensors import SensorSocket, abb_controller, command, kuka_controller, mutated

SWING, CYCLE = np.radians(10.0), 0.004

_state = functools.lru_cache(1)(state_from)


@functools.lru_cache(1)
def _robot(packet: bytes) -> Message:
    return unpacked(packet, ROBOT)


class Abb:
    """Corrections of a swing of all joints by 10 degrees, 0.5 Hz."""

    make, server = staticmethod(abb_controller), EgmServer

    def __init__(self) -> None:
        self._home: np.ndarray | None = None

    def time(self, packet: bytes) -> int:
        """Time of a state, ms."""
        return int(_robot(packet)["header"]["tm"])

    def late(self, packet: bytes) -> int | None:
        """Answers that were late, where the state says it."""
        return None

    def answer(self, packet: bytes, by_pose: bool = False) -> bytes:
        state = _robot(packet)
        if self._home is None:
            self._home = np.array(state["planned"]["joints"]["joints"])
        joints = self._home + np.degrees(SWING) * np.sin(np.pi * 1e-3 * state["header"]["tm"])
        planned = {"joints": {"joints": joints.tolist()}}
        if by_pose:
            planned = {"cartesian": state["planned"]["cartesian"]}
        return packed({"header": {"mtype": 3}, "planned": planned}, SENSOR)


class Kuka:
    """The same by relative corrections."""

    make, server = staticmethod(kuka_controller), RsiServer

    def time(self, packet: bytes) -> int:
        return _state(packet)[0]

    def late(self, packet: bytes) -> int | None:
        return int(_state(packet)[1]["Delay"]["D"])

    def answer(self, packet: bytes, by_pose: bool = False) -> bytes:
        ipoc = self.time(packet)
        rate = np.pi * np.degrees(SWING) * np.cos(np.pi * 1e-3 * ipoc)
        corrections = {AXIS_CORRECTION: np.full(6, rate * CYCLE)}
        if by_pose:
            corrections[POSE_CORRECTION] = np.full(6, 0.01)
        return answer_packet(Answer(ipoc, corrections, 3))


def lockstep(maker: Any, take: Callable[[SensorSocket, bytes], bool]) -> int:
    """Serve in simulated time in this thread; `take` answers each state and says whether to end. Refused requests."""
    with maker.make() as controller, contextlib.closing(SensorSocket()) as socket:
        sensors = {socket.address: maker.server(controller)}

        def ended() -> bool:
            return any(take(socket, packet) for packet in socket.waiting())

        with ControllerServer(controller, {}, LOOPBACK, False, sensors) as server:
            server.run(ended)
        return int(controller.refusals.total())


def simulated(maker: Any, minutes: float) -> None:
    begin, times = time.monotonic(), list[int]()

    def take(socket: SensorSocket, packet: bytes) -> bool:
        times.append(maker.time(packet))
        socket.answer(maker.answer(packet))
        return times[-1] - times[0] >= 60_000 * minutes

    refused = lockstep(maker, take)
    gaps = np.rint(np.diff(times) / (1e3 * CYCLE)).astype(int)
    repeated, lost = (gaps == 0).sum(), (gaps[gaps > 0] - 1).sum()
    took = time.monotonic() - begin
    print(
        f"simulated: {len(times)} states of {minutes:g} min, {lost} lost, {repeated} repeated, {refused} requests "
        f"refused, in {took:.1f} s"
    )


def real(maker: Any, name: str, seconds: float) -> None:
    with contextlib.closing(SensorSocket()) as socket:
        times, arrived, late = list[int](), list[float](), None
        with command(name, socket.address[1]) as process:
            end = time.monotonic() + seconds
            while time.monotonic() < end:
                packet = socket.receive()
                socket.answer(maker.answer(packet))
                arrived.append(time.monotonic())
                times.append(maker.time(packet))
            late = maker.late(packet)
            process.terminate()
            assert process.stdout is not None
            told = next(line.strip() for line in process.stdout.read().splitlines() if "cycles" in line)
    gaps = 1e3 * np.diff(arrived)
    lost = (np.rint(np.diff(times) / (1e3 * CYCLE)).astype(int) - 1).sum()
    print(
        f"real: {len(times)} states in {seconds:g} s, {lost} lost; {told}; answers late: {late}; gaps of the client: "
        f"median {np.median(gaps):.2f} ms, 99.9 % {np.quantile(gaps, 0.999):.2f} ms, largest {gaps.max():.1f} ms"
    )


def wrong_packets(maker: Any, number: int) -> None:
    rng, sent, times = np.random.default_rng(1), 0, list[int]()

    def take(socket: SensorSocket, packet: bytes) -> bool:
        nonlocal sent
        if (now := maker.time(packet)) not in times[-1:]:
            times.append(now)
            for i in range(min(20, number - sent)):
                socket.answer(mutated(maker.answer(packet, by_pose=i % 2 == 1), rng))
                sent += 1
        socket.answer(maker.answer(packet))
        return sent >= number and now > times[0]

    refused = lockstep(maker, take)
    print(f"packets: {sent} mutants in {len(times)} cycles, {refused} refused; every cycle went on")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("maker", choices=("abb", "kuka"))
    parser.add_argument("--minutes", type=float, default=0.0)
    parser.add_argument("--real", type=float, default=0.0)
    parser.add_argument("--packets", type=int, default=0)
    options = parser.parse_args()
    chosen = {"abb": Abb, "kuka": Kuka}[options.maker]
    if options.minutes:
        simulated(chosen(), options.minutes)
    if options.real:
        real(chosen(), options.maker, options.real)
    if options.packets:
        wrong_packets(chosen(), options.packets)
