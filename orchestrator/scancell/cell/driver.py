"""Runs programs on the FMU's controller and collects a record for every exposure."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from scancell.cell.controller import Mode, refusal
from scancell.cell.instance import CellInstance
from scancell.cell.program import BeltRun, Program, Segment, TriggerKind
from scancell.cell.program_file import temporary_program_file
from scancell.cell.recording import Recording
from scancell.cell.records import PATIENCE_US, RecordBatches, RecordCollector
from scancell.errors import CellError, CommandError

TRIGGER_MODES: dict[TriggerKind, int] = {
    "off": 0,
    "time": 1,
    "table_angle": 2,
    "path_distance": 3,
    "request": 4,
    "belt_travel": 5,
}
_TRIGGER_INPUTS: dict[TriggerKind, str] = {
    "time": "command.trigger.period",
    "table_angle": "command.trigger.angle",
    "path_distance": "command.trigger.distance",
}

# While a requested exposure is awaited: several steps in a controller cycle.
_REQUEST_STEPS = 4


class Driver:
    """Runs programs on one cell instance with its controller cycle (µs) and the duration of exposures (s).

    `batches` receives the records as they arrive.

    The controller executes each segment as a whole, at the monitor speed in force. A communication step lasts at most
    one controller cycle.
    """

    def __init__(
        self, cell: CellInstance, cycle_us: int, exposure: float, batches: RecordBatches | None = None
    ) -> None:
        self._cell = cell
        self._cycle_us = cycle_us
        self._clock = cell.real_group(["controller.clock"])
        self._gate = ["command.trigger.from", "command.trigger.to"]
        self._requests, self._starts = cell.get_integers(["command.trigger.request", "command.start"])
        self._records = RecordCollector(cell, cycle_us, exposure, batches)
        cell.set_integer("command.mode", Mode.PROGRAM)

    def run(self, program: Program, progress: Callable[[float], None] | None = None) -> Recording:
        """Drive `program` from start to end; `progress` gets the seconds of each segment.

        Raises
        ------
        CommandError
            If the controller does not start or finish a segment.
        CellError
            If the FMU reports an error, or a requested exposure is not taken.
        """
        try:
            with temporary_program_file(program, self._cell.folder) as file:
                self._cell.set_string("command.program", str(file))
                for segment in program.segments:
                    self._drive(segment)
                    if segment.trigger.kind == "request":
                        self._expose_at_rest(segment, program.settle)
                    elif segment.belt is not None:
                        self._run_belt(segment, segment.belt)
                    if progress:
                        progress(float(segment.times[-1]))
        except BaseException:
            self._records.pass_on()
            raise
        finally:
            self._disarm_trigger()
        return self._records.finish()

    def _drive(self, segment: Segment) -> None:
        """Run one segment to its end; how long it takes depends on the monitor speed."""
        self._arm_trigger(segment)
        self._starts += 1
        self._cell.set_integer("command.segment", segment.id)
        self._cell.set_integer("command.start", self._starts)
        clock, remaining, patience = 0.0, float(segment.times[-1]), self._cell.time_us + PATIENCE_US
        while remaining > 0.0:
            earliest = self._cell.time_us + round(remaining * 1e6)  # at full speed
            while self._cell.time_us < min(earliest, patience):
                self._cycle()
            reason = refusal(self._cell)
            if reason is not None:
                raise CommandError(f"segment {segment.id}: {reason}")
            now = float(self._cell.get(self._clock)[0])
            if now > clock:
                clock, patience = now, self._cell.time_us + PATIENCE_US
            elif self._cell.time_us >= patience:
                raise CommandError(
                    f"segment {segment.id}: no motion for {PATIENCE_US / 1e6:g} s, {clock:.3f} s after its start at "
                    "full speed: the monitor speed is 0, or the arm is held"
                )
            remaining = (
                0.0
                if self._cell.get_boolean("controller.at_destination")
                else max(float(segment.times[-1]) - clock, 1e-6)
            )

    def _arm_trigger(self, segment: Segment) -> None:
        kind = segment.trigger.kind
        if kind not in _TRIGGER_INPUTS:
            return self._disarm_trigger()
        inputs = self._cell.real_group([_TRIGGER_INPUTS[kind], *self._gate])
        self._cell.set(inputs, np.array([segment.trigger.interval, segment.trigger_from, segment.trigger_to]))
        self._cell.set_integer("command.trigger.mode", TRIGGER_MODES[kind])
        return None

    def _disarm_trigger(self) -> None:
        self._cell.set_integer("command.trigger.mode", TRIGGER_MODES["off"])

    def _expose_at_rest(self, segment: Segment, settle: float) -> None:
        end = self._cell.time_us + max(self._cycle_us, round(settle * 1e6))
        while self._cell.time_us < end:
            self._cycle(end)
        self._cell.set_integer("command.trigger.mode", TRIGGER_MODES["request"])
        self._requests += 1
        self._cell.set_integer("command.trigger.request", self._requests)
        before, limit = len(self._records), self._cell.time_us + PATIENCE_US
        while len(self._records) == before:
            if self._cell.time_us > limit:
                raise CellError(
                    f"segment {segment.id}: timed out after {PATIENCE_US / 1e6:g} s waiting for the exposure;"
                    " expected a shorter as_built.trigger.latency_ms"
                )
            self._records.step_to(self._cell.time_us + self._cycle_us // _REQUEST_STEPS)

    def _run_belt(self, segment: Segment, belt: BeltRun) -> None:
        """Run the belt past its range of exposures, and stop it; the arm holds the end of the segment."""
        conveyor, cell = f"conveyor[{belt.conveyor}]", self._cell
        speed = cell.real_group([f"command.{conveyor}.speed"])
        state = cell.real_group([f"measured.{conveyor}.travel", f"measured.{conveyor}.speed"])
        direction = np.copysign(1.0, belt.speed)
        passed = direction * (float(cell.get(state)[0]) - belt.trigger_from)
        if passed > 0.0:
            raise CommandError(
                f"segment {segment.id}: {conveyor} has travelled {1e3 * passed:.1f} mm beyond the first exposure: "
                "the part has passed the sensor, or is about to"
            )
        cell.set(cell.real_group(["command.trigger.travel"]), np.array([direction * segment.trigger.interval]))
        cell.set_integer("command.trigger.conveyor", belt.conveyor)

        def run_while(condition: Callable[[float, float], bool]) -> None:
            """Step while `condition` holds for travel along the motion (m) and speed (m/s)."""
            farthest, patience = -np.inf, cell.time_us + PATIENCE_US
            while condition(*(now := direction * cell.get(state))):
                if now[0] > farthest:
                    farthest, patience = now[0], cell.time_us + PATIENCE_US
                elif cell.time_us >= patience:
                    raise CommandError(f"segment {segment.id}: {conveyor} has not moved for {PATIENCE_US / 1e6:g} s")
                self._cycle()

        try:
            cell.set(speed, np.array([belt.speed]))
            run_while(lambda travel, _: travel < direction * belt.trigger_from)
            cell.set_integer("command.trigger.mode", TRIGGER_MODES["belt_travel"])
            run_while(lambda travel, _: travel < direction * belt.trigger_to)
        finally:
            self._disarm_trigger()
            cell.set(speed, np.array([0.0]))
        run_while(lambda _, now: now > 0.0)

    def _cycle(self, end: int | None = None) -> None:
        """Step to the end of a controller cycle, or to `end` where that is earlier."""
        cycle_ends = (self._cell.time_us // self._cycle_us + 1) * self._cycle_us
        self._records.step_to(cycle_ends if end is None else min(cycle_ends, end))
