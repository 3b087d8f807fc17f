"""Poses of the parts that a gripper or a belt moves, from what is measured: joints, table, belts and the gripper.

A part is at its described pose until the gripper holds it, and rides on its belt by the measured travel.  From the
instant in which the gripper reports a grip the part moves with the flange, until the fingers open; then it stays where
it is, on the platter, on a belt or in the world.  How it slips in the grip or settles afterwards is not measured.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scancell.arguments import checked_arguments
from scancell.config.cell import CellDescription
from scancell.config.units import si_value
from scancell.geometry import pose
from scancell.geometry.mesh import Mesh
from scancell.guard.messages import PlacedPart
from scancell.nominal.cell import NominalCell
from scancell.nominal.poses import pose_matrix

Array = NDArray[np.float64]

_OPENED = 0.5e-3  # m by which the fingers open to release a part
_NEAR_GRIP = 0.02  # m: a part farther from the space between the fingers is not what they hold
_ABOVE = 0.05  # m: a part that is released higher above the platter or a belt falls elsewhere
_RESTS = 1e-6  # m that a belt at rest travels between two states

WORLD, TABLE, FLANGE = "world", "table", "flange"


def movable_parts(cell: CellDescription) -> list[int]:
    """Numbers, from 1, of the free parts that a belt or a gripper can move."""
    is_moved = cell.gripper is not None
    numbers = [
        number
        for number, further in enumerate(cell.further_part, start=2)
        if further.fixture == "free" and (is_moved or further.conveyor)
    ]
    return [1, *numbers] if cell.part.fixture == "free" and (is_moved or cell.part.arrival) else numbers


@dataclass
class _Place:
    """Where a part is: its pose in the frame of a carrier, or on a belt (its index) since a travel, m."""

    carrier: str
    pose: Array
    belt: int | None = None
    travel: float = 0.0


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
        self._nominal = nominal
        self._belts = [pose_matrix(belt.pose) for belt in cell.conveyor]
        self._belt_sizes = [(si_value(belt, "length_mm") / 2, si_value(belt, "width_mm") / 2) for belt in cell.conveyor]
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
            Measured joints and table angle, (joints + 1,), rad.
        travel
            Measured travels of the belts, (belts,), m.
        width
            Measured distance between the pads, m.
        gripped
            Whether the gripper reports that it holds something.
        """
        axes, travel = np.asarray(axes, float), np.asarray(travel, float)
        moving, self._travel = np.abs(travel - self._travel) > _RESTS, travel
        if self._held is not None and width > self._width + _OPENED:
            self._release(self._held, axes)
            self._held = None
        elif self._held is None and gripped:
            self._take(axes, width)
        joints = len(axes) - 1
        numbers = {WORLD: 0, FLANGE: joints, TABLE: joints + 1}
        return tuple(
            PlacedPart(number, numbers[place.carrier], _numbers(self._on_carrier(place)))
            for number, place in self._places.items()
            if place.belt is None or not moving[place.belt]
        )

    def _start(self, cell: CellDescription, number: int) -> _Place:
        if number > 1:
            further = self._nominal.further_parts[number - 2]
            conveyor = further.description.conveyor
            return _Place(further.carrier, further.carrier_from_part, None if conveyor is None else conveyor - 1)
        arrival = cell.part.arrival
        if arrival is None:
            return _Place(TABLE, self._nominal.table_from_part)
        at = pose_matrix(arrival.pose)
        if arrival.conveyor is None:
            return _Place(WORLD, at)
        return _Place(WORLD, self._belts[arrival.conveyor - 1] @ at, arrival.conveyor - 1)

    def _on_carrier(self, place: _Place) -> Array:
        if place.belt is None:
            return place.pose
        along = self._belts[place.belt][:3, 0] * (self._travel[place.belt] - place.travel)
        return np.asarray(pose.translation(along) @ place.pose)

    def _in_world(self, place: _Place, axes: Array) -> Array:
        at = self._on_carrier(place)
        if place.carrier == FLANGE:
            return np.asarray(self._nominal.arm.fk(axes[:-1]) @ at)
        return np.asarray(self._nominal.world_from_platter(axes[-1]) @ at) if place.carrier == TABLE else at

    def _take(self, axes: Array, width: float) -> None:
        """The part nearest to the space between the fingers moves with the flange from now on."""
        flange = self._nominal.arm.fk(axes[:-1])
        grip = pose.transform_points(flange, self._grip)
        nearest, number = _NEAR_GRIP, None
        for candidate, place in self._places.items():
            in_part = pose.transform_points(pose.inverse(self._in_world(place, axes)), grip)
            low, high = self._meshes[candidate].bounds
            outside = np.maximum(np.maximum(low - in_part, in_part - high), 0.0)
            apart = float(np.linalg.norm(outside, axis=1).min())
            if apart < nearest:
                nearest, number = apart, candidate
        if number is not None:
            held = pose.inverse(flange) @ self._in_world(self._places[number], axes)
            self._places[number] = _Place(FLANGE, np.asarray(held))
            self._held, self._width = number, width

    def _release(self, number: int, axes: Array) -> None:
        """The part stays where it is."""
        at = self._in_world(self._places[number], axes)
        mesh = self._meshes[number].transformed(at)
        centre, lowest = mesh.bounds.mean(0), mesh.bounds[0][2]
        platter = self._nominal.world_from_platter(axes[-1])
        on_platter = pose.transform_points(pose.inverse(platter), centre[None])[0]
        if np.hypot(*on_platter[:2]) < self._nominal.table_radius and abs(lowest - platter[2, 3]) < _ABOVE:
            self._places[number] = _Place(TABLE, np.asarray(pose.inverse(platter) @ at))
            return
        belt = None
        for k, (world_from_belt, half) in enumerate(zip(self._belts, self._belt_sizes, strict=True)):
            on_belt = pose.transform_points(pose.inverse(world_from_belt), centre[None])[0]
            if (np.abs(on_belt[:2]) < half).all() and abs(lowest - world_from_belt[2, 3]) < _ABOVE:
                belt = k
        self._places[number] = _Place(WORLD, at, belt, 0.0 if belt is None else float(self._travel[belt]))


def _numbers(at: Array) -> tuple[float, ...]:
    """Position and quaternion of a pose (4, 4)."""
    return tuple(float(value) for value in (*at[:3, 3], *pose.quaternion_from_rotation(at[:3, :3])))
