"""Images of a sensor that differs from the nominal one, evaluated with the nominal one."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
import pytest
from scenes import Array, plane, pose, probe, still

from scancell.sensor import Exposures, Scene, Sensor, extract, render, scan, triangulate

Z = 0.12


def plane_at(z: float) -> tuple[Scene, Exposures]:
    scene = plane()
    return scene, still(pose((0, 0, z)))


def read_wrongly(sensor: Sensor, true_points: Array, camera: int) -> Array:
    """Apparent positions of points (n, 3): the line of sight intersected with the plane X = 0."""
    viewpoint = sensor.cameras[camera].sensor_from_camera[:3, 3]
    return np.asarray(viewpoint + (true_points - viewpoint) * (viewpoint[0] / (viewpoint[0] - true_points[:, :1])))


@pytest.mark.parametrize(("engine", "tolerance"), [("geometric", 1e-9), ("ray-traced", 3e-6)])
@pytest.mark.parametrize(
    ("laser", "middle"),
    [
        ({"turn_y": 0.003}, lambda y, z: np.tan(0.003) * z + 0 * y),
        ({"offset_x": 3e-4, "turn_z": 0.01}, lambda y, z: 3e-4 - np.tan(0.01) * y),
        ({"straightness": [0, 0, 5e-4, 0, 0, 0]}, lambda y, z: 5e-4 * z * (y / (z * np.tan(0.28))) ** 2),
    ],
    ids=["turned about y", "shifted and turned about z", "bowed"],
)
def test_misaligned_sheet_displaces_points(
    laser: dict[str, Any], middle: Any, engine: Literal["geometric", "ray-traced"], tolerance: float
) -> None:
    sensor, as_built = probe(), probe(laser=laser)
    scene, exposures = plane_at(Z)
    points = scan(scene, sensor, exposures, engine, as_built=as_built).profiles
    y = np.linspace(-0.04, 0.04, 8001)
    truth = np.stack([middle(y, Z), y, np.full(len(y), Z)], axis=1)
    for camera in (0, 1):
        found = points.points_in_sensor[points.camera == camera]
        seen = read_wrongly(sensor, truth, camera)
        expected = np.interp(found[:, 1], seen[:, 1], seen[:, 2])
        assert len(found) > 600
        assert np.sqrt(np.mean((found[:, 2] - expected) ** 2)) < tolerance
        assert np.abs(expected - Z).max() > 50e-6  # the error is significant
    # The result depends only on the images.
    assert np.abs(points.points_in_sensor[:, 0]).max() == 0.0


@pytest.mark.parametrize(("engine", "tolerance"), [("geometric", 1e-9), ("ray-traced", 3e-6)])
@pytest.mark.parametrize("extraction", [{}, {"fusion": "weighted"}, {"peak": "agreement"}], ids=str)
def test_described_sheet_leaves_no_error(
    extraction: dict[str, str], engine: Literal["geometric", "ray-traced"], tolerance: float
) -> None:
    """A sheet that is out of place, turned and bent: triangulated on the plane X = 0, and as it is described."""
    laser = {"offset_x": 3e-4, "turn_y": 0.003, "turn_z": 0.01, "straightness": [0, 0, 5e-4, 0, 0, 0]}
    as_built = probe(laser=laser)
    described = probe(laser=laser, extraction=extraction | {"triangulation": "sheet"})
    scene, exposures = plane_at(Z)
    counts = []
    for sensor in (described, probe(extraction=extraction)):
        profiles = scan(scene, sensor, exposures, engine, as_built=as_built).profiles
        counts.append(len(profiles))
        error = profiles.points_in_sensor[:, 2] - Z
        if sensor is described:
            assert np.sqrt(np.mean(error**2)) < tolerance
            assert len(profiles) > 600
        elif len(profiles):
            assert np.sqrt(np.mean(error**2)) > 50e-6
    # By the nominal plane the cameras disagree: all points of the images contradict one another.
    if engine == "ray-traced" and extraction == {"peak": "agreement"}:
        assert counts[1] < 0.3 * counts[0]


def test_ideal_rays_of_described_sheet_are_exact_points() -> None:
    """The geometric engine without noise: its hit points themselves, as triangulation would give them."""
    laser = {"turn_y": 0.003, "straightness": [0, 0, 5e-4, 0, 0, 0]}
    sensor = probe(laser=laser, extraction={"triangulation": "sheet"})
    scene, exposures = plane_at(Z)
    hits = scan(scene, sensor, exposures, "geometric").profiles
    triangulated = scan(scene, sensor, exposures, "geometric", as_built=probe(laser=laser)).profiles
    assert hits.sigma.max() == 0.0
    np.testing.assert_allclose(hits.points_in_sensor, triangulated.points_in_sensor, rtol=0, atol=1e-9)


@pytest.mark.parametrize("engine", ["geometric", "ray-traced"])
def test_longer_true_baseline_shrinks_ranges(engine: Literal["geometric", "ray-traced"]) -> None:
    """All triangulated distances are proportional to the baseline."""
    scene, exposures = plane_at(Z)
    profiles = scan(scene, probe(), exposures, engine, as_built=probe(camera={"baseline": 0.0602})).profiles
    z = profiles.points_in_sensor[:, 2]
    assert z.mean() == pytest.approx(Z * 0.06 / 0.0602, abs=2e-6)
    assert z.std() < 3e-6


def test_extraction_does_not_use_sensor_as_built() -> None:
    """A scan and separate extraction from its images agree to the last bit."""
    sensor = probe(render={"noise": True})
    as_built = probe(render={"noise": True}, laser={"turn_y": 0.002}, camera={"tilt": 0.512})
    scene, exposures = plane_at(Z)
    in_one = scan(scene, sensor, exposures, keep_images=True, as_built=as_built)
    images = render(scene, as_built, exposures)
    np.testing.assert_array_equal(images, in_one.images)
    apart = triangulate(extract(images, sensor), sensor)
    np.testing.assert_array_equal(apart.points_in_sensor, in_one.profiles.points_in_sensor)
    assert np.abs(in_one.profiles.points_in_sensor[:, 2] - Z).max() > 100e-6


def test_sensor_as_built_defaults_to_nominal_sensor() -> None:
    scene, exposures = plane_at(Z)
    sensor = probe(render={"noise": True})
    alone, twice = (
        scan(scene, sensor, exposures),
        scan(scene, sensor, exposures, as_built=probe(render={"noise": True})),
    )
    np.testing.assert_array_equal(alone.profiles.points_in_sensor, twice.profiles.points_in_sensor)


@pytest.mark.parametrize("other", [probe(cameras=1), probe(camera={"width_px": 1000})])
def test_mismatched_sensor_as_built_is_rejected(other: Sensor) -> None:
    scene, exposures = plane_at(Z)
    with pytest.raises(ValueError, match="as built differs"):
        scan(scene, probe(), exposures, as_built=other)
