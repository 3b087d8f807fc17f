"""Rejection of ghost reflections on polished parts by two cameras, on images with bounces and noise.

The reference is the geometric engine: the closest hits of the laser rays and their projections to the cameras.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scenes import Array, pose, still
from scipy.spatial import cKDTree
from stripe_images import make_sensor

from scancell.sensor import (
    PEAK_REJECTED,
    Exposures,
    Material,
    Peaks,
    Profiles,
    Scene,
    Sensor,
    extract,
    render,
    scan,
    triangulate_pixels,
)

POLISHED = Material(0.58, "rough_conductor", 0.08, 1.5)
MIRRORLIKE = Material(0.58, "rough_conductor", 0.03, 1.5)
MIRROR = Material(0.9, "mirror", 0.0, 1.5)
WHITE = Material(0.85, "oren_nayar", 0.3, 1.5)
PAINT = Material(0.5, "oren_nayar", 0.3, 1.5)
AGREEMENT = {"peak": "agreement", "fusion": "weighted"}


def folded(profile: Array, materials: list[Material], yaw: float) -> Scene:
    """Strip folded along lines parallel to X, rotated by `yaw`: `profile` (n, 2) of y and z."""
    turn = pose((0, 0, 0), (0, 0, yaw))[:3, :3]
    scene = Scene()
    for (y0, z0), (y1, z1), material in zip(profile, profile[1:], materials, strict=False):
        corners = np.array([[x, y, z] for x in (-0.1, 0.1) for y, z in ((y0, z0), (y1, z1))]) @ turn.T
        scene.add_mesh("part", corners, np.array([[0, 1, 2], [1, 3, 2]], np.uint32), material)
    return scene


def v_groove(yaw: float, walls: Material, top: Material, depth: float = 0.006) -> Scene:
    profile = np.array([(-0.08, 0.118), (-depth, 0.118), (0.0, 0.118 + depth), (depth, 0.118), (0.08, 0.118)])
    return folded(profile, [top, walls, walls, top], yaw)


def step(yaw: float, wall: Material, top: Material) -> Scene:
    return folded(np.array([(-0.1, 0.12), (0.0, 0.12), (0.0, 0.13), (0.1, 0.13)]), [top, wall, top], yaw + np.pi / 2)


SCENES: list[Callable[[float], Scene]] = [
    partial(v_groove, walls=POLISHED, top=POLISHED),
    partial(v_groove, walls=MIRRORLIKE, top=PAINT),
    partial(step, wall=POLISHED, top=POLISHED),
    partial(step, wall=MIRRORLIKE, top=PAINT),
]


def sensor(bounces: int, photons: int = 1 << 20) -> Sensor:
    render_options = {"bounces": bounces, "photons": photons, "noise": True}
    laser = {"power": 2e-3}
    limits = {"near": 0.06, "far": 0.2}
    return make_sensor(cameras=2, render=render_options, laser=laser, range=limits, extraction=AGREEMENT)


@dataclass
class Count:
    good: int = 0
    lost: int = 0
    ghosts: int = 0
    accepted: int = 0
    points: int = 0
    off_surface: int = 0


def off_truth(columns: NDArray[np.int32], rows: Array, column: NDArray[np.int32], row: Array) -> Array:
    """Distance in rows (n,) from each peak to the nearest true row in its column; 1e6: none."""
    order = np.argsort(columns, kind="stable")
    columns, rows = columns[order], rows[order]
    first = np.searchsorted(columns, column - 1, "left")
    last = np.searchsorted(columns, column + 1, "right")
    return np.array([np.abs(rows[a:b] - r).min(initial=1e6) for a, b, r in zip(first, last, row, strict=True)])


def true_stripe(scene: Scene, exposures: Exposures) -> Profiles:
    """Exact closest hits of the laser that a camera sees."""
    limits = {"near": 0.06, "far": 0.2}
    exact = make_sensor(cameras=2, render={"noise": False}, range=limits)
    return scan(scene, exact, exposures, engine="geometric").profiles


def of_camera(peaks: Peaks, camera: int) -> tuple[NDArray[np.int32], Array, NDArray[np.bool_]]:
    mine = peaks.camera == camera
    return peaks.column[mine], peaks.row[mine], (peaks.flags[mine] & PEAK_REJECTED) == 0


def count(scene: Scene, total: Count) -> None:
    exposures = still(np.eye(4))
    real, direct = sensor(2), sensor(0)
    truth = true_stripe(scene, exposures)
    scanned = scan(scene, real, exposures, keep_images=True)
    assert scanned.images is not None
    dirty = extract(scanned.images, real, all_peaks=True)
    clean = extract(render(scene, direct, exposures), direct)
    for k in (0, 1):
        mine = truth.camera == k
        column, row, accepted = of_camera(dirty, k)
        off = off_truth(truth.column[mine], truth.row[mine], column, row)
        total.ghosts += int((off > 2.0).sum())
        total.accepted += int(((off > 2.0) & accepted).sum())
        kept = set(column[accepted & (off < 0.5)])
        column, row, accepted = of_camera(clean, k)
        good = set(column[accepted & (off_truth(truth.column[mine], truth.row[mine], column, row) < 0.5)])
        total.good += len(good)
        total.lost += len(good - kept)
    fused = scanned.profiles.points_in_sensor
    distance, _ = cKDTree(truth.points_in_sensor).query(fused)
    total.points += len(fused)
    total.off_surface += int((distance > 2e-4).sum())


def test_ghosts_are_rejected_and_stripe_is_kept() -> None:
    total = Count()
    for make in SCENES:
        for yaw in (20, 60):
            count(make(np.radians(yaw)), total)
    print(total)
    assert total.ghosts > 5_000
    assert total.accepted < 0.01 * total.ghosts
    assert total.good > 10_000
    assert total.lost < 0.01 * total.good
    assert total.points > 5_000
    assert total.off_surface < 1e-3 * total.points


def wall_behind_mirror(yaw: float, bottom: float = 0.124, depth: float = 0.006) -> Array:
    """Points (n, 3) of the groove's second wall, mirrored in the first, on the continued laser rays."""
    across, down = np.array([-np.sin(yaw), np.cos(yaw), 0.0]), np.array([0.0, 0.0, 1.0])
    mirror, wall = (across - down) / np.sqrt(2), (across + down) / np.sqrt(2)  # normals
    slope = np.linspace(-0.3, 0.3, 200_001)
    rays = np.stack([0 * slope, slope, 0 * slope + 1], axis=1)
    first, second = ((bottom * down @ n) / (rays @ n) for n in (mirror, wall))
    points = second[:, None] * rays
    on_mirror = np.abs((first[:, None] * rays @ across) + depth / 2) < depth / 2
    behind = -(points - bottom * down) @ mirror
    return points[on_mirror & (second > first) & (behind > 0) & (behind < np.sqrt(2) * depth)]


def test_ideal_mirror_ghosts_on_sheet_are_accepted() -> None:
    """A wall that is both lit and seen via the mirror appears at the continued laser rays behind the mirror.

    The light returns along its own path, so that every camera sees it at the same point of the sheet: comparing the
    cameras does not distinguish it from a wall. The mirror itself reflects nothing that would contradict it.
    """
    others = accepted_others = images = 0
    for yaw in np.radians((10, 60)):
        profile = np.array([(-0.08, 0.118), (-0.006, 0.118), (0.0, 0.124), (0.006, 0.118), (0.08, 0.118)])
        scene = folded(profile, [WHITE, MIRROR, WHITE, WHITE], yaw)
        exposures, real = still(np.eye(4)), sensor(2)
        truth = true_stripe(scene, exposures)
        peaks = extract(render(scene, real, exposures), real, all_peaks=True)
        image = cKDTree(wall_behind_mirror(yaw))
        for k in (0, 1):
            mine = truth.camera == k
            column, row, accepted = of_camera(peaks, k)
            ghost = off_truth(truth.column[mine], truth.row[mine], column, row) > 2.0
            points = triangulate_pixels(np.stack([column, row], 1).astype(float), real, k, "exact")
            behind = image.query(points)[0] < 2e-5
            images += int((ghost & accepted & behind).sum())
            others += int((ghost & ~behind).sum())
            accepted_others += int((ghost & accepted & ~behind).sum())
    print(images, others, accepted_others)
    assert images > 300
    assert others > 900
    assert accepted_others < 0.01 * others
