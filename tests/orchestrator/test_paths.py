"""Scan paths: visibility of the surface for parts of various shapes, geometry of sweeps and passes, profile budget."""

import numpy as np
import pytest
import trimesh
from cells import RANGE, ball, block, mesh_of

from scancell.config.scan import ScanDescription
from scancell.config.sensor import SensorDescription
from scancell.errors import PlanningError
from scancell.geometry import pose
from scancell.planning.model import SensorRange, Work
from scancell.planning.options import Spacing, scan_options
from scancell.planning.views import paths
from scancell.planning.views.sensor_paths import SensorPath
from scancell.planning.views.views import (
    Pass,
    Sweep,
    crossing_angles,
    exposure_counts,
    lit_cosine,
    sample_part,
    seen_by,
    sweep_pose,
)

OPTIONS = scan_options(ScanDescription(sweep={"standoff_mm": 80.0}), SensorDescription.default())
ELEVATIONS = tuple(np.radians((30.0, 60.0)))


def on_table(mesh, x=0.0):
    return sample_part(mesh, pose.translation((x, 0.0, -mesh.bounds[0, 2])))


def test_range_trapezoid():
    made = SensorRange(0.075, 0.165, 0.0195, 0.036, np.zeros((1, 3)))
    assert made.half_line(0.12) == pytest.approx((0.0195 + 0.036) / 2)
    assert made.contains([0.0, 0.02, 0.035, 0.0], [0.08, 0.0751, 0.165, 0.166]).tolist() == [True, False, True, False]


def test_surface_samples_are_proportional_to_area():
    part = on_table(block(0.04, 0.06, 0.1))
    assert np.abs(np.linalg.norm(part.normals, axis=1) - 1).max() < 1e-12
    top = np.abs(part.points[:, 2] - 0.1) < 1e-12
    assert (part.normals[top] == [0, 0, 1]).all()
    share = 0.04 * 0.06 / (2 * (0.04 * 0.06 + 0.06 * 0.1 + 0.04 * 0.1))
    assert top.mean() == pytest.approx(share, abs=0.002)


def test_surface_sample_handles_inverted_and_open_meshes():
    good = block(0.04, 0.06, 0.1)
    turned = type(good)(good.vertices, good.faces[:, ::-1], "inside out")
    assert np.allclose(on_table(turned).normals, on_table(good).normals)
    lidless = type(good)(good.vertices, good.faces[2:], "open")
    assert len(on_table(lidless).points) == 2 * len(on_table(good).points)


def test_lit_cosine():
    looking_down = pose.from_rotation(np.diag([1.0, -1.0, -1.0]), (0.0, 0.0, 0.1))
    points = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, -0.07], [0.0, 0.03, 0.0], [0.0, 0.0, 0.03]])
    slope = np.array([np.sin(1.0), 0.0, np.cos(1.0)])
    normals = np.array([[0, 0, 1.0], slope, [0, 0, 1], [0, 0, 1], [0, 0, -1]])
    cosine = lit_cosine(RANGE, looking_down, points, normals)
    assert np.allclose(cosine, [1.0, np.cos(1.0), 0.0, 0.0, 0.0])  # zeros: out of range, outside the line, back-facing


def test_sweep_pose_faces_target_with_axis_in_sheet():
    target = np.array([0.03, 0.0, 0.05])
    for elevation in np.radians((0.0, 30.0, 85.0)):
        at = sweep_pose(target, elevation, 0.08)
        assert np.abs(at[:3, :3].T @ at[:3, :3] - np.eye(3)).max() < 1e-14
        assert np.linalg.det(at[:3, :3]) == pytest.approx(1.0)
        assert np.abs(at[:3, 3] + 0.08 * at[:3, 2] - target).max() < 1e-14
        # Both the axis' direction and a point of it lie in the sensor's YZ plane.
        assert at[:3, 0] @ (0.0, 0.0, 1.0) == pytest.approx(0.0, abs=1e-14)
        assert at[:3, 0] @ at[:3, 3] == pytest.approx(0.0, abs=1e-14)
        assert np.arcsin(-at[2, 2]) == pytest.approx(elevation)


@pytest.mark.parametrize(
    ("low", "high", "half", "step"), [(0, 0.01, 0.02, 0.03), (-0.1, 0.13, 0.02, 0.03), (0, 1, 0.02, 0.5)]
)
def test_tiles_cover_span(low, high, half, step):
    centres = paths.tile(low, high, half, step)
    points = np.linspace(low, high, 1001)
    assert (np.abs(points[:, None] - centres).min(1) <= half + 1e-12).all()
    assert len(centres) == 1 or np.diff(centres).max() <= min(step, 2 * half) + 1e-12


@pytest.mark.parametrize(
    "part",
    [
        on_table(ball()),
        on_table(ball(), x=0.02),
        on_table(ball(0.015), x=0.06),
        on_table(mesh_of(trimesh.creation.cylinder(0.05, 0.15))),
        on_table(mesh_of(trimesh.creation.cylinder(0.1, 0.01))),
        on_table(mesh_of(trimesh.creation.cone(0.04, 0.08))),
        on_table(ball(25e-6)),
    ],
    ids=["ball", "ball off the axis", "small ball far off", "tall cylinder", "disc", "cone", "speck"],
)
def test_views_cover_convex_parts(part):
    seen = seen_by([*paths.sweeps(part, RANGE, OPTIONS, ELEVATIONS), *paths.passes(part, RANGE, OPTIONS)], RANGE, part)
    seen |= seen_by(paths.side_sweeps(part, RANGE, OPTIONS, ELEVATIONS, seen, Work()), RANGE, part)
    # Samples with less than 65 degrees of incidence from some azimuth at 30 degrees of elevation, or from above.
    horizontal = np.hypot(part.normals[:, 0], part.normals[:, 1])
    best = horizontal * np.cos(np.radians(30)) + part.normals[:, 2] * np.sin(np.radians(30))
    visible = (best > np.cos(np.radians(65))) | (part.normals[:, 2] > np.cos(np.radians(65)))
    assert seen[visible].mean() > 0.95


def test_side_sweeps_cover_radial_walls():
    wings = [trimesh.creation.box((0.004, 0.1, 0.04)), trimesh.creation.box((0.1, 0.004, 0.04))]
    part = on_table(mesh_of(trimesh.boolean.union(wings, engine="manifold")))
    walls = (np.abs(part.normals[:, 2]) < 0.1) & (np.hypot(part.points[:, 0], part.points[:, 1]) > 0.03)
    walls &= np.hypot(part.points[:, 0], part.points[:, 1]) < 0.0495
    main = seen_by(paths.sweeps(part, RANGE, OPTIONS, ELEVATIONS), RANGE, part)
    beside = paths.side_sweeps(part, RANGE, OPTIONS, ELEVATIONS, main, Work())
    assert main[walls].mean() < 0.1
    assert (main | seen_by(beside, RANGE, part))[walls].mean() > 0.9
    assert {np.sign(view.target[1]) for view in beside} == {1.0, -1.0}


def test_points_cross_sheet_twice_per_turn():
    points = np.random.default_rng(2).uniform(-0.05, 0.05, (200, 3))
    for offset in (0.0, 0.02, -0.02):
        turned = (pose.rotation_about(2, crossing_angles(points, offset)) @ points[..., None])[..., 0]
        crossing = np.hypot(points[:, 0], points[:, 1]) > abs(offset)
        assert (np.isfinite(turned).all((0, 2)) == crossing).all()
        assert np.abs(turned[:, crossing, 1] - offset).max() < 1e-15
        assert (turned[0, crossing, 0] >= 0).all()
        assert (turned[1, crossing, 0] <= 0).all()
        assert np.abs(turned[:, crossing, 2] - points[crossing, 2]).max() < 1e-15


def test_points_lie_in_the_sheet_when_views_cross_them():
    points = np.random.default_rng(5).uniform(-0.04, 0.04, (300, 3))
    turn = np.linspace(0.0, 4 * np.pi, 121)
    spiral = np.array([pose.from_rotation(pose.rotation_about(2, a)) @ sweep_pose(np.zeros(3), 0.4, 0.1) for a in turn])
    tilted = sweep_pose(np.array([0.01, 0.0, 0.02]), 0.7, 0.09)
    views = [
        Sweep("sweep", sweep_pose(np.array([0.02, 0.01, 0.0]), 0.5, 0.1), np.zeros(3), 0.5),
        Pass("pass", tilted @ pose.translation((-0.03, 0, 0)), tilted @ pose.translation((0.03, 0, 0))),
        SensorPath("spiral", spiral, 0.1, 0.001),
    ]
    crossed = []
    for view in views:
        at = view.crossings(points)
        in_sensor = np.array([pose.transform_each(pose.inverse(one), points) for one in at])
        found = np.isfinite(in_sensor[..., 0])
        assert np.abs(in_sensor[found][:, 0]).max() < 2e-4
        crossed.append(found.sum(0))
    # A half turn brings every point into the sheet again.
    assert (crossed[0][np.hypot(points[:, 0], points[:, 1]) > 0.01] == 2).all()
    assert (crossed[2] == 4).all()


def test_straight_sensor_path_sees_what_a_pass_sees():
    part = on_table(ball())
    ends = [pose.from_rotation(np.diag([1.0, -1.0, -1.0]), (x, 0.005, 0.14)) for x in (-0.03, 0.03)]
    path = SensorPath("straight", np.stack([ends[0], ends[1]]), 0.05, 0.0005)
    seen = seen_by([path], RANGE, part)
    assert seen.any()
    assert np.array_equal(seen, seen_by([Pass("pass", *ends)], RANGE, part))


def test_passes_cover_upward_surfaces_at_all_levels():
    lower = trimesh.creation.box((0.16, 0.1, 0.01), pose.translation((0, 0, 0.005)))
    upper = trimesh.creation.box((0.03, 0.03, 0.12), pose.translation((-0.04, 0, 0.07)))
    part = on_table(mesh_of(trimesh.util.concatenate([lower, upper])))
    views = paths.passes(part, RANGE, OPTIONS)
    up = part.normals[:, 2] > 0.99
    assert len({round(view.start[2, 3], 6) for view in views}) == 2
    assert seen_by(views, RANGE, part)[up].all()


def test_passes_follow_long_side_in_alternating_directions():
    part = on_table(block(0.09, 0.03, 0.02))
    views = paths.passes(part, RANGE, OPTIONS)
    assert len(views) == 1
    assert np.allclose(views[0].start[1:3, 3], views[0].end[1:3, 3])
    assert views[0].length == pytest.approx(0.092, abs=5e-4)
    many = paths.passes(on_table(block(0.09, 0.09, 0.02)), RANGE, OPTIONS)
    travel = [np.sign(view.end[0, 3] - view.start[0, 3]) for view in many]
    assert (np.diff(travel) != 0).all()


@pytest.mark.parametrize("angle", [0.0129, 2 * np.pi / 90])
@pytest.mark.parametrize("pitch", [0.00037, 0.001])
def test_least_spacing_is_kept_by_the_nearest_number_of_exposures(angle, pitch):
    part = on_table(block(0.04, 0.06, 0.1))
    turns, lines = paths.sweeps(part, RANGE, OPTIONS, ELEVATIONS), paths.passes(part, RANGE, OPTIONS)
    counts = exposure_counts([*turns, *lines], Spacing(angle, pitch, True, True), 1_000_000)
    for count in counts[: len(turns)]:
        assert count * angle <= 2 * np.pi + 1e-9 < (count + 1) * angle + 1e-6
    for view, count in zip(lines, counts[len(turns) :], strict=True):
        assert (count - 1) * pitch <= view.length + 1e-9 < count * pitch + 1e-6


def test_budget_thins_all_views_uniformly():
    part = on_table(ball())
    views = [*paths.sweeps(part, RANGE, OPTIONS, ELEVATIONS), *paths.passes(part, RANGE, OPTIONS)]
    free = exposure_counts(views, Spacing(np.radians(1), 0.0005), 100_000)
    assert free[0] == 360
    assert free[-1] == int(np.ceil(views[-1].length / 0.0005 + 1))
    for budget in (len(views) * 2, 100, 1300):
        counts = exposure_counts(views, Spacing(np.radians(1), 0.0005), budget)
        assert sum(counts) <= budget
        assert min(counts) >= 2
    thinned = exposure_counts(views, Spacing(np.radians(1), 0.0005), 1300)
    ratios = np.array(free) / np.array(thinned)
    assert ratios.max() / ratios.min() < 1.05
    with pytest.raises(PlanningError, match=r"scan\.max_profiles = 5: 5 views need two exposures each"):
        exposure_counts(views, Spacing(1.0, 1.0), 5)
