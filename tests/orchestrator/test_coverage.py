"""Coverage: visibility against closed forms of spheres, walls and lids."""

from __future__ import annotations

import time

import numpy as np
import pytest
import trimesh

from orchestrator.evaluation.coverage import SensorView, coverage, sample_surface
from orchestrator.geometry import pose
from orchestrator.geometry.mesh import Mesh

RADIUS = 0.025
HEIGHT = 0.120  # of the sensor over the sphere's centre
BASELINE = 0.060
SPACING = 0.5e-3


def mesh_of(solid: trimesh.Trimesh) -> Mesh:
    return Mesh(np.asarray(solid.vertices, float), np.asarray(solid.faces, np.int64), "test")


def view(sides: tuple[int, ...] = (1, -1), size_px: int = 100_000, fan_half_angle: float = 0.5) -> SensorView:
    """A sensor whose images are so large that they cut nothing, unless `size_px` says otherwise."""
    cameras = [
        {
            "side": side,
            "baseline": BASELINE,
            "height": 0.0,
            "tilt": np.radians(29.3),
            "focal_px": 3000.0,
            "cx_px": (size_px - 1) / 2,
            "cy_px": (size_px - 1) / 2,
            "width_px": size_px,
            "height_px": size_px,
        }
        for side in sides
    ]
    laser = {"source_z": 0.0, "fan_half_angle": fan_half_angle}
    return SensorView.from_resolved({"laser": laser, "range": {"near": 0.02, "far": 0.5}, "cameras": cameras})


def looking_down(x: np.ndarray, height: float = HEIGHT) -> np.ndarray:
    """Sensor poses at height over the origin, Z down, the sheet across x."""
    down = np.diag([1.0, -1.0, -1.0])
    return pose.from_rotation(down, np.stack([x, 0 * x, 0 * x + height], -1))


BALL = mesh_of(trimesh.creation.icosphere(subdivisions=5, radius=RADIUS))
SWEEP = looking_down(np.arange(-0.03, 0.03, SPACING))


def cosine_on_sphere(normal: np.ndarray, viewpoint: np.ndarray) -> np.ndarray:
    way = viewpoint - RADIUS * normal
    return (way * normal).sum(-1) / np.linalg.norm(way, axis=-1)


def visible_on_sphere(normal: np.ndarray, limit: float) -> np.ndarray:
    """A sphere hides nothing of itself but what looks away: the two incidences decide."""
    x = RADIUS * normal[:, 0]
    source = np.stack([x, 0 * x, 0 * x + HEIGHT], -1)
    lit = cosine_on_sphere(normal, source) >= np.cos(limit)
    seen = [cosine_on_sphere(normal, source + np.array([side * BASELINE, 0, 0])) >= np.cos(limit) for side in (1, -1)]
    return lit & (seen[0] | seen[1])


@pytest.mark.parametrize("limit_deg", [40.0, 60.0, 75.0])
def test_visible_part_of_a_sphere_is_what_the_two_incidences_leave(limit_deg: float) -> None:
    limit = np.radians(limit_deg)
    result = coverage(BALL, np.zeros((0, 3)), SWEEP, view(), spacing=SPACING, incidence_limit=limit, samples=8000)
    i = np.arange(200_000) + 0.5  # Fibonacci lattice: equal areas, made without the code under test
    z, turn = 1 - 2 * i / len(i), np.pi * (1 + np.sqrt(5)) * i
    lattice = np.stack([np.sqrt(1 - z * z) * np.cos(turn), np.sqrt(1 - z * z) * np.sin(turn), z], -1)
    assert result.visible.mean() == pytest.approx(visible_on_sphere(lattice, limit).mean(), abs=0.01)


def test_half_scanned_sphere_is_half_covered() -> None:
    points, _ = sample_surface(BALL, 200_000, seed=7)
    half = points[points[:, 0] < 0]
    radius = 1e-3
    result = coverage(BALL, half, SWEEP, view(), spacing=SPACING, radius=radius)
    x = result.samples_in_part[result.visible, 0]
    assert (x < 0).mean() == pytest.approx(0.5, abs=0.01)  # visibility itself is symmetric
    # Beyond the border the points reach as far as the radius, a little less where the surface is steep.
    assert (x < 0).mean() <= result.fraction <= (x < radius).mean()
    assert result.fraction > (x < 0.8 * radius).mean()
    assert result.as_json()["radius_mm"] == pytest.approx(1.0)


def test_fully_scanned_sphere_is_covered_and_an_empty_cloud_covers_nothing() -> None:
    points, _ = sample_surface(BALL, 200_000, seed=8)
    assert coverage(BALL, points, SWEEP, view(), spacing=SPACING).fraction == 1.0
    assert coverage(BALL, np.zeros((0, 3)), SWEEP, view(), spacing=SPACING).fraction == 0.0


@pytest.mark.parametrize("pitch_mm", [0.5, 2.5, 4.0, 6.0, 12.0])
def test_between_profiles_far_apart_nothing_is_covered(pitch_mm: float) -> None:
    """A plane of 60 mm x 40 mm with profiles in the middle of equal strips: 1.5 mm to either side of each count."""
    pitch = pitch_mm * 1e-3
    plane = mesh_of(trimesh.creation.box((0.06, 0.04, 0.001), pose.translation((0, 0, -0.0005))))
    x = np.arange(-0.03 + pitch / 2, 0.03, pitch)
    y = np.linspace(-0.02, 0.02, 801)
    points = np.stack([np.repeat(x, len(y)), np.tile(y, len(x)), np.zeros(len(x) * len(y))], -1)
    result = coverage(plane, points, looking_down(x), view(), spacing=pitch)
    assert result.visible.mean() == pytest.approx(0.06 * 0.04 / plane.areas.sum(), rel=0.01), "the upper face"
    assert result.fraction == pytest.approx(min(1.0, 3.0 / pitch_mm), abs=0.01)


def test_exposures_that_miss_see_nothing() -> None:
    away = looking_down(np.array([0.1, 0.2]))
    result = coverage(BALL, np.zeros((0, 3)), away, view(), spacing=SPACING, samples=2000)
    assert not result.visible.any()
    assert np.isnan(result.fraction) and result.as_json()["fraction"] is None


def test_a_lid_hides_everything_below() -> None:
    lid = mesh_of(trimesh.creation.box((0.3, 0.3, 0.001), pose.translation((0, 0, 0.05))))
    result = coverage(BALL, np.zeros((0, 3)), SWEEP, view(), spacing=SPACING, obstacles=[lid], samples=2000)
    assert not result.visible.any()


def test_a_wall_casts_the_shadow_of_similar_triangles() -> None:
    """One camera at +x behind a wall: the strip of floor that it cannot see is h a / H wide; two cameras see it all."""
    floor = mesh_of(trimesh.creation.box((0.04, 0.01, 0.002), pose.translation((-0.02, 0.0, -0.001))))
    height = 0.010
    wall = mesh_of(trimesh.creation.box((0.001, 0.2, height), pose.translation((0.0005, 0.0, height / 2))))
    sweep = looking_down(np.arange(-0.045, 0.002, SPACING))
    found = {}
    for sides in ((1,), (-1,), (1, -1)):
        result = coverage(floor, np.zeros((0, 3)), sweep, view(sides), spacing=SPACING, obstacles=[wall])
        on_top = np.abs(result.samples_in_part[:, 2]) < 1e-9
        found[sides] = result.visible[on_top].mean()
    assert found[(1,)] == pytest.approx(1 - height * BASELINE / HEIGHT / 0.04, abs=0.02)
    assert found[(-1,)] > 0.99 and found[(1, -1)] > 0.99


def test_fan_and_image_limit_the_width() -> None:
    plate = mesh_of(trimesh.creation.box((0.04, 0.20, 0.002), pose.translation((0.0, 0.0, -0.001))))
    fan = 0.2
    result = coverage(plate, np.zeros((0, 3)), SWEEP, view(fan_half_angle=fan), spacing=SPACING)
    assert np.abs(result.samples_in_part[result.visible, 1]).max() == pytest.approx(HEIGHT * np.tan(fan), rel=0.01)
    # Half an image of 1280 px, and the distance along the camera's axis to a point in the sheet below it.
    result = coverage(plate, np.zeros((0, 3)), SWEEP, view(size_px=1280), spacing=SPACING)
    along_axis = BASELINE * np.sin(np.radians(29.3)) + HEIGHT * np.cos(np.radians(29.3))
    width = np.abs(result.samples_in_part[result.visible, 1]).max()
    assert width == pytest.approx(640 / 3000 * along_axis, rel=0.01)


def test_samples_stand_for_equal_areas() -> None:
    box = mesh_of(trimesh.creation.box((0.08, 0.06, 0.04)))
    points, normals = sample_surface(box, 10_000, seed=3)
    areas = np.array([0.06 * 0.04, 0.08 * 0.04, 0.08 * 0.06])
    share = np.array([(np.abs(normals[:, axis]) > 0.5).mean() for axis in range(3)])
    assert share == pytest.approx(areas / areas.sum(), abs=1e-3)
    assert ((points * normals).sum(1)) == pytest.approx(np.abs(normals) @ [0.04, 0.03, 0.02])
    again, _ = sample_surface(box, 10_000, seed=3)
    assert np.array_equal(points, again)


def test_it_is_fast_enough_for_every_scan() -> None:
    poses = pose.inverse(pose.from_rotation(pose.rotation_about(2, np.linspace(0, 2 * np.pi, 1300)))) @ SWEEP[60]
    start = time.perf_counter()
    result = coverage(BALL, np.zeros((0, 3)), poses, view(), spacing=SPACING, samples=20_000)
    assert result.visible.any()
    assert time.perf_counter() - start < 10.0
