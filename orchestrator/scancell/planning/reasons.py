"""Texts of planning errors and warnings."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scancell.geometry import pose
from scancell.planning.model import PlanningCell
from scancell.proximity.scene import Clash

Array = NDArray[np.float64]

MAX_LISTED = 8


def describe(clash: Clash) -> str:
    """Message that names the two bodies and, unless they intersect, their distance and the required clearance."""
    if clash.distance <= 0:
        return f"{clash.body_a} hits {clash.body_b}"
    distance, required = 1e3 * clash.distance, 1e3 * clash.clearance
    return f"{clash.body_a} comes within {distance:.1f} mm of {clash.body_b} (required clearance {required:g} mm)"


def out_of_reach(cell: PlanningCell, table_from_sensor: Array, branches: slice = slice(None)) -> str:
    """Message why none of several sensor poses (n, 4, 4) is feasible, with the smallest violation among them.

    Poses are in the frame of the table at angle 0. The violation is the distance to the reach of the arm, or the
    angle by which a joint exceeds its limits; in some of the arm's `branches`.
    """
    arm = cell.nominal.arm
    q = cell.ik(table_from_sensor, filtered=False)[:, branches]
    exists = np.asarray(np.isfinite(q).all(axis=-1))
    if not exists.any():
        world = cell.nominal.world_from_table @ table_from_sensor
        missing = float(np.min(arm.distance_outside_reach(world @ pose.inverse(cell.nominal.flange_from_sensor))))
        return f"out of the arm's reach by {1e3 * missing:.0f} mm" if missing > 0 else "out of the arm's reach"
    violation = np.where(exists[..., None], arm.limit_violation(np.nan_to_num(q)), np.inf)
    best = violation.reshape(-1, violation.shape[-1])[int(np.argmin(violation.max(-1)))]
    joint = int(np.argmax(best))
    if best[joint] <= 0:
        return "reachable only with a joint at its limit"
    return f"joint {joint + 1} would be {np.degrees(best[joint]):.1f} deg outside its limits"


def join_reasons(title: str, reasons: list[str]) -> str:
    """Message of a title and the first `MAX_LISTED` of several reasons."""
    more = [f"and {len(reasons) - MAX_LISTED} more"] if len(reasons) > MAX_LISTED else []
    return f"{title}: " + "; ".join([*reasons[:MAX_LISTED], *more])
