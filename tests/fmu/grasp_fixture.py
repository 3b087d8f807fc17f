"""A cell with a gripper and a box on the table, and moves of its arm."""

from __future__ import annotations

from typing import Any

import numpy as np
from cell_fixture import CYCLE_US, DH_MM_DEG, LIMITS_DEG, Array, CellFmu, box_part, cell_description, pose

from scancell.geometry.arm import Arm, Joint

CYCLE = CYCLE_US * 1e-6
GRAVITY = 9.80665
FINGER_LENGTH = 0.05
PAD_FRICTION = 0.5
BOX = (0.03, 0.03, 0.06)  # m
MASS = 0.4
TABLE = np.array([0.45, 0.0, 0.1])
PLACE = np.array([0.40, 0.0])
_JOINTS = [
    Joint(a / 1000, d / 1000, np.radians(alpha), 0.0, np.radians(low), np.radians(high), 5.0, 20.0)
    for (a, d, alpha), (low, high) in zip(DH_MM_DEG, LIMITS_DEG, strict=True)
]
ARM = Arm(_JOINTS, np.eye(4))


def gripper(**keys: float) -> dict[str, Any]:
    return {
        "flange_from_gripper": pose([0, 0, 0.06]), "stroke": 0.08, "finger_length": FINGER_LENGTH,
        "finger_width": 0.02, "finger_thickness": 0.01, "finger_mass": 0.1, "max_force": 60.0, "max_speed": 0.1,
        "friction": PAD_FRICTION, "centring_stiffness": 2e4, "start": 0.06, **keys,
    }  # fmt: skip


def joints_at(tip: Array, yaw: float = 0.0) -> Array:
    """Joint angles (6,) for which the finger tips are at a point (3,) in the world, pointing down."""
    world_from_flange = np.eye(4)
    c, s = np.cos(yaw), np.sin(yaw)
    world_from_flange[:3, :3] = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ np.diag([1.0, -1.0, -1.0])
    world_from_flange[:3, 3] = tip + np.array([0, 0, 0.06 + FINGER_LENGTH])
    branches = ARM.ik(world_from_flange)[0]
    q = branches[~np.isnan(branches).any(1)][0]
    # Rounding decides between the two turns of a joint that is half a turn from 0.
    return np.asarray(np.where(q < -np.pi + 1e-9, q + 2 * np.pi, q))


OVER_BOX = joints_at(np.array([*PLACE, TABLE[2] + 0.02]))


def grasp_cell(start: Array = OVER_BOX, contact: dict[str, Any] | None = None, **part: Any) -> dict[str, Any]:
    """Description with the arm at home around the box on the table, gripper open."""
    cell = cell_description()
    box = box_part(*BOX, MASS, fixture="free", friction=1.0, support_from_part=pose([*(PLACE - TABLE[:2]), 0]), **part)
    cell.update(parts=[box], gripper=gripper(), contact=contact or cell["contact"])
    for joint, angle in zip(cell["robot"]["joints"], start, strict=True):
        joint["start"] = float(angle)
    return cell


def smooth(share: Array) -> Array:
    """Quintic profile from 0 to 1 with zero speed and acceleration at its ends."""
    return np.asarray(share**3 * (10 - 15 * share + 6 * share**2))


def move(cell: CellFmu, start: Array, end: Array, duration: float) -> None:
    """Stream set-points of a smooth joint move."""
    cycles = round(duration / CYCLE)
    for share in smooth(np.arange(1, cycles + 1) / cycles):
        cell.command(start + share * (end - start))
        cell.step(CYCLE_US)


def grip(cell: CellFmu, force: float, hold: Array = OVER_BOX) -> None:
    cell.command(hold)
    cell.set("command.gripper.mode", 2)
    cell.set("command.gripper.force", force)
    cell.step(CYCLE_US, 40)


def part_in_gripper(cell: CellFmu) -> Array:
    return np.asarray(np.linalg.inv(cell.body("link[6]")) @ cell.body("part[1]"))
