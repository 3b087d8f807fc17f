"""Scan paths: what must be seen lies in the trapezoid, whatever the part; the budget is kept."""

import numpy as np
import pytest
import trimesh
from cells import RANGE, ball, block, mesh_of

from orchestrator.errors import PlanningError
from orchestrator.geometry import pose
from orchestrator.planning import paths, surface
from orchestrator.planning.model import SensorRange
from orchestrator.planning.options import RasterOptions, SweepOptions
from orchestrator.planning.surface import MIN_COSINE

SWEEP = SweepOptions(tuple(np.radians((30.0, 60.0))), np.radians(105), 0.08, 0.03, np.radians(1), 0.7)
RASTER = RasterOptions(0.08, 0.0005, 0.004, 0.05)


def seen_by(views, part):
    seen = np.zeros(len(part.points), bool)
    for view in views:
        if isinstance(view, paths.Sweep):
            seen |= surface.best_cosine_of_sweep(RANGE, view.at_azimuth_zero, part) > MIN_COSINE
        else:
            turned = part.turned(-view.direction)
            seen |= surface.best_cosine_of_passes(RANGE, view.start, view.end, turned) > MIN_COSINE
    return seen


def on_table(mesh, x=0.0):
    return surface.sample(mesh, pose.translation((x, 0.0, -mesh.bounds[0, 2])))


def test_range_widens_from_near_to_far():
    made = SensorRange(0.075, 0.165, 0.0195, 0.036, np.zeros((1, 3)))
    assert made.half_line(0.12) == pytest.approx((0.0195 + 0.036) / 2)
    assert made.holds([0.0, 0.02, 0.035, 0.0], [0.08, 0.0751, 0.165, 0.166]).tolist() == [True, False, True, False]


def test_samples_lie_on_the_surface_and_spread_by_area():
    part = on_table(block(0.04, 0.06, 0.1))
    assert np.abs(np.linalg.norm(part.normals, axis=1) - 1).max() < 1e-12
    top = np.abs(part.points[:, 2] - 0.1) < 1e-12
    assert (part.normals[top] == [0, 0, 1]).all()
    share = 0.04 * 0.06 / (2 * (0.04 * 0.06 + 0.06 * 0.1 + 0.04 * 0.1))
    assert top.mean() == pytest.approx(share, abs=0.002)


def test_inside_out_parts_are_turned_over_and_open_ones_have_two_sides():
    good = block(0.04, 0.06, 0.1)
    turned = type(good)(good.vertices, good.faces[:, ::-1], "inside out")
    assert np.allclose(on_table(turned).normals, on_table(good).normals)
    lidless = type(good)(good.vertices, good.faces[2:], "open")
    assert len(on_table(lidless).points) == 2 * len(on_table(good).points)


def test_light_falls_on_what_faces_the_sensor_within_range():
    looking_down = pose.from_rotation(np.diag([1.0, -1.0, -1.0]), (0.0, 0.0, 0.1))
    points = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, -0.07], [0.0, 0.03, 0.0], [0.0, 0.0, 0.03]])
    slope = np.array([np.sin(1.0), 0.0, np.cos(1.0)])
    normals = np.array([[0, 0, 1.0], slope, [0, 0, 1], [0, 0, 1], [0, 0, -1]])
    cosine = surface.lit_cosine(RANGE, looking_down, points, normals)
    assert np.allclose(cosine, [1.0, np.cos(1.0), 0.0, 0.0, 0.0])  # out of range, beside the line, facing away


def test_sweep_pose_looks_at_its_target_and_its_sheet_holds_the_axis():
    target = np.array([0.03, 0.0, 0.05])
    for elevation in np.radians((0.0, 30.0, 85.0)):
        at = paths.sweep_pose(target, elevation, 0.08)
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
def test_tiles_cover_the_span_with_steps_as_asked(low, high, half, step):
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
def test_sweeps_see_convex_parts_wherever_the_light_can_fall(part):
    seen = seen_by([*paths.sweeps(part, RANGE, SWEEP), *paths.passes(part, RANGE, RASTER)], part)
    seen |= seen_by(paths.side_sweeps(part, RANGE, SWEEP, seen), part)
    # From every side at 30 to 90 degrees of elevation, light within 70 degrees of the normal reaches these.
    horizontal = np.hypot(part.normals[:, 0], part.normals[:, 1])
    best = horizontal * np.cos(np.radians(30)) + part.normals[:, 2] * np.sin(np.radians(30))
    visible = (best > np.cos(np.radians(65))) | (part.normals[:, 2] > np.cos(np.radians(65)))
    assert seen[visible].mean() > 0.95


def test_walls_that_point_at_the_axis_need_a_sheet_beside_it():
    wings = [trimesh.creation.box((0.004, 0.1, 0.04)), trimesh.creation.box((0.1, 0.004, 0.04))]
    part = on_table(mesh_of(trimesh.boolean.union(wings, engine="manifold")))
    walls = (np.abs(part.normals[:, 2]) < 0.1) & (np.hypot(part.points[:, 0], part.points[:, 1]) > 0.03)
    walls &= np.hypot(part.points[:, 0], part.points[:, 1]) < 0.0495
    main = seen_by(paths.sweeps(part, RANGE, SWEEP), part)
    beside = paths.side_sweeps(part, RANGE, SWEEP, main)
    assert main[walls].mean() < 0.1
    assert (main | seen_by(beside, part))[walls].mean() > 0.9
    assert {np.sign(view.target[1]) for view in beside} == {1.0, -1.0}


def test_points_cross_the_sheet_twice_where_it_reaches_them():
    points = np.random.default_rng(2).uniform(-0.05, 0.05, (200, 3))
    for offset in (0.0, 0.02, -0.02):
        turned = (surface.crossings(points, offset) @ points[..., None])[..., 0]
        crossing = np.hypot(points[:, 0], points[:, 1]) > abs(offset)
        assert (np.isfinite(turned).all((0, 2)) == crossing).all()
        assert np.abs(turned[:, crossing, 1] - offset).max() < 1e-15
        assert (turned[0, crossing, 0] >= 0).all()
        assert (turned[1, crossing, 0] <= 0).all()
        assert np.abs(turned[:, crossing, 2] - points[crossing, 2]).max() < 1e-15


def test_passes_see_everything_that_faces_up_at_every_level():
    lower = trimesh.creation.box((0.16, 0.1, 0.01), pose.translation((0, 0, 0.005)))
    upper = trimesh.creation.box((0.03, 0.03, 0.12), pose.translation((-0.04, 0, 0.07)))
    part = on_table(mesh_of(trimesh.util.concatenate([lower, upper])))
    views = paths.passes(part, RANGE, RASTER)
    up = part.normals[:, 2] > 0.99
    assert len({round(view.start[2, 3], 6) for view in views}) == 2
    assert seen_by(views, part)[up].all()


def test_passes_run_along_the_long_side_and_turn_round_each_time():
    part = on_table(block(0.09, 0.03, 0.02))
    views = paths.passes(part, RANGE, RASTER)
    assert len(views) == 1
    assert views[0].direction == pytest.approx(0.0)
    assert views[0].length == pytest.approx(0.092, abs=5e-4)
    many = paths.passes(on_table(block(0.09, 0.09, 0.02)), RANGE, RASTER)
    travel = [np.sign(view.end[0, 3] - view.start[0, 3]) for view in many]
    assert (np.diff(travel) != 0).all()


def test_budget_is_kept_and_thins_everything_alike():
    part = on_table(ball())
    views = [*paths.sweeps(part, RANGE, SWEEP), *paths.passes(part, RANGE, RASTER)]
    free = paths.fit_budget(views, np.radians(1), 0.0005, 100_000)
    assert free[0] == 360
    assert free[-1] == int(np.ceil(views[-1].length / 0.0005 + 1))
    for budget in (len(views) * 2, 100, 1300):
        counts = paths.fit_budget(views, np.radians(1), 0.0005, budget)
        assert sum(counts) <= budget
        assert min(counts) >= 2
    thinned = paths.fit_budget(views, np.radians(1), 0.0005, 1300)
    ratios = np.array(free) / np.array(thinned)
    assert ratios.max() / ratios.min() < 1.05
    with pytest.raises(PlanningError, match="max_profiles = 5 is too few"):
        paths.fit_budget(views, 1.0, 1.0, 5)
