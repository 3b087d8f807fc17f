"""Poses of the parts that a gripper or a belt moves, from what is measured: joints, table, belts and the gripper.

A part is at its described pose until the gripper holds it, and rides on its belt by the measured travel.  From the
instant in which the gripper reports a grip the part moves with the flange, until the fingers open; then it stays where
it is, on the platter, on a belt or in the world.  How it slips in the grip or settles afterwards is not measured.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scancell.arguments import checked_arguments
from scancell.config.cell import CellDescription
from scancell.config.description import si_value
from scancell.geometry import pose
from scancell.geometry.mesh import Mesh
from scancell.geometry.tree import WORLD
from scancell.guard.messages import PlacedPart
from scancell.nominal.cell import NominalCell
from scancell.nominal.gripper import pose_matrix
from scancell.proximity.motion_check import arm_motion

Array = NDArray[np.float64]

_OPENED = 0.5e-3  # m by which the fingers open to release a part
_NEAR_GRIP = 0.02  # m: a part farther from the space between the fingers is not what they hold
_ABOVE = 0.05  # m: a part that is released higher above the platter or a belt falls elsewhere
_RESTS = 1e-6  # m that a belt at rest travels between two states

TABLE = "table"

_SINGULAR = 0.01  # smallest singular value of the Jacobian from which on the controller moves the tool straight


def movable_parts(cell: CellDescription) -> list[int]:
    """Numbers, from 1, of the free parts that a belt or a gripper can move."""
    is_moved = cell.gripper is not None
    numbers = [
        number
        for number, further in enumerate(cell.further_part, start=2)
        if further.fixture == "free" and (is_moved or further.conveyor)
    ]
    return [1, *numbers] if cell.part.fixture == "free" and (is_moved or cell.part.arrival) else numbers


@dataclass(frozen=True)
class _Place:
    """The frame that carries a part, and the pose (4, 4) of the part in it."""

    carrier: str
    pose: Array


class PartTracker:
    """Follows the parts of a cell that can be moved.

    Parameters
    ----------
    cell
        Its description.
    nominal
        The nominal cell with its parts.

    Examples
    --------
    >>> setup = scancell.load_setup(scancell.assets_dir() / "cells/pick_and_place.toml")
    >>> nominal = scancell.nominal_cell(setup.cell, scancell.load_part("part.stl"))
    >>> tracker = scancell.PartTracker(setup.cell, nominal)
    >>> axes = np.append(nominal.home, 0.0)
    >>> (part,) = tracker.update(axes, travel=[0.0], width=0.07, gripped=False)  # on its belt, in the world
    >>> part.number, part.carrier
    (1, 0)
    """

    @checked_arguments
    def __init__(self, cell: CellDescription, nominal: NominalCell) -> None:
        self._nominal, self._flange = nominal, nominal.arm.flange
        self._belts = {
            f"conveyor[{number}]": (si_value(belt, "length_mm") / 2, si_value(belt, "width_mm") / 2)
            for number, belt in enumerate(cell.conveyor, 1)
        }
        self._meshes: dict[int, Mesh] = {1: nominal.part}
        self._meshes |= {number: part.mesh for number, part in enumerate(nominal.further_parts, start=2)}
        self._places = {number: self._start(cell, number) for number in movable_parts(cell)}
        self._travel = np.zeros(len(self._belts))
        self._held: int | None = None
        self._width = np.inf  # at which the part is held
        self._grip = np.zeros((0, 3))
        if cell.gripper is not None:
            length = si_value(cell.gripper, "finger_length_mm")
            between = np.linspace(0.0, length, 10)[:, None] * [0.0, 0.0, 1.0]
            self._grip = pose.transform_points(pose_matrix(cell.gripper.pose), between)

    def update(self, axes: ArrayLike, travel: ArrayLike, width: float, gripped: bool) -> tuple[PlacedPart, ...]:
        """Poses of the parts, but for those on a belt that moves.

        Parameters
        ----------
        axes
            Measured joints and table angle, (axes,), rad.
        travel
            Measured travels of the belts, (belts,), m.
        width
            Measured distance between the pads, m.
        gripped
            Whether the gripper reports that it holds something.
        """
        axes, travel = np.asarray(axes, float), np.asarray(travel, float)
        moves, self._travel = np.abs(travel - self._travel) > _RESTS, travel
        moving = {frame for frame, moved in zip(self._belts, moves, strict=True) if moved}
        frames = self._nominal.tree.place([*axes, *travel])
        if self._held is not None and width > self._width + _OPENED:
            self._release(self._held, frames)
            self._held = None
        elif self._held is None and gripped:
            self._take(frames, width)
        numbers = {self._flange: len(axes) - 1, TABLE: len(axes)}
        return tuple(
            PlacedPart(number, 0, _numbers(frames[place.carrier] @ place.pose))
            if place.carrier not in numbers
            else PlacedPart(number, numbers[place.carrier], _numbers(place.pose))
            for number, place in self._places.items()
            if place.carrier not in moving
        )

    def _start(self, cell: CellDescription, number: int) -> _Place:
        if number > 1:
            further = self._nominal.further_parts[number - 2]
            return _Place(further.carrier, further.carrier_from_part)
        arrival = cell.part.arrival
        if arrival is None:
            return _Place(TABLE, self._nominal.table_from_part)
        return _Place(arrival.stands_on, pose_matrix(arrival.pose))

    def _take(self, frames: Mapping[str, Array], width: float) -> None:
        """The part nearest to the space between the fingers moves with the flange from now on."""
        flange = frames[self._flange]
        grip = pose.transform_points(flange, self._grip)
        nearest, number = _NEAR_GRIP, None
        for candidate, place in self._places.items():
            in_part = pose.transform_points(pose.inverse(frames[place.carrier] @ place.pose), grip)
            low, high = self._meshes[candidate].bounds
            outside = np.maximum(np.maximum(low - in_part, in_part - high), 0.0)
            apart = float(np.linalg.norm(outside, axis=1).min())
            if apart < nearest:
                nearest, number = apart, candidate
        if number is not None:
            place = self._places[number]
            self._places[number] = _Place(self._flange, pose.inverse(flange) @ frames[place.carrier] @ place.pose)
            self._held, self._width = number, width

    def _release(self, number: int, frames: Mapping[str, Array]) -> None:
        """The part stays on the platter or belt below it, or in the world."""
        place = self._places[number]
        at = frames[place.carrier] @ place.pose
        mesh = self._meshes[number].transformed(at)
        centre, lowest = mesh.bounds.mean(0), mesh.bounds[0][2]
        carrier = WORLD
        for frame in (*self._belts, TABLE):
            top = self._nominal.world_from(frame)
            across = np.abs(pose.transform_points(pose.inverse(top), centre[None])[0, :2])
            half = self._belts.get(frame)
            inside = np.hypot(*across) < self._nominal.table_radius if half is None else (across < half).all()
            if inside and abs(lowest - top[2, 3]) < _ABOVE:
                carrier = frame
        self._places[number] = _Place(carrier, pose.inverse(frames[carrier]) @ at)


def _numbers(at: Array) -> tuple[float, ...]:
    """Position and quaternion of a pose (4, 4)."""
    return tuple(float(value) for value in (*at[:3, 3], *pose.quaternion_from_rotation(at[:3, :3])))


class Tool:
    """Kinematics of the sensor of a cell.

    Attributes
    ----------
    active
        Numbers from 0 of the joints that Cartesian motion moves.
    held
        Those that it does not.
    """

    def __init__(self, nominal: NominalCell) -> None:
        self._motion, self._flange_from_tool = arm_motion(nominal), nominal.flange_from_sensor
        held = {joint.index for joint in nominal.arm.held}
        self.held = np.array(sorted(held), np.int64)
        self.active = np.array([i for i in range(len(nominal.arm.joints)) if i not in held], np.int64)

    def poses(self, joints: Array) -> tuple[Array, Array]:
        """``world_from_tool`` (n, 4, 4) at joints (n, joints), and the geometric Jacobian (n, 6, joints) of its origin.

        The Jacobian is in world axes: linear velocity, then angular velocity.
        """
        return self._motion.tool_poses(joints, joints.shape[1] - 1, self._flange_from_tool)

    def moves_straight(self, jacobian: Array) -> bool:
        """Whether Cartesian motion is possible with a Jacobian (6, joints): six active joints, no singular position."""
        if len(self.active) != 6:
            return False
        return bool(np.linalg.svd(jacobian[:, self.active], compute_uv=False)[-1] >= _SINGULAR)

    def rates(self, jacobian: Array, twist: Array) -> Array:
        """Rates (n, joints), rad/s, of twists (n, 6) of the tool, world axes; held joints stand still."""
        rates = np.zeros((len(twist), jacobian.shape[-1]))
        rates[:, self.active] = np.linalg.solve(jacobian[..., self.active], twist[..., None])[..., 0]
        return rates

    def length(self, joints: Array) -> float:
        """Length (m) of the path of the tool's origin through joints (n, joints)."""
        position = self.poses(joints)[0][:, :3, 3]
        return float(np.linalg.norm(np.diff(position, axis=0), axis=1).sum())
