"""Outliers of a deviation: points far from the bulk of the distances, and the places where they lie together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from scancell.geometry.mesh import Mesh

Array = NDArray[np.float64]

_ROBUST_DEVIATIONS = 5.0  # as in the acceptance test
_LEAST_THRESHOLD = 1e-7  # m: the rounding of exact distances has no outliers
_PLACES = 25  # radii of a place along the largest extent of the part


@dataclass(frozen=True)
class OutlierPlace:
    """Outliers that lie together.

    Attributes
    ----------
    row
        Point with the largest deviation.
    largest
        Its distance from the part, m.
    count
        Number of outliers.
    """

    row: int
    largest: float
    count: int


@dataclass(frozen=True, eq=False)
class Outliers:
    """Outliers of a cloud.

    Attributes
    ----------
    rows
        (k,) points that deviate by more than `threshold` (m) from the `median` (m), largest deviation first.
    places
        Where they lie, in the same order: each outlier belongs to the first place whose largest one is within `reach`
        (m).
    """

    rows: NDArray[np.int64]
    places: tuple[OutlierPlace, ...]
    median: float
    threshold: float
    reach: float


def find_outliers(points: Array, distance: Array, mesh: Mesh) -> Outliers:
    """Points (n, 3) whose distance (n,) is more than 5 robust standard deviations from the median, by place."""
    reach = float(np.ptp(mesh.bounds, axis=0).max()) / _PLACES
    if not len(distance):
        return Outliers(np.zeros(0, np.int64), (), 0.0, _LEAST_THRESHOLD, reach)
    median = float(np.median(distance))
    spread = np.abs(distance - median)
    threshold = max(_ROBUST_DEVIATIONS * 1.4826 * float(np.median(spread)), _LEAST_THRESHOLD)
    rows = np.flatnonzero(spread > threshold)
    rows = rows[np.argsort(-np.abs(distance[rows]), kind="stable")]
    places: list[OutlierPlace] = []
    if len(rows):
        tree, free = cKDTree(points[rows]), np.ones(len(rows), bool)
        for worst in range(len(rows)):
            if free[worst]:
                near = np.array(tree.query_ball_point(points[rows[worst]], reach))
                own = near[free[near]]
                free[own] = False
                places.append(OutlierPlace(int(rows[worst]), float(distance[rows[worst]]), len(own)))
    return Outliers(rows, tuple(places), median, threshold, reach)
