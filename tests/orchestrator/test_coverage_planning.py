"""Coverage-driven views: what `Sight` sees, against the geometric engine, and the choice, against enumeration."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import combinations

import numpy as np
import pytest
import trimesh
from cells import CYCLE, RANGE, block, mesh_of
from scipy.spatial import cKDTree

from scancell import sensor as sensor_rt
from scancell.config.files import assets_dir
from scancell.config.loading import load_setup
from scancell.errors import DescriptionError, PlanningError
from scancell.geometry import pose
from scancell.geometry.mesh import Mesh, load_mesh
from scancell.nominal.cell import nominal_cell
from scancell.nominal.parts import load_part
from scancell.planning.model import PlanningCell, Work
from scancell.planning.options import ScanOptions, scan_options
from scancell.planning.views.coverage import (
    GRAZING,
    OCCLUDED,
    OUT_OF_RANGE,
    SEEN,
    CoveragePlanner,
    Sight,
    _least_time,
    legs,
)
from scancell.planning.views.views import Pass, Shift, Sweep, Turn, sample_part, sweep_pose
from scancell.scanner import Scanner
from scancell.scanning.world import make_sensor
from scancell.visibility import MeasurableSurface, measurable_surface

BLOCK = block(0.05, 0.04, 0.03)
SAMPLES = 3000


def table_shape() -> Mesh:
    """A plate on a pillar: the foot is under a roof."""
    boxes = [((0.06, 0.06, 0.004), 0.002), ((0.01, 0.01, 0.03), 0.015), ((0.06, 0.06, 0.004), 0.032)]
    made = [trimesh.creation.box(size, pose.translation((0, 0, z))) for size, z in boxes]
    return mesh_of(trimesh.boolean.union(made, engine="manifold"))


def sight_of(part: Mesh, *words: str, samples: int = SAMPLES) -> tuple[PlanningCell, Sight]:
    setup = load_setup(settings=words)
    cell = PlanningCell(nominal_cell(setup.cell, part), RANGE, CYCLE)
    return cell, Sight(cell.nominal, setup.sensor, lambda n, s: measurable_surface(n, s, samples))


def options_of(*words: str) -> ScanOptions:
    setup = load_setup(settings=("scan.coverage.enabled=true", *words))
    return scan_options(setup.scan, setup.sensor)


def overhead(length: float, height: float = 0.13) -> Pass:
    ends = [pose.from_rotation(np.diag([1.0, -1.0, -1.0]), (x, 0.0, height)) for x in (-length / 2, length / 2)]
    return Pass("over the top", *ends)


def test_work_of_a_view_is_in_proportion_to_its_samples() -> None:
    setup = load_setup()
    nominal, spent = nominal_cell(setup.cell, BLOCK), []
    for samples in (500, 1000):
        work = Work()
        sight = Sight(nominal, setup.sensor, lambda n, s, k=samples: measurable_surface(n, s, k), work=work)
        before = work.spent
        sight.judge_at(np.tile(overhead(0.06).start, (len(sight.points), 1, 1)), np.arange(len(sight.points)))
        spent.append((work.spent - before) / len(sight.points))
    assert spent[0] > 0
    assert spent[1] == pytest.approx(spent[0])


def test_pass_over_a_block_sees_its_top_within_the_line_and_its_sides_at_grazing_incidence() -> None:
    _, sight = sight_of(BLOCK)
    judged = sight.judge(overhead(0.06))
    top = sight.normals[:, 2] > 0.9
    within = np.abs(sight.points[:, 1]) < 0.02
    assert (judged[top & within] == SEEN).all()
    # Along y the sides are parallel to the sheet; the others face neither laser nor camera.
    assert (judged[~top] <= GRAZING).all()
    short = sight.judge(overhead(0.02))
    assert (short[np.abs(sight.points[:, 0]) > 0.01] == OUT_OF_RANGE).all()
    assert (sight.judge(overhead(0.06, 0.4)) == OUT_OF_RANGE).all()


def test_roof_occludes_what_it_covers() -> None:
    _, sight = sight_of(table_shape())
    foot = (sight.normals[:, 2] > 0.9) & (sight.points[:, 2] < 0.01)
    under = foot & (np.abs(sight.points[:, :2]) < 0.025).all(1)
    judged = sight.judge(overhead(0.06))
    assert under.sum() > 20
    assert (judged[under] == OCCLUDED).all()
    slanted = sweep_pose(np.array([0.025, 0.0, 0.004]), np.radians(25), 0.1)
    aside = Pass("below the roof", *(slanted @ pose.translation((x, 0, 0)) for x in (-0.02, 0.02)))
    assert (sight.judge(aside)[foot] == SEEN).any()


@cache
def _machined() -> tuple[PlanningCell, Sight]:
    return sight_of(load_mesh(assets_dir() / "parts/machined.stl", "mm"))


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_seen_samples_match_the_geometric_engine(seed: int) -> None:
    cell, sight = _machined()
    rng = np.random.default_rng(seed)
    everything = np.arange(len(sight.points))
    (leg,) = legs(sight, everything, 1, 1, rng)
    mesh = cell.nominal.part.transformed(cell.nominal.table_from_part)
    scene = sensor_rt.Scene()
    scene.add_mesh("part", mesh.vertices, mesh.faces, 0.5)
    count = max(2, int(leg.view.length / 0.1e-3))
    poses = leg.view.at(np.linspace(0, leg.view.length, count))
    still = np.broadcast_to(np.eye(4), (count, 1, 1, 4, 4))
    exposures = sensor_rt.Exposures(poses[:, None], still, np.full(count, 1e-6), np.arange(count))
    sensor = make_sensor(load_setup(ideal=True).sensor, 0)
    profiles = sensor_rt.scan(scene, sensor, exposures, "geometric").profiles
    points = pose.transform_each(poses[profiles.frame], profiles.points_in_sensor)
    near = sensor_rt.covered_samples(sight.points, sight.normals, points, None, 0.4e-3, 0.5)
    seen = leg.judged == SEEN
    assert seen.sum() > 10
    assert near[seen].mean() > 0.99
    assert near[leg.judged == OUT_OF_RANGE].mean() < 0.02
    # What the engine measures within 70 degrees for laser and camera is judged as seen.
    distance, nearest = cKDTree(sight.points).query(points)
    optics = np.concatenate([np.zeros((1, 3)), sight.optics.cameras])
    seen_from = (optics[0 * profiles.camera], optics[1 + profiles.camera])
    ends = np.stack([pose.transform_each(poses[profiles.frame], at) for at in seen_from])
    rays = ends - points
    cosine = (rays * sight.normals[nearest]).sum(-1) / np.linalg.norm(rays, axis=-1)
    good = (cosine > np.cos(np.radians(70))).all(0) & (distance < 0.3e-3)
    assert good.sum() > 100
    assert seen[nearest[good]].mean() > 0.98


def test_choice_sees_the_share_and_its_report_adds_up() -> None:
    cell, sight = sight_of(BLOCK)
    part = sample_part(cell.nominal.part, cell.nominal.table_from_part)
    views, report = CoveragePlanner(cell, sight, options_of()).choose(part, 5000)
    seen = np.any([sight.judge(placed.view) == SEEN for placed, _ in views], axis=0)
    assert report.share >= 0.99
    assert seen.mean() == pytest.approx(report.share)
    assert sum(report.unseen.values()) == pytest.approx(1 - report.share)
    assert 0 < report.least_time <= report.time
    assert 1 <= report.greedy_factor <= 1 + np.log(len(sight.points))
    assert report.views == len(views)
    assert report.measurable_area == pytest.approx(2 * 0.03 * 0.09 + 0.05 * 0.04, rel=0.01)


def test_share_and_budget_limit_the_choice() -> None:
    cell, sight = sight_of(BLOCK, samples=1000)
    part = sample_part(cell.nominal.part, cell.nominal.table_from_part)
    half = CoveragePlanner(cell, sight, options_of("scan.coverage.share=0.5")).choose(part, 5000)[1]
    quick = CoveragePlanner(cell, sight, options_of("scan.coverage.max_time_s=4")).choose(part, 5000)[1]
    assert 0.5 <= half.share < 0.99
    assert quick.time <= 4
    for report in (half, quick):
        assert any("budget" in reason for reason in report.unseen)
    sweeps_only, _ = CoveragePlanner(cell, sight, options_of("scan.raster.enabled=false")).choose(part, 5000)
    assert sweeps_only
    assert not any(isinstance(placed.view, Pass) for placed, _ in sweeps_only)


def test_exposures_are_thinned_to_the_largest_number() -> None:
    cell, sight = sight_of(BLOCK)
    part = sample_part(cell.nominal.part, cell.nominal.table_from_part)
    views, _ = CoveragePlanner(cell, sight, options_of()).choose(part, 100)
    assert sum(count for _, count in views) <= 100
    with pytest.raises(PlanningError, match=r"scan\.max_profiles = 3: \d+ views need two exposures each"):
        CoveragePlanner(cell, sight, options_of()).choose(part, 3)


def test_least_time_is_a_bound_that_enumeration_confirms() -> None:
    """No set of random candidates sees the goal in less; for disjoint candidates of equal density it is exact."""
    rng = np.random.default_rng(4)
    for _ in range(30):
        seen, time = rng.random((7, 40)) < 0.3, rng.uniform(1, 5, 7)
        goal = int(0.8 * seen.any(0).sum())
        sets = [list(c) for k in range(1, 8) for c in combinations(range(7), k)]
        best = min(time[c].sum() for c in sets if seen[c].any(0).sum() >= goal)
        assert _least_time(seen.sum(1), time, goal) <= best + 1e-12
    assert _least_time(np.array([10, 10, 10]), np.array([1.0, 2.0, 4.0]), 20) == pytest.approx(3.0)
    assert _least_time(np.array([10, 10, 10]), np.array([1.0, 2.0, 4.0]), 15) == pytest.approx(2.0)


def test_poses_of_the_grid_measure_hard_samples() -> None:
    _, sight = _machined()
    rng = np.random.default_rng(0)
    rows = rng.choice(len(sight.points), 40, replace=False)
    found, poses = sight.search.poses(sight.rows[rows], 3)
    assert set(found) <= set(sight.rows[rows])
    assert len(set(found)) > 35
    assert np.bincount(found).max() <= 3
    sample_of = np.searchsorted(sight.rows, found)
    in_sensor = pose.transform_each(pose.inverse(poses), sight.points[sample_of])
    assert np.abs(in_sensor[:, 0]).max() < 1e-6
    assert (sight.judge_at(poses, sample_of) == SEEN).mean() > 0.97


def test_part_without_measurable_surface_is_refused() -> None:
    cell, _ = sight_of(BLOCK)
    setup = load_setup()

    def nothing(nominal: object, sensor: object) -> MeasurableSurface:
        found = measurable_surface(cell.nominal, setup.sensor, 100)
        return replace(found, measurable=np.zeros_like(found.measurable))

    part = sample_part(cell.nominal.part, cell.nominal.table_from_part)
    with pytest.raises(PlanningError, match="nothing of the part is measurable"):
        CoveragePlanner(cell, Sight(cell.nominal, setup.sensor, nothing), options_of()).choose(part, 1000)
    near = sight_of(BLOCK)[1]
    far = sight_of(BLOCK, "cell.table.pose.x_mm=3000")[0]
    with pytest.raises(PlanningError, match=r"no feasible view of the part: .*out of the arm's reach"):
        CoveragePlanner(far, near, options_of()).choose(part, 1000)


def test_coverage_without_any_kind_of_view_is_refused() -> None:
    with pytest.raises(DescriptionError, match="enable sweep or raster"):
        options_of("scan.sweep.enabled=false", "scan.raster.enabled=false", "scan.path=[]")


@pytest.mark.parametrize("seed", range(4))
def test_sheet_of_a_sensor_in_any_pose_passes_over_the_points_at_their_crossings(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = rng.uniform(-0.05, 0.05, (200, 3))
    at = pose.from_euler_xyz(rng.uniform(-0.1, 0.1, 3), rng.uniform(-np.pi, np.pi, 3))
    end = pose.translation(rng.uniform(-0.1, 0.1, 3)) @ at
    for view in (Turn(at), Shift(at, end)):
        crossings = view.crossings(points)
        for way in crossings:
            met = np.isfinite(way[:, 0, 3])
            across = pose.transform_each(pose.inverse(way[met]), points[met])[:, 0]
            assert np.abs(across).max(initial=0.0) < 1e-12
            if isinstance(view, Turn):  # the same sensor at another angle of the table
                assert way[met, 2] == pytest.approx(np.broadcast_to(at[2], (met.sum(), 4)))
        # What is not met lies on one side of the sheet at both ends, or nearer to the axis than the sheet.
        if isinstance(view, Shift):
            sides = [pose.transform_points(pose.inverse(one), points)[:, 0] > 0 for one in (at, end)]
            assert np.array_equal(np.isfinite(crossings[0, :, 0, 3]), sides[0] != sides[1])
        else:
            turned = [points @ pose.rotation_about(2, a).T for a in np.linspace(0, 2 * np.pi, 721)]
            sides = np.array([pose.transform_points(pose.inverse(at), one)[:, 0] > 0 for one in turned])
            changes = (sides[1:] != sides[:-1]).any(0)
            assert (np.isfinite(crossings[..., 0, 3]).all(0) == changes).mean() > 0.98


def test_sensor_at_the_place_of_the_main_one_sees_what_that_one_sees() -> None:
    twin = {"name": "twin", "moves_with": "link[6]", "pose": {"z_mm": 80.0}}
    setup = load_setup(load_setup().cell.replace({"further_sensor": [twin]}))
    nominal = nominal_cell(setup.cell, load_part(assets_dir() / "parts/step_block.stl"))
    sight = Sight(nominal, setup.sensor, lambda n, s: measurable_surface(n, s, 400), beside=[setup.sensor])
    sweep = Sweep("sweep", sweep_pose(np.array([0.0, 0.0, 0.02]), np.radians(45.0), 0.1), np.zeros(3), 0.0)
    above = pose.from_rotation(pose.rotation_about(0, np.pi), (0.0, 0.0, 0.11))
    leg = Pass("leg", pose.translation((-0.03, 0.0, 0.0)) @ above, pose.translation((0.03, 0.0, 0.0)) @ above)
    for view in (sweep, leg):
        seen = sight.judge(view) == SEEN
        assert 0 < seen.sum() < len(seen)
        assert np.array_equal(sight.judge_beside(view) == SEEN, seen), view.name
    without = Sight(nominal, setup.sensor, lambda n, s: measurable_surface(n, s, 400), beside=[None])
    assert not (without.judge_beside(sweep) == SEEN).any()


def test_surface_that_a_sensor_on_a_post_sees_in_a_sweep_is_measured_by_it() -> None:
    settings = {"scan.max_profiles": 400, "scan.raster.enabled": False, "scan.sweep.elevations_deg": [45.0]}
    part = assets_dir() / "parts/machined.stl"
    with Scanner(assets_dir() / "cells/two_sensors.toml", settings=settings, ideal=True) as scanner:
        result = scanner.scan(part, engine="geometric")
        setup, nominal = scanner.setup, nominal_cell(scanner.setup.cell, load_part(part))
    other = setup.seen_by(2).sensor
    sight = Sight(nominal, setup.sensor, lambda n, s: measurable_surface(n, s, 800), beside=[other])
    leg = pose.from_rotation(pose.rotation_about(0, np.pi), (0.0, 0.0, 0.11))
    assert not (sight.judge_beside(Pass("leg", leg, pose.translation((0.03, 0.0, 0.0)) @ leg)) == SEEN).any()
    judged = sight.judge_beside(Sweep("sweep", sweep_pose(np.zeros(3), 0.8, 0.1), np.zeros(3), 0.8))
    cloud = pose.transform_points(nominal.table_from_part, result.cloud.points_in_part[result.cloud.sensor == 2])
    away = cKDTree(cloud).query(sight.points)[0]
    # Less than a millimetre from one profile to the next.
    assert (away[judged == SEEN] < 1.5e-3).mean() > 0.97
    assert (away[judged != SEEN] < 0.3e-3).mean() < 0.1
