"""Profiles and trigger records for tests of reconstruction."""

from __future__ import annotations

import numpy as np

from scancell.cell.recording import TriggerRecords
from scancell.reconstruction.reconstruct import ProfilePoints


def records(q: np.ndarray, table: np.ndarray) -> TriggerRecords:
    """Exposures of one segment at joints (n, 6) and table angles (n,), at rest."""
    n = len(q)
    names = (*(f"joint[{i}]" for i in range(1, 7)), "table")
    axes = np.column_stack([q, table])
    number, time = np.arange(n), 0.01 * np.arange(n)
    return TriggerRecords(number + 1, np.ones(n, int), time, np.zeros(n), names, axes, np.zeros_like(axes))


def profiles_of(points_in_sensor: np.ndarray, frame: np.ndarray, column: np.ndarray) -> ProfilePoints:
    """Points (m, 3) of one camera, with their exposures and columns."""
    m = len(frame)
    return ProfilePoints(
        points_in_sensor=points_in_sensor,
        sigma=np.full(m, 5e-6),
        intensity=np.full(m, 100.0),
        camera=np.zeros(m, np.int32),
        column=column.astype(np.int32),
        frame=frame,
        flags=np.zeros(m, np.uint32),
        time_offset=np.zeros(m),
    )
