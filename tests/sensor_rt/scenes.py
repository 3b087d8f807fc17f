"""Scenes, poses and metrics shared by the tests of tracing and rendering."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation
from stripe_images import make_sensor

from scancell.sensor import Exposures, Material, Scene, Sensor, expected_electrons

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
    """`count` equal exposures without motion."""
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


# The probe's cameras with pixels twice as large: field of view and blur are the same in mm.
COARSE = {
    "width_px": 640,
    "height_px": 512,
    "focal_px": float(256 / np.tan(np.radians(9.34))),
    "cx_px": 319.5,
    "cy_px": 255.5,
    "pixel_pitch": 1e-5,
}


def stripe_centres(image: NDArray[np.float32]) -> tuple[Array, Array]:
    """First moment of the light per column (row, NaN in dark columns), and its sum."""
    light = image.astype(np.float64)
    total = light.sum(axis=0)
    rows = np.arange(image.shape[0])[:, None]
    with np.errstate(invalid="ignore"):
        return np.where(total > 0.0, (light * rows).sum(axis=0) / total, np.nan), total


def plane(material: Material | float = 0.5, size: float = 1.0) -> Scene:
    """A square, with its middle in the origin of the body "plane"."""
    scene = Scene()
    scene.add_plane("plane", np.eye(4), [size, size], material)
    return scene


def ball(radius: float, material: Material | float = 0.5) -> Scene:
    """A sphere about the origin of the body "ball"."""
    scene = Scene()
    scene.add_sphere("ball", [0.0, 0.0, 0.0], radius, material)
    return scene


def one_plane(
    sensor: Sensor, world_from_plane: Array, material: Material | float = 0.5, size: float = 1.0
) -> NDArray[np.float32]:
    """Expected electrons (cameras, height, width) on a single square."""
    return expected_electrons(plane(material, size), sensor, still(world_from_plane))[0]


def cluttered() -> tuple[Scene, list[Array]]:
    """Steps, slots, wires, steep walls, silhouettes without background, and one body that occludes another."""
    scene = Scene()
    scene.add_cylinder("table", np.eye(4), 0.09, 0.01, 0.3)
    for k in range(6):
        scene.add_box("comb", pose((0.0, -0.012 + 0.005 * k, 0.004 * k)), [0.02, 0.0023, 0.03], 0.6)
    scene.add_sphere("ball", [0, 0, 0], 0.011, 0.8)
    scene.add_cylinder("wire", pose(angles=(0, np.pi / 2, 0)), 0.00015, 0.05, 0.9)
    scene.add_box("edge", pose((0.01004, 0.0, 0.0)), [0.02, 0.01, 0.01], 0.7)
    wave = np.stack(np.meshgrid(np.linspace(-0.03, 0.03, 60), np.linspace(-0.01, 0.03, 60), indexing="ij"), axis=-1)
    height = 0.003 * np.sin(500 * wave[..., 0]) * np.cos(300 * wave[..., 1])
    vertices = np.concatenate([wave, height[..., None]], axis=-1).reshape(-1, 3)
    corner = (np.arange(59)[:, None] * 60 + np.arange(59)).ravel()
    faces = np.concatenate(
        [np.stack([corner, corner + 1, corner + 60], 1), np.stack([corner + 1, corner + 61, corner + 60], 1)]
    )
    scene.add_mesh("wave", vertices, faces, 0.5)
    poses = [
        pose((0, 0, 0.155), (0.3, 0.1, 0.0)),
        pose((0, -0.002, 0.125), (0.1, 0.3, 0.4)),
        pose((0.004, 0.012, 0.11)),
        pose((0, 0.0, 0.1), (0.0, 0.0, 0.2)),
        pose((0, -0.017, 0.115), (0.0, 0.0, 0.001)),
        pose((0, 0.01, 0.135), (-0.7, 0.2, 0.3)),
    ]
    return scene, poses


def cluttered_exposures(moves: bool) -> tuple[Scene, Exposures]:
    """The cluttered scene, static or rotating and translating during the exposure."""
    scene, poses = cluttered()
    later = [pose((1e-4, -3e-4, 2e-4), (0.004, 0.002, -0.006)) @ p for p in poses]
    return scene, moving([poses, later] if moves else [poses], [np.eye(4)] * (2 if moves else 1))


def fast_and_paths(
    scene: Scene,
    exposures: Exposures,
    samples: int = 256,
    columns: tuple[int, int] = (540, 740),
    camera: Mapping[str, Any] | None = None,
    render: Mapping[str, Any] | None = None,
    **overrides: Any,
) -> tuple[Array, Array]:
    """Light of the first exposure in some columns of the first camera, in fast mode and by path tracing.

    Of the rows, only those that receive light are traced.
    """
    camera, render = dict(camera or {}), {"noise": False} | dict(render or {})
    whole = expected_electrons(scene, probe(1, camera=camera, render=render, **overrides), exposures)[0, 0]
    lit = np.flatnonzero(whole[:, slice(*columns)].max(axis=1) > 0.01)
    first, last = max(0, int(lit[0]) - 8), min(whole.shape[0], int(lit[-1]) + 9)
    part = camera | {
        "width_px": columns[1] - columns[0],
        "height_px": last - first,
        "cx_px": camera.get("cx_px", 639.5) - columns[0],
        "cy_px": camera.get("cy_px", 511.5) - first,
    }
    paths = render | {"mode": "path", "samples_per_pixel": samples}
    a, b = (expected_electrons(scene, probe(1, camera=part, render=r, **overrides), exposures) for r in (render, paths))
    return a[0, 0].astype(np.float64), b[0, 0].astype(np.float64)
