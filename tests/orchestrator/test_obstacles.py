"""Obstacles in the description of a cell: bodies of planner, ray tracer and FMU, known or not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from cells import CYCLE, RANGE

from mesh_json import read_mesh_json
from scancell.cell.fmu_file import cell_json
from scancell.config.loading import load_setup
from scancell.errors import CellError, DescriptionError, MeshError
from scancell.geometry.mesh import box_mesh
from scancell.nominal.cell import nominal_cell
from scancell.planning.model import MOTION_SHARE, PlanningCell
from scancell.planning.options import pair_clearances
from scancell.scanner import Scanner

BLOCK = box_mesh((0.04, 0.03, 0.02), "block")
POST = '{ name = "post", mesh = "post.stl", pose = { x_mm = 300.0, y_mm = 150.0, z_mm = 100.0 } }'


@pytest.fixture(autouse=True)
def in_folder_of_post(tmp_path, monkeypatch):
    trimesh.creation.box((20.0, 20.0, 200.0)).export(tmp_path / "post.stl")
    monkeypatch.chdir(tmp_path)


def cell_with(obstacle: str):
    return load_setup(settings=[f"cell.obstacle=[{obstacle}]"]).cell


def test_known_obstacle_is_a_body_at_its_pose() -> None:
    body = nominal_cell(cell_with(POST), BLOCK).bodies[-1]
    assert (body.name, body.moves_with) == ("post", "world")
    np.testing.assert_allclose(body.mesh.bounds, [[0.29, 0.14, 0.0], [0.31, 0.16, 0.2]], atol=1e-9)


def test_obstacle_on_the_table_turns_with_it() -> None:
    on_table = POST.replace('"post.stl",', '"post.stl", moves_with = "table",').replace("x_mm = 300.0", "x_mm = 50.0")
    nominal = nominal_cell(cell_with(on_table.replace("y_mm = 150.0", "y_mm = 0.0")), BLOCK)
    before, after = (nominal.body_poses([*nominal.home, angle])[-1] for angle in (0.0, np.pi / 2))
    top = np.append(nominal.bodies[-1].mesh.vertices.max(0), 1.0)
    axis = nominal.world_from_table[:3, 3]
    turned = (after @ top)[:3] - axis
    np.testing.assert_allclose(turned, np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]]) @ ((before @ top)[:3] - axis))


def test_planning_keeps_the_clearance_of_the_obstacle() -> None:
    own = POST.replace("}", "}, clearance_mm = 30.0", 1)
    near = {}
    for obstacle in (POST, own):
        cell = PlanningCell(nominal_cell(cell_with(obstacle), BLOCK), RANGE, CYCLE)
        required = dict(zip(map(frozenset, cell.proximity.pairs), cell.clearances(0.005), strict=True))
        near[obstacle] = required[frozenset(("sensor", "post"))]
        assert required[frozenset(("sensor", "table"))] == 0.005
    assert near == {POST: 0.005, own: 0.03}


def test_pair_has_a_clearance_of_its_own() -> None:
    words = [
        f"cell.obstacle=[{POST}]",
        'scan.pair_clearance=[{ bodies = ["table", "sensor"], clearance_mm = 20.0 },'
        ' { bodies = ["sensor", "link3"], clearance_mm = 10.0 }]',
    ]
    setup = load_setup(settings=words)
    nominal = nominal_cell(setup.cell, BLOCK)
    cell = PlanningCell(nominal, RANGE, CYCLE, pair_clearance=pair_clearances(setup.scan, nominal))
    names = list(map(frozenset, cell.proximity.pairs))
    ranges = dict(zip(names, cell.clearance_ranges(0.005, 0.05, 0.01).tolist(), strict=True))
    assert ranges[frozenset(("sensor", "table"))] == pytest.approx([0.02, 0.05])
    assert ranges[frozenset(("sensor", "link3"))] == pytest.approx([0.01, 0.02])
    assert ranges[frozenset(("sensor", "post"))] == pytest.approx([0.005, 0.05])


@pytest.mark.parametrize("bodies", [("sensor", "tabel"), ("sensor", "sensor")])
def test_wrong_pair_is_refused(bodies) -> None:
    words = f'scan.pair_clearance=[{{ bodies = ["{bodies[0]}", "{bodies[1]}"], clearance_mm = 20.0 }}]'
    message = rf"pair_clearance\[1\].bodies = .*{bodies[1]}.*: expected two of base"
    with Scanner(setup=load_setup(settings=[words])) as scanner, pytest.raises(DescriptionError, match=message):
        scanner.plan(BLOCK)


def test_motion_15_mm_above_a_post_is_free_unless_the_post_needs_30_mm() -> None:
    post = POST.replace("x_mm = 300.0, y_mm = 150.0, z_mm = 100.0", "x_mm = 310.0, y_mm = 400.0, z_mm = 200.0")
    own = post.replace("}", "}, clearance_mm = 30.0", 1)
    cells = [PlanningCell(nominal_cell(cell_with(item), BLOCK), RANGE, CYCLE) for item in (post, own)]
    start = np.append(cells[0].nominal.home, 0.0)
    end = start + np.radians([35.0, 0, 0, 0, 0, 0, 0])
    near, clash = (cell.motion_check(0.005).first_clashes(start, end)[0] for cell in cells)
    assert near is None
    assert clash is not None
    assert {clash.body_a, clash.body_b} == {"sensor", "post"}
    assert clash.clearance == pytest.approx(MOTION_SHARE * 0.03)


def test_unknown_obstacle_is_in_scene_and_fmu_but_not_in_planning() -> None:
    setup = load_setup(settings=[f"cell.obstacle=[{POST.replace('}', '}, known = false', 1)}]"])
    with Scanner(setup=setup) as scanner:
        world = scanner.pipeline.load(setup, BLOCK)
    assert "post" not in [body.name for body in world.nominal.bodies]
    assert "post" in [body.name for body in world.bodies]
    description = world.for_fmu(collision_outputs=True)
    assert [body["frame"] for body in description["bodies"] if body["name"] == "post"] == ["world"]
    assert ["sensor", "post"] in description["collision"]["pairs"]
    assert replace(world.true, bodies=world.true.bodies[:-1]) == world.nominal


def test_obstacle_is_a_contact_shape_when_parts_move_freely() -> None:
    cell = cell_with(POST).replace({"part.fixture": "free"})
    contact = cell_json(cell, nominal_cell(cell, BLOCK), 0)["contact"]["bodies"]
    (hull,) = [body["hull"] for body in contact if body["name"] == "post"]
    np.testing.assert_allclose(read_mesh_json(hull)[0].min(0), [0.29, 0.14, 0.0], atol=1e-9)


def test_obstacle_that_reaches_into_the_table_is_refused() -> None:
    setup = load_setup(settings=[f"cell.obstacle=[{POST.replace('300.0', '450.0').replace('150.0', '0.0')}]"])
    with Scanner(setup=setup) as scanner, pytest.raises(CellError, match=r"'table.*' and 'post' intersect"):
        scanner.plan(BLOCK)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (POST.replace('"post"', '"table"'), "the name 'table' is taken"),
        (POST.replace("post.stl", "fence.stl"), r"obstacle\[1\].mesh = 'fence.stl': no such file"),
        (POST.replace('"post",', '"post", moves_with = "part",'), "moves_with = 'part': expected world, table"),
        (POST.replace("300.0", "nan"), "x_mm = nan: must be a finite number"),
        (POST.replace("}", "}, clearance_mm = -1", 1), "clearance_mm = -1"),
    ],
)
def test_wrong_obstacle_is_refused_by_key_and_value(wrong, message) -> None:
    with pytest.raises(DescriptionError, match=message):
        cell_with(wrong)


def test_broken_mesh_of_an_obstacle_is_refused_by_file(tmp_path) -> None:
    (tmp_path / "post.stl").write_text("no mesh")
    with pytest.raises(MeshError, match=r"post\.stl: not a readable STL mesh: it begins with .no mesh.") as caught:
        nominal_cell(cell_with(POST), BLOCK)
    assert str(tmp_path / "post.stl") in str(caught.value)
