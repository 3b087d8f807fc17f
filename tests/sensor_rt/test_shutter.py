"""Rolling shutter: effect of the row times on images and points, compared with closed forms."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scenes import Array, cluttered, fast_and_paths, moving, plane, pose, probe, still, stripe_centres
from scipy.spatial.transform import Rotation, Slerp

from scancell.sensor import Exposures, Scene, Sensor, expected_electrons, render, scan

READOUT, EXPOSURE = 8e-6, 5e-4
ROWS = 1024
SPAN = EXPOSURE + (ROWS - 1) * READOUT
DEEP = {"bit_depth": 16, "gain_dn_per_e": 5.0}


def rolling(readout: float = READOUT, **overrides: Any) -> Sensor:
    detector = {"row_readout": readout} | overrides.pop("detector", {})
    return probe(detector=detector, **overrides)


def row_time(row: Array) -> Array:
    """Time from the middle of the frame to the exposure of each row, s."""
    return (row - (ROWS - 1) / 2) * READOUT


def at(first: Array, last: Array, share: float) -> Array:
    """Pose (4, 4) interpolated between two at a fraction: constant linear and angular velocity."""
    turn = Slerp([0.0, 1.0], Rotation.from_matrix([first[:3, :3], last[:3, :3]]))(share)
    between = np.eye(4)
    between[:3, :3] = turn.as_matrix()
    between[:3, 3] = (1 - share) * first[:3, 3] + share * last[:3, 3]
    return between


@pytest.mark.parametrize("velocity", [(0.0, 0.0, 0.05), (0.0, 0.08, 0.0), (0.06, 0.0, -0.03)], ids=["z", "y", "xz"])
def test_moving_plane_is_sheared(velocity: tuple[float, float, float]) -> None:
    """Points are displaced by the plane's normal speed times the row time."""
    scene = plane(size=0.4)
    middle, angles = np.array([0.0, 0.0, 0.118]), (0.75, 0.12, 0.0)  # steep: the stripe covers most of the rows
    path = np.array(velocity) * SPAN
    places = moving([[pose(middle - path / 2, angles)], [pose(middle + path / 2, angles)]], [np.eye(4)] * 2)
    profiles = scan(scene, rolling(detector=DEEP), places).profiles
    normal = pose(middle, angles)[:3, 2]
    off = (profiles.points_in_sensor - middle) @ normal
    speed = normal @ velocity
    assert np.ptp(profiles.row) > 500
    assert np.abs(off).max() > 10 * 1e-6
    assert np.sqrt(np.mean((off - speed * row_time(profiles.row)) ** 2)) < 1e-6
    slope = np.polyfit(profiles.row, off, 1)[0]
    assert slope == pytest.approx(speed * READOUT, rel=2e-3)


def test_points_of_rotating_sphere_match_row_time() -> None:
    centre, radius = np.array([0.0, 0.012, 0.004]), 0.015
    scene = Scene()
    scene.add_sphere("ball", centre, radius, 0.5)
    first, last = pose((0.0, -0.012, 0.121)), pose((0.0004, -0.0118, 0.1212), (0.03, 0.02, 0.0))
    profiles = scan(scene, rolling(detector=DEEP), moving([[first], [last]], [np.eye(4)] * 2)).profiles
    points, shares = profiles.points_in_sensor, 0.5 + row_time(profiles.row) / SPAN
    places = np.array([at(first, last, s)[:3, :3] @ centre + at(first, last, s)[:3, 3] for s in shares])
    off = np.linalg.norm(points - places, axis=1) - radius
    mid_frame = at(first, last, 0.5)
    wrong = np.linalg.norm(points - mid_frame[:3, :3] @ centre - mid_frame[:3, 3], axis=1) - radius
    assert len(points) > 800
    assert np.sqrt(np.mean(off**2)) < 1e-6
    assert np.sqrt(np.mean(wrong**2)) > 10e-6  # a single pose for all rows is not sufficient


def image_of_row(sensor: Sensor, scene: Scene, first: list[Array], last: list[Array], row: int) -> Array:
    """Image, by path tracing, of a global shutter that is open while that row is exposed."""
    ends = [(row * READOUT + after) / SPAN for after in (0.0, EXPOSURE)]
    bodies = [[at(a, b, share) for a, b in zip(first, last, strict=True)] for share in ends]
    exposures = moving(bodies, [np.eye(4)] * 2)
    return np.asarray(expected_electrons(scene, sensor, exposures)[0], float)


NARROW = {"width_px": 160, "cx_px": 79.5}
PATHS = {"noise": False, "mode": "path", "samples_per_pixel": 4}


@pytest.mark.parametrize(
    ("light", "step"),
    [
        ({"camera": NARROW, "render": PATHS}, 29),
        ({"ambient": {"irradiance": 0.5}, "camera": NARROW, "render": PATHS}, 140),
    ],
    ids=["laser", "ambient"],
)
def test_each_row_matches_global_shutter_at_row_time(light: dict[str, Any], step: int) -> None:
    scene, first = cluttered()
    last = [pose((1e-4, -8e-4, 9e-4), (0.01, 0.004, -0.015)) @ p for p in first]
    exposures = moving([first, last], [np.eye(4)] * 2)
    image = np.asarray(expected_electrons(scene, rolling(**light), exposures)[0], float)
    lit = [r for r in range(0, ROWS, step) if (image[:, r] > 0).any()]
    assert len(lit) > 6
    for row in lit:
        alone = image_of_row(probe(**light), scene, first, last, row)[:, row]
        # A sample within rounding of an edge may fall on either side of it.
        differs = np.abs(image[:, row] - alone) > 1e-6 * alone.max()
        assert differs.mean() < 2e-3


@pytest.mark.parametrize("scale", [1.0, 10.0], ids=["6 px", "60 px"])
def test_stripe_of_moving_scene_matches_path_tracing(scale: float) -> None:
    """Motion during the readout of all rows."""
    scene, first = cluttered()
    last = [pose((0.0, -2e-4 * scale, 3e-4 * scale), (2e-3 * scale, 0.0, -3e-3 * scale)) @ p for p in first]
    exposures = moving([first, last], [np.eye(4)] * 2)
    fast, paths = fast_and_paths(scene, exposures, 64, detector={"row_readout": READOUT})
    assert fast.sum() == pytest.approx(paths.sum(), rel=3e-3)
    (centre, _), (true_centre, true_total) = stripe_centres(fast), stripe_centres(paths)
    bright = true_total > 0.5 * np.median(true_total)
    assert np.median(np.abs(centre - true_centre)[bright]) < 0.02


@pytest.mark.parametrize(
    "light", [{}, {"speckle": {"contrast": 1.0}, "ambient": {"irradiance": 0.5}}], ids=["laser", "all"]
)
def test_static_scene_matches_global_shutter(light: dict[str, Any]) -> None:
    scene, places = cluttered()
    options = {"render": {"noise": True, "samples_per_pixel": 4}} | light
    scene.add_light("lamp", "rectangle", pose((0, 0, -0.1)), [0.05, 0.05], 0.01, in_band=1.0)
    exposures = still(*places, pose())
    a, b = render(scene, rolling(**options), exposures), render(scene, probe(**options), exposures)
    assert a.max() > 50
    assert a.tobytes() == b.tobytes()


MEMORY_OF_DENSE_ROWS = """
import resource
from scenes import cluttered_exposures, probe
from scancell.sensor import expected_electrons
camera = {"width_px": 64, "cx_px": 31.5}
render = {"noise": False, "samples_per_pixel": 1024}
sensor = probe(detector={"row_readout": 8e-6}, camera=camera, render=render)
scene, exposures = cluttered_exposures(True)
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
assert expected_electrons(scene, sensor, exposures, threads=1).sum() > 0.0
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)
"""


def test_memory_is_bounded_with_many_samples_in_many_rows() -> None:
    """Every row has poses of its own for every sample; those of all 1024 rows take a gigabyte."""
    done = subprocess.run(
        [sys.executable, "-c", MEMORY_OF_DENSE_ROWS],
        cwd=Path(__file__).parent,
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])},
        check=True,
        capture_output=True,
        text=True,
    )
    print(f"{int(done.stdout) / 1024:.0f} MB")
    assert int(done.stdout) < 400 * 1024


def test_zero_readout_time_is_global_shutter() -> None:
    scene, first = cluttered()
    last = [pose((1e-4, -3e-4, 2e-4), (0.004, 0.002, -0.006)) @ p for p in first]
    exposures = moving([first, last], [np.eye(4)] * 2)
    a, b = render(scene, rolling(0.0), exposures), render(scene, probe(), exposures)
    tiny = render(scene, rolling(1e-12), exposures)
    assert a.tobytes() == b.tobytes()
    assert (np.abs(tiny.astype(int) - b.astype(int)) > 1).mean() < 1e-5  # rendered by the rolling-shutter code


def test_path_tracing_supports_rolling_shutter() -> None:
    scene = plane(size=0.4)
    ends = [[pose((0.0, 0.0, z), (0.5, 0.1, 0.0))] for z in (0.118, 0.120)]
    exposures: Exposures = moving(ends, [np.eye(4)] * 2)
    small = {"width": 160, "height": 128}
    fast, path = (
        expected_electrons(
            scene, rolling(6e-5, **small, render={"noise": False, "samples_per_pixel": 256, "mode": mode}), exposures
        )
        for mode in ("fast", "path")
    )
    for drawn, traced in zip(fast[0], path[0], strict=True):
        (centre, total), (true_centre, true_total) = stripe_centres(drawn), stripe_centres(traced)
        np.testing.assert_allclose(total, true_total, rtol=0.05)
        assert np.median(np.abs(centre - true_centre)) < 0.02
    assert (fast > 0).sum() > 500


def test_reflected_light_with_rolling_shutter_is_rejected() -> None:
    with pytest.raises(ValueError, match=r"render\.bounces.*global shutter"):
        rolling(render={"bounces": 1})
