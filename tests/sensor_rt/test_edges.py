"""Stripes near edges, partially or fully occluded from one camera: benefit and cost of camera agreement."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scenes import Array, ball, plane, pose, still
from stripe_images import make_sensor

from scancell.sensor import PEAK_REJECTED, Exposures, Scene, Sensor, extract, render, scan

HALF_BOX = np.array([0.012, 0.008, 0.01])
POSES = 150
LASER = {"power": 2e-3, "fan_half_angle": np.radians(16.0)}
RANGE = {"near": 0.0751, "far": 0.165}


def sensor(peak: str, noise: bool, **laser: float) -> Sensor:
    options = {"peak": peak}
    return make_sensor(cameras=2, render={"noise": noise}, laser=LASER | laser, range=RANGE, extraction=options)


def box_errors(peak: str, noise: bool) -> Array:
    """Distances (n,) of points from a box in several poses above a plane, m."""
    rng = np.random.default_rng(1)
    middle = np.array([0.0, 0.0, 0.125])
    boxes = [pose(middle + rng.uniform(-6e-3, 6e-3, 3), rng.uniform(-np.pi, np.pi, 3)) for _ in range(POSES)]
    plane = pose((0.0, 0.0, 0.155), (0.1, 0.05, 0.0))
    bodies = np.array([[[box], [plane]] for box in boxes])
    scene = Scene()
    scene.add_box("box", np.eye(4), (2 * HALF_BOX).tolist(), 0.5)
    scene.add_plane("plane", np.eye(4), [0.3, 0.3], 0.5)
    sensors = np.broadcast_to(np.eye(4), (POSES, 1, 4, 4))
    exposures = Exposures(sensors, bodies, np.full(POSES, 5e-4), np.arange(POSES))
    profiles = scan(scene, sensor(peak, noise), exposures).profiles
    points, world_from_box = profiles.points_in_sensor, bodies[profiles.frame, 0, 0]
    in_box = np.einsum("nji,nj->ni", world_from_box[:, :3, :3], points - world_from_box[:, :3, 3])
    beyond = np.abs(in_box) - HALF_BOX
    off_box = np.where((beyond > 0).any(1), np.linalg.norm(beyond.clip(0), axis=1), np.abs(beyond.max(1)))
    return np.minimum(off_box, np.abs((points - plane[:3, 3]) @ plane[:3, 2]))


def kept_with_sheet_off(offset: float) -> float:
    """Fraction of a plane's points kept by the agreement when the true sheet is off the nominal one by `offset`, m."""
    scene = plane(size=0.3)
    places = still(pose((0.0, 0.0, 0.12), (0.1, 0.05, 0.0)))
    as_built = sensor("agreement", True, offset_x=offset)
    single, both = (scan(scene, sensor(p, True), places, as_built=as_built) for p in ("brightest", "agreement"))
    return len(both.profiles) / len(single.profiles)


def test_agreement_rejects_distorted_points_at_edges() -> None:
    for noise in (False, True):
        single, both = box_errors("brightest", noise), box_errors("agreement", noise)
        assert len(single) > 200_000
        assert len(both) > 0.995 * len(single)
        # What remains lies within the tolerance of the agreement: half a pixel is 70 um there.
        for far in (15e-6, 20e-6):
            assert (single > far).sum() > 0
            assert (both > far).sum() < 0.7 * (single > far).sum()


def test_points_occluded_from_one_camera_are_kept() -> None:
    """A sphere occludes part of a table from one camera only."""
    scene = ball(0.02)
    scene.add_plane("table", np.eye(4), [0.2, 0.2], 0.5)
    places = still(pose((-0.01, 0.0, 0.125)), pose((-0.01, 0.0, 0.1575)))
    images = render(scene, sensor("brightest", False), places)

    def on_table(peak: str) -> NDArray[np.bool_]:
        peaks = extract(images, sensor(peak, False))
        of_table = np.zeros((2, 1280), bool)
        sound = ((peaks.flags & PEAK_REJECTED) == 0) & (np.abs(peaks.row - table_row) < 0.5)
        of_table[peaks.camera[sound], peaks.column[sound]] = True
        return of_table

    optics = sensor("brightest", False).cameras[0]
    table_row = float(np.asarray(optics.project(np.array([[0.0, 0.03, 0.1575]])))[0, 1])
    single, both = on_table("brightest"), on_table("agreement")
    assert single.sum() > 300
    assert single[0].sum() - single[1].sum() > 100  # one sees less of it
    np.testing.assert_array_equal(both, single)


def test_agreement_rejects_points_of_misaligned_sheet() -> None:
    assert kept_with_sheet_off(5e-6) > 0.99
    assert kept_with_sheet_off(100e-6) < 0.01
