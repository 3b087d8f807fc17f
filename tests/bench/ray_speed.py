"""Speed of bare geometry against other programs: rays that meet triangles, closest points on them."""

from __future__ import annotations

import importlib
import importlib.util
import os
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scancell import sensor as sensor_rt
from scancell.geometry.mesh import Mesh, sample_surface

from .peers.check import PeerMissingError
from .raw_embree import RAYS, Fans, raw_times, turning_fans
from .scenes import PART_TRIANGLES, Faces, bumpy_part, make_sensor, part_on_table, turning_exposures
from .table import Row, Wanted, processor_row
from .timing import Timing, measure

Array = NDArray[np.float64]

FANS = 256
POINTS = 1_000_000
EVALUATED_TRIANGLES = 100_000


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


def laser_ray_rows() -> Iterator[Row]:
    """Millions of laser rays per second, from arrays to arrays, every caster in the precision it has."""
    vertices, faces = bumpy_part(PART_TRIANGLES)
    fans = turning_fans(FANS)
    origins, directions = fans.laser_rays()
    scene = sensor_rt.Scene()
    scene.add_mesh("part", vertices, faces, 0.6)
    cores = len(os.sched_getaffinity(0))

    def cast(threads: int) -> Timing:
        return measure(lambda: sensor_rt.cast_rays(scene, np.eye(4)[None], origins, directions, threads=threads))

    raw = raw_times(vertices, faces, fans)
    if raw is None:
        print("  laser rays against bare Embree: skipped: sensor-raw-embree is not built (SCANCELL_TESTS)")
    else:
        peer = f"bare Embree in C++, packets of {raw.width}"
        theirs = _rate(fans, raw.laser, 1)
        yield _ray_row("cast_rays", fans, cast(1), 1, peer, theirs, 0.6)
        profiles, count = _whole_profiles()
        both = Timing(raw.laser.best + raw.views.best, 0.0, raw.laser.processor + raw.views.processor)
        views = 1 + fans.eyes.shape[1]
        rate = 1e-6 * views * count * RAYS / profiles.processor
        wall = 1e-6 * views * count * RAYS / profiles.best
        name, theirs = "whole profiles: laser + 2 view rays, 1 thread", views * _rate(fans, both, 1)
        yield Row(name, rate, "Mrays/s", peer, theirs, profiles.spread, clock="processor", other=wall)
    try:
        open3d = import_open3d()
    except PeerMissingError as missing:
        print(f"  laser rays against Open3D: skipped: {missing}")
        return
    casting = open3d_scene(open3d, vertices, faces)
    rays = open3d.core.Tensor(np.concatenate([origins, directions], 1).astype(np.float32))
    timing = measure(lambda: casting.cast_rays(rays, nthreads=cores))
    theirs = _rate(fans, timing, cores)
    yield _ray_row("cast_rays", fans, cast(cores), cores, "Open3D RaycastingScene", theirs, 3.0)


def _rate(fans: Fans, timing: Timing, cores: int) -> float:
    """Millions of laser rays per second of `cores` free cores, by processor time."""
    return 1e-6 * cores * fans.count / timing.processor


def _ray_row(what: str, fans: Fans, timing: Timing, threads: int, peer: str, theirs: float, least: float) -> Row:
    rate, wall = _rate(fans, timing, threads), 1e-6 * fans.count / timing.best
    name = f"{what}, {RAYS}-ray fans, {threads} thread{'s' if threads > 1 else ''}"
    return Row(name, rate, "Mrays/s", peer, theirs, timing.spread, "at least", least, "processor", wall)


def _whole_profiles() -> tuple[Timing, int]:
    """Whole profiles, and how many: a laser ray and a ray from each camera per point."""
    sensor, exposures = make_sensor([f"sensor.geometric.rays={RAYS}"]), turning_exposures(FANS)
    scene = part_on_table(PART_TRIANGLES)
    return measure(lambda: sensor_rt.scan(scene, sensor, exposures, engine="geometric", threads=1)), FANS


def closest_point_rows() -> Iterator[Row]:
    """Seconds for the closest points of a million points near the part, and for their signed distances alone."""
    vertices, faces = bumpy_part(PART_TRIANGLES)
    points = vertices[np.arange(POINTS) % len(vertices)] + np.random.default_rng(1).normal(0, 1e-3, (POINTS, 3))
    yield _distance_row(
        "closest points, 1 M points",
        lambda: sensor_rt.closest_points(vertices, faces, points),
        lambda peer, single: peer.compute_closest_points(single),
        (vertices, faces, points),
    )
    # A cloud as `scancell evaluate` compares it: within some 20 um of the surface.
    vertices, faces = bumpy_part(EVALUATED_TRIANGLES)
    mesh, surface = Mesh(vertices, faces.astype(np.int64)), sensor_rt.MeshSurface(vertices, faces)
    points, face = sample_surface(mesh, POINTS, 1)
    points += np.random.default_rng(2).normal(0, 20e-6, (POINTS, 1)) * mesh.normals[face]
    yield _distance_row(
        f"signed distances, 1 M points, {len(faces):,} faces",
        lambda: surface.signed_distances(points),
        lambda peer, single: peer.compute_distance(single),
        (vertices, faces, points),
        0.5,
    )


def _distance_row(
    name: str,
    work: Callable[[], object],
    peer_work: Callable[[Any, Any], object],
    given: tuple[Array, Faces, Array],
    limit: float = 0.0,
) -> Row:
    """Processor seconds of all threads together, at most `limit` of the peer's where it is set."""
    timing = measure(work, 2)
    try:
        open3d = import_open3d()
    except PeerMissingError as missing:
        print(f"  {name} against Open3D: skipped: {missing}")
        return processor_row(name, timing, "s", "1 s", 1.0)
    vertices, faces, points = given
    peer, single = open3d_scene(open3d, vertices, faces), open3d.core.Tensor(points.astype(np.float32))
    theirs = measure(lambda: peer_work(peer, single), 2).processor
    wanted: Wanted = "at most" if limit else ""
    return processor_row(name, timing, "s", "Open3D RaycastingScene", theirs, wanted, limit or 1.0)
