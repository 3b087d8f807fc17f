"""Profiles and trigger records for tests of reconstruction."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from scancell.reconstruction.reconstruct import ProfilePoints


@dataclass(frozen=True)
class Triggers:
    """Records of n exposures, see `scancell.reconstruction.reconstruct.Triggers`."""

    index: np.ndarray
    segment: np.ndarray
    time: np.ndarray
    q: np.ndarray
    table: np.ndarray
    qd: np.ndarray
    table_rate: np.ndarray

    @property
    def axes(self) -> np.ndarray:
        return np.column_stack([self.q, self.table])

    @property
    def axis_rates(self) -> np.ndarray:
        return np.column_stack([self.qd, self.table_rate])


def records(q: np.ndarray, table: np.ndarray) -> Triggers:
    """Exposures of one segment at joints (n, 6) and table angles (n,), at rest."""
    n = len(q)
    return Triggers(np.arange(1, n + 1), np.ones(n, int), 0.01 * np.arange(n), q, table, np.zeros((n, 6)), np.zeros(n))


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
