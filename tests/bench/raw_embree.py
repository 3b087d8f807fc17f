"""Bare Embree in C++ on the rays of profiles: the measure of what is spent beside tracing."""

from __future__ import annotations

import json
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scancell.geometry import pose

from .scenes import PART_Z, Faces, make_sensor, sensor_description
from .timing import Timing

Array = NDArray[np.float64]

RAYS = 1024


@dataclass(frozen=True)
class Fans:
    """Laser fans onto a turning part, in the part's frame; the cameras are the default sensor's.

    Attributes
    ----------
    sources
        (n, 3), m
    eyes
        (n, cameras, 3), m
    directions
        (n, RAYS, 3), unit vectors
    """

    sources: Array
    eyes: Array
    directions: Array

    @property
    def count(self) -> int:
        """Laser rays of all fans."""
        return len(self.sources) * RAYS

    def laser_rays(self) -> tuple[Array, Array]:
        """Origins and directions (n * RAYS, 3) one by one."""
        return np.repeat(self.sources, RAYS, axis=0), self.directions.reshape(-1, 3)


def turning_fans(count: int) -> Fans:
    """The fans of `scenes.turning_exposures`."""
    half_angle = float(sensor_description()["laser"]["fan_half_angle"])
    angles = half_angle * (2 * (np.arange(RAYS) + 0.5) / RAYS - 1)
    in_sensor = np.stack([0 * angles, np.sin(angles), np.cos(angles)], -1)
    cameras = np.array([camera.sensor_from_camera[:3, 3] for camera in make_sensor().cameras])
    sources, eyes, directions = [], [], []
    for k in range(count):
        part_from_sensor = pose.inverse(pose.from_euler_xyz((0, 0, PART_Z), (0.02 * k, 0.1, 0.2)))
        rotation, source = part_from_sensor[:3, :3], part_from_sensor[:3, 3]
        sources.append(source)
        eyes.append(cameras @ rotation.T + source)
        directions.append(in_sensor @ rotation.T)
    return Fans(np.array(sources), np.array(eyes), np.array(directions))


@dataclass(frozen=True)
class RawTimes:
    """Seconds of all fans: laser rays, and rays from every camera to what the laser met."""

    width: int
    laser: Timing
    views: Timing


def raw_times(vertices: Array, faces: Faces, fans: Fans, repeats: int = 5) -> RawTimes | None:
    """What bare Embree takes with packets of 8 or 16, whichever is faster; None where the program is not built."""
    built = sorted(Path(__file__).parents[2].glob("build/*/tests/sensor_rt/sensor-raw-embree"))
    if not built:
        return None
    counts = np.array([len(vertices), len(faces), len(fans.sources), RAYS, fans.eyes.shape[1]], np.uint64)
    single = (part.astype(np.float32) for part in (fans.sources, fans.eyes, fans.directions))
    with tempfile.TemporaryDirectory(prefix="scancell-bench-") as folder:
        file = Path(folder) / "fans.bin"
        with file.open("wb") as out:
            for part in (counts, np.asarray(vertices, float), np.asarray(faces, np.uint32), *single):
                out.write(np.ascontiguousarray(part).tobytes())
        command = [str(built[-1]), str(file), str(repeats)]
        lines = subprocess.run(command, check=True, capture_output=True, text=True).stdout.splitlines()
    runs = [json.loads(line) for line in lines]
    best = min(runs, key=lambda run: run["laser"][1] + run["views"][1])
    laser, views = (Timing(wall, 0.0, processor) for wall, processor in (best["laser"], best["views"]))
    return RawTimes(best["width"], laser, views)
