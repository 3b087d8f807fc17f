"""Measurable surface that views see: range, incidence, and occlusion of laser and cameras by rays."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from scancell.config.sensor import SensorDescription
from scancell.geometry import pose
from scancell.nominal.cell import NominalCell
from scancell.planning.views.views import View
from scancell.planning.work import SIGHT, Work
from scancell.visibility.measurable import MeasurableSurface, measurable_surface
from scancell.visibility.sensor_field import SensorField, SensorOptics
from scancell.visibility.surface_search import INCIDENCE_LIMIT, SurfaceSearch, Tracer

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
Judgements = NDArray[np.int8]
Indices = NDArray[np.int64]

# Why a view does not measure a sample, in the order of the checks.
OUT_OF_RANGE, GRAZING, OCCLUDED, SEEN = range(4)

_MOST_SAMPLES = 6000  # of the measurable surface
_LIFT = 2e-5  # m by which rays start above the surface
_MIN_COSINE = float(np.cos(INCIDENCE_LIMIT))


class Sight:
    """Determines which samples of the measurable surface of a part views measure.

    Occluders are the part and all bodies that rest on the table; what stands beside the table, the arm and the housing
    of the sensor are not, as in the geometric engine the housing is not.

    Parameters
    ----------
    nominal
        Cell with the part.
    sensor
        Its sensor.
    measurable
        Finds the measurable surface; asked for once.
    threads
        0: all cores. Results do not depend on it.
    work
        Counts the judgements.
    most_samples
        Number of measurable samples that are judged at most.
    """

    def __init__(
        self,
        nominal: NominalCell,
        sensor: SensorDescription,
        measurable: Callable[[NominalCell, SensorDescription], MeasurableSurface] = measurable_surface,
        threads: int = 0,
        work: Work | None = None,
        most_samples: int = _MOST_SAMPLES,
    ) -> None:
        self._most_samples = most_samples
        self._nominal, self._description, self._measurable = nominal, sensor, measurable
        self._threads, self._work = threads, work or Work()

    @cached_property
    def surface(self) -> MeasurableSurface:
        """The measurable surface."""
        return self._measurable(self._nominal, self._description)

    @cached_property
    def search(self) -> SurfaceSearch:
        """Search for poses that measure samples of the surface."""
        field = SensorField.of(self._description)
        return SurfaceSearch(self._nominal, field, len(self.surface.samples), self._threads)

    @cached_property
    def rows(self) -> Indices:
        """(n,) those of the samples of the surface that are judged: measurable ones, evenly chosen."""
        measurable = np.flatnonzero(self.surface.measurable)
        return measurable[:: max(1, -(-len(measurable) // self._most_samples))]

    @cached_property
    def points(self) -> Array:
        """(n, 3) judged samples in the frame of the table at angle 0, m, of equal area each."""
        return pose.transform_points(self._nominal.table_from_part, self.search.samples[self.rows])

    @cached_property
    def normals(self) -> Array:
        """(n, 3) their unit normals; of a mesh that is not closed either side counts."""
        return np.asarray(self.search.normals[self.rows] @ self._nominal.table_from_part[:3, :3].T)

    @cached_property
    def optics(self) -> SensorOptics:
        """Optics of the sensor."""
        return SensorOptics.of(self._description)

    @cached_property
    def _tracer(self) -> Tracer:
        return Tracer(self.search.obstacles, self._threads)

    def judge(self, view: View) -> Judgements:
        """(n,) result of each sample in the view: `SEEN`, or the last check that it passes at no crossing."""
        best = np.full(len(self.points), OUT_OF_RANGE, np.int8)
        for table_from_sensor in view.crossings(self.points):
            rows = np.flatnonzero(np.isfinite(table_from_sensor[:, 0, 3]) & (best < SEEN))
            best[rows] = np.maximum(best[rows], self.judge_at(table_from_sensor[rows], rows))
        return best

    def judge_at(self, table_from_sensor: Array, rows: Indices) -> Judgements:
        """(k,) the same for the samples `rows` (k,), each from a pose (k, 4, 4) with the sample in the laser sheet."""
        self._work.spend(SIGHT * len(rows))
        points, normals = self.points[rows], self.normals[rows]
        result = np.full(len(rows), OUT_OF_RANGE, np.int8)
        in_view = self.optics.contains(pose.transform_each(pose.inverse(table_from_sensor), points))
        optics = np.concatenate([[[0.0, 0.0, self.optics.source_z]], self.optics.cameras])
        ends = np.einsum("nij,kj->nki", table_from_sensor[:, :3, :3], optics) + table_from_sensor[:, None, :3, 3]
        rays = ends - points[:, None]
        if not self._nominal.part.is_closed:
            normals = np.where((rays[:, 0] * normals).sum(-1, keepdims=True) < 0, -normals, normals)
        cosine = np.einsum("nki,ni->nk", rays, normals) / np.linalg.norm(rays, axis=-1)
        facing = in_view & (cosine[:, :1] > _MIN_COSINE) & (cosine[:, 1:] > _MIN_COSINE)
        result[in_view.any(1)] = GRAZING
        result[facing.any(1)] = OCCLUDED
        lit = np.flatnonzero(facing.any(1))
        lifted = points + _LIFT * normals
        lit = lit[~self._tracer.blocked(lifted[lit], ends[lit, 0])]
        for camera in range(facing.shape[1]):
            asked = lit[facing[lit, camera] & (result[lit] < SEEN)]
            result[asked[~self._tracer.blocked(lifted[asked], ends[asked, 1 + camera])]] = SEEN
        return result
