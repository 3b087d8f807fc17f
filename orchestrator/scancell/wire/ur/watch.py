"""A guard beside a robot of Universal Robots: reads RTDE, slows by the speed slider, stops by slider and dashboard."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from scancell.errors import LinkError
from scancell.wire.ur.client import DashboardClient, RtdeClient
from scancell.wire.watch import POLL, Announcer, Counts, Order, Watch, moves

_SLIDER = ("speed_slider_mask", "speed_slider_fraction")
_MOST_NUMBER = 2**31 - 2
_SILENCE = 1.0  # s without data after which the connection counts as lost

Package = Mapping[str, tuple[float, ...]]


class UrWatch:
    """Orders of a `Watch` as inputs of a robot; sockets are elsewhere.

    With every order the number of its state is written into an integer register, which the robot's program may watch
    (``rtde_set_watchdog``). Its value comes back with the next states, so that the age of the order that the robot has
    is known by the clock of the robot: beyond the `max_age` of the guard's settings a robot that moves is stopped, and
    one that rests is held by the slider.

    Parameters
    ----------
    watch
        What decides.
    max_age
        Largest age of the state that the last order answers, s.
    register
        Number of the register.
    slows
        Whether to move the speed slider; else it warns, and stops by the dashboard alone.

    Attributes
    ----------
    outputs, inputs
        Names of the variables of RTDE that it reads and writes.
    age
        Age of the state that the last order of the robot answers, s.
    """

    def __init__(self, watch: Watch, max_age: float, register: int = 24, slows: bool = True) -> None:
        self._watch, self._max_age, self._slows = watch, max_age, slows
        self._register = f"input_int_register_{register}"
        self.outputs = ("timestamp", "actual_q", "actual_qd", "speed_scaling", self._register)
        self.inputs = (self._register, *(_SLIDER if slows else ()))
        self._number, self._times = 0, dict[int, float]()
        self.age = 0.0

    def take(self, package: Package) -> tuple[Order, tuple[float, ...]]:
        """Order that follows from the `outputs`, and values of the `inputs`.

        Raises `MessageError` if a value is out of its range.
        """
        (stamp,), (share,), (answered,) = (package[key] for key in ("timestamp", "speed_scaling", self._register))
        joints, rates = np.array(package["actual_q"]), np.array(package["actual_qd"])
        order = self._watch.order(stamp, joints, rates, float(np.clip(share, 0.0, 1.0)))
        if not self._times:  # the number that an earlier watch left is none of ours
            self._number = int(answered)
        self._times.setdefault(int(answered), stamp)
        self.age = stamp - self._times[int(answered)]
        if self.age > self._max_age:
            text = f"the robot has an order of {self.age:.3f} s ago, {self._max_age:.3f} s are permitted"
            order = Order(moves(rates), 0.0, f"stop: {text}" if moves(rates) else f"held: {text}", True)
        self._number = self._number % _MOST_NUMBER + 1
        self._times[self._number] = stamp
        for number in list(self._times):  # connections keep the order: no earlier one will come back
            if number == int(answered):
                break
            del self._times[number]
        return order, (self._number, *((1, order.share) if self._slows else ()))


def watch_ur(
    watch: UrWatch,
    host: str,
    ports: tuple[int, int] = (30004, 29999),
    show: Callable[[str, bool], None] = lambda text, beep: None,
    ended: Callable[[], bool] = lambda: False,
) -> Counts:
    """Watch a robot until `ended`.

    Parameters
    ----------
    watch
        What decides.
    host, ports
        Address of the robot, and its ports of RTDE and of the dashboard.
    show
        Receives lines, and whether to beep.
    ended
        Called with every state.

    Raises
    ------
    LinkError
        If the robot cannot be reached, refuses the inputs, or ends the connection.
    """
    counts, announcer = Counts(), Announcer(show)
    with RtdeClient(host, ports[0]) as rtde, DashboardClient(host, ports[1]) as dashboard:
        if "true" not in dashboard.request("is in remote control").lower():
            show("warning: the robot is not in remote control, and may refuse to be stopped by the dashboard", True)
        rtde.set_outputs(watch.outputs, 1.0 / POLL)
        recipe = rtde.set_inputs(watch.inputs)
        rtde.start()
        show(f"guard: watches {host}", False)
        is_stopped = False
        while not ended():
            packages = rtde.receive(_SILENCE)
            if not packages:
                raise LinkError(f"{host}: no data for {_SILENCE:g} s: the robot is not watched")
            order, values = watch.take(packages[-1])
            rtde.write(recipe, values)
            counts.states += 1
            counts.slowed += order.share < 1.0
            counts.longest_age = max(counts.longest_age, watch.age)
            if order.stop and not is_stopped:
                answer = dashboard.request("stop")
                counts.stops += 1
                counts.reasons.append(order.text)
                announcer.announce(replace(order, text=f"{order.text} (dashboard: {answer})"))
            else:
                announcer.announce(order)
            is_stopped = order.stop
    return counts
