"""Why something cannot be done, in words for people."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from orchestrator.geometry import pose
from orchestrator.planning.model import PlanningCell
from orchestrator.proximity.scene import Clash

Array = NDArray[np.float64]


def describe(clash: Clash, clearance: float) -> str:
    """What comes too near what."""
    if clash.distance <= 0:
        return f"{clash.body_a} hits {clash.body_b}"
    near, wanted = 1e3 * clash.distance, 1e3 * clearance
    return f"{clash.body_a} comes within {near:.1f} mm of {clash.body_b} ({wanted:g} mm wanted)"


def out_of_reach(cell: PlanningCell, table_from_sensor: Array) -> str:
    """Why the arm takes none of several sensor poses (n, 4, 4), judged by the one that comes nearest."""
    arm = cell.nominal.arm
    q = cell.ik(table_from_sensor, filtered=False)
    exists = np.asarray(np.isfinite(q).all(axis=-1))
    if not exists.any():
        world = cell.nominal.world_from_table @ table_from_sensor
        missing = float(np.min(arm.shortfall(world @ pose.inverse(cell.nominal.flange_from_sensor))))
        return f"out of the arm's reach by {1e3 * missing:.0f} mm" if missing > 0 else "out of the arm's reach"
    excess = np.where(exists[..., None], arm.excess(np.nan_to_num(q)), np.inf)
    best = excess.reshape(-1, excess.shape[-1])[int(np.argmin(excess.max(-1)))]
    joint = int(np.argmax(best))
    if best[joint] <= 0:
        return "only with a joint at its limit"
    return f"joint {joint + 1} would be {np.degrees(best[joint]):.1f} deg outside its limits"


def listed(title: str, reasons: list[str]) -> str:
    """One sentence of several reasons, cut short after eight."""
    more = [f"and {len(reasons) - 8} more"] if len(reasons) > 8 else []
    return f"{title}: " + "; ".join([*reasons[:8], *more])
