"""What planning knows of the cell: nominal kinematics, bodies and the sensor's range, all SI."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from orchestrator.geometry import pose
from orchestrator.geometry.arm import Arm
from orchestrator.geometry.mesh import Mesh
from orchestrator.proximity.pairs import always_touching, cell_pairs
from orchestrator.proximity.scene import ProximityScene

Array = NDArray[np.float64]


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

    @staticmethod
    def from_corners(corners: ArrayLike, cameras: ArrayLike) -> SensorRange:
        """Range from the trapezoid's corners (4, 2) as (y, z), in any order."""
        c = np.asarray(corners, float)
        near, far = c[:, 1].min(), c[:, 1].max()
        at_near, at_far = (np.abs(c[np.isclose(c[:, 1], z), 0]).min() for z in (near, far))
        return SensorRange(float(near), float(far), float(at_near), float(at_far), np.asarray(cameras, float))

    def half_line(self, z: ArrayLike) -> Array:
        """Half-width (m) of the line that is seen at range `z`."""
        slope = (self.half_far - self.half_near) / (self.far - self.near)
        return np.asarray(self.half_near + slope * (np.asarray(z, float) - self.near))

    def holds(self, y: ArrayLike, z: ArrayLike) -> NDArray[np.bool_]:
        """Whether points (y, z) of the sheet lie in the trapezoid."""
        y, z = np.asarray(y, float), np.asarray(z, float)
        return np.asarray((z >= self.near) & (z <= self.far) & (np.abs(y) <= self.half_line(z)))


@dataclass(frozen=True)
class TableModel:
    """Rotary table. `world_from_table` at angle 0: origin where the axis meets the top face, z along the axis."""

    world_from_table: Array
    radius: float
    max_speed: float
    max_acceleration: float

    def pose(self, angle: ArrayLike) -> Array:
        """``world_from_platter`` (..., 4, 4) at table angles (...)."""
        return np.asarray(self.world_from_table @ pose.from_rotation(pose.rotation_about(2, angle)))


@dataclass(frozen=True)
class CellModel:
    """The nominal cell.

    Attributes
    ----------
    arm, flange_from_sensor, table
        Kinematics.
    part, table_from_part
        The part's mesh in its own frame, and where it is clamped on the platter at angle 0.
    links
        Meshes of the base and the links in their Denavit-Hartenberg frames, base first, last link last.
    sensor
        Housing in the sensor frame, without the bracket.
    platter, table_base
        The part of the table that turns, and what stands still below it (may be None), table frame.
    home, table_start
        Joints (6,) and table angle where every program starts; it also ends at `home`.
    range
        Where the sensor sees.
    cycle
        Seconds between set-points.
    """

    arm: Arm
    flange_from_sensor: Array
    table: TableModel
    part: Mesh
    table_from_part: Array
    links: tuple[Mesh, ...]
    sensor: Mesh
    platter: Mesh
    table_base: Mesh | None
    home: Array
    table_start: float
    range: SensorRange
    cycle: float

    @cached_property
    def chain(self) -> tuple[str, ...]:
        """Names of the bodies that the arm carries, base first."""
        return ("base", *(f"link[{i}]" for i in range(1, len(self.links))), "sensor")

    @cached_property
    def meshes(self) -> Mapping[str, Mesh]:
        """Body name → mesh."""
        bodies = dict(zip(self.chain, (*self.links, self.sensor), strict=True))
        bodies |= {"table": self.platter, "part": self.part}
        if self.table_base is not None:
            bodies["table_base"] = self.table_base
        return bodies

    @cached_property
    def proximity(self) -> ProximityScene:
        """Pairs of bodies that a motion must keep apart, without those that intersect whatever the arm does."""
        around = [name for name in self.meshes if name not in self.chain]
        everything = ProximityScene(self.meshes, cell_pairs(self.chain, around))
        lower, upper = self.arm.limits
        q = np.random.default_rng(0).uniform(lower, upper, (200, len(lower)))
        touching = always_touching(everything, self.body_poses(q, np.zeros(len(q))))
        if not touching:
            return everything
        return ProximityScene(self.meshes, cell_pairs(self.chain, around, touching))

    def world_from_sensor(self, q: ArrayLike) -> Array:
        """Nominal sensor poses (..., 4, 4) at joints (..., 6)."""
        return np.asarray(self.arm.fk(q) @ self.flange_from_sensor)

    def part_from_sensor(self, q: ArrayLike, table: ArrayLike) -> Array:
        """Sensor poses (..., 4, 4) in the part frame at joints (..., 6) and table angles (...)."""
        world_from_part = self.table.pose(table) @ self.table_from_part
        return np.asarray(pose.inverse(world_from_part) @ self.world_from_sensor(q))

    def flange_targets(self, world_from_sensor: ArrayLike) -> Array:
        """Flange poses that put the sensor where it is wanted."""
        return np.asarray(np.asarray(world_from_sensor, float) @ pose.inverse(self.flange_from_sensor))

    def body_poses(self, q: ArrayLike, table: ArrayLike) -> Array:
        """``world_from_body`` (n, bodies, 4, 4) at joints (n, 6) and table angles (n,), in the order of `meshes`."""
        frames = self.arm.link_poses(q)
        platter = self.table.pose(table)
        placed = dict(zip(self.chain, np.moveaxis(frames, 1, 0), strict=False))
        placed["sensor"] = frames[:, -1] @ self.flange_from_sensor
        placed |= {"table": platter, "part": platter @ self.table_from_part}
        placed["table_base"] = np.broadcast_to(self.table.world_from_table, platter.shape)
        return np.stack([placed[name] for name in self.meshes], 1)
