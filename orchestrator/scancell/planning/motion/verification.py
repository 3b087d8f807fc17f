"""Checks of a cell before planning, of finished plans by python-fcl, and of saved plans."""

from __future__ import annotations

from itertools import product

import numpy as np

from scancell.errors import PlanningError
from scancell.nominal.cell import OCCUPIED
from scancell.planning.model import CONFIGURATION, PlanningCell, describe
from scancell.planning.motion import trajectory
from scancell.planning.motion.timing import axis_name
from scancell.planning.options import ScanOptions
from scancell.planning.plan import Plan
from scancell.proximity.judge import Judge
from scancell.proximity.scene import arm_chain

_SAME_PLACE = 1e-6  # rad
_BLOCK = 1024  # poses that python-fcl checks between two looks at the work


def check_part(cell: PlanningCell) -> None:
    """Check that the part lies on the table (if it is to be there) and that nothing collides at the home position.

    Raises
    ------
    PlanningError
        Otherwise, with the distance by which the part protrudes or the bodies that collide.
    """
    if cell.nominal.support == "table":
        _check_on_table(cell)
    hit = cell.contacts(cell.start[None])
    if hit:
        raise PlanningError(f"at the home position: {describe(hit[0])}")


def _check_on_table(cell: PlanningCell) -> None:
    nominal = cell.nominal
    used = nominal.part.vertices[np.unique(nominal.part.faces)]
    on_table = used @ nominal.table_from_part[:3, :3].T + nominal.table_from_part[:3, 3]
    radius = float(np.hypot(on_table[:, 0], on_table[:, 1]).max())
    if radius > nominal.table_radius + 1e-9:
        raise PlanningError(
            f"too large for the table: it extends to {1e3 * radius:.1f} mm from the axis,"
            f" {1e3 * (radius - nominal.table_radius):.1f} mm beyond cell.table.radius_mm ="
            f" {1e3 * nominal.table_radius:g}; move or turn it with cell.part.x_mm, y_mm, rx_deg, ry_deg, rz_deg",
            file=nominal.part.source,
        )
    if on_table[:, 2].min() < -1e-6:
        raise PlanningError(
            f"its lowest point is {-1e3 * on_table[:, 2].min():.3f} mm below the table's top; raise cell.part.z_mm",
            file=nominal.part.source,
        )


def recheck(cell: PlanningCell, saved: Plan, options: ScanOptions) -> Plan:
    """A saved plan, after it was checked in this cell as a new one is: limits, clearances, python-fcl.

    Raises `PlanningError` if the plan is for another arm or controller, does not start at the home position, does not
    continue, exceeds a limit, or comes too close to something; with the segment.
    """
    check_part(cell)
    nominal, at = cell.nominal, cell.start
    motions = cell.motion_check(options.clearance)
    lower, upper = nominal.arm.limits
    for segment in saved.program.segments:
        where = f"{saved.source}: segment {segment.id} ({segment.name})"
        points = segment.axes
        if points.shape[1] != len(at):
            raise PlanningError(f"{where}: {points.shape[1] - 1} joints, the arm has {len(nominal.home)}")
        if np.abs(np.diff(segment.times, prepend=-cell.cycle) - cell.cycle).max() > 1e-9:
            raise PlanningError(
                f"{where}", expected=f"a set-point every {1e3 * cell.cycle:g} ms from 0, the controller's cycle"
            )
        gap = float(np.abs(points[0] - at).max())
        if gap > _SAME_PLACE:
            raise PlanningError(f"{where}: starts {np.degrees(gap):.3f} deg from where the motion before it ends")
        if (points[:, :-1] < lower - _SAME_PLACE).any() or (points[:, :-1] > upper + _SAME_PLACE).any():
            raise PlanningError(f"{where}: leaves the joint limits")
        resting = np.concatenate([*3 * [points[:1]], points, *3 * [points[-1:]]])
        used = trajectory.limit_fractions(resting, cell.axis_limits, cell.cycle)
        if used.max() > 1 + 1e-6:
            axis = axis_name(cell, int(np.argmax(used.max(0))))
            raise PlanningError(f"{where}: {axis} exceeds a limit by {100 * (used.max() - 1):.1f} %")
        clash = motions.clash_along(points)
        if clash is not None:
            raise PlanningError(f"{where}: {describe(clash)}")
        at = points[-1]
    return verified(cell, options, saved)


def verified(cell: PlanningCell, options: ScanOptions, made: Plan) -> Plan:
    """The plan, after python-fcl found no collision at every second set-point.

    Raises
    ------
    PlanningError
        Otherwise: a defect of scancell, whose own distances proved the motion free.
    """
    if not options.verify:
        return made
    segments = made.program.segments
    poses = cell.nominal.body_poses(np.concatenate([segment.axes[::2] for segment in segments]))
    cell.work.doing = "checking the finished plan by python-fcl"
    names = [body.name for body in cell.nominal.bodies]
    # Occupied space around bodies that stand in the cell cannot be told from them, and counts for the arm alone.
    measured, others = [name for name in names if name.startswith(OCCUPIED)], set(names) - set(arm_chain(cell.nominal))
    around = [frozenset(pair) for pair in product(measured, others)]
    start = cell.nominal.body_poses(cell.start)
    judge = Judge(cell.judged_meshes, names, start, around)
    for first in range(0, len(poses), _BLOCK):
        block = poses[first : first + _BLOCK]
        cell.work.spend(CONFIGURATION * len(block))
        clash = judge.first_collision(block)
        if clash is not None:
            break
    else:
        return made
    starts = np.cumsum([0, *(len(segment.times[::2]) for segment in segments)])
    number = int(np.searchsorted(starts, first + clash.index, side="right")) - 1
    segment, at = segments[number], 2 * int(first + clash.index - starts[number])
    place = f"segment {segment.id} ({segment.name}), {segment.times[at]:.3f} s after its start"
    raise PlanningError(f"python-fcl finds that {clash.body_a} hits {clash.body_b} in {place}")
