"""A guard between a robot that sends its states by UDP and the program that answers them."""

from __future__ import annotations

import contextlib
import socket
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from selectors import EVENT_READ, DefaultSelector
from typing import Any, Protocol

from scancell.arrays import Array
from scancell.config.choices import LOOPBACK
from scancell.errors import MessageError
from scancell.guard.server import bound_socket
from scancell.wire.serve import datagram_socket
from scancell.wire.watch import POLL, Announcer, Counts, Order, Watch, moves

Decision = tuple[float, Order]  # time of the state, s, and what follows

_RECEIVE = 65_536  # bytes
_SILENCE = 1.0  # s without answers of the program after which a stop ends, or without states of the robot
_LOOK = 0.1  # s between looks whether to end


class Interface(Protocol):
    """What a guard must know of the packets of a maker."""

    def state(self, packet: bytes) -> tuple[float, Array]:
        """Time (s) and joint angles (joints,) of a state; raises `MessageError` if it is none."""

    def note(self, answer: bytes) -> None:
        """Take notice of an answer of the program that is passed on; raises `MessageError` if it is none."""

    def hold(self, packet: bytes, is_first: bool) -> bytes | None:
        """Answer to a state with which the robot comes to rest; `is_first` of a stop; None: silence stops it."""


class GuardedLink:
    """Passes answers of a program on to its robot, or in their place such as stop it; sockets are elsewhere.

    The robot stops when the watch says so, and when it moves while no decision about a state of the last `max_age` has
    come. A stop ends when the program has been silent for a second: what it wanted meanwhile is not passed on.

    Parameters
    ----------
    watch
        What decides.
    interface
        Packets of the maker.
    max_age
        Largest age of the state that was decided about last, s.

    Attributes
    ----------
    is_stopped
        Whether a stop is in force.
    counts
        What happened.
    """

    def __init__(self, watch: Watch, interface: Interface, max_age: float) -> None:
        self._watch, self._interface, self._max_age = watch, interface, max_age
        self._joints: Array | None = None  # of the last state that was given to decide
        self._rates: Array | None = None
        self._now = self._given = self._decided = self._answered = 0.0  # times of the robot, s
        self.is_stopped = self._holds = False
        self.counts = Counts()

    def take(self, packet: bytes) -> Callable[[], Decision] | None:
        """Take a state of the robot; what decides about it, if that is due.

        Raises
        ------
        MessageError
            If it is no state.
        """
        now, joints = self._interface.state(packet)
        if self._joints is None or not 0.0 <= now - self._now <= _SILENCE:  # another start of the robot
            self._given, self._decided, self._answered = now - POLL, now, now
            self._joints = joints
        self._now = now
        if now - self._given < POLL - 1e-6:
            return None
        rates = (joints - self._joints) / (now - self._given)
        self._joints, self._rates, self._given = joints, rates, now
        return lambda: (now, self._watch.order(now, joints, rates, 1.0))

    def apply(self, decision: Decision) -> Order:
        """Take a decision; its order."""
        self._decided, order = decision
        self.counts.states += 1
        return self._stop(order)

    def check(self) -> Order | None:
        """Order to stop if the robot moves and the last decision is too old."""
        age = self._now - self._decided
        self.counts.longest_age = max(self.counts.longest_age, age)
        if age <= self._max_age or self._rates is None or not moves(self._rates):
            return None
        text = f"stop: the last decision is {age:.3f} s old, {self._max_age:.3f} s are permitted"
        return self._stop(Order(True, 0.0, text, True))

    def answer(self, packet: bytes) -> bytes | None:
        """Answer to a state in place of the program, while a stop is in force."""
        if self.is_stopped and self._now - self._answered > _SILENCE:
            self.is_stopped = False
        if not self.is_stopped:
            return None
        is_first, self._holds = not self._holds, True
        return self._interface.hold(packet, is_first)

    def passed(self, answer: bytes) -> bytes | None:
        """Answer of the program as it is passed on; None: it is not.

        Raises
        ------
        MessageError
            If it is none.
        """
        self._answered = self._now
        if self.is_stopped:
            return None
        self._interface.note(answer)
        return answer

    def _stop(self, order: Order) -> Order:
        if order.stop and not self.is_stopped:
            self.is_stopped, self._holds, self._answered = True, False, self._now
            self.counts.stops += 1
            self.counts.reasons.append(order.text)
        return order


def watch_link(
    link: GuardedLink,
    host: str,
    ports: tuple[int, int],
    show: Callable[[str, bool], None] = lambda text, beep: None,
    ended: Callable[[], bool] = lambda: False,
) -> Counts:
    """Watch a robot, and pass packets, until `ended`.

    Parameters
    ----------
    link
        What is passed on.
    host, ports
        Address of the robot; the port of this machine to which it sends, and the one at which the program listens.
    show
        Receives lines, and whether to beep.
    ended
        Called several times per second.

    Raises
    ------
    LinkError
        If there is no way to the robot, or the port is in use.
    """
    announcer = Announcer(show)
    with contextlib.ExitStack() as stack:
        with datagram_socket(host, ports[0]) as way:  # the address of this machine that reaches the robot
            own = way.getsockname()[0]
            robot_host = way.getpeername()[0]
        robot = stack.enter_context(bound_socket(own, ports[0], socket.SOCK_DGRAM))
        program = stack.enter_context(datagram_socket(LOOPBACK, ports[1]))
        selector = stack.enter_context(DefaultSelector())
        pool = stack.enter_context(ThreadPoolExecutor(1))
        for source in (robot, program):
            selector.register(source, EVENT_READ)
        show(f"guard: watches {host}", False)
        sender: Any = None
        pending: Future[Decision] | None = None
        while not ended():
            ready = {key.fileobj for key, _ in selector.select(_LOOK)}
            if pending is not None and pending.done():
                announcer.announce(link.apply(pending.result()))
                pending = None
            try:
                if program in ready and (answer := _answer_of(link, program)) is not None and sender is not None:
                    robot.sendto(answer, sender)
                if robot not in ready:
                    continue
                packet, source = robot.recvfrom(_RECEIVE)
                if source[0] != robot_host:
                    continue
                sender, due = source, link.take(packet)
            except MessageError as error:
                announcer.announce(Order(False, 1.0, f"not passed on: {error}", False))
                continue
            if due is not None and pending is None:
                pending = pool.submit(due)
            if (order := link.check()) is not None:
                announcer.announce(order)
            if (answer := link.answer(packet)) is not None:
                robot.sendto(answer, sender)
            with contextlib.suppress(OSError):  # nobody listens there yet
                program.send(packet)
    return link.counts


def _answer_of(link: GuardedLink, program: socket.socket) -> bytes | None:
    """Answer of the program that is to be passed on."""
    try:
        packet = program.recv(_RECEIVE)
    except OSError:  # nobody listens there
        return None
    return link.passed(packet)
