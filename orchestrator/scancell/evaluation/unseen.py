"""Surface without points of the cloud, by the reason: what each exposure of the scan could measure of it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from scancell.config.sensor import SensorDescription
from scancell.evaluation.coverage import Coverage
from scancell.geometry import pose
from scancell.nominal.cell import NominalCell
from scancell.planning.views.sight import GRAZING, OCCLUDED, OUT_OF_RANGE, SEEN, Sight
from scancell.values import Value
from scancell.visibility.measurable import MeasurableSurface

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

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
        Of the same samples.
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
