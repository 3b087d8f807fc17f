"""Scenes that every program can hold: a few surfaces, placed in the sensor frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scancell import sensor as sensor_rt
from scancell.geometry import pose

from ..scenes import PART_TRIANGLES, PART_Z, Array, Faces, bumpy_part


@dataclass(frozen=True)
class Ball:
    """Sphere."""

    centre: Array
    radius: float

    def add_to(self, scene: sensor_rt.Scene, name: str) -> None:
        """Add to ours."""
        scene.add_sphere(name, self.centre, self.radius, 1.0)


@dataclass(frozen=True)
class Flat:
    """Large rectangle in the xy plane of its own frame."""

    sensor_from_flat: Array
    size: float = 0.4
    grooves: tuple[float, float] | None = None  # GGX roughness along its x and y; None: matt white

    def add_to(self, scene: sensor_rt.Scene, name: str) -> None:
        """Add to ours."""
        material: sensor_rt.Material | float = 1.0
        if self.grooves is not None:
            along, across = self.grooves
            material = sensor_rt.Material(1.0, "grooved_conductor", across, 1.5, along, [1, 0, 0])
        scene.add_plane(name, self.sensor_from_flat, (self.size, self.size), material)


@dataclass(frozen=True)
class Block:
    """Box with edges along the axes of the sensor frame."""

    lower: Array
    upper: Array
    medium: sensor_rt.Material | None = None  # translucent; None: matt white

    def add_to(self, scene: sensor_rt.Scene, name: str) -> None:
        """Add to ours."""
        material = 1.0 if self.medium is None else self.medium
        scene.add_box(name, pose.translation((self.lower + self.upper) / 2), self.upper - self.lower, material)


@dataclass(frozen=True)
class Net:
    """Triangle mesh."""

    vertices: Array
    faces: Faces

    def add_to(self, scene: sensor_rt.Scene, name: str) -> None:
        """Add to ours."""
        scene.add_mesh(name, self.vertices, self.faces, 1.0)


Surface = Ball | Flat | Block | Net


def build(surfaces: tuple[Surface, ...]) -> sensor_rt.Scene:
    """Our scene, every surface a body of its own."""
    scene = sensor_rt.Scene()
    for number, surface in enumerate(surfaces):
        surface.add_to(scene, f"surface{number}")
    return scene


def flat(z: float, tilt_x: float, tilt_y: float) -> Flat:
    """Plane through (0, 0, z), tilted about x and y, rad."""
    return Flat(pose.from_euler_xyz((0, 0, z), (tilt_x, tilt_y, 0)))


def part() -> Net:
    """The bumpy ball in the middle of the measuring range."""
    vertices, faces = bumpy_part(PART_TRIANGLES)
    placed: NDArray[np.float64] = pose.transform_points(pose.from_euler_xyz((0, 0, PART_Z), (0.4, 0.1, 0.2)), vertices)
    return Net(placed, faces)


def small_ball() -> Ball:
    """A sphere whose outline the laser reaches."""
    return Ball(np.array([0.003, 0.004, 0.14]), 0.012)


def shading_block() -> Block:
    """Something that hides a piece of `part` from the laser, and another from the cameras."""
    return Block(np.array([-0.002, -0.012, 0.085]), np.array([0.006, -0.006, 0.095]))
