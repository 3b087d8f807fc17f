"""Targets for the calibration of a sensor, and the poses at which it measures them."""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import NDArray

from scancell.calibration.sensor.checkered import CheckeredBoard
from scancell.config.choices import SensorTarget
from scancell.config.material import PRESETS, Material
from scancell.config.sensor import SensorDescription, focal_length_px, read_out
from scancell.geometry import pose
from scancell.geometry.mesh import Mesh
from scancell.geometry.shapes import PlacedShape, Plane, ShapeGroup, Sphere
from scancell.nominal.cell import Body
from scancell.nominal.patches import Patch

Array = NDArray[np.float64]

_MARGIN = 0.06
_PRINT = Material(0.05)
_FACING_SENSOR = pose.from_euler_xyz((0.0, 0.0, 0.0), (np.pi, 0.0, 0.0))  # the target's z towards the sensor


def surface_of(target: SensorTarget) -> ShapeGroup:
    """Shapes of a target by its name."""
    match target:
        case "ball":
            return ball()
        case "step":
            return step_block()
        case "checkered":
            return CheckeredBoard().surface


def ball(diameter: float = 0.025) -> ShapeGroup:
    """A ball, m."""
    return ShapeGroup((PlacedShape("ball", Sphere(diameter / 2), np.eye(4)),), "ball")


def step_block(treads: int = 3, width: float = 0.008, rise: float = 0.004, length: float = 0.04) -> ShapeGroup:
    """Level treads one beside the other along y, each higher by `rise`, m; the middle one at the origin."""
    places = np.arange(treads) - (treads - 1) / 2
    return ShapeGroup(
        tuple(
            PlacedShape(f"tread {k + 1}", Plane(length, width), pose.translation((0.0, width * place, rise * place)))
            for k, place in enumerate(places)
        ),
        "step block",
    )


def ball_poses(sensor: SensorDescription, diameter: float = 0.025, heights: int = 5) -> Array:
    """Poses (9 heights, 4, 4) of a ball over range and line, its centre on and beside the laser sheet."""
    radius = diameter / 2
    found = []
    for z in _heights(sensor, heights, _MARGIN):
        side = max(_half_width(sensor, z) - radius, 0.0)
        for y, x in product((-side, 0.0, side), (-0.35 * radius, 0.0, 0.35 * radius)):
            found.append(pose.translation((x, y, z + radius)))
    return np.array(found)


def step_poses(
    sensor: SensorDescription, heights: int = 5, tilt: float = np.radians(20.0), margin: float = _MARGIN
) -> Array:
    """Poses (5 heights, 4, 4) of a level target over the range: upright, and tilted to four sides.

    `margin` is the share of the measuring range that is left out at both of its ends.
    """
    tilts = [(0.0, 0.0), (tilt, 0.0), (-tilt, 0.0), (0.0, tilt), (0.0, -tilt)]
    found = []
    for z in _heights(sensor, heights, margin):
        for about_x, about_y in tilts:
            tilted = pose.from_euler_xyz((0.0, 0.0, z), (about_x, about_y, 0.0))
            found.append(tilted @ _FACING_SENSOR)
    return np.array(found)


def board_poses(sensor: SensorDescription, heights: int = 2, tilt: float = np.radians(25.0)) -> Array:
    """Poses (5 heights, 4, 4) of a checkered board: those of `step_poses`, turned about its own normal in between."""
    poses = step_poses(sensor, heights, tilt, margin=0.25)  # nearer the ends it leaves the cameras' field of view
    turns = [pose.from_euler_xyz((0.0, 0.0, 0.0), (0.0, 0.0, 0.4 * k)) for k in range(len(poses))]
    return np.array([one @ turn for one, turn in zip(poses, turns, strict=True)])


def solid_body(target: ShapeGroup) -> Body:
    """The shapes as a matt white body."""
    return Body("target", "part", target.mesh(), PRESETS["matt_white"])


def board_body(board: CheckeredBoard) -> Body:
    """The board as a mesh of square cells, white or printed."""
    rows, columns = board.white.shape
    width, height = board.size
    x, y = np.linspace(-width / 2, width / 2, columns + 1), np.linspace(height / 2, -height / 2, rows + 1)
    vertices = np.stack([*np.meshgrid(x, y), np.zeros((rows + 1, columns + 1))], -1).reshape(-1, 3)
    top_left = (np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)).ravel()
    below = top_left + columns + 1
    faces = np.stack([top_left, below, below + 1, top_left, below + 1, top_left + 1], 1).reshape(-1, 3)
    printed = np.flatnonzero(np.repeat(~board.white.ravel(), 2))
    mesh = Mesh(vertices, faces, "checkered board")
    return Body("target", "part", mesh, PRESETS["matt_white"], (Patch(printed, _PRINT),))


def _heights(sensor: SensorDescription, count: int, margin: float) -> Array:
    near, far = 1e-3 * sensor.range.near_mm, 1e-3 * sensor.range.far_mm
    left_out = margin * (far - near)
    return np.linspace(near + left_out, far - left_out, count)


def _half_width(sensor: SensorDescription, z: float) -> float:
    """Half the length of the line that laser and cameras cover at a height."""
    laser = sensor.laser
    of_fan = (z - 1e-3 * laser.source_z_mm) * np.tan(np.radians(laser.fan_half_angle_deg))
    of_cameras = [
        np.hypot(1e-3 * one.baseline_mm, z - 1e-3 * one.height_mm) * one.width_px / (2 * focal_length_px(one))
        for one in read_out(sensor).camera
    ]
    return float(min(of_fan, *of_cameras))
