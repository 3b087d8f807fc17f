"""Error of unflagged points from noise-free rendered images."""

from __future__ import annotations

import numpy as np
import pytest
from scenes import ball, plane, pose, probe, still

from scancell.sensor import PEAK_REJECTED, extract, render, triangulate

DETECTOR = {"bit_depth": 12, "gain_dn_per_e": 0.36, "black_level_dn": 64.0}
RANGE = {"near": 0.0751, "far": 0.165}


def measure(scene, world_from_body, **extraction):
    """Points (n, 3) of all unflagged peaks, and the fraction of flagged peaks."""
    sensor = probe(detector=DETECTOR, range=RANGE, extraction=extraction)
    peaks = extract(render(scene, sensor, still(world_from_body)), sensor)
    return np.asarray(triangulate(peaks, sensor).points_in_sensor), ((peaks.flags & PEAK_REJECTED) != 0).mean()


WAYS = [{}, {"peak": "agreement", "fusion": "weighted"}]


@pytest.mark.parametrize("extraction", WAYS, ids=["default", "fused"])
@pytest.mark.parametrize("z", [0.090, 0.125, 0.160])
def test_sphere_error_without_noise(z, extraction):
    """Sphere of 25 mm near both ends and in the middle of the range, the sheet slightly off its centre."""
    centre, radius = np.array([0.0005, 0.0003, z]), 0.0125
    scene = ball(radius)
    points, flagged = measure(scene, pose(centre), **extraction)
    deviation = np.linalg.norm(points - centre, axis=1) - radius
    assert len(points) > 400
    assert np.sqrt(np.mean(deviation**2)) < 1e-6
    assert np.abs(deviation).max() < 10e-6
    assert flagged < 0.05


@pytest.mark.parametrize("extraction", WAYS, ids=["default", "fused"])
@pytest.mark.parametrize("z", [0.078, 0.120, 0.161])
def test_tilted_plane_error_without_noise(z, extraction):
    """Plane tilted about two axes."""
    place = pose([0.0, 0.0, z], [0.08, 0.1, 0.0])
    scene = plane(size=0.2)
    points, flagged = measure(scene, place, **extraction)
    deviation = (points - place[:3, 3]) @ place[:3, 2]
    assert len(points) > 1000
    assert np.sqrt(np.mean(deviation**2)) < 1e-6
    assert np.abs(deviation).max() < 10e-6
    assert flagged < 0.05
