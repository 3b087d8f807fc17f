"""A guard beside a robot that shows no path: it knows measured joints alone."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from scancell.arrays import Array
from scancell.cell.driver import Mode, Operation
from scancell.guard.guard import Guard
from scancell.guard.messages import CellState

POLL = 0.032  # s between states
LEAST_SHARE = 0.05  # of the speed: a robot at rest would not show where it leads
_RISE = 0.5  # per s, of the share when the way is clear
_AT_REST = 2e-3  # rad/s
_AGAIN = 0.5  # s between lines about the same bodies


@dataclass(frozen=True)
class Order:
    """What a robot is to do.

    Attributes
    ----------
    stop
        Whether it must stop now.
    share
        Share of its speed, 0 to 1.
    text, beep
        Reason, and whether to warn by a sound.
    """

    stop: bool
    share: float
    text: str
    beep: bool


@dataclass
class Counts:
    """What a watch did.

    Attributes
    ----------
    states
        Decisions.
    slowed, stops
        Decisions to slow down, and stops that were made.
    longest_age
        Largest age of the state that the last order of the robot answered, by the robot's clock, s.
    reasons
        Of the stops.
    """

    states: int = 0
    slowed: int = 0
    stops: int = 0
    longest_age: float = 0.0
    reasons: list[str] = field(default_factory=list)


class Announcer:
    """Shows texts of orders, and the same one again after a time only.

    Parameters
    ----------
    show
        Receives lines, and whether to beep.
    """

    def __init__(self, show: Callable[[str, bool], None]) -> None:
        self._show, self._shown, self._again = show, "", 0.0

    def announce(self, order: Order) -> None:
        """Show the text of an order."""
        subject = order.text.split(":")[0]
        if order.text and (subject != self._shown or time.monotonic() >= self._again):
            self._show(order.text, order.beep)
            self._again = time.monotonic() + _AGAIN
        self._shown = subject


class Watch:
    """Predicts the motion of a robot from its measured joints (Eqs. 9 and 10 of the paper), and slows or stops it.

    Motions are those of `Guard` in manual operation without a shown path, whatever moves the robot. While a contact is
    predicted within the horizon of the guard's settings, the speed is that at which it would be a horizon away, so that
    the robot comes near ever more slowly; where no stop in time is proved any more, it must stop.

    Parameters
    ----------
    guard
        Guard of the cell, whose axes are those of the robot first.
    rest
        Positions (axes,) of all axes at the start; those beyond the joints rest there.
    """

    def __init__(self, guard: Guard, rest: ArrayLike) -> None:
        self._guard, self._axes = guard, np.asarray(rest, float).copy()
        self._number, self._time = 0, -np.inf
        self._share = 1.0

    def order(self, time: float, joints: Array, rates: Array, share: float) -> Order:
        """Decide by a state.

        Parameters
        ----------
        time
            By the clock of the robot, s.
        joints, rates
            Measured joint angles and their rates, rad and rad/s.
        share
            Share of its speed that is in force, 0 to 1.

        Raises
        ------
        MessageError
            If a value is outside the bounds of states.
        """
        settings = self._guard.settings
        if not 0.0 <= time - self._time <= settings.max_age * 3:  # another start of the robot, or of this watch
            self._guard.reset()
            self._time = time
        self._axes[: len(joints)] = joints
        # The first state of a motion that was not seen says nothing about it.
        is_moving = self._number > 0 and moves(rates)
        self._number += 1
        state = CellState(self._number % 2**32, time, Operation.MANUAL, Mode.HOLD, is_moving, self._axes.copy())
        answer = self._guard.answer(state)
        passed, self._time = time - self._time, time
        if answer.emergency_stop:
            self._share = 0.0
        elif np.isfinite(free := self._guard.decision.free_until):
            wanted = max(share, LEAST_SHARE) * free / settings.horizon
            self._share = min(self._share, max(wanted, LEAST_SHARE))
        else:
            self._share = min(1.0, self._share + _RISE * passed)
        return Order(answer.emergency_stop, self._share, answer.text, answer.beep)


def moves(rates: Array) -> bool:
    """Whether a robot with these joint rates, rad/s, moves."""
    return bool(np.abs(rates).max() > _AT_REST)
