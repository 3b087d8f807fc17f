"""Streams a program to the FMU and collects a record for every exposure."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from orchestrator.cell.controller import Mode
from orchestrator.cell.instance import CellInstance
from orchestrator.cell.program import Program, Segment, TriggerKind
from orchestrator.cell.recording import INTEGER_COLUMNS, MEASURED_COLUMNS, Recording, count_moving, truth_columns
from orchestrator.config.loading import Setup
from orchestrator.config.units import si_value
from orchestrator.errors import CellError

_TRIGGER_MODES: dict[TriggerKind, int] = {"off": 0, "time": 1, "table_angle": 2, "path_distance": 3, "request": 4}
_TRIGGER_INPUTS: dict[TriggerKind, str] = {
    "time": "command.trigger.period",
    "table_angle": "command.trigger.angle",
    "path_distance": "command.trigger.distance",
}
# A record must arrive within this time of its request, or the cell is not working.
_PATIENCE_US = 5_000_000

Progress = Callable[[float], None]


@dataclass(frozen=True)
class DriveOptions:
    """Steps of the co-simulation: the controller's cycle and how many communication steps it takes."""

    cycle_us: int
    exposure: float
    steps_per_cycle: int = 4

    @classmethod
    def of(cls, setup: Setup) -> Self:
        """As described."""
        return cls(setup.cell.world.controller_cycle_us, si_value(setup.sensor.detector, "exposure_ms"))


class Driver:
    """Runs programs on one cell instance."""

    def __init__(self, cell: CellInstance, options: DriveOptions) -> None:
        self._cell = cell
        self._cycle_us = options.cycle_us
        self._step_us = options.cycle_us // options.steps_per_cycle
        self._setpoints = cell.real_group([*(f"command.q[{i}]" for i in range(1, 7)), "command.table"])
        self._record_columns = (*MEASURED_COLUMNS, *truth_columns(*count_moving(cell.names)))
        self._record_group = cell.real_group(self._record_columns)
        self._records: list[NDArray[np.float64]] = []
        self._numbers: list[tuple[int, int]] = []
        self._shown = 0
        self._requests = 0
        cell.set(cell.real_group(["command.exposure"]), np.array([options.exposure]))
        cell.set_integer("command.mode", Mode.SERVO)

    def run(self, program: Program, progress: Progress | None = None) -> Recording:
        """Drive `program` from start to end; `progress` hears of the seconds of each segment.

        Raises
        ------
        CellError
            If the FMU reports an error, or a requested exposure never comes.
        """
        for segment in program.segments:
            self._drive(segment)
            if segment.trigger.kind == "request":
                self._expose_at_rest(segment, program.settle)
            if progress:
                progress(float(segment.times[-1]))
        self._drain()
        return self._recording()

    def _drive(self, segment: Segment) -> None:
        """Stream one segment; a set-point sent at one cycle is reached at the next."""
        start_us = self._cell.time_us
        self._cell.set_integer("command.segment", segment.id)
        on_us = start_us + self._cycle_us + round(segment.trigger_from * 1e6)
        off_us = start_us + self._cycle_us + round(segment.trigger_to * 1e6)
        gated = segment.trigger.kind not in {"off", "request"}
        for k in range(len(segment.times)):
            self._cell.set(self._setpoints, np.append(segment.q[k], segment.table[k]))
            cycle_end = start_us + (k + 1) * self._cycle_us
            for time_us in self._communication_points(cycle_end, (on_us, off_us) if gated else ()):
                if gated and self._cell.time_us == on_us:
                    self._arm_trigger(segment)
                elif gated and self._cell.time_us == off_us:
                    self._cell.set_integer("command.trigger.mode", _TRIGGER_MODES["off"])
                self._step(time_us)
        # One more cycle reaches the last set-point and lets its trigger out.
        self._step(self._cell.time_us + self._cycle_us)
        if gated:
            self._cell.set_integer("command.trigger.mode", _TRIGGER_MODES["off"])

    def _communication_points(self, end_us: int, extra: tuple[int, ...]) -> Iterator[int]:
        points = set(range(self._cell.time_us + self._step_us, end_us, self._step_us)) | {end_us}
        points |= {point for point in extra if self._cell.time_us < point < end_us}
        yield from sorted(points)

    def _arm_trigger(self, segment: Segment) -> None:
        kind = segment.trigger.kind
        name = _TRIGGER_INPUTS[kind]
        self._cell.set(self._cell.real_group([name]), np.array([segment.trigger.interval]))
        self._cell.set_integer("command.trigger.mode", _TRIGGER_MODES[kind])

    def _expose_at_rest(self, segment: Segment, settle: float) -> None:
        self._step(self._cell.time_us + max(self._cycle_us, round(settle * 1e6)))
        self._cell.set_integer("command.trigger.mode", _TRIGGER_MODES["request"])
        self._requests += 1
        self._cell.set_integer("command.trigger.request", self._requests)
        before, limit = len(self._records), self._cell.time_us + _PATIENCE_US
        while len(self._records) == before:
            if self._cell.time_us > limit:
                raise CellError(f"segment {segment.id}: the requested exposure never came")
            self._step(self._cell.time_us + self._step_us)

    def _step(self, time_us: int) -> None:
        self._cell.step_to(time_us)
        index = self._cell.get_integer("trigger.index")
        if index != self._shown:
            self._shown = index
            self._numbers.append((index, self._cell.get_integer("trigger.segment")))
            self._records.append(self._cell.get(self._record_group).copy())

    def _drain(self) -> None:
        """One record is shown per communication step; step on until none waits and none is on its way."""
        limit = self._cell.time_us + _PATIENCE_US
        while self._cell.get_integer("trigger.count") > self._shown:
            if self._cell.time_us > limit:
                raise CellError("trigger records are missing at the end of the program")
            self._step(self._cell.time_us + self._step_us)

    def _recording(self) -> Recording:
        values = np.array(self._records, float).reshape(-1, len(self._record_columns))
        numbers = np.array(self._numbers, np.int64).reshape(-1, len(INTEGER_COLUMNS))
        columns: dict[str, NDArray[np.float64] | NDArray[np.int64]] = {
            name: numbers[:, i] for i, name in enumerate(INTEGER_COLUMNS)
        }
        columns.update({name: values[:, i] for i, name in enumerate(self._record_columns)})
        return Recording(columns)
