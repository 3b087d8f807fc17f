"""Motions of the table on which a part that stands freely does not slip."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scancell.config.cell import CellDescription
from scancell.geometry import pose
from scancell.geometry.mesh import Mesh

# Shares of the friction that turning and speeding up may each take at the part's farthest point: together half of it,
# because the pressure under the part is not even.
_OF_SPEED, _OF_ACCELERATION = 0.4, 0.3


def table_limits(cell: CellDescription, part: Mesh, table_from_part: NDArray[np.float64]) -> tuple[float, float]:
    """Speed (rad/s) and acceleration (rad/s²) of the table: its limits, or lower ones at which friction holds the part.

    At a distance R from the axis, friction μ holds what turns at ω and speeds up by α while
    ``sqrt((ω² R)² + (α R)²) < μ g``.
    """
    speed, acceleration = np.radians([cell.table.max_speed_deg_s, cell.table.max_acceleration_deg_s2]).tolist()
    if cell.part.fixture != "free":
        return speed, acceleration
    used = part.vertices[np.unique(part.faces)]
    radius = float(np.hypot(*pose.transform_points(table_from_part, used)[:, :2].T).max())
    held = min(cell.part.friction, cell.table.friction) * cell.world.gravity_m_s2
    return min(speed, float(np.sqrt(_OF_SPEED * held / radius))), min(acceleration, _OF_ACCELERATION * held / radius)
