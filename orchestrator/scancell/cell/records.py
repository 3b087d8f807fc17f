"""Collects the trigger records of a cell while it is stepped."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scancell.cell.instance import CellInstance
from scancell.cell.recording import INTEGER_COLUMNS, Recording, RecordLayout
from scancell.errors import CellError

_RECORD_NUMBERS = (*INTEGER_COLUMNS, "trigger.queued")
# A record must arrive within this time of its exposure, or the cell is not working.
PATIENCE_US = 5_000_000


@dataclass(frozen=True)
class RecordBatches:
    """Passes records on as they arrive: `size` at a time, fewer at the end."""

    size: int
    receive: Callable[[Recording], object]


class RecordCollector:
    """Steps a cell and keeps every trigger record from now on.

    The FMU shows one record per communication step: while records wait, a step is divided into as many.

    Parameters
    ----------
    cycle_us
        The controller's cycle.
    exposure
        Duration of the exposures, s.
    batches
        Receives the records in addition.
    """

    def __init__(
        self, cell: CellInstance, cycle_us: int, exposure: float, batches: RecordBatches | None = None
    ) -> None:
        self._cell, self._cycle_us, self._batches = cell, cycle_us, batches
        self._passed_on = 0
        layout = RecordLayout.of(cell.names)
        self._columns = (*layout.measured, *layout.truth)
        self._group = cell.real_group(self._columns)
        self._records: list[NDArray[np.float64]] = []
        self._numbers: list[tuple[int, int]] = []
        # The cell may have run before, and still show or queue records of that run.
        self._last, self._queued = cell.get_integers(["trigger.count", "trigger.queued"])
        cell.set(cell.real_group(["command.exposure"]), np.array([exposure]))

    def __len__(self) -> int:
        return len(self._records)

    def step_to(self, time_us: int) -> None:
        """Step to `time_us`, in one communication step and one more for each record that waits."""
        start_us = self._cell.time_us
        steps = min(1 + self._queued, time_us - start_us)
        for k in range(1, steps + 1):
            self._cell.step_to(start_us + (time_us - start_us) * k // steps)
            index, segment, self._queued = self._cell.get_integers(_RECORD_NUMBERS)
            if index > self._last:
                self._last = index
                self._numbers.append((index, segment))
                self._records.append(self._cell.get(self._group).copy())
        if self._batches is not None and len(self) - self._passed_on >= self._batches.size:
            self.pass_on()

    def pass_on(self) -> None:
        """Pass on the records of an incomplete batch, such as those before a stop."""
        if self._batches is not None and len(self) > self._passed_on:
            first, self._passed_on = self._passed_on, len(self)
            self._batches.receive(self._recording(first))

    def finish(self) -> Recording:
        """Step until no record is queued or pending; returns all records.

        Raises
        ------
        CellError
            If a record never comes.
        """
        limit = self._cell.time_us + PATIENCE_US
        while self._cell.get_integer("trigger.count") > self._last:
            if self._cell.time_us > limit:
                raise CellError("trigger records are missing at the end of the program")
            self.step_to(self._cell.time_us + self._cycle_us)
        self.pass_on()
        return self._recording()

    def _recording(self, first: int = 0) -> Recording:
        values = np.array(self._records[first:], float).reshape(-1, len(self._columns))
        numbers = np.array(self._numbers[first:], np.int64).reshape(-1, len(INTEGER_COLUMNS))
        columns: dict[str, NDArray[np.float64] | NDArray[np.int64]] = {
            name: numbers[:, i] for i, name in enumerate(INTEGER_COLUMNS)
        }
        columns.update({name: values[:, i] for i, name in enumerate(self._columns)})
        return Recording(columns)
