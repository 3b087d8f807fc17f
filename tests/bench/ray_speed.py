"""Speed of bare geometry against other programs: rays that meet triangles, closest points on them."""

from __future__ import annotations

import importlib
import importlib.util
import os
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from numpy.typing import NDArray

import sensor_rt
from orchestrator.geometry import pose

from .peers.check import PeerMissingError
from .scenes import (
    PART_TRIANGLES,
    PART_Z,
    Faces,
    bumpy_part,
    make_sensor,
    part_on_table,
    sensor_description,
    turning_exposures,
)
from .table import Row
from .timing import measure

Array = NDArray[np.float64]

FANS = 256
RAYS = 1024
POINTS = 1_000_000


def import_open3d() -> Any:
    """The peer's module.

    Raises
    ------
    PeerMissingError
        If it, or a system library that it needs, is not installed.
    """
    if importlib.util.find_spec("open3d") is None:
        raise PeerMissingError("Open3D is not installed: pip install open3d")
    try:
        return importlib.import_module("open3d")
    except ImportError as error:
        libraries = "apt-get install libusb-1.0-0 libgl1 libgomp1 libx11-6 libegl1"
        raise PeerMissingError(f"Open3D does not load ({error}): {libraries}") from error


def open3d_scene(open3d: Any, vertices: Array, faces: Faces) -> Any:
    """Open3D's ray casting scene of a mesh."""
    scene = open3d.t.geometry.RaycastingScene()
    scene.add_triangles(open3d.core.Tensor(vertices.astype(np.float32)), open3d.core.Tensor(faces.astype(np.uint32)))
    return scene


def fans(count: int) -> tuple[Array, Array]:
    """Origins and unit directions (count * RAYS, 3), in the part's frame, of laser fans onto a turning part."""
    half_angle = float(sensor_description()["laser"]["fan_half_angle"])
    angles = np.linspace(-half_angle, half_angle, RAYS)
    directions = np.stack([0 * angles, np.sin(angles), np.cos(angles)], -1)
    origins, turned = [], []
    for k in range(count):
        part_from_sensor = pose.inverse(pose.from_euler_xyz((0, 0, PART_Z), (0.02 * k, 0.1, 0.2)))
        origins.append(np.broadcast_to(part_from_sensor[:3, 3], (RAYS, 3)))
        turned.append(directions @ part_from_sensor[:3, :3].T)
    return np.concatenate(origins), np.concatenate(turned)


def laser_ray_rows() -> Iterator[Row]:
    """Millions of laser rays per second, from arrays to arrays, every caster in the precision it has."""
    vertices, faces = bumpy_part(PART_TRIANGLES)
    origins, directions = fans(FANS)
    scene = sensor_rt.Scene()
    scene.add_mesh("part", vertices, faces, 0.6)
    own_pose = np.eye(4)[None]

    def rate(work: Callable[[], object]) -> tuple[float, float]:
        timing = measure(work)
        return 1e-6 * len(origins) / timing.best, timing.spread

    single = rate(lambda: sensor_rt.cast_rays(scene, own_pose, origins, directions, threads=1))
    raw = rate(_embreex_work(vertices, faces, origins, directions))[0]
    name = f"cast_rays, {RAYS}-ray fans, 1 thread"
    yield Row(name, single[0], "Mrays/s", "embreex, 1 thread", raw, single[1], "at least", 0.6)
    fan = _geometric_fans()
    name = "geometric mode: laser + 2 view rays, 1 thread"
    yield Row(name, fan[0], "Mrays/s", "embreex, 1 thread", raw, fan[1])
    try:
        open3d = import_open3d()
    except PeerMissingError as missing:
        print(f"  laser rays against Open3D: skipped: {missing}")
        return
    peer = open3d_scene(open3d, vertices, faces)
    rays = open3d.core.Tensor(np.concatenate([origins, directions], 1).astype(np.float32))
    cores = len(os.sched_getaffinity(0))
    theirs = rate(lambda: peer.cast_rays(rays, nthreads=cores))
    ours = rate(lambda: sensor_rt.cast_rays(scene, own_pose, origins, directions, threads=cores))
    name = f"cast_rays, {RAYS}-ray fans, {cores} threads"
    yield Row(name, ours[0], "Mrays/s", "Open3D RaycastingScene", theirs[0], ours[1], "at least", 3.0)


def _embreex_work(vertices: Array, faces: Faces, origins: Array, directions: Array) -> Callable[[], object]:
    """The same rays through Embree 4 as the `embreex` package binds it, in single precision."""
    scene = EmbreeScene()
    mesh = TriangleMesh(scene, vertices[faces].astype(np.float32))
    rays = origins.astype(np.float32), directions.astype(np.float32)

    def work() -> object:
        return mesh, scene.run(*rays, output=True)

    return work


def _geometric_fans() -> tuple[float, float]:
    """Millions of rays per second of whole profiles: a laser ray and a ray from each camera per point."""
    sensor, exposures = make_sensor([f"sensor.geometric.rays={RAYS}"]), turning_exposures(FANS)
    scene = part_on_table(PART_TRIANGLES)
    timing = measure(lambda: sensor_rt.scan(scene, sensor, exposures, engine="geometric", threads=1))
    return 1e-6 * FANS * RAYS * (1 + len(sensor.cameras)) / timing.best, timing.spread


def closest_point_rows() -> Iterator[Row]:
    """Seconds for the closest points of a million points near the part."""
    vertices, faces = bumpy_part(PART_TRIANGLES)
    points = vertices[np.arange(POINTS) % len(vertices)] + np.random.default_rng(1).normal(0, 1e-3, (POINTS, 3))
    timing = measure(lambda: sensor_rt.closest_points(vertices, faces, points), 2)
    try:
        open3d = import_open3d()
    except PeerMissingError as missing:
        print(f"  closest points against Open3D: skipped: {missing}")
        yield Row("closest points, 1 M points", timing.best, "s", "1 s", 1.0, timing.spread)
        return
    peer, single = open3d_scene(open3d, vertices, faces), open3d.core.Tensor(points.astype(np.float32))
    theirs = measure(lambda: peer.compute_closest_points(single), 2)
    yield Row("closest points, 1 M points", timing.best, "s", "Open3D RaycastingScene", theirs.best, timing.spread)
