"""A guard between the simulated ABB or KUKA and the program that guides it."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

import scancell
from scancell.errors import LinkError, MessageError
from scancell.geometry import pose
from scancell.live.state import ContactWatch
from scancell.wire.abb.controller import EgmServer
from scancell.wire.abb.packets import ROBOT, SENSOR, Kind, packed, pose_message, unpacked
from scancell.wire.abb.watch import EgmInterface
from scancell.wire.kuka.controller import RsiServer
from scancell.wire.kuka.packets import Answer, answer_from, answer_packet, state_from, state_packet
from scancell.wire.kuka.watch import RsiInterface
from scancell.wire.relay import GuardedLink, watch_link
from scancell.wire.serve import ControllerServer
from scancell.wire.watch import Order, Watch
from wire_sensors import CELLS, SensorSocket, abb_controller, free_port, kuka_controller

CLEAR, STOP = Order(False, 1.0, "", False), Order(True, 0.0, "stop: sensor - table", True)
SPEED = 0.1  # m/s


class Planned:
    """Orders as planned, whatever the robot does."""

    def __init__(self, *orders: Order) -> None:
        self._orders = list(orders)

    def order(self, *_: object) -> Order:
        return self._orders.pop(0) if len(self._orders) > 1 else self._orders[0]


class Lowering:
    """A program that lowers the TCP straight down through the table."""

    def __init__(self, maker: str, controller: Any) -> None:
        self._maker, robot = maker, controller.robot
        self._start = robot.base_from_tcp(robot.home)
        above = -0.25 if maker == "kuka" else 0.25  # z of the base of a KUKA points down
        self._start[:3, 3] = (0.45, 0.0, above)
        self._cycle, self.count = robot.cycle, 0
        self.first = robot.joints_for(self._start)

    def answer(self, packet: bytes) -> bytes:
        self.count += 1
        if self._maker == "kuka":
            corrections = {"RKorr": np.array([0.0, 0.0, -1e3 * SPEED * self._cycle, 0.0, 0.0, 0.0])}
            return answer_packet(Answer(state_from(packet)[0], corrections))
        place = self._start.copy()
        place[2, 3] -= SPEED * self._cycle * self.count
        return packed({"header": {"mtype": Kind.CORRECTION}, "planned": {"cartesian": pose_message(place)}}, SENSOR)


MAKERS = {
    "abb": (abb_controller, EgmServer, EgmInterface),
    "kuka": (kuka_controller, RsiServer, RsiInterface),
}


@pytest.fixture(scope="module", params=MAKERS)
def guarded(request: pytest.FixtureRequest) -> tuple[str, scancell.Guard]:
    return request.param, scancell.guard_of(CELLS[request.param], max_age=0.2)


@pytest.mark.parametrize("delay", [None, 0.0, 0.05])
def test_robot_stops_in_front_of_the_table(guarded: tuple[str, scancell.Guard], delay: float | None) -> None:
    """`delay` from a state to its decision, s; None: without the guard, and the sensor touches the table."""
    maker, guard = guarded
    make, serve, interface = MAKERS[maker]
    guard.reset()
    with make() as controller:
        robot, peer, pending = controller.robot, serve(controller), []
        program = Lowering(maker, controller)
        robot.move_joints(program.first, 1.0)
        while not robot.is_at_end or robot.is_moving:
            robot.step()
        link = GuardedLink(Watch(guard, np.append(program.first, 0.0)), interface(), guard.settings.max_age)
        contacts = ContactWatch(robot._session.cell, [body.name for body in robot._session.true.bodies])
        end = robot.time + 2.5
        while robot.time < end and not contacts.pairs:
            packet = peer.cycle()
            answer = program.answer(packet)
            if delay is not None:
                if (due := link.take(packet)) is not None:
                    pending.append((robot.time + delay, due()))
                while pending and pending[0][0] <= robot.time + 1e-9:
                    link.apply(pending.pop(0)[1])
                link.check()
                passed = link.passed(answer)
                answer = link.answer(packet) or passed
            if answer is not None:
                peer.receive(answer)
            controller.step()
        contacts.end()
        is_moving = robot.is_moving
    assert bool(contacts.pairs) == (delay is None)
    if delay is not None:
        assert link.counts.stops == 1
        assert not is_moving
        assert link.is_stopped


@pytest.mark.parametrize("by_pose", [False, True])
def test_egm_is_held_where_it_was(by_pose: bool) -> None:
    interface = EgmInterface()
    place = pose.translation((0.4, 0.0, 0.5))

    def state(number: int) -> bytes:
        feedback = {"joints": {"joints": [float(number)] * 6}, "cartesian": pose_message(place)}
        return packed({"header": {"seqno": number, "tm": 4 * number, "mtype": 2}, "feedBack": feedback}, ROBOT)

    wanted = {"cartesian": pose_message(place)} if by_pose else {"joints": {"joints": [1.0] * 6}}
    interface.note(packed({"header": {"mtype": 3}, "planned": wanted}, SENSOR))
    held = [unpacked(interface.hold(state(number), number == 3), SENSOR) for number in (3, 4)]
    expected = {"cartesian": pose_message(place)} if by_pose else {"joints": {"joints": [3.0] * 6}}
    assert [message["planned"] for message in held] == [expected] * 2
    assert all(message["header"]["mtype"] == Kind.CORRECTION for message in held)
    time_, joints = interface.state(state(5))
    assert time_ == pytest.approx(0.02)
    assert joints == pytest.approx(np.radians([5.0] * 6))


@pytest.mark.parametrize("is_absolute", [False, True])
def test_rsi_is_held_by_corrections_that_change_nothing(is_absolute: bool) -> None:
    interface = RsiInterface(is_absolute)
    interface.note(b'<Sen Type="Mine"><EStr>a &amp; b</EStr><RKorr X="2"/><DiO>3</DiO><IPOC>4</IPOC></Sen>')
    state = state_packet({"AIPos": {f"A{i}": 10.0 for i in range(1, 7)}}, 8)
    held = answer_from(interface.hold(state, True) or b"")
    assert (held.ipoc, held.sensor, held.outputs, held.text) == (8, "Mine", 3, "a & b")
    assert held.corrections["RKorr"] == pytest.approx([2.0 * is_absolute, 0, 0, 0, 0, 0])
    assert interface.state(state)[1] == pytest.approx(np.radians([10.0] * 6))
    with pytest.raises(MessageError, match="AIPos"):
        interface.state(state_packet({}, 8))


def state_of(number: int, angle: float) -> bytes:
    return state_packet({"AIPos": {f"A{i}": angle for i in range(1, 7)}}, 4 * number)


@pytest.mark.parametrize(("rate", "stops"), [(0.02, True), (0.0, False)])
def test_robot_that_moves_without_recent_decision_is_stopped(rate: float, stops: bool) -> None:
    """Decisions never come; `rate` in degrees per cycle."""
    link = GuardedLink(Planned(CLEAR), RsiInterface(), 0.2)
    for number in range(100):
        assert not link.is_stopped or number * 0.004 > 0.2
        link.take(state_of(number, rate * number))
        link.check()
    assert link.is_stopped is stops


def test_stop_ends_when_the_program_is_silent() -> None:
    link = GuardedLink(Planned(STOP), RsiInterface(), 10.0)
    answer = answer_packet(Answer(0, {"AKorr": np.full(6, 0.1)}))
    assert link.passed(answer) == answer
    link.take(state_of(0, 0.0))
    due = link.take(state_of(8, 0.0))
    assert due is not None
    link.apply(due())
    for number in range(9, 600):  # a program that goes on is held for good
        link.take(state_of(number, 0.0))
        held = link.answer(state_of(number, 0.0))
        assert (held is None) == (number >= 9 + 25)  # silence then ends RSI, and the motion of the robot's program
        assert held is None or answer_from(held).corrections["AKorr"] == pytest.approx(np.zeros(6))
        assert link.passed(answer) is None
    for number in range(600, 860):
        link.take(state_of(number, 0.0))
        link.answer(state_of(number, 0.0))
    assert not link.is_stopped
    assert link.passed(answer) == answer


@pytest.fixture(params=MAKERS)
def relayed(request: pytest.FixtureRequest) -> Iterator[tuple[Any, Callable[..., Any]]]:
    """A controller that sends to a guard, and what starts the guard in a thread."""
    make, serve, interface = MAKERS[request.param]
    port, ended, threads, lines = free_port(), threading.Event(), [], []
    program = SensorSocket()
    with make() as controller:
        server = ControllerServer(controller, {}, "127.0.0.1", False, {("127.0.0.1", port): serve(controller)})

        def start(*orders: Order) -> tuple[SensorSocket, GuardedLink, list[str]]:
            link = GuardedLink(Planned(*orders), interface(), 1e3)
            ports = port, program.address[1]
            acts = (
                lambda: server.run(ended.is_set),
                lambda: watch_link(link, "127.0.0.1", ports, lambda text, _: lines.append(text), ended.is_set),
            )
            threads.extend(threading.Thread(target=act) for act in acts)
            for thread in threads:
                thread.start()
            return program, link, lines

        try:
            yield (request.param, controller), start
        finally:
            ended.set()
            for thread in threads:
                thread.join(20.0)
            program.close()
            server.close()


def test_packets_pass_through_until_a_stop(relayed: tuple[Any, Callable[..., Any]]) -> None:
    (maker, controller), start = relayed
    program, link, lines = start(*[CLEAR] * 5, STOP)
    lowering, end = Lowering(maker, controller), time.monotonic() + 60.0
    while not link.is_stopped:
        assert time.monotonic() < end
        program.answer(lowering.answer(program.receive()))
    moved = controller.robot.base_from_tcp(controller.robot.targets)[2, 3]
    for _ in range(100):
        program.answer(lowering.answer(program.receive()))
    rest = controller.robot.base_from_tcp(controller.robot.targets)[2, 3]
    assert not controller.robot.is_moving
    assert abs(rest - moved) < 0.05
    assert lines[0] == "guard: watches 127.0.0.1"
    assert STOP.text in lines
    assert link.counts.reasons == [STOP.text]


def test_port_in_use_is_an_error() -> None:
    sensor = SensorSocket()
    with pytest.raises(LinkError, match="address to listen on"):
        watch_link(GuardedLink(Planned(CLEAR), RsiInterface(), 1.0), "127.0.0.1", (sensor.address[1], 1))
    sensor.close()
