"""A guard beside the simulated UR, which knows measured joints alone."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator

import numpy as np
import pytest

import scancell
from scancell.errors import LinkError
from scancell.wire.ur.client import RtdeClient
from scancell.wire.ur.controller import UrController
from scancell.wire.ur.variables import pose_vector
from scancell.wire.ur.watch import UrWatch, watch_ur
from scancell.wire.watch import LEAST_SHARE, Order, Watch
from wire_ur import CELL, controller_of, own_address, served, watched_run

WATCHDOG = '  rtde_set_watchdog("input_int_register_24", 10, "stop")'


@pytest.fixture
def controller() -> Iterator[UrController]:
    with controller_of() as made:
        yield made


@pytest.fixture(scope="module")
def guard() -> scancell.Guard:
    return scancell.guard_of(CELL, max_age=0.2)


@pytest.fixture
def watch(guard: scancell.Guard, controller: UrController) -> UrWatch:
    guard.reset()
    return UrWatch(Watch(guard, np.append(controller.robot.home, 0.0)), guard.settings.max_age)


def program(controller: UrController, kind: str, height: float, speed: float) -> str:
    """A move of the sensor to a height (m) on the axis of the table, whose top is at 100 mm."""
    goal = controller.robot.base_from_tcp(controller.robot.home)
    goal[:3, 3] = 0.45, 0.0, height
    joints = controller.robot.joints_for(goal).tolist()
    move = f"movej({joints}, v={speed})" if kind == "movej" else f"movel(p{pose_vector(goal).tolist()}, v={speed})"
    return f"def f():\n{WATCHDOG}\n  {move}\nend"


@pytest.mark.parametrize(("kind", "speed"), [("movej", 0.2), ("movel", 0.25)])
@pytest.mark.parametrize("delay", [0.01, 0.06])
def test_stopped_before_the_table(
    controller: UrController, watch: UrWatch, kind: str, speed: float, delay: float
) -> None:
    run = watched_run(controller, program(controller, kind, 0.09, speed), watch, delay)
    assert run.contacts == []
    assert "stop: sensor - table" in run.stop
    assert run.slowed > 0.0
    assert 0.1 < controller.robot.base_from_tcp(controller.robot.joints)[2, 3] < 0.17
    assert delay < run.age < delay + 0.1


def test_the_same_move_without_a_watch_ends_in_the_table(controller: UrController) -> None:
    script = program(controller, "movel", 0.09, 0.25).replace(WATCHDOG, "")
    assert watched_run(controller, script, None).contacts == ["sensor - table"]


def test_a_move_far_from_everything_is_not_slowed(controller: UrController, watch: UrWatch) -> None:
    run = watched_run(controller, program(controller, "movel", 0.45, 0.05), watch, 0.02)
    assert (run.contacts, run.stop, run.slowed) == ([], "", 0.0)
    assert controller.robot.base_from_tcp(controller.robot.joints)[2, 3] == pytest.approx(0.45, abs=1e-5)


def test_watchdog_of_the_program_stops_when_no_order_comes(controller: UrController, watch: UrWatch) -> None:
    run = watched_run(controller, program(controller, "movel", 0.09, 0.1), watch, loss=1.0)
    assert run.contacts == []
    assert "watchdog" in run.stop


def test_orders_that_are_too_old_hold_the_robot(controller: UrController, watch: UrWatch) -> None:
    run = watched_run(controller, program(controller, "movel", 0.09, 0.25), watch, 0.25, longest=2.0)
    assert run.contacts == []
    assert run.age > 0.2
    assert controller.robot.joints == pytest.approx(controller.robot.home, abs=0.02)


def test_share_follows_the_time_to_contact_and_rises_again(guard: scancell.Guard) -> None:
    """The sensor sinks towards the table; at rest the share rises by half of it each second."""
    guard.reset()
    with controller_of() as controller:
        robot, home = controller.robot, controller.robot.home
        rates = robot.rates_for([0, 0, -0.25, 0, 0, 0])
    watch, shares = Watch(guard, np.append(home, 0.0)), []
    for number in range(15):
        moved = rates if number else 0.0 * rates
        shares.append(watch.order(0.032 * number, home + 0.032 * number * rates, moved, 1.0).share)
    assert shares[0] == 1.0
    assert LEAST_SHARE <= shares[-1] < 1.0
    assert (np.diff(shares) <= 0).all()
    low, at = shares[-1], home + 0.032 * 14 * rates
    for number in range(15, 30):
        last = watch.order(0.032 * number, at, np.zeros(6), 1.0).share
    assert last == pytest.approx(min(1.0, low + 0.5 * 0.032 * 15), abs=1e-6)


@pytest.mark.parametrize("states", [10, 1_100])
def test_age_grows_while_no_order_comes_back(states: int) -> None:
    watch = UrWatch(Planned(Order(False, 1.0, "", False)), 0.2)
    for number in range(states):
        package = {"timestamp": (0.032 * number,), "actual_q": (0.0,) * 6, "actual_qd": (0.0,) * 6}
        order, _ = watch.take(package | {"speed_scaling": (1.0,), "input_int_register_24": (500,)})
    assert watch.age == pytest.approx(0.032 * (states - 1))
    assert order.share == 0.0
    assert not order.stop
    package = {"timestamp": (0.032 * states,), "actual_q": (0.0,) * 6, "actual_qd": (0.1,) * 6}
    order, _ = watch.take(package | {"speed_scaling": (1.0,), "input_int_register_24": (500,)})
    assert order.stop


class Planned:
    """Orders as planned, whatever the robot does."""

    def __init__(self, *orders: Order) -> None:
        self._orders = list(orders)

    def order(self, *_: object) -> Order:
        return self._orders.pop(0) if len(self._orders) > 1 else self._orders[0]


def test_orders_reach_the_robot_by_slider_register_and_dashboard(controller: UrController) -> None:
    clear, slow = Order(False, 1.0, "", False), Order(False, 0.25, "sensor - table: 30 mm", True)
    planned = Planned(clear, slow, slow, slow, Order(True, 0.0, "stop: sensor - table", True))
    watch, lines = UrWatch(planned, 10.0), []
    controller.run_script("sleep(1000)")
    with served(controller, realtime=True) as (rtde, _, dashboard, server):
        ports = server.ports[rtde], server.ports[dashboard]
        end = time.monotonic() + 20.0
        counts = watch_ur(
            watch,
            own_address(),
            ports,
            lambda text, beep: lines.append((text, beep)),
            lambda: (not controller.is_running and controller.speed_slider == 0.0) or time.monotonic() > end,
        )
    assert not controller.is_running
    assert controller.speed_slider == 0.0
    assert controller.registers["input_int_register_24"] >= 5
    assert counts.stops == 1
    stopped = "stop: sensor - table (dashboard: Stopped)"
    assert lines == [(f"guard: watches {own_address()}", False), ("sensor - table: 30 mm", True), (stopped, True)]


def test_inputs_of_another_client_are_no_watch(controller: UrController) -> None:
    watch = UrWatch(Planned(Order(False, 1.0, "", False)), 1.0)
    with (
        served(controller) as (rtde, _, dashboard, server),
        RtdeClient(own_address(), server.ports[rtde]) as other,
    ):
        other.set_inputs(["input_int_register_24"])
        with pytest.raises(scancell.errors.ScancellError, match="input_int_register_24"):
            watch_ur(watch, own_address(), (server.ports[rtde], server.ports[dashboard]))


def test_silence_of_the_robot_ends_the_watch_with_an_error(controller: UrController) -> None:
    """The server ends while the watch runs."""
    watch, failed = UrWatch(Planned(Order(False, 1.0, "", False)), 10.0), []

    def run(ports: tuple[int, int]) -> None:
        try:
            watch_ur(watch, own_address(), ports)
        except LinkError as error:
            failed.append(str(error))

    with served(controller, realtime=True) as (rtde, _, dashboard, server):
        thread = threading.Thread(target=run, args=((server.ports[rtde], server.ports[dashboard]),))
        thread.start()
        end = time.monotonic() + 10.0
        while not controller.registers.get("input_int_register_24") and time.monotonic() < end:
            time.sleep(0.01)
    thread.join(10.0)
    assert len(failed) == 1
