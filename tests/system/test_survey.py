"""Survey of a cell that holds a post of which its description for planning knows nothing."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
import trimesh
from commands import scancell_here

from scancell.cell.driver import Driver
from scancell.config.loading import assets_dir, load_setup
from scancell.config.sensor import exposure_span
from scancell.errors import DescriptionError, PlanningError
from scancell.planning.plan import Plan
from scancell.planning.space_map import read_voxels
from scancell.proximity.scene import cell_scene
from scancell.scanner import Scanner
from scancell.scanning.survey import SurveyResult

PART = assets_dir() / "parts" / "step_block.stl"
SIDE, TOP = 0.006, 0.15  # m: edge of the post, and its height above the table
BESIDE = (0.0, 0.145)  # m from the axis of the table, whose radius is 120 mm


@pytest.fixture(scope="module")
def post(tmp_path_factory) -> str:
    """The description of the post, from the floor to its top."""
    file = tmp_path_factory.mktemp("survey") / "post.stl"
    trimesh.creation.box((1e3 * SIDE, 1e3 * SIDE, 250.0)).export(file)
    x, y = 450.0 + 1e3 * BESIDE[0], 1e3 * BESIDE[1]
    pose = f"{{ x_mm = {x}, y_mm = {y}, z_mm = 125.0 }}"
    return f'cell.obstacle=[{{ name = "post", mesh = "{file}", known = false, pose = {pose} }}]'


@pytest.fixture(scope="module")
def scanner(post) -> Iterator[Scanner]:
    with Scanner(setup=load_setup(settings=[post])) as opened:
        yield opened


@pytest.fixture(scope="module")
def found(scanner) -> SurveyResult:
    return scanner.survey(PART)


@pytest.fixture(scope="module")
def knowing(found, post, tmp_path_factory) -> Iterator[Scanner]:
    """A scanner in the same cell that plans with the survey."""
    file = found.save(tmp_path_factory.mktemp("voxels") / "survey.npz")
    with Scanner(setup=load_setup(settings=[post, f'scan.occupied=[{{ file = "{file}" }}]'])) as opened:
        yield opened


def in_post(points: np.ndarray, margin: float) -> np.ndarray:
    """Whether points in the frame of the table lie in the post, grown by a margin (m)."""
    across = np.abs(points[..., :2] - BESIDE).max(-1) <= SIDE / 2 + margin
    return across & (points[..., 2] <= TOP + margin)


def test_survey_finds_the_post_and_nothing_else(found) -> None:
    space, voxel = found.space, found.region.voxel
    occupied = space.grid.centres[space.occupied & space.region]
    assert len(occupied) >= 1
    assert in_post(occupied, voxel).all()


def test_all_of_the_post_in_the_surveyed_space_is_blocked(found) -> None:
    inside = np.random.default_rng(0).uniform(
        [*np.subtract(BESIDE, SIDE / 2), 0.0], [*np.add(BESIDE, SIDE / 2), TOP], (20_000, 3)
    )
    voxels = tuple(found.space.grid.index(inside).T)
    surveyed = found.space.region[voxels]
    assert surveyed.mean() > 0.9
    assert found.grids["fixed"].occupied[voxels][surveyed].all()


def test_most_of_the_space_is_seen(found) -> None:
    volumes = found.volumes
    whole = found.space.region.sum() * found.region.voxel**3
    assert sum(volumes.values()) == pytest.approx(whole)
    assert volumes["free"] > 0.9 * whole
    assert volumes["occupied"] < 0.005 * whole


def test_space_above_the_platter_is_also_blocked_where_the_table_turns_it(found) -> None:
    fixed, table = found.grids["fixed"], found.grids["table"]
    over = np.linalg.norm(fixed.centres[..., :2], axis=-1) <= found.table_radius
    np.testing.assert_array_equal(table.occupied, fixed.occupied & over)


def distance_to_post(scanner: Scanner, *plans: Plan) -> float:
    """Smallest distance of arm and sensor from the post over all set-points, m, up to 50 mm."""
    true = scanner.pipeline.load(scanner.setup, scanner.load_part(PART)).true
    scene = cell_scene(true, {body.name: body.mesh for body in true.bodies})
    of_post = np.array(["post" in pair for pair in scene.pairs])
    segments = [segment for plan in plans for segment in plan.program.segments]
    poses = true.body_poses(np.concatenate([s.axes for s in segments]))
    return float(scene.distances(poses, np.where(of_post, 0.05, 0.0))[:, of_post].min())


def collisions_in_fmu(scanner: Scanner, plan: Plan) -> int:
    """Largest number of pairs of bodies that collide at a time while the FMU executes the plan."""
    world = scanner.pipeline.load(scanner.setup, scanner.load_part(PART))
    cell = scanner.pipeline.runner.start(world, collision_outputs=True)
    pairs = [0]
    cell.on_step(lambda: pairs.append(cell.get_integer("truth.collision.pairs")))
    cycle_us = scanner.setup.cell.world.controller_cycle_us
    Driver(cell, cycle_us, exposure_span(scanner.setup.sensor)).run(plan.program)
    assert len(pairs) > len(plan.q)
    return max(pairs)


def test_plan_with_the_survey_avoids_the_post_that_the_plan_without_hits(scanner, knowing) -> None:
    blind, aware = scanner.plan(PART), knowing.plan(PART)
    assert distance_to_post(scanner, blind) == 0.0
    assert distance_to_post(knowing, aware) > 0.004
    assert collisions_in_fmu(scanner, blind) > 0
    assert collisions_in_fmu(knowing, aware) == 0
    assert aware.coverage is not None
    assert aware.coverage > 0.9 * (blind.coverage or 0.0)


def test_unknown_clamp_on_the_table_is_avoided_while_the_table_turns(tmp_path) -> None:
    """The survey sees it at one angle of the table; a scan turns it past the sensor."""
    trimesh.creation.box((20.0, 20.0, 99.0)).export(tmp_path / "clamp.stl")
    clamp = f'name = "post", mesh = "{tmp_path / "clamp.stl"}", moves_with = "table", known = false'
    words = [f"cell.obstacle=[{{ {clamp}, pose = {{ x_mm = 95.0, z_mm = 50.0 }} }}]"]
    with Scanner(setup=load_setup(settings=words)) as scanner:
        file = scanner.survey(PART, pitch=0.01).save(tmp_path / "survey.npz")
        blind = scanner.plan(PART)
        words.append(f'scan.occupied=[{{ file = "{file}" }}]')
        with Scanner(setup=load_setup(settings=words)) as knowing:
            aware = knowing.plan(PART)
        assert distance_to_post(scanner, blind) == 0.0
        assert distance_to_post(scanner, aware) > 0.004


def test_survey_itself_touches_nothing(scanner, monkeypatch) -> None:
    """All motions of the survey in the true cell, post included."""
    driven: list[Plan] = []
    drive = scanner.pipeline.drive

    def note(request, plan, *rest):
        driven.append(plan)
        return drive(request, plan, *rest)

    monkeypatch.setattr(scanner.pipeline, "drive", note)
    scanner.survey(PART, voxel=0.02, pitch=0.02)
    assert len(driven) >= 2
    assert distance_to_post(scanner, *driven) > 0.004


def test_survey_refuses_wrong_sizes(scanner) -> None:
    with pytest.raises(DescriptionError, match=r"voxel = 0\.0: expected a finite number above 0"):
        scanner.survey(PART, voxel=0.0)
    with pytest.raises(DescriptionError, match=r"pitch = 0\.02: expected at most voxel \(0\.01\)"):
        scanner.survey(PART, pitch=0.02)
    with pytest.raises(DescriptionError, match="radius = nan"):
        scanner.survey(PART, radius=float("nan"))


def test_survey_beyond_the_reach_of_the_arm_is_refused(scanner) -> None:
    with pytest.raises(PlanningError, match="no pose of the survey can be reached"):
        scanner.survey(PART, height=1.0, radius=0.05)


def test_command_writes_voxels_and_states_volumes(post, tmp_path) -> None:
    file = tmp_path / "out" / "survey.npz"
    done = scancell_here(
        "survey", PART, "--set", post, "--voxel-mm", "20", "--pitch-mm", "20", "--out", file, "--json", cwd=tmp_path
    )
    assert done.code == 0, done.err
    volumes = done.last_line["figures"]["volumes_m3"]
    voxels = read_voxels(file)
    blocked = voxels["fixed"].occupied.sum() * 0.02**3
    assert set(voxels) == {"fixed", "table"}
    assert blocked >= volumes["occupied"] + volumes["unseen"] > 0
    assert [path.name for path in file.parent.iterdir()] == ["survey.npz"]
