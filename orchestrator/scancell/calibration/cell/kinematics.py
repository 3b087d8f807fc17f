"""Kinematics from the sensor to the platter with deviations from nominal, and their derivatives as screws.

A deviation is named like the ``as_built`` parameter of the FMU, without the prefix: ``tool.x``, ``dh[3].theta``,
``table.rx``, ``platter.y``, ``trigger.latency``; SI units. The wobble of the table axis is a rotation vector in the
table's nominal x-y plane, ``rx = rx_cos cos t + rx_sin sin t`` at table angle t, and `ry` likewise: to first order the
general tilt of an axis that repeats with every revolution.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace

import numpy as np
from numpy.typing import NDArray

from scancell.cell.recording import later
from scancell.geometry import pose
from scancell.geometry.chain import Chain

Array = NDArray[np.float64]

TOOL = tuple(f"tool.{name}" for name in ("x", "y", "z", "rx", "ry", "rz"))
TABLE = tuple(f"table.{name}" for name in ("x", "y", "rx", "ry"))
PLATTER = ("platter.x", "platter.y")
UNIT = 1e-3  # of unknowns in normal equations and of directions: mm, mrad, ms

_TILTS = ("rx", "ry")
WOBBLE = tuple(f"table.wobble_{axis}_{part}" for axis in _TILTS for part in ("cos", "sin"))
LATENCY = "trigger.latency"


def joint_names(count: int, *quantities: str) -> tuple[str, ...]:
    """Names of Denavit-Hartenberg deviations of all joints, such as ``dh[1].theta``."""
    return tuple(f"dh[{i}].{quantity}" for i in range(1, count + 1) for quantity in quantities)


@dataclass(frozen=True)
class AxisReadings:
    """Measured joints (n, joints) and table angles (n,), rad, of n exposures, their rates and accelerations.

    With `flange`, measured poses (n, 4, 4) of the flange in the robot's base, there are no joints: (n, 0).
    """

    q: Array
    table: Array
    qd: Array
    table_rate: Array
    qdd: Array
    table_acceleration: Array
    flange: Array | None = None

    def __len__(self) -> int:
        return len(self.table)

    def rows(self, chosen: NDArray[np.intp]) -> AxisReadings:
        """Those of some exposures, by row."""
        flange = None if self.flange is None else self.flange[chosen]
        names = [one.name for one in fields(self) if one.name != "flange"]
        return AxisReadings(**{name: getattr(self, name)[chosen] for name in names}, flange=flange)

    def after(self, latency: float) -> AxisReadings:
        """With joints and table `latency` (s) later, by their rates and accelerations; poses of the flange stay."""
        return replace(
            self,
            q=later(self.q, self.qd, self.qdd, latency),
            table=later(self.table, self.table_rate, self.table_acceleration, latency),
        )

    def moved(self, time: float) -> AxisReadings:
        """With joints and table `time` (s) later, by their rates alone; poses of the flange stay."""
        return replace(self, q=self.q + self.qd * time, table=self.table + self.table_rate * time)

    @classmethod
    def at_rest(cls, q: Array, table: Array) -> AxisReadings:
        """Readings of axes that do not move."""
        still, still_table = np.zeros_like(q), np.zeros_like(table)
        return cls(q, table, still, still_table, still, still_table)

    @classmethod
    def of_flange(cls, flange: Array, table: Array) -> AxisReadings:
        """Measured poses (n, 4, 4) of the flange at rest."""
        return replace(cls.at_rest(np.zeros((len(flange), 0)), table), flange=flange)


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


@dataclass
class _Walk:
    """A frame that is moved on by elementary transforms; keeps the screw of each in the world."""

    world_from_frame: Array
    screws: dict[str, Array] = field(default_factory=dict)

    def move(self, frame_from_next: Array) -> None:
        self.world_from_frame = self.world_from_frame @ frame_from_next

    def translate(self, axis: int, amount: float, name: str) -> None:
        direction = self.world_from_frame[:, :3, axis]
        self.screws[name] = np.hstack([direction, np.zeros_like(direction)])
        step = np.eye(4)
        step[axis, 3] = amount
        self.move(step)

    def rotate(self, axis: int, angle: Array | float, name: str = "") -> None:
        if name:
            direction, origin = self.world_from_frame[:, :3, axis], self.world_from_frame[:, :3, 3]
            self.screws[name] = np.hstack([np.cross(origin, direction), direction])
        self.move(pose.from_rotation(pose.rotation_about(axis, angle)))


@dataclass(frozen=True)
class CellKinematics:
    """Nominal geometry of arm, tool and table; poses (4, 4), m."""

    arm: Chain
    flange_from_sensor: Array
    world_from_table: Array

    @property
    def names(self) -> tuple[str, ...]:
        """All deviations."""
        joints = joint_names(len(self.arm.joints), "theta", "d", "a", "alpha", "beta")
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
        qd = readings.qd + latency * readings.qdd
        table_rate = readings.table_rate + latency * readings.table_acceleration
        if readings.flange is None:
            arm = self._flange(readings.q + latency * (readings.qd + qd) / 2, value)
        else:
            arm = _Walk(self.arm.world_from_base @ readings.flange)
        self._sensor(arm, value)
        angle = readings.table + latency * (readings.table_rate + table_rate) / 2
        table = self._platter(angle, value)
        world_from_platter = table.world_from_frame
        flange = _flange_screws(arm.screws.pop("flange"))
        # A platter that moves one way moves what is fixed to the world the other way.
        screws = {**arm.screws, **{name: -screw for name, screw in table.screws.items()}}
        named = dict(zip(screws, _in_frame(world_from_platter, np.stack(list(screws.values()))), strict=True))
        thetas = joint_names(readings.q.shape[1], "theta")
        joints = np.stack([named[name] for name in thetas], -1) if thetas else np.zeros((len(readings), 6, 0))
        tilts, turn = {name: named.pop(name) for name in _TILTS}, named.pop("table")
        for name, tilt in tilts.items():
            cosine, sine = np.cos(angle)[:, None], np.sin(angle)[:, None]
            along, across = value[f"table.wobble_{name}_cos"], value[f"table.wobble_{name}_sin"]
            named[f"table.wobble_{name}_cos"], named[f"table.wobble_{name}_sin"] = tilt * cosine, tilt * sine
            turn = turn + tilt * (across * cosine - along * sine)
        named[LATENCY] = np.einsum("nij,nj->ni", joints, qd) + turn * table_rate[:, None]
        return SensorPoses(
            platter_from_sensor=pose.inverse(world_from_platter) @ arm.world_from_frame,
            deviations=named,
            joints=joints,
            table=turn,
            flange=np.moveaxis(_in_frame(world_from_platter, flange), 0, -1),
        )

    def _flange(self, q: Array, value: Mapping[str, float]) -> _Walk:
        walk = _Walk(np.broadcast_to(self.arm.world_from_base, (len(q), 4, 4)))
        for i, joint in enumerate(self.arm.joints):
            row = f"dh[{i + 1}]."
            walk.rotate(2, q[:, i] + joint.theta + value[row + "theta"], row + "theta")
            walk.translate(0, joint.a + value[row + "a"], row + "a")
            walk.translate(2, joint.d + value[row + "d"], row + "d")
            walk.rotate(0, joint.alpha + value[row + "alpha"], row + "alpha")
            walk.rotate(1, joint.beta + value[row + "beta"], row + "beta")
        return walk

    def _sensor(self, walk: _Walk, value: Mapping[str, float]) -> None:
        """Go on from the flange to the sensor."""
        walk.screws["flange"] = walk.world_from_frame
        walk.move(self.flange_from_sensor)
        for axis, name in enumerate(TOOL[:3]):
            walk.translate(axis, value[name], name)
        for axis, name in enumerate(TOOL[3:]):
            walk.rotate(axis, value[name], name)

    def _platter(self, angle: Array, value: Mapping[str, float]) -> _Walk:
        walk = _Walk(np.broadcast_to(self.world_from_table, (len(angle), 4, 4)))
        for axis, name in enumerate(TABLE[:2]):
            walk.translate(axis, value[name], name)
        for axis, name in enumerate(TABLE[2:]):
            walk.rotate(axis, value[name], name)
        for axis, name in enumerate(_TILTS):
            tilt = value[f"table.wobble_{name}_cos"] * np.cos(angle) + value[f"table.wobble_{name}_sin"] * np.sin(angle)
            walk.rotate(axis, tilt, name)
        walk.rotate(2, angle, "table")
        for axis, name in enumerate(PLATTER):
            walk.translate(axis, value[name], name)
        return walk


def _flange_screws(world_from_flange: Array) -> Array:
    """Screws (6, n, 6) of translations along the axes of the flange, and rotations about them."""
    axes, origin = np.moveaxis(world_from_flange[:, :3, :3], -1, 0), world_from_flange[:, :3, 3]
    translations = np.concatenate([axes, np.zeros_like(axes)], -1)
    return np.concatenate([translations, np.concatenate([np.cross(origin, axes), axes], -1)])


def _in_frame(world_from_frame: Array, screws: Array) -> Array:
    """Screws (..., n, 6) of the world in a frame (n, 4, 4)."""
    velocity, rate = screws[..., :3], screws[..., 3:]
    rotation = world_from_frame[:, :3, :3]
    velocity = velocity + np.cross(rate, world_from_frame[:, :3, 3])
    turned = [np.einsum("nji,...nj->...ni", rotation, one) for one in (velocity, rate)]
    return np.concatenate(turned, -1)


def written_unit(name: str) -> tuple[str, float]:
    """Unit of a deviation in descriptions, and its factor to SI: ``mm``, ``deg`` or ``ms``."""
    if name == LATENCY:
        return "ms", 1e-3
    return ("mm", 1e-3) if name.rsplit(".", 1)[1] in {"x", "y", "z", "a", "d"} else ("deg", np.pi / 180)
