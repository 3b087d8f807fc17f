"""Scenes, poses and measures that the tests of tracing and rendering share."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation
from stripe_images import make_sensor

from sensor_rt import Exposures, Scene, Sensor, expected_electrons

Array = NDArray[np.float64]


def pose(position: ArrayLike = (0.0, 0.0, 0.0), angles: ArrayLike = (0.0, 0.0, 0.0)) -> Array:
    """Pose (4, 4) from a position and intrinsic XYZ angles."""
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_euler("XYZ", angles).as_matrix()
    matrix[:3, 3] = position
    return matrix


def random_pose(rng: np.random.Generator, spread: float = 0.1) -> Array:
    return pose(rng.uniform(-spread, spread, 3), rng.uniform(-np.pi, np.pi, 3))


def still(
    *bodies: Array, sensor: Array | None = None, count: int = 1, duration: float = 5e-4, first: int = 0
) -> Exposures:
    """`count` equal exposures in which nothing moves."""
    return moving([list(bodies)], [np.eye(4) if sensor is None else sensor], count, duration, first)


def moving(
    bodies: list[list[Array]], sensor: list[Array], count: int = 1, duration: float = 5e-4, first: int = 0
) -> Exposures:
    """`count` equal exposures; `bodies` and `sensor` list the poses at each sample: bodies[sample][body]."""
    world_from_body = np.array(bodies).reshape(len(bodies), -1, 4, 4).transpose(1, 0, 2, 3)
    return Exposures(
        np.broadcast_to(np.array(sensor), (count, len(sensor), 4, 4)),
        np.broadcast_to(world_from_body, (count, *world_from_body.shape)),
        np.full(count, duration),
        np.arange(first, first + count),
    )


def probe(cameras: int = 2, **overrides: Any) -> Sensor:
    """The standard two-camera probe without noise."""
    return make_sensor(cameras=cameras, **{"render": {"noise": False}, "range": {"near": 0.06, "far": 0.2}} | overrides)


def stripe_centres(image: NDArray[np.float32]) -> tuple[Array, Array]:
    """First moment of every column's light (row, NaN in dark columns), and its sum."""
    light = image.astype(np.float64)
    total = light.sum(axis=0)
    rows = np.arange(image.shape[0])[:, None]
    with np.errstate(invalid="ignore"):
        return np.where(total > 0.0, (light * rows).sum(axis=0) / total, np.nan), total


def one_plane(
    sensor: Sensor, world_from_plane: Array, reflectance: float = 0.5, size: float = 1.0
) -> NDArray[np.float32]:
    """Expected electrons (cameras, height, width) on a single rectangle."""
    scene = Scene()
    scene.add_plane("plane", np.eye(4), [size, size], reflectance)
    return expected_electrons(scene, sensor, still(world_from_plane))[0]
