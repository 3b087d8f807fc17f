"""Runs programs on the FMU's controller and collects a record for every exposure."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from scancell.cell.controller import Mode, refusal
from scancell.cell.instance import CellInstance
from scancell.cell.program import Program, Segment, TriggerKind
from scancell.cell.program_file import temporary_program_file
from scancell.cell.recording import INTEGER_COLUMNS, Recording, RecordLayout
from scancell.config.loading import Setup
from scancell.config.units import si_value
from scancell.errors import CellError, CommandError

_TRIGGER_MODES: dict[TriggerKind, int] = {"off": 0, "time": 1, "table_angle": 2, "path_distance": 3, "request": 4}
_TRIGGER_INPUTS: dict[TriggerKind, str] = {
    "time": "command.trigger.period",
    "table_angle": "command.trigger.angle",
    "path_distance": "command.trigger.distance",
}
_RECORD_NUMBERS = (*INTEGER_COLUMNS, "trigger.queued")
# A record must arrive within this time of its request, or the cell is not working.
_PATIENCE_US = 5_000_000

# While a requested exposure is awaited: several steps in a controller cycle.
_REQUEST_STEPS = 4

Progress = Callable[[float], None]


@dataclass(frozen=True)
class DriveOptions:
    """Controller cycle (µs) and duration of the exposures (s)."""

    cycle_us: int
    exposure: float

    @classmethod
    def of(cls, setup: Setup) -> Self:
        """As described."""
        return cls(setup.cell.world.controller_cycle_us, si_value(setup.sensor.detector, "exposure_ms"))


class Driver:
    """Runs programs on one cell instance.

    The controller executes each segment as a whole, at the monitor speed in force. A communication step lasts one
    controller cycle. The FMU shows one record per communication step: while records wait, a cycle is divided into as
    many steps.
    """

    def __init__(self, cell: CellInstance, options: DriveOptions) -> None:
        self._cell = cell
        self._cycle_us = options.cycle_us
        self._clock = cell.real_group(["controller.clock"])
        self._gate = ["command.trigger.from", "command.trigger.to"]
        layout = RecordLayout.of(cell.names)
        self._record_columns = (*layout.measured, *layout.truth)
        self._record_group = cell.real_group(self._record_columns)
        self._records: list[NDArray[np.float64]] = []
        self._numbers: list[tuple[int, int]] = []
        # The cell may have run before, and still show the last record of that run.
        self._shown, self._queued, self._requests, self._starts = cell.get_integers(
            ["trigger.index", "trigger.queued", "command.trigger.request", "command.start"]
        )
        cell.set(cell.real_group(["command.exposure"]), np.array([options.exposure]))
        cell.set_integer("command.mode", Mode.PROGRAM)

    def run(self, program: Program, progress: Progress | None = None) -> Recording:
        """Drive `program` from start to end; `progress` gets the seconds of each segment.

        Raises
        ------
        CommandError
            If the controller does not start or finish a segment.
        CellError
            If the FMU reports an error, or a requested exposure is not taken.
        """
        with temporary_program_file(program, self._cell.folder) as file:
            self._cell.set_string("command.program", str(file))
            for segment in program.segments:
                self._drive(segment)
                if segment.trigger.kind == "request":
                    self._expose_at_rest(segment, program.settle)
                if progress:
                    progress(float(segment.times[-1]))
        self._disarm_trigger()
        self._drain()
        return self._recording()

    def _drive(self, segment: Segment) -> None:
        """Run one segment to its end; how long it takes depends on the monitor speed."""
        self._arm_trigger(segment)
        self._starts += 1
        self._cell.set_integer("command.segment", segment.id)
        self._cell.set_integer("command.start", self._starts)
        clock, remaining, patience = 0.0, float(segment.times[-1]), self._cell.time_us + _PATIENCE_US
        while remaining > 0.0:
            earliest = self._cell.time_us + round(remaining * 1e6)  # at full speed
            while self._cell.time_us < min(earliest, patience):
                self._advance((self._cell.time_us // self._cycle_us + 1) * self._cycle_us)
            reason = refusal(self._cell)
            if reason is not None:
                raise CommandError(f"segment {segment.id}: {reason}")
            now = float(self._cell.get(self._clock)[0])
            if now > clock:
                clock, patience = now, self._cell.time_us + _PATIENCE_US
            elif self._cell.time_us >= patience:
                raise CommandError(
                    f"segment {segment.id}: no motion for {_PATIENCE_US / 1e6:g} s, {clock:.3f} s after its start at "
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
        self._cell.set_integer("command.trigger.mode", _TRIGGER_MODES[kind])
        return None

    def _disarm_trigger(self) -> None:
        self._cell.set_integer("command.trigger.mode", _TRIGGER_MODES["off"])

    def _expose_at_rest(self, segment: Segment, settle: float) -> None:
        self._advance(self._cell.time_us + max(self._cycle_us, round(settle * 1e6)))
        self._cell.set_integer("command.trigger.mode", _TRIGGER_MODES["request"])
        self._requests += 1
        self._cell.set_integer("command.trigger.request", self._requests)
        before, limit = len(self._records), self._cell.time_us + _PATIENCE_US
        while len(self._records) == before:
            if self._cell.time_us > limit:
                raise CellError(
                    f"segment {segment.id}: timed out after {_PATIENCE_US / 1e6:g} s waiting for the exposure"
                )
            self._advance(self._cell.time_us + self._cycle_us // _REQUEST_STEPS)

    def _advance(self, time_us: int) -> None:
        """Step to `time_us`, in one communication step and one more for each record that waits."""
        start_us = self._cell.time_us
        steps = min(1 + self._queued, time_us - start_us)
        for k in range(1, steps + 1):
            self._cell.step_to(start_us + (time_us - start_us) * k // steps)
            index, segment, self._queued = self._cell.get_integers(_RECORD_NUMBERS)
            if index != self._shown:
                self._shown = index
                self._numbers.append((index, segment))
                self._records.append(self._cell.get(self._record_group).copy())

    def _drain(self) -> None:
        """Step on until no record waits and none is on its way."""
        limit = self._cell.time_us + _PATIENCE_US
        while self._cell.get_integer("trigger.count") > self._shown:
            if self._cell.time_us > limit:
                raise CellError("trigger records are missing at the end of the program")
            self._advance(self._cell.time_us + self._cycle_us)

    def _recording(self) -> Recording:
        values = np.array(self._records, float).reshape(-1, len(self._record_columns))
        numbers = np.array(self._numbers, np.int64).reshape(-1, len(INTEGER_COLUMNS))
        columns: dict[str, NDArray[np.float64] | NDArray[np.int64]] = {
            name: numbers[:, i] for i, name in enumerate(INTEGER_COLUMNS)
        }
        columns.update({name: values[:, i] for i, name in enumerate(self._record_columns)})
        return Recording(columns)
