"""Open3D's ray casting and closest points, EAIK's inverse kinematics."""

from __future__ import annotations

import importlib
import importlib.util
import os
from collections.abc import Iterator

import numpy as np

from scancell import sensor as sensor_rt

from ..raw_embree import turning_fans
from ..ray_speed import import_open3d, open3d_scene
from ..scenes import PART_TRIANGLES, bumpy_part
from ..timing import measure
from .check import Check, PeerMissingError

# Open3D works in single precision.
DISTANCE_LIMIT_UM = 0.2
RAY_SPEED = 3.0
ANGLE_LIMIT_RAD = 1e-6
_FANS = 256
_POINTS = 200_000
_POSES = 200


def open3d_checks() -> Iterator[Check]:
    """Distances along rays and to the closest points of the same mesh, and the speed of rays."""
    vertices, faces = bumpy_part(PART_TRIANGLES)
    open3d = import_open3d()
    peer = open3d_scene(open3d, vertices, faces)
    scene = sensor_rt.Scene()
    scene.add_mesh("part", vertices, faces, 0.6)
    origins, directions = turning_fans(_FANS).laser_rays()
    ours, _, _ = sensor_rt.cast_rays(scene, np.eye(4)[None], origins, directions)
    rays = open3d.core.Tensor(np.concatenate([origins, directions], 1).astype(np.float32))
    theirs = peer.cast_rays(rays)["t_hit"].numpy()
    hit = np.isfinite(ours) & np.isfinite(theirs)
    # Grazing rays magnify the rounding of single precision.
    gap = float(1e6 * np.quantile(np.abs(ours[hit] - theirs[hit]), 0.999))
    yield Check(f"distance along {hit.sum()} rays, 99.9 %", gap, "um", DISTANCE_LIMIT_UM)
    yield Check(
        "rays that only one of the two lets hit", float(np.mean(np.isfinite(ours) != np.isfinite(theirs))), "", 1e-4
    )
    points = vertices[np.arange(_POINTS) % len(vertices)]
    points = points + np.random.default_rng(1).normal(0, 1e-3, points.shape)
    closest, _, signed = sensor_rt.closest_points(vertices, faces, points)
    their_points = peer.compute_closest_points(open3d.core.Tensor(points.astype(np.float32)))["points"].numpy()
    their_distance = np.linalg.norm(their_points - points, axis=1)
    gap = float(1e6 * np.abs(np.abs(signed) - their_distance).max())
    yield Check(f"distance to the closest point of {_POINTS} points, largest", gap, "um", DISTANCE_LIMIT_UM)
    own = float(1e6 * np.abs(np.linalg.norm(closest - points, axis=1) - np.abs(signed)).max())
    yield Check("our closest points against our distances", own, "um", 1e-6)
    cores = len(os.sched_getaffinity(0))
    slow = measure(lambda: peer.cast_rays(rays, nthreads=cores)).best
    fast = measure(lambda: sensor_rt.cast_rays(scene, np.eye(4)[None], origins, directions, threads=cores)).best
    yield Check("speed of laser rays over Open3D's", slow / fast, "x", RAY_SPEED, at_least=True)


def eaik_checks() -> Iterator[Check]:
    """All branches of the shipped arms at random poses, without regard to joint limits."""
    if importlib.util.find_spec("eaik") is None:
        raise PeerMissingError("EAIK is not installed: pip install EAIK")
    judge = importlib.import_module("bench.inverse_kinematics")
    for name, arm in judge.shipped_arms():
        found = judge.compare(arm, judge.random_joints(arm, _POSES, seed=5))
        yield Check(f"{name}: every branch of {_POSES} poses", found.worst, "rad", ANGLE_LIMIT_RAD)
        yield Check(f"{name}: branches that only one of the two finds", float(found.missing + found.further), "", 0)
