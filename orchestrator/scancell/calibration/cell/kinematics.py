"""Kinematics from the sensor to the platter with deviations from nominal, and their derivatives as screws.

Where the arm holds the artefact before a sensor on a post, the flange takes the place of the platter.

A deviation is named like the ``as_built`` parameter of the FMU, without the prefix: ``tool.x``, ``dh[3].theta``,
``grasp.z``, ``table.rx``, ``platter.y``, ``trigger.latency``; SI units. The wobble of the table axis is a rotation
vector in the table's nominal x-y plane, ``rx = rx_cos cos t + rx_sin sin t`` at table angle t, and `ry` likewise: to
first order the general tilt of an axis that repeats with every revolution.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from scancell.arrays import Array
from scancell.cell.recording import later
from scancell.geometry.arm import Chain
from scancell.geometry.pose import inverse
from scancell.geometry.tree import WORLD, Joint, Tree, z_along

TOOL = tuple(f"tool.{name}" for name in ("x", "y", "z", "rx", "ry", "rz"))
GRASP = tuple(f"grasp.{name}" for name in ("x", "y", "z", "rx", "ry", "rz"))
TABLE = tuple(f"table.{name}" for name in ("x", "y", "rx", "ry"))
PLATTER = ("platter.x", "platter.y")
UNIT = 1e-3  # of unknowns in normal equations and of directions: mm, mrad, ms

# Coordinate axes along which and about which a frame is moved.
_XYZ = _X, _Y, _Z, _RX, _RY, _RZ = range(6)
_DH = {"theta": _RZ, "a": _X, "d": _Z, "alpha": _RX, "beta": _RY}
_FLANGE = {f"flange.{name}": direction for direction, name in enumerate(("x", "y", "z", "rx", "ry", "rz"))}
_TILTS = ("rx", "ry")
WOBBLE = tuple(f"table.wobble_{axis}_{part}" for axis in _TILTS for part in ("cos", "sin"))
LATENCY = "trigger.latency"


def joint_names(count: int, *quantities: str) -> tuple[str, ...]:
    """Names of Denavit-Hartenberg deviations of all joints, such as ``dh[1].theta``."""
    return tuple(f"dh[{i}].{quantity}" for i in range(1, count + 1) for quantity in quantities)


@dataclass(frozen=True)
class AxisReadings:
    """Measured positions of joints and table (n, axes), rad, at n exposures, their rates and accelerations.

    With `flange`, measured poses (n, 4, 4) of the flange in the robot's base, the table is the only axis: (n, 1).
    """

    axes: Array
    rates: Array
    accelerations: Array
    flange: Array | None = None

    def __len__(self) -> int:
        return len(self.axes)

    @property
    def q(self) -> Array:
        """Joints (n, joints), rad."""
        return self.axes[:, :-1]

    @property
    def table(self) -> Array:
        """Angles (n,) of the table, rad."""
        return self.axes[:, -1]

    def rows(self, chosen: NDArray[np.intp]) -> AxisReadings:
        """Readings of some exposures, by row."""
        flange = None if self.flange is None else self.flange[chosen]
        return AxisReadings(self.axes[chosen], self.rates[chosen], self.accelerations[chosen], flange)

    def after(self, latency: float) -> AxisReadings:
        """With all axes `latency` (s) later, by their rates and accelerations; poses of the flange stay."""
        return replace(self, axes=later(self.axes, self.rates, self.accelerations, latency))

    def moved(self, time: float) -> AxisReadings:
        """With all axes `time` (s) later, by their rates alone; poses of the flange stay."""
        return replace(self, axes=self.axes + self.rates * time)

    @classmethod
    def at_rest(cls, axes: Array) -> AxisReadings:
        """Readings of joints and table (n, axes) that do not move."""
        return cls(axes, np.zeros_like(axes), np.zeros_like(axes))

    @classmethod
    def of_flange(cls, flange: Array, table: Array) -> AxisReadings:
        """Measured poses (n, 4, 4) of the flange at rest."""
        return replace(cls.at_rest(table[:, None]), flange=flange)

    def columns(self) -> dict[str, Array]:
        """Columns (n,) of tables: angles, rates and accelerations of all axes in deg, deg/s and deg/s²."""
        found: dict[str, Array] = {}
        for name, of_table, values, unit in (
            ("q", "table", self.axes, "deg"),
            ("qd", "table_rate", self.rates, "deg_s"),
            ("qdd", "table_acceleration", self.accelerations, "deg_s2"),
        ):
            *joints, table = np.degrees(values).T
            found |= {f"{name}{i}_{unit}": column for i, column in enumerate(joints, 1)} | {f"{of_table}_{unit}": table}
        return found


@dataclass(frozen=True)
class SensorPoses:
    """``platter_from_sensor`` (n, 4, 4), and how deviations move a point that is fixed to the sensor.

    A screw (n, 6) is a velocity (m per unit) of the point at the platter's origin and an angular velocity (rad per
    unit), both in the platter frame: a point p moves by ``v + w × p``. `deviations` holds those of named deviations,
    `joints` (n, 6, joints) those of the joint angles, `table` (n, 6) that of the table angle, `flange` (n, 6, 6) those
    of translations along and rotations about the flange's axes.
    """

    platter_from_sensor: Array
    deviations: Mapping[str, Array]
    joints: Array
    table: Array
    flange: Array


@dataclass(frozen=True)
class CellKinematics:
    """Nominal geometry of arm, tool and table; poses (4, 4), m.

    The sensor is on the flange, or, where `flange_from_part` states the pose of an artefact there, in the world.
    """

    arm: Chain
    carrier_from_sensor: Array
    world_from_table: Array
    flange_from_part: Array | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """All deviations."""
        joints = joint_names(len(self.arm.joints), *_DH)
        if self.flange_from_part is not None:
            return (*TOOL, *GRASP, *joints, LATENCY)
        return (*TOOL, *TABLE, *PLATTER, *WOBBLE, *joints, LATENCY)

    def poses(self, readings: AxisReadings, deviations: Mapping[str, float]) -> SensorPoses:
        """Poses of the sensor on the platter, when light falls on it.

        That is the latched instant, or later by the latency: joints and table are extrapolated by their rates and
        accelerations. Without these a straight path is missed by the square of the way over twice the arm's length.

        Parameters
        ----------
        deviations
            By name, SI; those not given are 0.
        """
        value = {name: float(deviations.get(name, 0.0)) for name in self.names}
        latency = value[LATENCY]
        rates = readings.rates + latency * readings.accelerations
        axes = readings.axes + latency * (readings.rates + rates) / 2
        angle = axes[:, -1]
        cosine, sine = np.cos(angle), np.sin(angle)
        position: dict[str, Array | float] = {**value, "table": angle}
        tilts = () if self.flange_from_part is not None else _TILTS
        for name in tilts:
            along, across = value[f"table.wobble_{name}_cos"], value[f"table.wobble_{name}_sin"]
            position[f"wobble.{name}"] = along * cosine + across * sine
        thetas = joint_names(readings.q.shape[1], "theta")
        position |= {name: axes[:, i] + value[name] for i, name in enumerate(thetas)}

        tree = self._tree if readings.flange is None else self._tree_behind(self._stated(readings.flange))
        positions = np.stack([np.broadcast_to(position.get(axis, 0.0), len(readings)) for axis in tree.axes], -1)
        platter_from_sensor, screws = tree.relative("sensor", "platter", positions)
        # From the velocity of the sensor's origin to that of the point at the platter's.
        screws[:, :3] += np.cross(platter_from_sensor[:, :3, 3:], screws[:, 3:], axis=1)
        named = dict(zip(tree.axes, np.moveaxis(screws, -1, 0), strict=True))
        turn = named.pop("table", np.zeros((len(readings), 6)))
        for name in tilts:
            tilt = named.pop(f"wobble.{name}")
            along, across = value[f"table.wobble_{name}_cos"], value[f"table.wobble_{name}_sin"]
            for part, share in (("cos", cosine), ("sin", sine)):
                named[f"table.wobble_{name}_{part}"] = tilt * share[:, None]
            turn = turn + tilt * (across * cosine - along * sine)[:, None]
        joints = np.stack([named[name] for name in thetas], -1) if thetas else np.zeros((len(readings), 6, 0))
        named[LATENCY] = np.einsum("nij,nj->ni", joints, rates[:, :-1]) + turn * rates[:, -1:]
        flange = np.stack([named.pop(name) for name in _FLANGE], -1)
        return SensorPoses(platter_from_sensor, named, joints, turn, flange)

    @cached_property
    def _tree(self) -> Tree:
        """The tree whose axes are the deviations, among which those of theta are the joints, and the table."""
        steps: list[tuple[str, int]] = []
        nominal: list[float] = []
        for number, joint in enumerate(self.arm.joints, 1):
            steps += [(f"dh[{number}].{name}", direction) for name, direction in _DH.items()]
            nominal += [getattr(joint, name) for name in _DH]
        return self._tree_behind(self.arm.world_from_base, *_elementary("base", steps, nominal))

    def _stated(self, base_from_flange: Array) -> Array:
        """Poses (n, 4, 4) of measured flanges: on an arm that holds the artefact, in the world of the sensor."""
        held = self.flange_from_part is not None
        return np.asarray(self.arm.world_from_base @ base_from_flange) if held else base_from_flange

    def _tree_behind(self, world_from_base: Array, *arm: Joint) -> Tree:
        """The tree of joints of an arm at `world_from_base` (..., 4, 4), of the tool behind it, and of the table."""
        base, part = Joint("base", parent_from_joint=world_from_base), self.flange_from_part
        flange = _elementary([base, *arm][-1].frame, list(_FLANGE.items()))
        carrier = flange[-1].frame if part is None else WORLD
        sensor = Joint("nominal sensor", carrier, parent_from_joint=self.carrier_from_sensor)
        tool = _elementary(sensor.frame, list(zip(TOOL, _XYZ, strict=True)))
        if part is not None:
            held = Joint("nominal part", flange[-1].frame, parent_from_joint=part)
            grasp = _elementary(held.frame, list(zip(GRASP, _XYZ, strict=True)))
            end = Joint("platter", grasp[-1].frame, parent_from_joint=inverse(part))
            return Tree([base, *arm, *flange, sensor, *tool, held, *grasp, Joint("sensor", tool[-1].frame), end])
        table = Joint("nominal table", parent_from_joint=self.world_from_table)
        of_table = [
            *zip(TABLE, (_X, _Y, _RX, _RY), strict=True),
            ("wobble.rx", _RX),
            ("wobble.ry", _RY),
            ("table", _RZ),
        ]
        platter = _elementary(table.frame, [*of_table, *zip(PLATTER, (_X, _Y), strict=True)])
        ends = [Joint("sensor", tool[-1].frame), Joint("platter", platter[-1].frame)]
        return Tree([base, *arm, *flange, sensor, *tool, table, *platter, *ends])


def _elementary(parent: str, steps: Sequence[tuple[str, int]], zeros: Sequence[float] = ()) -> list[Joint]:
    """Joints one behind another, each named like its axis, along and about the coordinate axes."""
    joints = []
    for (name, direction), zero in zip(steps, zeros or [0.0] * len(steps), strict=True):
        kind: Literal["prismatic", "revolute"] = "prismatic" if direction < 3 else "revolute"
        turned = z_along(direction % 3)
        joints.append(Joint(name, parent, kind, name, zero, turned, turned.T))
        parent = name
    return joints


def written_unit(name: str) -> tuple[str, float]:
    """Unit of a deviation in descriptions, and its factor to SI: ``mm``, ``deg`` or ``ms``."""
    if name == LATENCY:
        return "ms", 1e-3
    return ("mm", 1e-3) if name.rsplit(".", 1)[1] in {"x", "y", "z", "a", "d"} else ("deg", np.pi / 180)
