"""The motion of a program by its own clock."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scancell.cell.program import Program

Array = NDArray[np.float64]


class ProgramMotion:
    """Set-points of a program against its own clock, which does not count settling.

    Attributes
    ----------
    begins
        (segments,) times at which the segments begin, s.
    duration
        s.
    """

    def __init__(self, program: Program) -> None:
        segments = program.segments
        ends = np.cumsum([float(item.times[-1]) for item in segments])
        self.begins, self.duration = np.concatenate([[0.0], ends[:-1]]), float(ends[-1])
        self._times = np.concatenate([begin + item.times for begin, item in zip(self.begins, segments, strict=True)])
        self._axes = np.concatenate([np.column_stack([item.q, item.table]) for item in segments])

    def axes(self, at: float) -> Array:
        """Joints and table angle (joints + 1,), rad, at a time, s; at rest before the start and after the end."""
        return np.array([np.interp(at, self._times, axis) for axis in self._axes.T])

    def segment_at(self, at: float) -> int:
        """Index of the segment that moves at a time, s."""
        return max(0, int(np.searchsorted(self.begins, at + 1e-9, side="right")) - 1)
