"""What views truly see of the measurable surface: range, incidence, and occlusion of laser and cameras by rays."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from scancell import sensor as sensor_rt
from scancell.config.sensor import SensorDescription
from scancell.geometry import pose
from scancell.nominal.cell import NominalCell
from scancell.planning.views import View
from scancell.visibility.measurable import INCIDENCE_LIMIT, MeasurableSurface, measurable_surface
from scancell.visibility.sensor_field import SensorOptics
from scancell.visibility.tracer import Tracer

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
Judgements = NDArray[np.int8]

# Why a view does not measure a sample, in the order of the checks.
OUT_OF_RANGE, GRAZING, OCCLUDED, SEEN = range(4)

_LIFT = 2e-5  # m by which rays start above the surface
_MIN_COSINE = float(np.cos(INCIDENCE_LIMIT))


class Sight:
    """Judges what views measure of the measurable surface of a part.

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
    """

    def __init__(
        self,
        nominal: NominalCell,
        sensor: SensorDescription,
        measurable: Callable[[NominalCell, SensorDescription], MeasurableSurface] = measurable_surface,
        threads: int = 0,
    ) -> None:
        self._nominal, self._description, self._measurable = nominal, sensor, measurable
        self._threads = threads

    @cached_property
    def surface(self) -> MeasurableSurface:
        """The measurable surface."""
        return self._measurable(self._nominal, self._description)

    @cached_property
    def points(self) -> Array:
        """(n, 3) measurable samples in the frame of the table at angle 0, m, of equal area each."""
        return pose.transform_points(self._nominal.table_from_part, self.surface.samples[self.surface.measurable])

    @cached_property
    def normals(self) -> Array:
        """(n, 3) their unit normals; of a mesh that is not closed either side counts."""
        part = self._nominal.part
        normals = self.surface.normals[self.surface.measurable]
        if not part.is_closed:
            samples = self.surface.samples[self.surface.measurable]
            normals = part.normals[sensor_rt.closest_points(part.vertices, part.faces, samples, self._threads)[2]]
        return np.asarray(normals @ self._nominal.table_from_part[:3, :3].T)

    @cached_property
    def optics(self) -> SensorOptics:
        """Optics of the sensor."""
        return SensorOptics.of(self._description)

    @cached_property
    def _tracer(self) -> Tracer:
        nominal = self._nominal
        frames = nominal.frame_poses(nominal.home, 0.0)
        turned = nominal.frame_poses(nominal.home, 1.0)
        table_from_world = pose.inverse(frames["table"])
        on_table = [b for b in nominal.bodies if not np.allclose(frames[b.moves_with], turned[b.moves_with])]
        return Tracer([b.mesh.transformed(table_from_world @ frames[b.moves_with]) for b in on_table], self._threads)

    def judge(self, view: View) -> Judgements:
        """(n,) what the view makes of each sample: `SEEN`, or the last check that it passes at no crossing."""
        best = np.full(len(self.points), OUT_OF_RANGE, np.int8)
        for table_from_sensor in view.crossings(self.points):
            rows = np.flatnonzero(np.isfinite(table_from_sensor[:, 0, 3]) & (best < SEEN))
            best[rows] = np.maximum(best[rows], self.judge_at(table_from_sensor[rows], rows))
        return best

    def judge_at(self, table_from_sensor: Array, rows: NDArray[np.int64]) -> Judgements:
        """(k,) the same for the samples `rows` (k,), each from a pose (k, 4, 4) with the sample in the laser sheet."""
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
