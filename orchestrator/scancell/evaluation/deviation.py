"""Deviation of a cloud from the CAD mesh or the exact shapes of the part: distances and their statistics."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from scancell import sensor as sensor_rt
from scancell.arrays import Array, Flags
from scancell.config.sensor import SensorDescription, camera_label
from scancell.geometry import pose
from scancell.geometry.mesh import Mesh
from scancell.geometry.shapes import PartSurface
from scancell.nominal.cell import NominalCell
from scancell.planning.views.coverage import GRAZING, OCCLUDED, OUT_OF_RANGE, SEEN, Sight
from scancell.reconstruction.cloud import Cloud
from scancell.values import Value
from scancell.visibility import MeasurableSurface

_TOLERANCE_SPACINGS = 1.5  # of the profiles; dense profiles need half of one
_SPACING_AT_REST = 1e-3  # m: of a single exposure, and of exposures that are repeated at one pose
_LARGEST_TOLERANCE = 1.5e-3  # m
_LEAST_COSINE = 0.5  # between the normals of sample and point
_MOST_PAIRS = 200  # of successive exposures of which the spacing is the median
_HULL_POINTS = 2000

_ROBUST_DEVIATIONS = 5.0  # as in the acceptance test
_LEAST_THRESHOLD = 1e-7  # m: the rounding of exact distances has no outliers
_PLACES = 25  # radii of a place along the largest extent of the part

STANDS_ON = "the part stands on it"
NOT_MEASURABLE = "hidden, at grazing incidence or out of reach from every pose of the arm"
NOT_CROSSED = "no laser line of the scan crosses it within the measuring range"
ONLY_GRAZING = "crossed at grazing incidence only (more than 75° from the normal)"
ONLY_OCCLUDED = "crossed only where the part or the table occludes laser or camera"
TAKEN_FOR_TABLE = "lower than scan.table_margin_mm: its points are taken for the table's"
NO_POINT = "in view, but without an accepted point"

_JUDGED = {OUT_OF_RANGE: NOT_CROSSED, GRAZING: ONLY_GRAZING, OCCLUDED: ONLY_OCCLUDED, SEEN: NO_POINT}
_STANDING_HEIGHT = 1e-4  # m above the table up to which a face that looks down stands on it
_DOWN = -0.9  # largest z component of the normal of such a face
_EXPOSURES = 64  # judged at a time, which bounds the memory


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
        Surface area of the whole part, m².
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
        return _SPACING_AT_REST
    rows = np.unique(np.linspace(0, count - 1, min(count, _MOST_PAIRS)).round().astype(np.int64))
    points = points_in_part[:: max(1, len(points_in_part) // _HULL_POINTS)]
    # Distance from the sheet X = 0 of the sensor: linear in the point.
    sheet = pose.inverse(part_from_sensor)[:, 0]
    step = sheet[rows + 1] - sheet[rows]
    largest = np.abs(points @ step[:, :3].T + step[:, 3]).max(0)
    same = segment[rows] == segment[rows + 1]
    # The median ignores the jumps between the views of stop-and-look programs.
    return float(np.median(largest[same] if same.any() else largest)) or _SPACING_AT_REST


@dataclass(frozen=True)
class DeviationFigures:
    """Statistics of `count` distances, m; signed ones are positive outside the material.

    `d95`, `d99_9` and `max_abs` are the 95 % and 99.9 % quantiles and the maximum of the absolute distance;
    `standard_deviation` is about the mean, `rms` about zero.
    """

    count: int
    mean: float
    standard_deviation: float
    rms: float
    d95: float
    d99_9: float
    max_abs: float
    maximum: float
    minimum: float

    @classmethod
    def of(cls, distance: Array) -> DeviationFigures:
        """Statistics of distances (n,), m; NaN without points."""
        if len(distance) == 0:
            return cls(0, *([float("nan")] * 8))
        mean, maximum, minimum = float(distance.mean()), float(distance.max()), float(distance.min())
        work = distance - mean
        # No BLAS: its sums depend on the number of threads.
        variance = float(np.square(work, out=work).mean())
        d95, d99_9 = _upper_quantiles(np.abs(distance, out=work), (0.95, 0.999))
        return cls(
            count=len(distance),
            mean=mean,
            standard_deviation=variance**0.5,
            rms=(variance + mean**2) ** 0.5,
            d95=d95,
            d99_9=d99_9,
            max_abs=max(maximum, -minimum),
            maximum=maximum,
            minimum=minimum,
        )

    def text(self) -> str:
        """A line of text."""
        return (
            f"  {self.count} compared, mean {1e6 * self.mean:.1f} um, RMS {1e6 * self.rms:.1f} um,"
            f" D95 % {1e6 * self.d95:.1f} um"
        )

    def as_um(self) -> dict[str, int | float | None]:
        """Figures in µm, by names with the suffix ``_um``, for JSON; None instead of NaN."""
        plain = asdict(self)
        count = plain.pop("count")
        figures = {f"{name}_um": None if np.isnan(value) else 1e6 * value for name, value in plain.items()}
        return {"count": count, **figures}


@dataclass(frozen=True, eq=False, repr=False)
class Deviation(Value):
    """Distance (n,) of each point of a cloud, in m, the mesh face nearest to it, and the figures.

    Distances are positive outside the material where `is_signed`, and absolute otherwise: a mesh that is not closed
    has no inside. `is_exact`: they are distances to the exact shapes of the part, of which the mesh is a tessellation.
    `by_camera` and `by_segment` are the figures by index of the camera and by segment of the plan, `by_sensor` those by
    number of the sensor of a cell with several. In such a cell, cameras have the numbers of `Setup.camera_names`.

    Examples
    --------
    >>> result = scancell.scan("part.stl", engine="geometric", settings={"scan.max_profiles": 40})
    >>> len(result.deviation.distance) == len(result.cloud)
    True
    >>> result.deviation.rms < 2e-6
    True
    """

    distance: Array
    face: NDArray[np.int32]
    figures: DeviationFigures
    by_camera: dict[int, DeviationFigures]
    by_segment: dict[int, DeviationFigures]
    is_signed: bool = True
    is_exact: bool = False
    by_sensor: dict[int, DeviationFigures] = field(default_factory=dict)

    @classmethod
    def of(
        cls,
        cloud: Cloud,
        distance: Array,
        face: NDArray[np.integer[Any]],
        is_signed: bool = True,
        is_exact: bool = False,
    ) -> Deviation:
        """From the distance (n,) of each point of the cloud and its nearest face (n,); flags as of `Deviation`."""
        several = (cloud.sensor != 1).any()
        camera = camera_label(cloud.sensor.astype(np.int32), cloud.camera) if several else cloud.camera
        return cls(
            distance=distance,
            face=face.astype(np.int32),
            figures=DeviationFigures.of(distance),
            by_camera=figures_by_label(distance, camera),
            by_segment=figures_by_label(distance, cloud.segment),
            is_signed=is_signed,
            is_exact=is_exact,
            by_sensor=figures_by_label(distance, cloud.sensor.astype(np.int32)) if several else {},
        )

    @property
    def mean(self) -> float:
        """Mean distance, m."""
        return self.figures.mean

    @property
    def rms(self) -> float:
        """Root mean square of the distances, m."""
        return self.figures.rms

    @property
    def d95(self) -> float:
        """95 % quantile of the absolute distances, m."""
        return self.figures.d95

    @property
    def max_abs(self) -> float:
        """Largest absolute distance, m."""
        return self.figures.max_abs

    def as_json(
        self, cameras: Sequence[str] | Mapping[int, str], segments: Mapping[int, str], sensors: Sequence[str] = ()
    ) -> dict[str, Any]:
        """Plain data for ``deviation.json``, with names of cameras by index, of segments by id, and of sensors."""
        by_sensor = {sensors[key - 1]: figures.as_um() for key, figures in self.by_sensor.items()}
        return {
            "what": "distance from each exported point to the nearest point of the "
            + ("exact shapes, " if self.is_exact else "mesh, ")
            + ("positive outside" if self.is_signed else "unsigned because the mesh is not closed"),
            "d95_um": "95 % of the absolute distances are smaller",
            "d99_9_um": "99.9 % of the absolute distances are smaller",
            "all": self.figures.as_um(),
            **({"by_sensor": by_sensor} if by_sensor else {}),
            "by_camera": {cameras[key]: figures.as_um() for key, figures in self.by_camera.items()},
            "by_segment": [
                {"id": key, "name": segments.get(key, str(key)), **figures.as_um()}
                for key, figures in self.by_segment.items()
            ],
        }


def deviation_from_mesh(cloud: Cloud, mesh: Mesh | PartSurface, threads: int = 0) -> Deviation:
    """Distances of all points of the cloud to a mesh, or its exact shapes, in the same frame; no point is left out.

    A `PartSurface` is a mesh prepared for queries, which serves any number of clouds. `threads` does not change the
    result; 0 uses all cores. Distances to an open mesh are absolute: it has no inside.
    """
    surface = mesh if isinstance(mesh, PartSurface) else PartSurface(mesh)
    distance, face = surface.distances(cloud.points_in_part, threads)
    return Deviation.of(cloud, distance, face, surface.is_signed, surface.is_exact)


def _upper_quantiles(values: Array, shares: tuple[float, ...]) -> list[float]:
    """Quantiles at ascending shares near 1, linear between the values, whose order it changes."""
    places = np.asarray(shares) * (len(values) - 1)
    first = int(places[0])
    values.partition(first)
    largest = np.sort(values[first:])
    return [float(value) for value in np.interp(places - first, np.arange(len(largest)), largest)]


def figures_by_label(distance: Array, label: NDArray[np.integer[Any]]) -> dict[int, DeviationFigures]:
    """Figures of the points of each label (n,), by rising label."""
    if not len(label):
        return {}
    lowest = int(label.min())
    present = np.flatnonzero(np.bincount(label - lowest)) + lowest
    return {int(key): DeviationFigures.of(distance[label == key]) for key in present}


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


@dataclass(frozen=True, eq=False, repr=False)
class UnseenSurface(Value):
    """Samples of the surface that no point of the cloud covers.

    Attributes
    ----------
    samples_in_part
        (k, 3), m; each represents `area / total` of the surface.
    reason
        (k,) index into `reasons`.
    reasons
        Sentences, in the order of the checks.
    total, area
        Number of samples of the whole surface, and its area, m².
    """

    samples_in_part: Array
    reason: NDArray[np.int64]
    reasons: tuple[str, ...]
    total: int
    area: float

    @property
    def shares(self) -> dict[str, float]:
        """Share of the whole surface by reason, largest first, without reasons that do not occur."""
        count = np.bincount(self.reason, minlength=len(self.reasons))
        order = np.argsort(-count, kind="stable")
        return {self.reasons[k]: float(count[k] / self.total) for k in order if count[k]}

    @classmethod
    def without_reason(
        cls, samples_in_part: Array, covered: Flags, area: float, tolerance: float, why_unknown: str
    ) -> UnseenSurface:
        """The samples (n, 3) that are not `covered` (n,) within the tolerance, m, where no sensor pose is known."""
        reason = f"no point within {1e3 * tolerance:.3g} mm; {why_unknown}"
        bare = np.flatnonzero(~covered)
        return cls(samples_in_part[bare], np.zeros(len(bare), np.int64), (reason,), len(covered), area)


def unseen_surface(
    coverage: Coverage,
    surface: MeasurableSurface,
    nominal: NominalCell,
    sensor: SensorDescription,
    part_from_sensor: Array,
    table_margin: float,
    threads: int = 0,
) -> UnseenSurface:
    """The uncovered samples of a part on the table, each with the last check that it passes in any exposure.

    Parameters
    ----------
    coverage, surface
        Coverage and surface of the same samples.
    part_from_sensor
        (n, 4, 4) nominal pose of the sensor at each exposure. An exposure crosses the samples from which
        its laser sheet is within the tolerance of the coverage along the surface.
    table_margin
        Height above the table below which points may be taken for the table's, m.
    threads
        0: all cores. The result does not depend on it.
    """
    reasons = (STANDS_ON, NOT_MEASURABLE, NOT_CROSSED, ONLY_GRAZING, ONLY_OCCLUDED, TAKEN_FOR_TABLE, NO_POINT)
    open_ = coverage.measurable & ~coverage.covered
    missed = replace(surface, measurable=open_)
    sight = Sight(nominal, sensor, lambda *_: missed, threads, most_samples=len(open_))
    height = pose.transform_points(nominal.table_from_part, surface.samples)[:, 2]
    down = sight.search.normals @ nominal.table_from_part[2, :3]
    of_sample = np.where((height < _STANDING_HEIGHT) & (down < _DOWN), 0, 1)
    judged = _judged(sight, nominal.table_from_part @ part_from_sensor, coverage.tolerance)
    of_sample[sight.rows] = np.array([reasons.index(_JUDGED[k]) for k in sorted(_JUDGED)])[judged]
    low = (of_sample == reasons.index(NO_POINT)) & (height < table_margin)
    of_sample[low] = reasons.index(TAKEN_FOR_TABLE)
    bare = ~coverage.covered
    return UnseenSurface(coverage.samples_in_part[bare], of_sample[bare], reasons, len(bare), coverage.surface_area)


def _judged(sight: Sight, table_from_sensor: Array, tolerance: float) -> NDArray[np.int64]:
    """(n,) best result of each judged sample in the exposures (m, 4, 4) whose stripe may be within the tolerance."""
    best = np.full(len(sight.rows), OUT_OF_RANGE, np.int64)
    # Distance from the sheet X = 0 of the sensor: linear in the point.
    sheets = pose.inverse(table_from_sensor)[:, 0]
    for first in range(0, len(sheets), _EXPOSURES):
        some = sheets[first : first + _EXPOSURES]
        left = np.flatnonzero(best < SEEN)
        offset = np.abs(some[:, :3] @ sight.points[left].T + some[:, 3:])
        # Along the surface the stripe is as much farther away as the sheet is inclined to the normal.
        along = np.sqrt(np.maximum(1 - np.square(some[:, :3] @ sight.normals[left].T), 0))
        exposure, sample = np.nonzero(offset <= tolerance * along)
        rows = left[sample]
        np.maximum.at(best, rows, sight.judge_at(table_from_sensor[first + exposure], rows).astype(np.int64))
    return best
