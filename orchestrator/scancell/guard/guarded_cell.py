"""The cell's side of the guard: states to the guard, its answers to the controller."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from scancell.arguments import checked_arguments
from scancell.cell.controller import Mode, MonitorSpeed, Operation
from scancell.cell.instance import CellInstance
from scancell.guard.link import Link
from scancell.guard.messages import CellState, GuardMessage, PlacedPart, axes_digest
from scancell.guard.parts import PartTracker
from scancell.stopwatch import Pace

_POLL_CYCLES = 2  # of the controller; it answers position queries no faster
_EMERGENCY = 3  # controller.state
_AHEAD = 64  # points of the path ahead, a cycle of path clock apart; the first one is the present set-point


class GuardedCell:
    """Steps a cell that exchanges messages with its guard.

    Parameters
    ----------
    cell
        A running instance at a multiple of the controller's cycle.
    cycle_us
        The controller's cycle, µs.
    link
        To the guard; None: without a guard.
    max_age
        Age of the last answer's state at which the controller stops, s.
    shows_jogs
        Whether the guard sees where a jog leads before it moves the robot, and limits its speed; else it identifies
        jogs by measured states.
    parts
        Follows what the gripper and belts move; None: the guard does not know where these parts are.

    Attributes
    ----------
    monitor_speed
        Of the operator, 0 to 1; the lower one of this and the guard's is in force.
    stop_pressed
        Whether the operator keeps the emergency stop pressed, independently of the guard.

    Examples
    --------
    >>> guard = scancell.guard_of(part="part.stl")
    >>> link = scancell.Link(scancell.InProcess(guard, compute_time=0.003), guard.settings.max_age)
    >>> with scancell.Scanner() as scanner, scanner.session("part.stl") as session:
    ...     guarded = scancell.GuardedCell(session.cell, 16_000, link, guard.settings.max_age)
    ...     guarded.attach()
    ...     session.move_tool(scancell.location(0.45, 0.0, 0.05, rx=np.pi))
    Traceback (most recent call last):
        ...
    scancell.errors.CommandError: move_tool: held by the guard ...: slowed to 0%: sensor - part

    `Scanner.session` with ``guarded=True`` does the same.
    """

    @checked_arguments
    def __init__(
        self,
        cell: CellInstance,
        cycle_us: int,
        link: Link | None,
        max_age: float,
        shows_jogs: bool = True,
        parts: PartTracker | None = None,
    ) -> None:
        self._cell, self._cycle_us, self._link, self._shows_jogs = cell, cycle_us, link, shows_jogs
        self._parts = parts
        axes = cell.axis_names("")
        self._digest = axes_digest(axes)
        self._widths = cell.real_group([name for name in cell.names if name == "measured.gripper.width"])
        belts = sum(name.startswith("measured.conveyor[") and name.endswith("].travel") for name in cell.names)
        self._travel = cell.real_group([f"measured.conveyor[{i}].travel" for i in range(1, belts + 1)])
        self._measured = cell.real_group([f"measured.{axis}" for axis in axes])
        self._rate = cell.real_group(["controller.rate"])
        self._path_time = cell.real_group(["controller.path_time"])
        self._ahead = cell.path_ahead(_AHEAD)
        self._guard_time = cell.real_group(["command.guard.time"])
        self._monitor_speed = cell.real_group(["command.monitor_speed"])
        self._polls = 0
        self._sequence = 0
        self._allowed = 1.0 if link is None else 0.0  # by the last answer
        self.monitor_speed = 1.0
        self.stop_pressed = False
        if link is not None:
            cell.set(cell.real_group(["command.guard.max_age"]), np.array([max_age]))

    def attach(self) -> None:
        """Poll at the end of every controller cycle from now on, however the cell is stepped.

        So commands and programs of a `CellSession` cannot step the cell past its guard.
        """
        self.poll()
        self._cell.on_cycle(self._cycle_us, self.poll)

    @checked_arguments
    def set_monitor_speed(self, share: MonitorSpeed) -> None:
        """Change the operator's monitor speed to `share`, 0 to 1.

        It acts at once, but never beyond what the guard allows, and scales no jog.

        Raises
        ------
        DescriptionError
            If it is out of its range.
        """
        self.monitor_speed = share
        self._apply_monitor_speed()

    def _apply_monitor_speed(self) -> None:
        manual = self._cell.get_integer("command.operation") == Operation.MANUAL
        speed = self._allowed if manual else min(self.monitor_speed, self._allowed)
        self._cell.set(self._monitor_speed, np.array([speed]))

    def poll(self) -> list[GuardMessage]:
        """Send the state when a query is due, and apply the answers that have arrived; to be called once a cycle.

        The answers are returned, see `Link.poll`.
        """
        if self._link is None:
            return []
        time = self._cell.time_us * 1e-6
        if self._polls % _POLL_CYCLES == 0:
            self._link.send(self.state(), time)
        self._polls += 1
        answers = self._link.poll(time)
        if answers:
            last = answers[-1]
            self._cell.set(self._guard_time, np.array([time - self._link.age(time)]))
            self._allowed = last.monitor_speed
            self._apply_monitor_speed()
            stop = self.stop_pressed or any(answer.emergency_stop for answer in answers)
            self._cell.set_boolean("command.emergency_stop", stop)
            if last.text or self._cell.get_integer("controller.state") != _EMERGENCY:  # else the reason stays
                self._cell.set_string("command.pendant.text", last.text)
            self._cell.set_boolean("command.pendant.beep", last.beep)
        return answers

    def run(self, seconds: float, act: Callable[[], bool]) -> None:
        """Run in real time for `seconds` of the cell, or until `act`, which is called once a cycle, returns true.

        A machine that is too slow makes the cell's clock slow, which is that of the ages: see `Pace`.
        """
        pace = Pace(self._cycle_us * 1e-6)
        end = self._cell.time_us + round(seconds * 1e6)
        while self._cell.time_us < end and not act():
            self.poll()
            self._cell.step_to(self._cell.time_us + self._cycle_us)
            pace.wait()

    def state(self) -> CellState:
        """The cell as the controller answers a query."""
        cell = self._cell
        operation = Operation(cell.get_integer("command.operation"))
        mode = Mode(cell.get_integer("controller.mode"))
        automatic = operation is Operation.AUTOMATIC
        follows = mode not in (Mode.HOLD, Mode.SERVO) if automatic else self._shows_jogs
        self._sequence = (self._sequence + 1) % 2**32
        axes = cell.get(self._measured).copy()
        return CellState(
            self._sequence,
            cell.time_us * 1e-6,
            operation,
            mode,
            cell.get_boolean("controller.moving"),
            axes,
            float(np.clip(cell.get(self._rate)[0], 0.0, 1.0)),
            cell.get(self._ahead).reshape(_AHEAD, len(axes)).copy() if follows else (),
            self._cycle_us * 1e-6 if follows else 0.0,
            float(cell.get(self._path_time)[0]) if follows else 0.0,
            self._shows_jogs,
            cell.get(self._widths).copy(),
            self._placed_parts(axes),
            digest=self._digest,
        )

    def _placed_parts(self, axes: NDArray[np.float64]) -> tuple[PlacedPart, ...]:
        if self._parts is None:
            return ()
        has_gripper = self._widths.count > 0
        width = float(self._cell.get(self._widths)[0]) if has_gripper else 0.0
        gripped = has_gripper and self._cell.get_boolean("measured.gripper.gripped")
        return self._parts.update(axes, self._cell.get(self._travel), width, gripped)
