"""Usual practice without a moving table: the first of 72 table angles, and arm branch, at which the path is free."""

from __future__ import annotations

from typing import Any

import numpy as np

from benchmarks.planning_cases import dense_poses, first_contact, judge_of, path_poses, planning_cell
from scancell.geometry import pose

_STEP = np.radians(0.5)  # of an axis between poses that are checked for collision
_JUMP = np.radians(20.0)  # of a joint between rows


def planning(case: dict[str, Any]) -> dict[str, Any]:
    """Joints by inverse kinematics; collisions by python-fcl."""
    cell, poses = planning_cell(case["case"]), path_poses(case["path"])
    judge = judge_of(cell)
    for table in np.linspace(0.0, 2 * np.pi, 72, endpoint=False):
        branches = cell.ik(pose.from_rotation(pose.rotation_about(2, np.full(len(poses), table))) @ poses)
        for q in np.moveaxis(branches, 1, 0):
            if not np.isfinite(q).all() or np.abs(np.diff(q, axis=0)).max() > _JUMP:
                continue
            axes = np.column_stack([q, np.full(len(q), table)])
            if not first_contact(cell, judge, dense_poses(axes, _STEP)):
                return _table(axes)
    return _table(np.zeros((0, 7)))


def _table(axes: Any) -> dict[str, Any]:
    names = (*(f"q{joint}_deg" for joint in range(1, 7)), "table_deg")
    return dict(zip(names, np.degrees(axes).T, strict=True))
