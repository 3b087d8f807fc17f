"""Rejection of ghost reflections on polished parts by two cameras. Images by geometry, see `ghosts`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from ghosts import Views, Wall, draw, step, v_groove, view
from numpy.typing import NDArray
from stripe_images import make_sensor

from scancell.sensor import PEAK_FLAGS, PEAK_REJECTED, Sensor, expose, extract, triangulate_pixels

WIDTH, HEIGHT, SIGMA = 1280, 1024, 1.3
OVERLAP_PX = 6 * SIGMA  # closer reflections distort the stripe itself


@dataclass
class Count:
    good: int = 0
    lost: int = 0
    ghosts: int = 0
    accepted: int = 0

    def __add__(self, other: Count) -> Count:
        return Count(
            self.good + other.good, self.lost + other.lost, self.ghosts + other.ghosts, self.accepted + other.accepted
        )


def photographs(views: list[Views], sensor: Sensor, ghosts: float, seed: int) -> NDArray[np.uint16]:
    """Images (1, 2, H, W) of non-uniform brightness.

    A wall may face a camera better than the one that the laser meets first, so what it lights there may be brighter
    than the stripe; a mirror shows less than it is given.
    """
    rng = np.random.default_rng(seed)

    def uneven(low: float, high: float) -> NDArray[np.float64]:
        phase = np.arange(WIDTH) / rng.uniform(20, 90) + rng.uniform(0, 6)
        return low + (high - low) * (0.5 + 0.5 * np.sin(phase))

    light = []
    for seen in views:
        heights = [uneven(2500, 6000) for _ in seen.direct]
        heights += [ghosts * uneven(1000, 9000) for _ in seen.bounced]
        heights += [ghosts * uneven(500, 4000) for _ in seen.mirrored]
        light.append(draw(seen.direct + seen.ghosts, heights, SIGMA, HEIGHT))
    return expose(np.array(light)[None].astype(np.float32), sensor, np.array([5e-4]), np.array([seed]))


def off(curves, column, row):
    """Distance (n,) in px of peaks from the nearest of several curves in their columns."""
    rows = np.array([*curves, np.full(WIDTH, 1e6)])[:, column]
    return np.nanmin(np.abs(rows - row), axis=0)


def accepted(peaks, camera):
    keep = (peaks.camera == camera) & ((peaks.flags & PEAK_REJECTED) == 0)
    return peaks.column[keep], peaks.row[keep]


def count(walls: list[Wall], peak: str, seed: int) -> Count:
    sensor = make_sensor(cameras=2, extraction={"peak": peak})
    views = [view(walls, sensor, camera) for camera in sensor.cameras]
    clean = extract(photographs(views, sensor, 0.0, seed), sensor)
    dirty = extract(photographs(views, sensor, 1.0, seed), sensor, all_peaks=True)
    total = Count()
    for k, seen in enumerate(views):
        column, row = accepted(clean, k)
        right = off(seen.direct, column, row) < 0.3
        points = triangulate_pixels(np.stack([column, row], 1).astype(float), sensor, k, "exact")
        mirrored = np.asarray(sensor.cameras[1 - k].project(points)).round().astype(int)
        mirrored[:, 0] = mirrored[:, 0].clip(0, WIDTH - 1)
        free = off(seen.ghosts, column, row) > OVERLAP_PX
        free &= off(views[1 - k].ghosts, mirrored[:, 0], mirrored[:, 1]) > OVERLAP_PX
        good = set(column[right & free])
        column, row = accepted(dirty, k)
        still = set(column[off(seen.direct, column, row) < 0.3])
        mine = dirty.camera == k
        ghost = off(seen.ghosts, dirty.column[mine], dirty.row[mine]) < 0.5
        ghost &= off(seen.direct, dirty.column[mine], dirty.row[mine]) > 2.0
        passed = ghost & ((dirty.flags[mine] & PEAK_REJECTED) == 0)
        total += Count(len(good), len(good - still), int(ghost.sum()), int(passed.sum()))
    return total


SCENES = [v_groove(np.radians(yaw)) for yaw in (5, 15, 25, 40, 60, 80)]
SCENES += [step(np.radians(yaw)) for yaw in (10, 30, 50, 70)]


def test_two_cameras_reject_ghosts_and_keep_stripe():
    total = sum((count(walls, "agreement", 1) for walls in SCENES), Count())
    naive = sum((count(walls, "brightest", 1) for walls in SCENES[:6:2]), Count())
    assert total.ghosts > 5000
    assert naive.accepted > 0.2 * naive.ghosts  # without agreement many ghosts are accepted
    assert total.accepted < 0.01 * total.ghosts
    assert total.good > 8000
    assert total.lost < 0.01 * total.good


def test_stripe_at_different_point_in_other_camera_is_unconfirmed():
    """A flat stripe, displaced by one row between the cameras; the tolerance is half a row."""
    sensor = make_sensor(cameras=2, extraction={"peak": "agreement"})
    for shift, share in ((0.0, 0.0), (0.3, 0.0), (1.0, 1.0)):
        rows = [np.full(WIDTH, 500.2), np.full(WIDTH, 500.2 + shift)]
        light = np.array([draw([r], [np.full(WIDTH, 6000.0)], SIGMA, HEIGHT) for r in rows])[None]
        peaks = extract(expose(light.astype(np.float32), sensor, np.array([5e-4]), np.array([0])), sensor)
        unconfirmed = (peaks.flags & PEAK_FLAGS["unconfirmed"]) != 0
        assert unconfirmed.mean() == pytest.approx(share, abs=0.01)


def test_agreement_requires_two_cameras():
    sensor = make_sensor(64, 48, extraction={"peak": "agreement"})
    with pytest.raises(ValueError, match="agreement: expected two cameras"):
        extract(np.zeros((1, 1, 48, 64), np.uint16), sensor)


def test_agreement_works_with_distortion():
    camera = {"distortion": [-0.12, 0.05, 1e-3, -5e-4, 0.01]}
    sensor = make_sensor(cameras=2, camera=camera, extraction={"peak": "agreement"})
    views = [view(v_groove(np.radians(40.0)), sensor, c) for c in sensor.cameras]
    peaks = extract(photographs(views, sensor, 0.0, 4), sensor)
    assert ((peaks.flags & PEAK_FLAGS["unconfirmed"]) == 0).mean() > 0.98
