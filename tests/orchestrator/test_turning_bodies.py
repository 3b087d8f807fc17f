"""Bodies that turn with the table against bodies that stand still: pairs, bounds, plans, the judge, the FMU's pairs."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations, pairwise
from pathlib import Path

import numpy as np
import pytest
import trimesh
from cells import CYCLE, RANGE, mesh_of
from fcl_collisions import path_collisions
from planned_motion import setpoints

from scancell.cell.fmu_file import sensing_json
from scancell.config.loading import assets_dir, load_setup
from scancell.errors import PlanningError
from scancell.geometry import pose
from scancell.geometry.mesh import Mesh
from scancell.nominal.cell import NominalCell, nominal_cell
from scancell.nominal.parts import Body
from scancell.planning.model import PlanningCell
from scancell.planning.motion import assembly
from scancell.planning.motion.connection import Connector
from scancell.planning.options import scan_options
from scancell.planning.planner import plan
from scancell.proximity.judge import Judge
from scancell.proximity.motion_check import MotionBounds, MotionCheck
from scancell.proximity.scene import cell_scene, moving_pairs

Array = np.ndarray


def box(low: tuple[float, ...], high: tuple[float, ...]) -> trimesh.Trimesh:
    return trimesh.creation.box(bounds=[low, high])


def bracket() -> Mesh:
    """A C that is open towards +x: its back, and two arms at y = ±50 to ±60 mm."""
    arms = [box((-0.04, y - 0.005, 0.0), (0.06, y + 0.005, 0.03)) for y in (-0.055, 0.055)]
    return mesh_of(trimesh.util.concatenate([box((-0.05, -0.06, 0.0), (-0.04, 0.06, 0.03)), *arms]))


@pytest.fixture
def hook(tmp_path: Path) -> str:
    """A rod that hangs into the opening of the bracket: 12 mm square, 50 mm from the axis, 10 mm above the table."""
    file = tmp_path / "hook.stl"
    box((494.0, -6.0, 110.0), (506.0, 6.0, 200.0)).export(file)
    return f'cell.obstacle=[{{ name = "hook", mesh = "{file}" }}]'


def cell_with(*settings: str) -> PlanningCell:
    return PlanningCell(nominal_cell(load_setup(settings=[*settings]).cell, bracket()), RANGE, CYCLE)


def changing(nominal: NominalCell) -> set[frozenset[str]]:
    """Pairs of bodies whose relative pose changes between random poses of joints and table."""
    lower, upper = nominal.arm.limits
    rng = np.random.default_rng(3)
    poses = nominal.body_poses(np.column_stack([rng.uniform(lower, upper, (8, len(lower))), rng.uniform(0, 6, 8)]))
    found = set()
    for (i, a), (k, b) in combinations(enumerate(nominal.bodies), 2):
        relative = pose.inverse(poses[:, i]) @ poses[:, k]
        if np.ptp(relative, axis=0).max() > 1e-9:
            found.add(frozenset((a.name, b.name)))
    return found


@pytest.mark.parametrize("name", ["default", "pick_and_place", "seven_axis"])
def test_pairs_are_those_whose_relative_pose_changes(name: str, hook: str) -> None:
    nominal = nominal_cell(load_setup(cell=assets_dir() / "cells" / f"{name}.toml", settings=[hook]).cell, bracket())
    pairs = set(map(frozenset, moving_pairs(nominal)))
    links = ["base", *(f"link{i}" for i in range(1, len(nominal.arm.joints) + 1))]
    neighbours = {frozenset(pair) for pair in pairwise(links)} | {frozenset(("table", "table_base"))}
    assert pairs == changing(nominal) - neighbours
    assert {frozenset(("part", "hook")), frozenset(("table", "hook"))} <= pairs
    assert frozenset(("base", "hook")) not in pairs


def test_what_is_carried_by_a_link_is_no_longer_on_the_table(hook: str) -> None:
    """A body that a gripper holds is a body of the arm: the pairs follow from the frame that carries it."""
    nominal = cell_with(hook).nominal
    held = [replace(b, moves_with="link[6]") if b.name == "part" else b for b in nominal.bodies]
    pairs = set(map(frozenset, moving_pairs(replace(nominal, bodies=tuple(held)))))
    assert {frozenset(("part", "table")), frozenset(("part", "hook")), frozenset(("part", "link3"))} <= pairs
    assert frozenset(("part", "sensor")) not in pairs


def test_measured_space_is_compared_with_the_part_and_not_with_itself() -> None:
    nominal = cell_with().nominal
    voxel = mesh_of(box((0.3, -0.01, 0.1), (0.32, 0.01, 0.12)))
    measured = [
        Body(f"occupied[{i}]", frame, voxel, nominal.bodies[0].material) for i, frame in ((1, "world"), (2, "table"))
    ]
    pairs = set(map(frozenset, moving_pairs(replace(nominal, bodies=(*nominal.bodies, *measured)))))
    assert frozenset(("part", "occupied[1]")) in pairs
    assert frozenset(("base", "occupied[2]")) in pairs
    assert not {frozenset(("occupied[1]", "occupied[2]")), frozenset(("base", "occupied[1]"))} & pairs


def test_bound_on_the_motion_of_the_table_holds_for_every_point(hook: str) -> None:
    nominal = cell_with(hook).nominal
    pairs = [("part", "hook"), ("hook", "part"), ("table", "hook")]
    at = np.append(nominal.home, 0.3)
    for half in (0.01, 0.2, 1.0):
        bound = MotionBounds(nominal, pairs).straight(at[None], np.append(np.zeros(6), half)[None], np.zeros((1, 7)))[0]
        frames = [nominal.frame_poses([*nominal.home, 0.3 + half * f]) for f in np.linspace(-1, 1, 41)]
        meshes = {body.name: body for body in nominal.bodies}
        for (a, b), limit in zip(pairs, bound, strict=True):
            body = meshes[a if a != "hook" else b]
            points = [pose.transform_points(frame[body.moves_with], body.mesh.vertices) for frame in frames]
            moved = np.linalg.norm(np.array(points) - points[20], axis=-1).max()
            assert 0.5 * limit < moved <= limit


def test_jog_of_the_table_into_an_obstacle_is_found(hook: str) -> None:
    cell = cell_with(hook)
    check = MotionCheck(cell.nominal, cell.proximity, 0.0)
    start = np.append(cell.nominal.home, 0.0)
    (clash,) = check.first_clashes(start, start + np.append(np.zeros(6), 2.0))
    assert clash is not None
    assert {clash.body_a, clash.body_b} == {"part", "hook"}
    # A corner of an arm is 60 mm from the axis, the hook spans 44 to 56 mm.
    assert check.first_clashes(start, start + np.append(np.zeros(6), 0.3)) == [None]


@pytest.mark.parametrize("mode", ["dynamic", "stop-and-look"])
def test_plan_turns_no_part_through_an_obstacle(hook: str, mode: str) -> None:
    cell = cell_with(hook)
    setup = load_setup(settings=["scan.max_profiles=60", "scan.max_lost_share=1.0", f'scan.mode="{mode}"'])
    made = plan(cell, scan_options(setup.scan, setup.sensor))
    assert any("the table cannot turn" in warning and "hook" in warning for warning in made.warnings)
    assert not path_collisions(cell, setpoints(made)[::2])


def test_judge_finds_the_part_in_the_hook_whatever_the_planner_compares(hook: str) -> None:
    """A plan of the cell without the hook turns the part: python-fcl refuses it in the cell with the hook."""
    setup = load_setup(settings=["scan.max_profiles=60"])
    options = scan_options(setup.scan, setup.sensor)
    made, cell = plan(cell_with(), options), cell_with(hook)
    cell.__dict__["proximity"] = cell.proximity.without(set(map(frozenset, cell.proximity.pairs)))
    with pytest.raises(PlanningError, match=r"python-fcl finds that .*hook"):
        assembly.verified(cell, options, made)


def test_judge_compares_all_that_moves_but_what_touches_at_the_start(hook: str) -> None:
    nominal = cell_with(hook).nominal
    meshes = {body.name: body.mesh for body in nominal.bodies}
    judge = Judge(meshes, tuple(meshes), nominal.body_poses(nominal.home))
    pairs = set(map(frozenset, judge.pairs))
    assert changing(nominal) - pairs <= {frozenset((f"link{i}", f"link{i + 1}")) for i in range(1, 6)} | {
        frozenset(("base", "link1")), frozenset(("link6", "link5"))
    }  # fmt: skip
    assert frozenset(("table", "part")) not in pairs


@pytest.mark.parametrize(("fixture", "arrives"), [("clamped", False), ("free", False), ("free", True)])
def test_pairs_of_the_fmu(fixture: str, arrives: bool, hook: str) -> None:
    words = [hook, f'cell.part.fixture="{fixture}"']
    if arrives:
        words += [
            'cell.conveyor=[{ name = "belt", pose = { x_mm = 450.0, y_mm = -400.0, z_mm = 100.0 },'
            " length_mm = 400.0, width_mm = 90.0 }]",
            'cell.part.arrival={ stands_on = "conveyor[1]" }',
        ]
    setup = load_setup(settings=words)
    nominal = nominal_cell(setup.cell, bracket())
    pairs = {frozenset(pair) for pair in sensing_json(setup.cell, nominal)["collision"]["pairs"]}
    assert {frozenset(("part", "hook")), frozenset(("table", "hook")), frozenset(("part", "sensor"))} <= pairs
    assert not {frozenset(("part", "table")), frozenset(("part", "belt"))} & pairs


def test_platter_that_slides_on_its_bearing_is_no_pair(tmp_path: Path) -> None:
    """A ring under the platter touches it at every angle: in contact by construction. A part is never excepted."""
    ring = trimesh.creation.annulus(0.03, 0.05, 0.02)
    ring.apply_translation((0.45, 0.0, cell_with().nominal.bodies[8].mesh.bounds[0, 2] + 0.1 - 0.01))
    file = tmp_path / "ring.stl"
    ring.apply_scale(1e3).export(file)
    nominal = nominal_cell(
        load_setup(settings=[f'cell.obstacle=[{{ name = "ring", mesh = "{file}" }}]']).cell, bracket()
    )
    pairs = {frozenset(pair) for pair in cell_scene(nominal, {b.name: b.mesh for b in nominal.bodies}).pairs}
    assert frozenset(("table", "ring")) not in pairs
    assert frozenset(("part", "ring")) in pairs


@pytest.mark.parametrize("clearance", [0.0, 5.0])
def test_thin_fin_is_planned_at_any_clearance(clearance: float) -> None:
    """A fin of 1 mm passes between table angles at which a turn is sampled."""
    fin = mesh_of(box((-0.0005, -0.06, 0.0), (0.0005, 0.06, 0.18)))
    setup = load_setup(settings=[f"scan.clearance_mm={clearance}", "scan.max_profiles=40", "scan.max_lost_share=1.0"])
    cell = PlanningCell(nominal_cell(setup.cell, fin), RANGE, CYCLE)
    made = plan(cell, scan_options(setup.scan, setup.sensor))
    assert made.coverage > 0.4
    assert not path_collisions(cell, setpoints(made))


def test_view_without_a_free_motion_is_left_out_by_name(monkeypatch) -> None:
    setup = load_setup(settings=["scan.max_profiles=60"])
    options, connect = scan_options(setup.scan, setup.sensor), Connector.connect
    whole = plan(cell_with(), options)
    first = next(segment.name for segment in whole.program.segments if segment.trigger.kind == "table_angle")

    def blocked(self: Connector, start: Array, end: Array, purpose: str) -> list[Array]:
        if purpose in refused:
            raise PlanningError(f"no collision-free path to {purpose}: blocked")
        return connect(self, start, end, purpose)

    monkeypatch.setattr(Connector, "connect", blocked)
    refused = {first}
    made = plan(cell_with(), options)
    assert f"omitted: no collision-free path to {first}: blocked" in made.warnings
    assert first not in {segment.name for segment in made.program.segments}
    assert 0 < made.coverage <= whole.coverage
    refused = {segment.name for segment in whole.program.segments}
    with pytest.raises(PlanningError, match=r"no view of the part can be taken: .*omitted: no collision-free path"):
        plan(cell_with(), options)
