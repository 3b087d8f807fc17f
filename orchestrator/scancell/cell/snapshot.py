"""The present poses of a running cell as a recording: of one exposure, or of all poses from now on."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scancell.cell.instance import CellInstance
from scancell.cell.recording import INTEGER_COLUMNS, Recording, RecordLayout

_OF_EXPOSURE = ("trigger.time", "trigger.exposure")
_RECORD = "trigger."
# Beyond every trigger index, which are 32 bits wide: the index seeds the noise of an image.
_FIRST_INDEX = 1 << 31


def snapshot(cell: CellInstance, exposure: float, number: int = 0) -> Recording:
    """One row: axes, poses and twists at the present instant, as of an exposure whose middle is now.

    The cell is not stepped, and its trigger records are not touched; as-built latency and jitter of the trigger do not
    apply.

    Parameters
    ----------
    exposure
        Duration of the exposure, s.
    number
        Number of the snapshot, from 0; another number gives other image noise.
    """
    present = _present_columns(cell)
    values = cell.get(cell.real_group([name.removeprefix(_RECORD) for name in present]))
    columns: dict[str, NDArray[np.float64] | NDArray[np.int64]] = {
        name: np.array([index], np.int64)
        for name, index in zip(INTEGER_COLUMNS, (_FIRST_INDEX + number, 0), strict=True)
    }
    columns |= {"trigger.time": np.array([cell.time_us * 1e-6]), "trigger.exposure": np.array([exposure])}
    columns |= {name: np.array([value]) for name, value in zip(present, values, strict=True)}
    return Recording(columns)


def _present_columns(cell: CellInstance) -> list[str]:
    """Columns of a recording that the cell also states for the present instant, without ``trigger.``."""
    layout = RecordLayout.of(cell.names)
    return [name for name in (*layout.measured, *layout.truth) if name not in _OF_EXPOSURE]


class MotionLog:
    """Axes, poses and twists of a cell from now on until `end`, at least `interval_us` µs apart; the last ones always.

    Attributes
    ----------
    end
        Ends the log.
    """

    def __init__(self, cell: CellInstance, interval_us: int) -> None:
        self._cell, self._interval_us = cell, interval_us
        self._columns = _present_columns(cell)
        self._group = cell.real_group([name.removeprefix(_RECORD) for name in self._columns])
        self._times_us: list[int] = []
        self._rows: list[NDArray[np.float64]] = []
        self._look()
        self.end = cell.on_step(self._look)

    def _look(self) -> None:
        if len(self._rows) > 1 and self._times_us[-1] - self._times_us[-2] < self._interval_us:
            self._times_us.pop()
            self._rows.pop()
        self._times_us.append(self._cell.time_us)
        self._rows.append(self._cell.get(self._group).copy())

    @property
    def recording(self) -> Recording:
        """All poses as a recording whose rows are no exposures: these are 0 s long."""
        count, values = len(self._rows), np.array(self._rows)
        columns: dict[str, NDArray[np.float64] | NDArray[np.int64]] = {
            name: values[:, i] for i, name in enumerate(self._columns)
        }
        columns |= {"trigger.time": 1e-6 * np.array(self._times_us), "trigger.exposure": np.zeros(count)}
        columns |= zip(INTEGER_COLUMNS, (np.arange(1, count + 1), np.zeros(count, np.int64)), strict=True)
        return Recording(columns)
