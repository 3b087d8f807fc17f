"""Sensors, parts and exposures that benchmarks and comparisons share."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scancell import sensor as sensor_rt
from scancell.config.loading import load_setup
from scancell.config.sensor import sensor_json
from scancell.geometry import pose

Array = NDArray[np.float64]
Faces = NDArray[np.uint32]

PART_TRIANGLES = 70_000
# Middle of a part and top of the table under it on the sensor's axis: the part lies inside the measuring range.
PART_Z = 0.14
TABLE_Z = 0.17

# An image sensor that turns light into numbers without any loss that matters.
FAITHFUL_DETECTOR = (
    "sensor.render.noise=false",
    "sensor.detector.bit_depth=16",
    "sensor.detector.black_level_dn=0",
    "sensor.detector.prnu=0.0",
    "sensor.detector.dsnu_e=0.0",
    "sensor.detector.dark_current_e_per_s=0.0",
    "sensor.detector.read_noise_e=0.0",
    "sensor.detector.full_well_e=1e6",
    "sensor.detector.gain_dn_per_e=5.0",
)


def sensor_description(overrides: Sequence[str] = (), sensor: Path | None = None) -> dict[str, Any]:
    """Resolved SI description of a sensor; None: the default one."""
    return sensor_json(load_setup(sensor=sensor, settings=overrides).sensor, seed=0)


def make_sensor(overrides: Sequence[str] = (), sensor: Path | None = None) -> sensor_rt.Sensor:
    """A sensor, None: the default one, with overrides like ``sensor.render.noise=false``."""
    return sensor_rt.Sensor(json.dumps(sensor_description(overrides, sensor)))


def both_cameras(*settings: str) -> tuple[str, ...]:
    """Overrides that give both cameras of the default sensor these settings."""
    return tuple(f"sensor.camera[{number}].{setting}" for number in (1, 2) for setting in settings)


def bumpy_part(triangles: int) -> tuple[Array, Faces]:
    """Closed bumpy ball of 60 mm with about `triangles` triangles, the same surface at every count.

    Its poles lie on the x axis, out of the laser sheet, so that the triangles in view are of one size.

    Returns
    -------
    vertices (n, 3) in metres and faces (m, 3).
    """
    rings = max(4, round(np.sqrt(triangles / 4)))
    around = 2 * rings
    polar = (np.arange(1, rings) * np.pi / rings)[:, None]
    turn = (np.arange(around) * 2 * np.pi / around)[None, :]
    unit = np.stack(np.broadcast_arrays(np.cos(polar), np.sin(polar) * np.cos(turn), np.sin(polar) * np.sin(turn)), -1)
    directions = np.concatenate([unit.reshape(-1, 3), [[1.0, 0, 0], [-1.0, 0, 0]]])
    x, y, z = directions.T
    radius = 0.03 * (1 + 0.04 * np.sin(9 * x) * np.cos(7 * y) + 0.03 * np.sin(13 * z))
    return radius[:, None] * directions, _ball_faces(rings, around)


def _ball_faces(rings: int, around: int) -> Faces:
    """Triangles between the rings of vertices and to the two poles, which come last; normals outwards."""
    column = np.arange(around)
    following = (column + 1) % around
    start = (np.arange(rings - 2) * around)[:, None]
    a, b = start + column, start + following
    c, d = a + around, b + around
    sides = np.stack([np.stack([a, c, b], -1), np.stack([b, c, d], -1)]).reshape(-1, 3)
    last = (rings - 2) * around
    first_pole = np.full(around, (rings - 1) * around)
    caps = [
        np.stack([first_pole, column, following], -1),
        np.stack([first_pole + 1, last + following, last + column], -1),
    ]
    return np.concatenate([sides, *caps]).astype(np.uint32)


def part_on_table(triangles: int) -> sensor_rt.Scene:
    """Scene of bodies ``part`` (bumpy ball) and ``table`` (disc)."""
    scene = sensor_rt.Scene()
    scene.add_mesh("part", *bumpy_part(triangles), 0.6)
    scene.add_cylinder("table", np.eye(4), 0.12, 0.02, 0.3)
    return scene


def turning_exposures(count: int, duration: float = 5e-4, moving: bool = True) -> sensor_rt.Exposures:
    """Exposures of `part_on_table`: the part turns from one to the next and, when `moving`, during each of them."""
    samples = 2 if moving else 1
    world_from_body = np.empty((count, 2, samples, 4, 4))
    for frame in range(count):
        for sample in range(samples):
            # 1 rad/s at 30 mm: a surface speed of 30 mm/s.
            angle = 0.02 * frame + duration * sample
            world_from_body[frame, 0, sample] = pose.from_euler_xyz((0, 0, PART_Z), (angle, 0.1, 0.2))
            world_from_body[frame, 1, sample] = pose.from_euler_xyz((0, 0, TABLE_Z), (0.0, 0.1, 0.0))
    world_from_sensor = np.broadcast_to(np.eye(4), (count, samples, 4, 4))
    return sensor_rt.Exposures(world_from_sensor, world_from_body, np.full(count, duration), np.arange(count))


def still_exposure(bodies: int, duration: float) -> sensor_rt.Exposures:
    """One exposure of `bodies` bodies whose frames coincide with the sensor's."""
    poses = np.broadcast_to(np.eye(4), (1, bodies, 1, 4, 4))
    return sensor_rt.Exposures(np.eye(4)[None, None], poses, np.array([duration]), np.array([1], np.int64))
