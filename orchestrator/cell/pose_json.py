"""Poses as the FMU's description holds them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from orchestrator.geometry import pose


def pose_json(target_from_source: NDArray[np.float64]) -> dict[str, Any]:
    """Position (m) and quaternion (w, x, y, z) of a (4, 4) matrix."""
    quaternion = pose.quaternion_from_rotation(target_from_source[:3, :3])
    return {"position": target_from_source[:3, 3].tolist(), "quaternion": quaternion.tolist()}
