"""Surface normals from neighbours along the profile and in adjacent profiles."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scancell import sensor as sensor_rt

Array = NDArray[np.float64]
Index = NDArray[np.int64]


def estimate_normals(
    points: Array, frame: Index, camera: NDArray[np.int32], column: Index, sensor_in_part: Array, threads: int = 0
) -> Array:
    """Unit normals (m, 3) of the surface at points (m, 3), towards the sensor; NaN where undetermined.

    Three methods in order, until one gives a normal that faces the laser:

    1. Grid of profiles and columns. Along the profile: the slope of a line fit over up to six columns on either side.
       Across: the steps to the previous and next frame in the same column. Neighbours are connected by steps shorter
       than 10 mm and than four times the median step in a block of 400 frames.
    2. Plane fit to the twelve nearest points if they lie within 10 mm and are not collinear; otherwise to those among
       every 4th, 16th or 64th point, because points are much denser along a profile than across.
    3. The direction perpendicular to the profile that is nearest to the incident light.

    Raises `ValueError` if a point is not finite, beyond 1000 km, or its frame is not in 0 … n - 1.

    Parameters
    ----------
    points
        (m, 3) in the part frame, m.
    frame, camera, column
        (m,) indices of each point; the points of one camera form a grid of frames and columns. Of several points of
        one camera, frame and column the grid holds the last one.
    sensor_in_part
        (n, 3) origin of the laser light in each frame, m.
    threads
        Number of threads; 0 uses all cores. The result does not depend on it.
    """
    return sensor_rt.estimate_normals(points, frame, camera, column, sensor_in_part, threads)
