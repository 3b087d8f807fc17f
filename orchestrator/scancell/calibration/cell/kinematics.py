"""Kinematics from the sensor to the platter with deviations from nominal, and their derivatives as screws.

Where the arm holds the artefact before a sensor on a post, the flange takes the place of the platter, and the belt
where one carries it past the sensor.

A deviation is named like the ``as_built`` parameter of the FMU, without the prefix: ``tool.x``, ``dh[3].theta``,
``grasp.z``, ``table.rx``, ``platter.y``, ``axis.track.rz``, ``trigger.latency``; SI units. Those of a belt,
``conveyor[1].rz``, turn its direction; ``conveyor[1].encoder_scale`` is a relative error of its readings. The wobble of
the table axis is a rotation vector in the table's nominal x-y plane, ``rx = rx_cos cos t + rx_sin sin t`` at table
angle t, and `ry` likewise: to first order the general tilt of an axis that repeats with every revolution.
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
from scancell.geometry import pose
from scancell.geometry.arm import Chain
from scancell.geometry.tree import WORLD, Joint, Tree, z_along

_POSE = ("x", "y", "z", "rx", "ry", "rz")
TOOL = tuple(f"tool.{name}" for name in _POSE)
GRASP = tuple(f"grasp.{name}" for name in _POSE)
TABLE = tuple(f"table.{name}" for name in ("x", "y", "rx", "ry"))
PLATTER = ("platter.x", "platter.y")
_SCALE = "encoder_scale"  # of a belt: the encoder reads the travel times 1 + scale
UNIT = 1e-3  # of unknowns in normal equations and of directions: mm, mrad, ms

# Coordinate axes along which and about which a frame is moved.
_XYZ = _X, _Y, _Z, _RX, _RY, _RZ = range(6)
_DH = {"theta": _RZ, "a": _X, "d": _Z, "alpha": _RX, "beta": _RY}
_FLANGE = {f"flange.{name}": direction for direction, name in enumerate(_POSE)}
_TILTS = ("rx", "ry")
WOBBLE = tuple(f"table.wobble_{axis}_{part}" for axis in _TILTS for part in ("cos", "sin"))
LATENCY = "trigger.latency"


def axis_deviations(name: str) -> tuple[str, ...]:
    """Names of the deviations of a further axis, such as ``axis.track.x``, or of a belt: ``conveyor[1].rz``."""
    if name.startswith("conveyor["):
        return tuple(f"{name}.{key}" for key in ("ry", "rz", _SCALE))
    return tuple(f"axis.{name}.{key}" for key in _POSE)


def column_unit(joint: Joint) -> tuple[str, float]:
    """Unit of the positions of a further axis in tables, and its factor to SI."""
    return ("mm", 1e-3) if joint.kind == "prismatic" else ("deg", np.pi / 180)


def axis_column(joint: Joint, suffix: str = "", end: str = "") -> str:
    """Name of the column of a further axis in tables; of its rates with ``_rate`` and ``_s``."""
    return f"{joint.axis}{suffix}_{column_unit(joint)[0]}{end}"


def joint_names(count: int, *quantities: str) -> tuple[str, ...]:
    """Names of Denavit-Hartenberg deviations of all joints, such as ``dh[1].theta``."""
    return tuple(f"dh[{i}].{quantity}" for i in range(1, count + 1) for quantity in quantities)


@dataclass(frozen=True)
class AxisReadings:
    """Measured positions of joints, table and `further` axes (n, axes), rad and m, at n exposures.

    Also their rates and accelerations. With `flange`, measured poses (n, 4, 4) of the flange in the robot's base, the
    joints are left out.
    """

    axes: Array
    rates: Array
    accelerations: Array
    flange: Array | None = None
    further: tuple[Joint, ...] = ()

    def __len__(self) -> int:
        return len(self.axes)

    @property
    def q(self) -> Array:
        """Joints (n, joints), rad."""
        return self.axes[:, : self.joints]

    @property
    def joints(self) -> int:
        """Number of joints that are stated."""
        return int(self.axes.shape[1]) - 1 - len(self.further)

    @property
    def table(self) -> Array:
        """Angles (n,) of the table, rad."""
        return self.axes[:, self.joints]

    def rows(self, chosen: NDArray[np.intp]) -> AxisReadings:
        """Readings of some exposures, by row."""
        flange = None if self.flange is None else self.flange[chosen]
        return AxisReadings(self.axes[chosen], self.rates[chosen], self.accelerations[chosen], flange, self.further)

    def after(self, latency: float) -> AxisReadings:
        """With all axes `latency` (s) later, by their rates and accelerations; poses of the flange stay."""
        return replace(self, axes=later(self.axes, self.rates, self.accelerations, latency))

    def moved(self, time: float) -> AxisReadings:
        """With all axes `time` (s) later, by their rates alone; poses of the flange stay."""
        return replace(self, axes=self.axes + self.rates * time)

    @classmethod
    def at_rest(cls, axes: Array, further: Sequence[Joint] = ()) -> AxisReadings:
        """Readings of joints, table and `further` axes (n, axes) that do not move."""
        return cls(axes, np.zeros_like(axes), np.zeros_like(axes), further=tuple(further))

    @classmethod
    def of_flange(cls, flange: Array, axes: Array, further: Sequence[Joint] = ()) -> AxisReadings:
        """Measured poses (n, 4, 4) of the flange at rest, at positions (n,) of the table, or (n, k) with further axes.

        These follow the table.
        """
        return replace(cls.at_rest(axes.reshape(len(flange), -1), further), flange=flange)

    def columns(self) -> dict[str, Array]:
        """Columns (n,) of tables: positions, rates and accelerations of all axes in deg or mm, per s and s²."""
        found: dict[str, Array] = {}
        for (joint, suffix), end, values in zip(
            (("q", ""), ("qd", "_rate"), ("qdd", "_acceleration")),
            ("", "_s", "_s2"),
            (self.axes, self.rates, self.accelerations),
            strict=True,
        ):
            names = [f"{joint}{i}_deg{end}" for i in range(1, self.joints + 1)] + [f"table{suffix}_deg{end}"]
            found |= dict(zip(names, np.degrees(values).T, strict=False))
            for axis, column in zip(self.further, values[:, len(names) :].T, strict=True):
                found[axis_column(axis, suffix, end)] = column / column_unit(axis)[1]
        return found


@dataclass(frozen=True)
class SensorPoses:
    """``platter_from_sensor`` (n, 4, 4), and how deviations move a point that is fixed to the sensor.

    A screw (n, 6) is a velocity (m per unit) of the point at the platter's origin and an angular velocity (rad per
    unit), both in the platter frame: a point p moves by ``v + w × p``. `deviations` holds those of named deviations,
    `joints` (n, 6, joints) those of the joint angles, `table` (n, 6) that of the table angle, or of the travel of the
    belt that carries the artefact, `flange` (n, 6, 6) those of translations along and rotations about its axes.
    """

    platter_from_sensor: Array
    deviations: Mapping[str, Array]
    joints: Array
    table: Array
    flange: Array


@dataclass(frozen=True)
class CellKinematics:
    """Nominal geometry of arm, tool, table, and of further axes which carry them; poses (4, 4), m.

    The sensor is on the flange, or on `sensor_on`: in the world or on a further axis. There it sees an artefact that
    the arm holds, at `flange_from_part`, or that the table turns. With `belt`, the name of one of the `further` axes,
    this belt carries the artefact past the sensor.
    """

    arm: Chain
    carrier_from_sensor: Array
    world_from_table: Array
    flange_from_part: Array | None = None
    further: tuple[Joint, ...] = ()
    arm_on: str = WORLD
    table_on: str = WORLD
    sensor_on: str | None = None
    belt: str | None = None

    @property
    def has_table(self) -> bool:
        """Whether the table carries the artefact."""
        return self.flange_from_part is None and self.belt is None

    @property
    def names(self) -> tuple[str, ...]:
        """All deviations."""
        joints = joint_names(len(self.arm.joints), *_DH)
        of_axes = [name for joint in self.further for name in axis_deviations(joint.axis)]
        of_part = (*TABLE, *PLATTER, *WOBBLE) if self.has_table else GRASP if self.belt is None else ()
        return (*TOOL, *of_part, *joints, *of_axes, LATENCY)

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
        angle = axes[:, readings.joints]
        cosine, sine = np.cos(angle), np.sin(angle)
        position: dict[str, Array | float] = {**value, "table": angle}
        tilts = _TILTS if self.has_table else ()
        for name in tilts:
            along, across = value[f"table.wobble_{name}_cos"], value[f"table.wobble_{name}_sin"]
            position[f"wobble.{name}"] = along * cosine + across * sine
        thetas = joint_names(readings.q.shape[1], "theta")
        position |= {name: axes[:, i] + value[name] for i, name in enumerate(thetas)}
        further = {f"axis.{joint.axis}": i for i, joint in enumerate(readings.further, len(thetas) + 1)}
        gains = {f"axis.{joint.axis}": 1.0 / (1.0 + value.get(f"{joint.axis}.{_SCALE}", 0.0)) for joint in self.further}
        position |= {name: gains[name] * axes[:, i] for name, i in further.items()}

        tree = self._tree if readings.flange is None else self._tree_behind(readings.flange)
        positions = np.stack([np.broadcast_to(position.get(axis, 0.0), len(readings)) for axis in tree.axes], -1)
        platter_from_sensor, screws = tree.relative("sensor", "platter", positions)
        # From the velocity of the sensor's origin to that of the point at the platter's.
        screws[:, :3] += np.cross(platter_from_sensor[:, :3, 3:], screws[:, 3:], axis=1)
        named = dict(zip(tree.axes, np.moveaxis(screws, -1, 0), strict=True))
        moved = {name: gain * named.pop(name) for name, gain in gains.items()}
        turn = named.pop("table", np.zeros((len(readings), 6)))
        for name in tilts:
            tilt = named.pop(f"wobble.{name}")
            along, across = value[f"table.wobble_{name}_cos"], value[f"table.wobble_{name}_sin"]
            for part, share in (("cos", cosine), ("sin", sine)):
                named[f"table.wobble_{name}_{part}"] = tilt * share[:, None]
            turn = turn + tilt * (across * cosine - along * sine)[:, None]
        joints = np.stack([named[name] for name in thetas], -1) if thetas else np.zeros((len(readings), 6, 0))
        count = readings.joints
        latency_screw = np.einsum("nij,nj->ni", joints, rates[:, :count]) + turn * rates[:, count : count + 1]
        for name, i in further.items():
            latency_screw = latency_screw + moved[name] * rates[:, i : i + 1]
        named[LATENCY] = latency_screw
        if self.belt is not None:
            name = f"axis.{self.belt}"
            turn = moved[name]
            named[f"{self.belt}.{_SCALE}"] = -gains[name] * turn * axes[:, further[name], None]
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
        return self._tree_behind(np.eye(4), *_elementary("base", steps, nominal))

    def _tree_behind(self, base_from_arm: Array, *arm: Joint) -> Tree:
        """The tree of joints of an arm at `base_from_arm` (..., 4, 4), the tool behind it, table and further axes."""
        carriers: list[Joint] = []
        for joint in self.further:
            # A deviation is that of the frame which the axis carries, at position 0.
            at_0 = Joint(f"{joint.axis} at 0", _carrier(joint.parent))
            at_0 = replace(at_0, parent_from_joint=joint.parent_from_joint @ joint.joint_from_frame)
            of_axis = {name: name.rsplit(".", 1)[1] for name in axis_deviations(joint.axis)}
            steps = [(name, _POSE.index(key)) for name, key in of_axis.items() if key in _POSE]
            deviating = _elementary(at_0.frame, steps)
            moved = Joint(
                *(_carrier(joint.frame), deviating[-1].frame, joint.kind, f"axis.{joint.axis}", joint.zero),
                parent_from_joint=pose.inverse(joint.joint_from_frame),
                joint_from_frame=joint.joint_from_frame,
            )
            carriers += [at_0, *deviating, moved]
        part = self.flange_from_part
        base = Joint("base", _carrier(self.arm_on), parent_from_joint=self.arm.world_from_base @ base_from_arm)
        flange = _elementary([base, *arm][-1].frame, list(_FLANGE.items()))
        carrier = flange[-1].frame if self.sensor_on is None else _carrier(self.sensor_on)
        sensor = Joint("nominal sensor", carrier, parent_from_joint=self.carrier_from_sensor)
        tool = _elementary(sensor.frame, list(zip(TOOL, _XYZ, strict=True)))
        if part is not None:
            held = Joint("nominal part", flange[-1].frame, parent_from_joint=part)
            grasp = _elementary(held.frame, list(zip(GRASP, _XYZ, strict=True)))
            ends = [
                Joint("sensor", tool[-1].frame),
                Joint("platter", grasp[-1].frame, parent_from_joint=pose.inverse(part)),
            ]
            return Tree([*carriers, base, *arm, *flange, sensor, *tool, held, *grasp, *ends])
        if self.belt is not None:
            ends = [Joint("sensor", tool[-1].frame), Joint("platter", _carrier(self.belt))]
            return Tree([*carriers, base, *arm, *flange, sensor, *tool, *ends])
        table = Joint("nominal table", _carrier(self.table_on), parent_from_joint=self.world_from_table)
        of_table = [
            *zip(TABLE, (_X, _Y, _RX, _RY), strict=True),
            ("wobble.rx", _RX),
            ("wobble.ry", _RY),
            ("table", _RZ),
        ]
        platter = _elementary(table.frame, [*of_table, *zip(PLATTER, (_X, _Y), strict=True)])
        ends = [Joint("sensor", tool[-1].frame), Joint("platter", platter[-1].frame)]
        return Tree([*carriers, base, *arm, *flange, sensor, *tool, table, *platter, *ends])


def _carrier(frame: str | None) -> str:
    """Name in the tree of the frame of a further axis, or of the world."""
    return WORLD if frame in (None, WORLD) else f"axis.{frame}"


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
    """Unit of a deviation in descriptions, and its factor to SI: ``mm``, ``deg``, ``ms``; ``ppm`` of scales."""
    if name == LATENCY:
        return "ms", 1e-3
    if name.endswith(_SCALE):
        return "ppm", 1e-6
    return ("mm", 1e-3) if name.rsplit(".", 1)[1] in {"x", "y", "z", "a", "d"} else ("deg", np.pi / 180)
