"""Non-ideal laser sheet: non-uniform, bent, misaligned, with an extended source."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scenes import (
    Array,
    cluttered_exposures,
    fast_and_paths,
    one_plane,
    plane,
    pose,
    probe,
    still,
    stripe_centres,
)

from scancell.sensor import expected_electrons, scan

HALF = 0.28  # of the fan, rad
GAUSSIAN = {
    "profile_angle": np.linspace(-HALF, HALF, 513).tolist(),
    "profile_power": np.exp(-2 * (np.linspace(-HALF, HALF, 513) / 0.2) ** 2).tolist(),
}
TABLE = {"profile_angle": [-0.3, -0.1, 0.05, 0.2], "profile_power": [1.0, 3.0, 2.0, 0.5]}
BENT = {"straightness": [1e-4, -2e-4, 6e-4, 3e-4, 0.0, -1e-4]}
TURNED = {"offset_x": 2e-4, "turn_y": 0.004, "turn_z": -0.006}
LONG = {"source_length": 1.5e-3}


def relative_power(laser: dict[str, Any], angle: Array) -> Array:
    """Power per angle of a table relative to that of a uniform fan."""
    nodes, power = np.array(laser["profile_angle"]), np.array(laser["profile_power"])
    fine = np.linspace(-HALF, HALF, 200_001)
    values = np.interp(fine, nodes, power, left=0.0, right=0.0)
    return np.interp(angle, nodes, power, left=0.0, right=0.0) / values.mean()


@pytest.mark.parametrize("shape", [{}, GAUSSIAN, TABLE, BENT, TURNED])
@pytest.mark.parametrize("z", [0.08, 0.16])
def test_power_is_conserved_in_every_cross_section(shape: dict[str, Any], z: float) -> None:
    sensor = probe(laser=shape)
    y = np.linspace(-0.07, 0.07, 2801)
    x = np.linspace(-0.0017, 0.0017, 681)
    x = x + 0.006 * z + 2e-4 if "turn_y" in shape else x
    points = np.stack([*np.meshgrid(x, y, indexing="ij"), np.full((len(x), len(y)), z)], axis=-1)
    cosine = z / np.linalg.norm(points, axis=-1)
    flux = sensor.laser_irradiance(points.reshape(-1, 3)).reshape(points.shape[:2]) * cosine
    total = flux.sum() * (x[1] - x[0]) * (y[1] - y[0])
    assert total == pytest.approx(1e-3, rel=2e-3)  # the plane's grid, and an obliquity of some mrad


@pytest.mark.parametrize("laser", [GAUSSIAN, TABLE], ids=["gaussian", "table"])
@pytest.mark.parametrize("z", [0.09, 0.15])
def test_light_along_line_follows_profile(laser: dict[str, Any], z: float) -> None:
    even, uneven = (one_plane(probe(laser=shape), pose((0, 0, z)))[0] for shape in ({}, laser))
    camera = probe().cameras[0]
    (_, base), (_, total) = stripe_centres(even), stripe_centres(uneven)
    centre = camera.sensor_from_camera[:3, 3]
    row = np.nan_to_num(stripe_centres(even)[0], nan=500.0)
    rays = camera.view_rays(np.stack([np.arange(1280.0), row], axis=1))
    angle = np.arctan2(centre[1] + (z - centre[2]) / rays[:, 2] * rays[:, 1], z)
    inside = (base > 0.5 * base.max()) & (np.abs(angle) < 0.95 * HALF)
    relative = relative_power(laser, angle)
    inside &= np.abs(np.gradient(relative)) < 0.1  # the profile table may end within the fan
    expected = base * relative
    np.testing.assert_allclose(total[inside], expected[inside], rtol=3e-3, atol=2e-3 * base.max())
    assert np.ptp(relative[inside]) > 0.5


def middle_of_sheet(shape: dict[str, Any], y: Array, z: Array | float) -> Array:
    """Sensor x of the sheet centre, computed here from the definition."""
    if "straightness" in shape:
        place = y / (z * np.tan(HALF))
        return np.asarray(z * np.polynomial.polynomial.polyval(place, shape["straightness"]))
    # A plane through the source, rotated about Y, then Z, then translated.
    a, b = shape["turn_y"], shape["turn_z"]
    normal = np.array([np.cos(a) * np.cos(b), np.cos(a) * np.sin(b), -np.sin(a)])
    return np.asarray(shape["offset_x"] - (normal[1] * y + normal[2] * z) / normal[0])


@pytest.mark.parametrize("shape", [BENT, TURNED], ids=["bent", "turned"])
@pytest.mark.parametrize("z", [0.085, 0.12, 0.155])
def test_stripe_lies_on_intersection_of_true_sheet_and_plane(shape: dict[str, Any], z: float) -> None:
    sensor = probe(laser=shape)
    for camera, image in zip(sensor.cameras, one_plane(sensor, pose((0, 0, z))), strict=True):
        rows, total = stripe_centres(image)
        lit = (total > 0.5 * total.max()) & (np.abs(rows - 511.5) < 480)
        y = np.linspace(-0.05, 0.05, 4001)
        there = camera.project(np.stack([middle_of_sheet(shape, y, z), y, np.full(len(y), z)], axis=1))
        order = np.argsort(there[:, 0])
        expected = np.interp(np.arange(1280.0), there[order, 0], there[order, 1])
        nominal = camera.project(np.array([[0.0, 0.0, z]]))[0, 1]
        assert lit.sum() > 600
        assert np.abs(rows[lit] - expected[lit])[5:-5].max() < 0.01
        assert np.abs(expected[lit] - nominal).max() > 1.0  # px: the error is significant


@pytest.mark.parametrize("shape", [BENT, TURNED], ids=["bent", "turned"])
def test_geometric_engine_uses_true_sheet(shape: dict[str, Any]) -> None:
    scene = plane()
    world_from_plane = pose((0, 0, 0.12), (0.2, 0.1, 0.0))
    sensor = probe(laser=shape)
    profiles = scan(scene, sensor, still(world_from_plane), engine="geometric").profiles
    assert len(profiles) > 1000
    # Points are triangulated on the plane X = 0: follow their lines of sight back to the true plane.
    viewpoints = np.array([camera.sensor_from_camera[:3, 3] for camera in sensor.cameras])[profiles.camera]
    view_rays, normal = profiles.points_in_sensor - viewpoints, world_from_plane[:3, 2]
    scale = ((world_from_plane[:3, 3] - viewpoints) @ normal) / (view_rays @ normal)
    points = viewpoints + view_rays * scale[:, None]
    assert np.abs(points - profiles.points_in_sensor).max() > 1e-4
    np.testing.assert_allclose(points[:, 0], middle_of_sheet(shape, points[:, 1], points[:, 2]), atol=1e-9)


@pytest.mark.parametrize("source_length", [0.5e-3, 2e-3])
def test_edge_shadow_has_penumbra_of_similar_triangles(source_length: float) -> None:
    """Edge at a third of the range: the light rises linearly over source_length * (z - z_edge) / z_edge."""
    z, edge = 0.15, 0.05
    scene = plane()
    scene.add_box("screen", np.eye(4), [0.002, 0.02, 1e-4], 0.0)
    sensor = probe(laser={"source_length": source_length}, render={"noise": False, "samples_per_pixel": 256})
    exposures = still(pose((0, 0, z)), pose((0, -0.01, edge)))  # covers y < 0
    image = expected_electrons(scene, sensor, exposures)[0, 0]
    base = one_plane(sensor, pose((0, 0, z)))[0]
    camera = sensor.cameras[0]
    y = np.linspace(-0.02, 0.02, 4001)
    column = camera.project(np.stack([0 * y, y, np.full(len(y), z)], axis=1))[:, 0]
    share = stripe_centres(image)[1] / np.maximum(stripe_centres(base)[1], 1e-12)
    y_of_column = np.interp(np.arange(1280.0), column[::-1], y[::-1])
    width = source_length * (z - edge) / edge
    # The upper corner of the screen, half its thickness above the centre, limits the light.
    inside = np.abs(y_of_column) < 0.75 * width + 1e-4
    expected = np.clip(0.5 + y_of_column / width, 0.0, 1.0)
    assert np.abs(share - expected)[inside].max() < 0.03
    assert inside.sum() > 30
    # The screen blocks half of the light for any source length.
    assert share[inside].mean() == pytest.approx(0.5, abs=0.01)


def test_source_length_has_no_effect_without_occlusion() -> None:
    point, long = (one_plane(probe(laser=laser), pose((0, 0, 0.12))) for laser in ({}, LONG))
    inner = slice(200, -200)
    for a, b in zip(point, long, strict=True):
        np.testing.assert_allclose(stripe_centres(b)[1][inner], stripe_centres(a)[1][inner], rtol=1e-3)


@pytest.mark.parametrize("moves", [False, True])
@pytest.mark.parametrize("laser", [BENT, TURNED, LONG, TABLE, BENT | TURNED | LONG | GAUSSIAN])
def test_cluttered_scene_in_any_sheet_matches_path_tracing(laser: dict[str, Any], moves: bool) -> None:
    scene, exposures = cluttered_exposures(moves)
    fast, paths = fast_and_paths(scene, exposures, 256, laser=laser)
    assert fast.sum() == pytest.approx(paths.sum(), rel=3e-3)
    assert np.mean(np.abs(fast - paths)[paths > 0] < 0.01 * paths.max()) > 0.95


def test_stripe_of_non_ideal_sheet_matches_path_tracing() -> None:
    """Both renderers on the same non-uniform, bent, rotated sheet from an extended source."""
    scene = plane()
    scene.add_box("screen", np.eye(4), [0.002, 0.01, 0.001], 0.0)
    exposures = still(pose((0, 0, 0.14), (0.1, 0.2, 0.0)), pose((0, -0.006, 0.06)))
    laser = BENT | TURNED | LONG | GAUSSIAN
    fast, paths = fast_and_paths(scene, exposures, 256, laser=laser, render={"samples_per_pixel": 64})
    np.testing.assert_allclose(fast, paths, atol=0.01 * paths.max())
