"""What planning needs beside the nominal cell: where the sensor sees, and which bodies must keep apart."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from orchestrator.cell.keep_apart import arm_chain, keep_apart
from orchestrator.cell.nominal import NominalCell
from orchestrator.geometry import pose
from orchestrator.geometry.mesh import Mesh, clustered
from orchestrator.proximity.scene import Clash, ProximityScene

Array = NDArray[np.float64]

_SELF_CLEARANCE = 2e-3  # m between links of the arm
_MANY_FACES = 100_000
_CLUSTER = 3e-4  # m: makes meshes of many faces light, at an error well below any clearance


@dataclass(frozen=True)
class SensorRange:
    """The range trapezoid in the laser sheet and where the cameras stand (sensor frame, metres).

    At range z the laser line is seen for |y| up to a half-width linear in z, from `half_near` to `half_far`.
    `cameras` is (k, 3), the centres of projection.
    """

    near: float
    far: float
    half_near: float
    half_far: float
    cameras: Array

    def half_line(self, z: ArrayLike) -> Array:
        """Half-width (m) of the line that is seen at range `z`."""
        slope = (self.half_far - self.half_near) / (self.far - self.near)
        return np.asarray(self.half_near + slope * (np.asarray(z, float) - self.near))

    def holds(self, y: ArrayLike, z: ArrayLike) -> NDArray[np.bool_]:
        """Whether points (y, z) of the sheet lie in the trapezoid."""
        y, z = np.asarray(y, float), np.asarray(z, float)
        return np.asarray((z >= self.near) & (z <= self.far) & (np.abs(y) <= self.half_line(z)))


def _light(mesh: Mesh) -> Mesh:
    return clustered(mesh, _CLUSTER) if len(mesh.faces) > _MANY_FACES else mesh


@dataclass(frozen=True)
class PlanningCell:
    """The nominal cell as planning sees it.

    Attributes
    ----------
    nominal
        Kinematics and bodies; every program starts and ends at its `home`.
    range
        Where the sensor sees.
    cycle
        Seconds between set-points.
    table_start
        Table angle at the start, rad.
    """

    nominal: NominalCell
    range: SensorRange
    cycle: float
    table_start: float = 0.0

    @cached_property
    def _chain(self) -> list[str]:
        return arm_chain(self.nominal)

    @cached_property
    def proximity(self) -> ProximityScene:
        """Pairs of bodies that a motion must keep apart, without those that intersect whatever the arm does."""
        return keep_apart(self.nominal, {body.name: _light(body.mesh) for body in self.nominal.bodies})

    def too_near(self, q: ArrayLike, table: ArrayLike, clearance: float) -> list[Clash]:
        """What comes nearer than `clearance` (m) at joints (n, 6) and table angles (n,).

        The arm's own links are near each other by design: among them `_SELF_CLEARANCE` is enough.
        """
        near = self.proximity.too_near(self.nominal.body_poses(q, table), clearance)
        return [c for c in near if c.distance < _SELF_CLEARANCE or not {c.body_a, c.body_b} <= set(self._chain)]

    def table_from_sensor(self, q: ArrayLike) -> Array:
        """Sensor poses (..., 4, 4) in the frame of the table at angle 0, at joints (..., 6)."""
        return np.asarray(pose.inverse(self.nominal.world_from_table) @ self.nominal.world_from_sensor(q))

    def ik(self, table_from_sensor: ArrayLike, reference: ArrayLike | None = None, filtered: bool = True) -> Array:
        """Joints (n, 8, 6) of every branch that puts the sensor at poses (n, 4, 4) in the standing table's frame."""
        world_from_sensor = self.nominal.world_from_table @ np.asarray(table_from_sensor, float)
        flange = world_from_sensor @ pose.inverse(self.nominal.flange_from_sensor)
        return self.nominal.arm.ik(flange, reference, filtered)
