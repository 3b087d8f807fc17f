"""Coverage of clouds on surfaces whose measurable part is given."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from cells import mesh_of

import scancell
from scancell.config.loading import assets_dir
from scancell.evaluation.deviation import coverage, profile_spacing
from scancell.geometry import pose
from scancell.geometry.mesh import Mesh, sample_surface
from scancell.sensor import covered_samples
from scancell.visibility import MeasurableSurface

RADIUS = 0.025
SPACING = 0.5e-3


def surface_of(mesh: Mesh, samples: int = 20_000) -> MeasurableSurface:
    """A surface that is measurable everywhere."""
    points, face = sample_surface(mesh, samples, seed=0)
    return MeasurableSurface(points, mesh.normals[face], np.ones(samples, bool), float(mesh.areas.sum()), "")


BALL = mesh_of(trimesh.creation.icosphere(subdivisions=5, radius=RADIUS))
BALL_CLOUD, BALL_FACE = sample_surface(BALL, 200_000, seed=7)
NOTHING = np.zeros((0, 3))


def test_half_scanned_sphere_is_half_covered() -> None:
    half = BALL_CLOUD[BALL_CLOUD[:, 0] < 0]
    tolerance = 1e-3
    result = coverage(half, surface_of(BALL), SPACING, tolerance=tolerance)
    x = result.samples_in_part[:, 0]
    # Beyond the border the points reach as far as the tolerance, a little less where the surface is steep.
    assert (x < 0).mean() <= result.fraction <= (x < tolerance).mean()
    assert result.fraction > (x < 0.8 * tolerance).mean()
    assert result.as_json()["tolerance_mm"] == pytest.approx(1.0)


def test_fully_scanned_sphere_is_covered_and_an_empty_cloud_covers_nothing() -> None:
    surface = surface_of(BALL)
    assert coverage(BALL_CLOUD, surface, SPACING, BALL.normals[BALL_FACE]).fraction == 1.0
    assert coverage(NOTHING, surface, SPACING).fraction == 0.0
    assert coverage(NOTHING, surface, SPACING, NOTHING).surface_fraction == 0.0


@pytest.mark.parametrize("pitch_mm", [0.5, 2.5, 4.0, 6.0, 12.0])
def test_between_distant_profiles_nothing_is_covered(pitch_mm: float) -> None:
    """A plane of 60 mm x 40 mm with profiles in the middle of equal strips: 1.5 mm to either side of each count."""
    pitch = pitch_mm * 1e-3
    plane = Mesh(0.01 * np.array([[-3.0, -2, 0], [3, -2, 0], [3, 2, 0], [-3, 2, 0]]), np.array([[0, 1, 2], [0, 2, 3]]))
    x, y = np.arange(-0.03 + pitch / 2, 0.03, pitch), np.linspace(-0.02, 0.02, 801)
    points = np.stack([np.repeat(x, len(y)), np.tile(y, len(x)), np.zeros(len(x) * len(y))], -1)
    result = coverage(points, surface_of(plane), pitch)
    assert result.fraction == pytest.approx(min(1.0, 3.0 / pitch_mm), abs=0.01)


def test_shares_are_of_the_measurable_and_of_the_whole_surface() -> None:
    surface = surface_of(BALL)
    upper = MeasurableSurface(surface.samples, surface.normals, surface.samples[:, 2] > 0, surface.area, "")
    scanned = BALL_CLOUD[(BALL_CLOUD[:, 2] > 0) & (BALL_CLOUD[:, 0] > 0)]
    result = coverage(scanned, upper, SPACING, tolerance=0.2e-3)
    assert result.measurable_fraction == pytest.approx(0.5, abs=0.01)
    assert result.fraction == pytest.approx(0.5, abs=0.02)
    assert result.surface_fraction == pytest.approx(0.25, abs=0.01)
    plain = result.as_json()
    assert plain["measurable_area_mm2"] == pytest.approx(plain["surface_area_mm2"] / 2, rel=0.02)
    assert plain["surface_area_mm2"] == pytest.approx(4e6 * np.pi * RADIUS**2, rel=0.01)
    nowhere = MeasurableSurface(surface.samples, surface.normals, np.zeros(20_000, bool), surface.area, "")
    assert np.isnan(coverage(scanned, nowhere, SPACING).fraction)
    assert coverage(scanned, nowhere, SPACING).as_json()["fraction"] is None


def test_a_thin_wall_is_not_covered_by_the_points_of_its_back() -> None:
    wall = mesh_of(trimesh.creation.box((0.05, 0.04, 0.0005)))
    surface = surface_of(wall)
    points, face = sample_surface(wall, 100_000, seed=3)
    front = wall.normals[face][:, 2] > 0.5
    result = coverage(points[front], surface, 1e-3, wall.normals[face][front])
    assert result.covered[surface.normals[:, 2] > 0.5].all()
    assert not result.covered[surface.normals[:, 2] < -0.5].any()
    unknown = np.full((int(front.sum()), 3), np.nan)
    assert coverage(points[front], surface, 1e-3, unknown).covered[surface.normals[:, 2] < -0.5].all()
    # The normals of point and surface may be 60 deg apart.
    for angle, counts in ((np.radians(55), True), (np.radians(65), False)):
        tilted = np.tile([np.sin(angle), 0.0, np.cos(angle)], (int(front.sum()), 1))
        covered = coverage(points[front], surface, 1e-3, tilted).covered[surface.normals[:, 2] > 0.5]
        assert covered.all() if counts else not covered.any()
    # Of an open mesh either side counts.
    two_sided = MeasurableSurface(surface.samples, np.full_like(surface.normals, np.nan), surface.measurable, 1.0, "")
    assert coverage(points[front], two_sided, 1e-3, wall.normals[face][front]).fraction > 0.99


@pytest.mark.parametrize("tolerance", [0.05e-3, 1.5e-3, 20e-3])
def test_covered_samples_are_those_with_a_point_within_the_tolerance(tolerance: float) -> None:
    rng = np.random.default_rng(5)
    samples, points = (rng.normal(scale=0.03, size=(n, 3)) for n in (400, 3000))
    normals, point_normals = (rng.normal(size=(n, 3)) for n in (400, 3000))
    normals, point_normals = (v / np.linalg.norm(v, axis=1, keepdims=True) for v in (normals, point_normals))
    points[:400:7] = samples[::7] + 0.9 * tolerance * point_normals[:400:7]
    points[400:800:7] = samples[::7] + 1.1 * tolerance * point_normals[400:800:7]
    points[-1] = np.nan
    near = np.linalg.norm(samples[:, None] - points, axis=2) <= tolerance
    for with_normals in (False, True):
        alike = normals @ point_normals.T >= 0.5 if with_normals else True
        found = covered_samples(samples, normals, points, point_normals if with_normals else None, tolerance, 0.5)
        assert np.array_equal(found, (near & alike).any(1))
    assert near.any(1).sum() >= 58


def test_more_points_never_lower_the_coverage() -> None:
    surface = surface_of(BALL)
    order = np.random.default_rng(1).permutation(len(BALL_CLOUD))
    found = [coverage(BALL_CLOUD[order[:n]], surface, SPACING).fraction for n in (0, 100, 1000, 10_000, 200_000)]
    assert found == sorted(found) and found[1] < found[2] < found[3]


def test_profile_spacing_is_the_travel_of_the_sheet_over_the_part() -> None:
    """Points on a cylinder that turns under a sheet through its axis: its radius times the angle."""
    angle = np.arange(720) * np.radians(0.5)
    around = np.linspace(0, 2 * np.pi, 500)
    points = np.stack([0.03 * np.cos(around), 0.03 * np.sin(around), 0 * around], -1)
    turned = pose.from_rotation(pose.rotation_about(2, angle))
    sensor = turned @ pose.from_rotation(pose.rotation_about(0, np.pi / 2), (0.0, -0.1, 0.0))
    segment = np.ones(720, np.int64)
    expected = 2 * 0.03 * np.sin(np.radians(0.25))
    assert profile_spacing(points, sensor, segment) == pytest.approx(expected, rel=1e-3)
    # Jumps between segments do not count, and single exposures count with their neighbours.
    jumping = sensor @ pose.translation(np.where(np.arange(720) % 2, 0.05, 0.0)[:, None] * [1.0, 0, 0])
    assert profile_spacing(points, jumping, np.arange(720) // 2 * 2) > 0.04
    assert profile_spacing(points, sensor, np.arange(720)) == pytest.approx(expected, rel=1e-3)
    assert profile_spacing(points, sensor[:1], segment[:1]) == 1e-3
    # Repeated exposures at one pose do not move.
    assert profile_spacing(points, np.repeat(sensor[:1], 4, 0), segment[:4]) == 1e-3


def test_one_turn_from_above_leaves_gaps_and_further_turns_add_to_it() -> None:
    settings = ["scan.raster.enabled=false", "scan.max_profiles=300", "scan.sweep.elevations_deg=[85.0]"]
    with scancell.Scanner(settings=settings, ideal=True) as scanner:
        result = scanner.scan(assets_dir() / "parts" / "step_block.stl", engine="geometric", normals=False)
    turns = np.unique(result.cloud.segment)
    clouds = [result.cloud[np.isin(result.cloud.segment, turns[: n + 1])] for n in range(len(turns))]
    found = [coverage(cloud.points_in_part, result.measurable, 1e-3) for cloud in clouds]
    shares = [each.fraction for each in found]
    assert len(turns) > 1 and 0.3 < shares[0] < 0.8
    assert shares == sorted(shares) and shares[-1] > shares[0] + 0.01
    assert all(each.measurable_area == found[0].measurable_area for each in found)
