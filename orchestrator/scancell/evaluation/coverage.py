"""Coverage of a scan: the share of the measurable surface that has points of the cloud.

The measurable surface is a property of part, placement, cell and sensor alone (see `measurable`): it does not depend on
the scan, so that more profiles never lower the coverage.

A surface sample is covered when a point of the cloud lies within the tolerance, on the same side of the surface: the
angle between their normals is at most 60°, so that a thin wall is not covered by the points of its back. Points without
a normal count on either side. The tolerance is 1.5 profile spacings and at most 1.5 mm: of a plane scanned in profiles
`s` apart that leaves the share min(1, 3 mm / s).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scancell import sensor as sensor_rt
from scancell.geometry import pose
from scancell.values import Value
from scancell.visibility.measurable import MeasurableSurface

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

_TOLERANCE_SPACINGS = 1.5  # of the profiles; dense profiles need half of one
_LARGEST_TOLERANCE = 1.5e-3  # m
_LEAST_COSINE = 0.5  # between the normals of sample and point
_MOST_PAIRS = 200  # of successive exposures of which the spacing is the median
_HULL_POINTS = 2000


@dataclass(frozen=True, eq=False, repr=False)
class Coverage(Value):
    """Coverage of one cloud.

    Attributes
    ----------
    samples_in_part
        (n, 3) surface samples, m; each represents the same share of the surface.
    measurable
        (n,) whether the sensor can measure the sample from any pose that the arm reaches.
    covered
        (n,) whether the cloud has a point there, measurable or not.
    surface_area
        Of the whole part, m².
    tolerance
        Largest distance between a sample and a point that covers it, m.

    Examples
    --------
    >>> result = scancell.scan("part.stl", engine="geometric", settings={"scan.max_profiles": 40})
    >>> 0 < result.coverage.surface_fraction < result.coverage.fraction < 1
    True
    """

    samples_in_part: Array
    measurable: Flags
    covered: Flags
    surface_area: float
    tolerance: float

    @property
    def fraction(self) -> float:
        """Covered share of the measurable surface, 0 … 1; NaN when nothing is measurable."""
        count = int(self.measurable.sum())
        return float((self.covered & self.measurable).sum() / count) if count else float("nan")

    @property
    def surface_fraction(self) -> float:
        """Covered share of the whole surface, 0 … 1."""
        return float(self.covered.mean())

    @property
    def measurable_fraction(self) -> float:
        """Measurable share of the whole surface, 0 … 1."""
        return float(self.measurable.mean())

    @property
    def measurable_area(self) -> float:
        """Area of the measurable surface, m²."""
        return self.surface_area * self.measurable_fraction

    def as_json(self) -> dict[str, Any]:
        """Plain data for ``deviation.json``."""
        fraction = self.fraction
        return {
            "definitions": {
                "covered": "has a point of the cloud within tolerance_mm on the same side",
                "measurable": "the sensor can measure it from some pose that the arm reaches, whatever the plan",
                "fraction": "covered share of the measurable surface",
                "surface_fraction": "covered share of the whole surface",
                "measurable_fraction": "measurable share of the whole surface",
            },
            "fraction": None if np.isnan(fraction) else fraction,
            "surface_fraction": self.surface_fraction,
            "measurable_fraction": self.measurable_fraction,
            "measurable_area_mm2": 1e6 * self.measurable_area,
            "surface_area_mm2": 1e6 * self.surface_area,
            "tolerance_mm": 1e3 * self.tolerance,
            "samples": len(self.covered),
        }


def coverage(
    points_in_part: Array,
    surface: MeasurableSurface,
    spacing: float,
    normals: Array | None = None,
    tolerance: float | None = None,
) -> Coverage:
    """Coverage of a cloud.

    Parameters
    ----------
    points_in_part
        (m, 3) m
    spacing
        Distance between neighbouring profiles on the part, m, see `profile_spacing`; it decides the tolerance.
    normals
        (m, 3) unit normals of the points, NaN where unknown; None: all unknown.
    tolerance
        Distance within which a point covers a sample, m; by default 1.5 spacings and at most 1.5 mm.
    """
    reach = min(_TOLERANCE_SPACINGS * spacing, _LARGEST_TOLERANCE) if tolerance is None else tolerance
    covered = sensor_rt.covered_samples(surface.samples, surface.normals, points_in_part, normals, reach, _LEAST_COSINE)
    return Coverage(surface.samples, surface.measurable, covered, surface.area, reach)


def profile_spacing(points_in_part: Array, part_from_sensor: Array, segment: NDArray[np.int64]) -> float:
    """Typical distance (m) by which the laser sheet moves over the part between neighbouring exposures.

    Of each pair of neighbours the largest distance anywhere on the part counts, of the pairs the median.

    Parameters
    ----------
    points_in_part
        (k, 3) points spread over the part, such as the samples of its surface.
    part_from_sensor
        (n, 4, 4) sensor pose of each exposure.
    segment
        (n,) segment of the program; a segment with a single exposure counts with its neighbour in time.
    """
    count = len(part_from_sensor) - 1
    if count < 1:
        return 1e-3
    rows = np.unique(np.linspace(0, count - 1, min(count, _MOST_PAIRS)).round().astype(np.int64))
    points = points_in_part[:: max(1, len(points_in_part) // _HULL_POINTS)]
    # Distance from the sheet X = 0 of the sensor: linear in the point.
    sheet = pose.inverse(part_from_sensor)[:, 0]
    step = sheet[rows + 1] - sheet[rows]
    largest = np.abs(points @ step[:, :3].T + step[:, 3]).max(0)
    same = segment[rows] == segment[rows + 1]
    # The median ignores the jumps between the views of stop-and-look programs.
    return float(np.median(largest[same] if same.any() else largest))
