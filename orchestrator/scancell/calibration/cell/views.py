"""Views by which an artefact is measured: candidates that the arm reaches, passes, and the choice of the best poses."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from scancell.arrays import Array
from scancell.calibration.cell.kinematics import UNIT
from scancell.calibration.cell.problem import CalibrationProblem, measured_meshes
from scancell.calibration.cell.solve import moments_of
from scancell.calibration.variance_components import informations
from scancell.config.description import si_value
from scancell.errors import CalibrationError, PlanningError
from scancell.geometry import pose
from scancell.geometry.mesh import Mesh
from scancell.nominal.cell import with_table
from scancell.planning.model import PlanningCell
from scancell.planning.motion.assembly import Assembly, check_part, verified
from scancell.planning.options import ScanOptions
from scancell.planning.plan import Plan
from scancell.planning.views.placement import PlacedPass, PlacedPose, Placer
from scancell.planning.views.views import Pass

_TILT = np.radians(50.0)  # largest angle between the sensor's z and the normal of the surface that it looks at
_RANGE_MARGIN = 0.15  # share of the measuring range that is left free at both ends
_LINE_SHARE = 0.5  # of the half laser line, within which the target lies
_ATTEMPTS = 20  # samples per candidate
_BLOCK = 512
_PASS_LENGTH = 0.02  # m
_PASS_TRIES = 12

_PRIOR = 1e-4  # information per unit² (10 mm, 100 ms ...): the first poses alone determine nothing


def candidates(cell: PlanningCell, count: int, rng: np.random.Generator, clearance: float, turn_table: bool) -> Array:
    """Random positions (n, axes), rad, at which the sensor views the measured surfaces of an artefact with clearance.

    Raises `CalibrationError` if the arm reaches none.
    """
    found: list[Array] = []
    total = 0
    for _ in range(_ATTEMPTS * count // _BLOCK + 1):
        part_from_sensor = _random_views(cell, _BLOCK, rng)
        table = rng.uniform(-np.pi, np.pi, _BLOCK) if turn_table else np.zeros(_BLOCK)
        at_home = with_table(cell.nominal.home, table)
        solutions = cell.nominal.arm.ik(cell.nominal.world_from_flange(part_from_sensor, at_home))
        # A random one of the configurations that reach the view.
        score = np.where(np.isnan(solutions).any(2), -1.0, rng.uniform(size=solutions.shape[:2]))
        chosen = with_table(solutions[np.arange(_BLOCK), score.argmax(1)], table)
        reached = chosen[score.max(1) >= 0.0]
        near = [clash.index for clash in cell.clearance_violations(reached, clearance)]
        found.append(np.delete(reached, near, 0))
        total += len(found[-1])
        if total >= count:
            break
    if not total:
        raise CalibrationError(
            f"the arm reaches no view of it with a clearance of {1e3 * clearance:g} mm to all bodies:"
            " place it elsewhere (cell.part.x_mm, cell.part.y_mm)",
            file=cell.nominal.part.source,
        )
    return np.concatenate(found)[:count]


def turned_tables(cell: PlanningCell, count: int, rng: np.random.Generator, clearance: float) -> Iterator[Array]:
    """Positions (n, axes), rad, at random angles of the table with clearance, while the arm rests.

    It rests at home, then, as it may hide the artefact there, with its first joint turned.
    """
    nominal, home = cell.nominal, cell.nominal.home
    first = nominal.arm.joints[0]
    turns = home[0] + np.pi / 4 * np.array([0, 1, -1, 2, -2, 3, -3])
    angles = rng.uniform(-np.pi, np.pi, count)
    for turn in turns[(turns >= first.min) & (turns <= first.max)]:
        turned = with_table([turn, *home[1:]], angles)
        yield np.delete(turned, [clash.index for clash in cell.clearance_violations(turned, clearance)], 0)


def _random_views(cell: PlanningCell, count: int, rng: np.random.Generator) -> Array:
    """``part_from_sensor`` (n, 4, 4) that look at random points of the measured surfaces, at most `_TILT` obliquely."""
    points, normals = _surface_points(cell.nominal.part, count, rng)
    tilt, around = _TILT * np.sqrt(rng.uniform(size=count)), rng.uniform(-np.pi, np.pi, count)
    axis = -_tilted(normals, tilt, around)
    side = np.cross(axis, rng.normal(size=(count, 3)))
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    rotation = np.stack([side, np.cross(axis, side), axis], -1)
    span = cell.range.far - cell.range.near
    z = rng.uniform(cell.range.near + _RANGE_MARGIN * span, cell.range.far - _RANGE_MARGIN * span, count)
    y = rng.uniform(-_LINE_SHARE, _LINE_SHARE, count) * cell.range.half_line(z)
    offset = np.einsum("nij,nj->ni", rotation, np.column_stack([np.zeros(count), y, z]))
    return pose.from_rotation(rotation, points - offset)


def _surface_points(part: Mesh, count: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """Random points (n, 3) on the measured surfaces, each as likely as the others, and normals (n, 3)."""
    points, normals = np.empty((count, 3)), np.empty((count, 3))
    surfaces = measured_meshes(part)
    which = rng.integers(len(surfaces), size=count)
    for number, mesh in enumerate(surfaces):
        rows = np.flatnonzero(which == number)
        face = rng.choice(len(mesh.faces), len(rows), p=mesh.areas / mesh.areas.sum())
        weights = rng.dirichlet((1.0, 1.0, 1.0), len(rows))
        points[rows] = np.einsum("nk,nki->ni", weights, mesh.vertices[mesh.faces[face]])
        normals[rows] = mesh.normals[face]
    return points, normals


def _tilted(directions: Array, tilt: Array, around: Array) -> Array:
    """Unit vectors (n, 3) turned by angles `tilt` towards directions at angles `around`, rad."""
    helper = np.where(np.abs(directions[:, :1]) < 0.9, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
    u = np.cross(directions, helper)
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    v = np.cross(directions, u)
    sideways = np.cos(around)[:, None] * u + np.sin(around)[:, None] * v
    return np.asarray(np.cos(tilt)[:, None] * directions + np.sin(tilt)[:, None] * sideways)


def passes(cell: PlanningCell, count: int, rng: np.random.Generator, options: ScanOptions) -> list[PlacedPass]:
    """Passes of the sensor over the artefact along its x, each followed by the same one backwards.

    Raises `CalibrationError` if fewer are feasible.
    """
    speed, pitch = si_value(options.scan.raster, "speed_mm_s"), options.spacing.pitch
    placer = Placer(cell, options.azimuth, options.clearance)
    placed: list[PlacedPass] = []
    for _ in range(_PASS_TRIES):
        there = [_pass(view, len(placed) // 2) for view in _random_views(cell, count, rng)]
        there = [Pass(one.name, *(cell.nominal.table_from_part @ end for end in (one.start, one.end))) for one in there]
        back = [Pass(f"{one.name}, back", one.end, one.start) for one in there]
        views = [view for pair in zip(there, back, strict=True) for view in pair]
        exposures = [max(2, round(_PASS_LENGTH / pitch)) + 1] * len(views)
        found = placer.passes(views, exposures, speed, None)
        for one, other in zip(found[::2], found[1::2], strict=True):
            if isinstance(one, PlacedPass) and isinstance(other, PlacedPass) and len(placed) < count:
                placed += [one, other]
        if len(placed) >= count:
            return placed
    raise CalibrationError(
        f"{len(placed)} passes over it are feasible", file=cell.nominal.part.source, expected=str(count)
    )


def _pass(part_from_sensor: Array, number: int) -> Pass:
    along = part_from_sensor[:3, 0] * _PASS_LENGTH / 2
    start, end = part_from_sensor.copy(), part_from_sensor.copy()
    start[:3, 3] -= along
    end[:3, 3] += along
    return Pass(f"calibration pass {number + 1}", start, end)


def plan_views(cell: PlanningCell, options: ScanOptions, still: Array, moving: Sequence[PlacedPass]) -> Plan:
    """Collision-free program: an exposure at rest at each of `still` (n, axes), rad, the nearest next; then the passes.

    Raises `PlanningError` if no collision-free path is found.
    """
    check_part(cell)
    options = replace(options, scan=options.scan.model_copy(update={"mode": "dynamic"}))
    assembly = Assembly(cell, options)
    left = [PlacedPose(f"pose {number}", axes) for number, axes in enumerate(still, 1)]
    skipped: list[str] = []
    while left:
        nearest = int(np.argmin([assembly.time_to(one.axes) for one in left]))
        one = left.pop(nearest)
        try:
            assembly.add_pose(one)
        except PlanningError as error:
            skipped.append(f"{one.name} is left out: {error}")
    for view in moving:
        assembly.add_motion(view)
    return verified(cell, options, Plan(*assembly.finish(), None, tuple(skipped)))


@dataclass(frozen=True)
class PoseDesign:
    """Chosen candidates.

    Attributes
    ----------
    rows
        (c,) rows of the candidates, best first.
    expected
        (c, p) standard deviations of the free deviations to be expected after each choice, SI.
    """

    rows: NDArray[np.intp]
    expected: Array


def design_poses(candidates: CalibrationProblem, log_variances: Array, count: int) -> PoseDesign:
    """Choose `count` exposures of a problem greedily: each reduces the mean variance most (A-optimal).

    Parameters
    ----------
    candidates
        Problem whose observations are those to be expected: exact points, with standard deviations.
    log_variances
        Logarithms of the variances of points, relative to their stated one, and of pose errors, SI.

    Notes
    -----
    Variances are added in units of 1 mm, 1 mrad and 1 ms. A candidate is chosen once at most.
    """
    each = informations(moments_of(candidates), log_variances)
    free = len(candidates.free)
    total = _PRIOR * np.eye(each.shape[-1])
    left = np.ones(len(each), bool)
    rows, expected = [], []
    for _ in range(min(count, len(each))):
        covariance = np.linalg.inv(total + each)
        cost = np.where(left, np.trace(covariance[:, :free, :free], axis1=1, axis2=2), np.inf)
        best = int(cost.argmin())
        left[best] = False
        total = total + each[best]
        rows.append(best)
        expected.append(np.sqrt(np.diag(covariance[best])[:free]) * UNIT)
    return PoseDesign(np.array(rows, np.intp), np.array(expected))
