"""Short straight passes in any direction, for surface that other views do not see."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scancell.geometry import pose
from scancell.planning.views.sight import SEEN, Judgements, Sight
from scancell.planning.views.views import Pass
from scancell.visibility.surface_search import ANGLE_STEP, orientations

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

_TRIED = 1500  # poses of the sensor that are tried for each target
_HALF_LENGTH = 0.15  # m: longest leg to either side of its target
_GAP = 0.008  # m along a leg without unseen surface that ends it
_LEG_MARGIN = 1.5e-3  # m
_RANGES = (0.1, 0.35, 0.6)  # of the depth of field: where in the range targets are put


@dataclass(frozen=True)
class Leg:
    """A pass, and its result for each sample of the `Sight` (n,)."""

    view: Pass
    judged: Judgements


def legs(sight: Sight, wanted: Indices, targets: int, legs_each: int, rng: np.random.Generator) -> list[Leg]:
    """Passes over samples `wanted`, from poses that see randomly drawn targets among them.

    The poses are drawn at random from the orientations of the grid of the measurable surface, in steps of 15 degrees;
    for targets that none of them sees, the grid is searched. A pass extends to both sides of its target as long as it
    sees wanted samples.

    Parameters
    ----------
    targets
        Number of samples that are drawn.
    legs_each
        Largest number of passes for each.
    rng
        Random numbers.
    """
    poses, hard = [], []
    for target in rng.choice(wanted, min(targets, len(wanted)), replace=False):
        tried = _poses_above(sight, target, rng)
        good = np.flatnonzero(sight.judge_at(tried, np.full(len(tried), target)) == SEEN)
        poses.append(tried[rng.choice(good, min(legs_each, len(good)), replace=False)])
        if not len(good):
            hard.append(target)
    poses.append(sight.search.poses(sight.rows[hard], legs_each)[1])
    made = (_leg(sight, at, wanted) for at in np.concatenate(poses))
    return [leg for leg in made if leg is not None]


def _poses_above(sight: Sight, target: int, rng: np.random.Generator) -> Array:
    """Random poses (k, 4, 4), k <= `_TRIED`, that have the target on the sensor's Z axis, above the table."""
    grid = orientations()
    turns = pose.rotation_about(2, ANGLE_STEP * rng.integers(round(2 * np.pi / ANGLE_STEP), size=_TRIED))
    rotation = turns @ grid[rng.integers(len(grid), size=_TRIED)]
    near, far = sight.optics.sensor.range
    distance = near + rng.choice(_RANGES, _TRIED) * (far - near)
    origin = sight.points[target] - distance[:, None] * rotation[:, :, 2]
    return np.asarray(pose.from_rotation(rotation, origin)[origin[:, 2] > 0])


def _leg(sight: Sight, at: Array, wanted: Indices) -> Leg | None:
    """The pass through a pose (4, 4) as long as it sees wanted samples."""
    reach = _pass(at, -_HALF_LENGTH, _HALF_LENGTH)
    judged = sight.judge(reach)
    along = (sight.points - at[:3, 3]) @ at[:3, 0]
    useful = np.sort(along[wanted[judged[wanted] == SEEN]])
    if not len(useful):
        return None
    # The target itself lies at 0; the run of neighbours without a large gap around it.
    gaps = np.flatnonzero(np.diff(useful) > _GAP)
    low = useful[gaps[useful[gaps + 1] <= 0] + 1].max(initial=useful[0])
    high = useful[gaps[useful[gaps] >= 0]].min(initial=useful[-1])
    low, high = float(low) - _LEG_MARGIN, float(high) + _LEG_MARGIN
    return Leg(_pass(at, low, high), np.where((along >= low) & (along <= high), judged, 0).astype(np.int8))


def _pass(at: Array, low: float, high: float) -> Pass:
    ends = [at @ pose.translation((x, 0.0, 0.0)) for x in (low, high)]
    x, y, z = 1e3 * (ends[0][:3, 3] + ends[1][:3, 3]) / 2
    elevation = float(np.degrees(np.arcsin(-at[2, 2].clip(-1, 1))))
    return Pass(
        f"leg at {elevation:.0f} deg, {1e3 * (high - low):.0f} mm, sensor at ({x:.0f}, {y:.0f}, {z:.0f}) mm", *ends
    )
