"""Contact of the arm's bodies and of the floor: they stop, carry and push."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from cell_fixture import (
    CYCLE_US,
    Array,
    Build,
    CellFmu,
    box_hull,
    box_part,
    cell_description,
    collision,
    conveyor,
    pose,
)
from test_fmu_dynamic_arm import dynamic_cell

from scancell.cell.fmu_file import mesh_json

MAX_TORQUE = 150.0
TOOL_SIZE = (0.04, 0.04, 0.1)
CLEARANCE = 0.03
CORNERS = np.array([[x, y, z, 1.0] for x in (-0.02, 0.02) for y in (-0.02, 0.02) for z in (0.0, 0.1)])
MANUAL, AUTOMATIC = 0, 1
JOG = 5
EMERGENCY_STOP = 3


def slab(top: float) -> dict[str, Any]:
    """A box of 4 m x 4 m x 0.2 m with its top face at this height."""
    return box_hull(4.0, 4.0, 0.2, base=top - 0.2)


def tool_height(cell: CellFmu) -> float:
    """Height of the lowest corner of the tool."""
    return float((CORNERS @ cell.body("link[6]").T)[:, 2].min())


@pytest.fixture
def floor_height(build: Build) -> float:
    return tool_height(build()) - CLEARANCE


def with_floor(cell: dict[str, Any], floor: float, stops_arm: bool = False, **pair: Any) -> dict[str, Any]:
    """The cell with a tool on the flange and a floor, whose contact the keyword arguments describe."""
    bodies = [("tool", "link[6]", box_hull(*TOOL_SIZE)), ("floor", "world", slab(floor))]
    contact = {"bodies": [{"name": n, "frame": frame, "hull": hull} for n, frame, hull in bodies]}
    if pair:
        contact["pairs"] = [{"bodies": ["tool", "floor"], "points": 4, "response": True, **pair}]
    return {
        **cell,
        "contact": {**cell["contact"], **contact},
        "bodies": [{"name": n, "frame": frame, "mesh": hull} for n, frame, hull in bodies],
        "collision": collision(("tool", "floor"), stops_arm=stops_arm),
    }


def jog_down(cell: CellFmu, cycles: int) -> Array:
    """Heights of the tool after each controller cycle of a jog along world -z."""
    cell.command(mode=JOG)
    cell.set("command.operation", MANUAL)
    cell.set("command.jog[3]", -1.0)
    heights = []
    for _ in range(cycles):
        cell.step(CYCLE_US)
        heights.append(tool_height(cell))
    return np.array(heights)


def test_floor_stops_arm_with_dynamic_drives_at_its_torque_limits(build: Build, floor_height: float) -> None:
    cell = build(3, with_floor(dynamic_cell(max_torque=MAX_TORQUE), floor_height))
    heights = jog_down(cell, 60)
    assert heights.min() > floor_height - 1e-3
    assert heights[-20:].max() < floor_height + 1e-3
    assert np.abs(cell.vector("measured.torque", 6)).max() == pytest.approx(MAX_TORQUE)
    passing = build(3, with_floor(dynamic_cell(max_torque=MAX_TORQUE), floor_height, response=False))
    while passing.time_us < 60 * CYCLE_US and tool_height(passing) > floor_height - 0.02:
        jog_down(passing, 1)
    assert tool_height(passing) < floor_height - 0.02
    assert passing.get_int("truth.collision.pairs") == 1


def test_kinematic_arm_passes_through_floor_and_collision_is_reported(build: Build, floor_height: float) -> None:
    cell = build(3, with_floor(cell_description(), floor_height))
    heights = jog_down(cell, 30)
    assert heights[-1] < floor_height - 0.02
    assert cell.get_int("truth.collision.pairs") == 1


def test_collision_stops_kinematic_arm_on_request(build: Build, floor_height: float) -> None:
    cell = build(3, with_floor(cell_description(), floor_height, stops_arm=True))
    heights = jog_down(cell, 60)
    assert cell.get_int("controller.state") == EMERGENCY_STOP
    # At most two cycles of travel at the jog speed, and the braking distance of the slowest axis.
    speed, braking = 0.25, 20.0
    assert floor_height - heights.min() < 2 * speed * CYCLE_US * 1e-6 + speed**2 / (2 * 0.3 * braking)
    assert np.ptp(heights[-20:]) == 0


def test_reset_arm_in_a_collision_moves_away_but_no_deeper(build: Build, floor_height: float) -> None:
    """Each attempt to go deeper ends 0.1 mm, two cycles from rest and the braking distance further down."""
    cell = build(3, with_floor(cell_description(), floor_height, stops_arm=True))
    depths = [floor_height - jog_down(cell, 60)[-1]]
    for attempt in range(1, 6):
        reset(cell, attempt)
        cell.step(CYCLE_US, 10)
        assert cell.get_int("controller.state") == 0  # at rest in the collision
        depths.append(floor_height - jog_down(cell, 40)[-1])
        assert cell.get_int("controller.state") == EMERGENCY_STOP
    gained, acceleration = np.diff(depths), 0.8
    assert np.all(gained > 0)
    assert np.all(gained < 1e-4 + 2 * acceleration * (3 * CYCLE_US * 1e-6) ** 2)
    reset(cell, 6)
    cell.command(mode=JOG)
    cell.set("command.jog[3]", 1.0)
    for _ in range(60):
        cell.step(CYCLE_US)
        assert cell.get_int("controller.state") != EMERGENCY_STOP
    assert cell.get_int("truth.collision.pairs") == 0


def reset(cell: CellFmu, count: int) -> None:
    cell.command(mode=0)
    cell.set("command.jog[3]", 0.0)
    cell.set("command.reset", count)
    cell.step(CYCLE_US, 2)


def prism(sides: int, radius: float, height: float) -> dict[str, Any]:
    """Hull of an upright prism on a regular polygon."""
    angle = 2 * np.pi * np.arange(sides) / sides
    vertices = [[radius * np.cos(a), radius * np.sin(a), z] for z in (0.0, height) for a in angle]
    faces = [[0, i + 1, i] for i in range(1, sides - 1)] + [
        [sides, sides + i, sides + i + 1] for i in range(1, sides - 1)
    ]
    for i in range(sides):
        k = (i + 1) % sides
        faces += [[i, k, sides + k], [i, sides + k, sides + i]]
    return mesh_json(vertices, faces)


@pytest.mark.parametrize("support", ["world", "conveyor[1]"])
def test_sixty_prisms_of_48_sides_load_and_rest(build: Build, support: str) -> None:
    """Several thousand contact points in a step; each prism rests on four of its own."""
    hull, corner = prism(48, 0.02, 0.03), {"world": [-0.6, 0.5], "conveyor[1]": [-1.0, -0.1]}[support]
    description = {**cell_description(), "time_step_us": 4000}
    description["conveyors"] = [conveyor(length=4.0, width=0.5)]
    description["contact"]["bodies"] = [{"name": "floor", "frame": "world", "hull": slab(0.0)}]
    description["parts"] = [
        box_part(0.04, 0.04, 0.03, name=f"prism {k}", fixture="free", stands_on=support, hull=hull,
                 support_from_part=pose([corner[0] + 0.06 * (k % 20), corner[1] + 0.06 * (k // 20), 0.0]))
        for k in range(60)
    ]  # fmt: skip
    cell = build(3, description)
    names = [f"truth.part[{k}].position[{i}]" for k in range(1, 61) for i in (1, 2, 3)]
    before = cell.get(*names).reshape(60, 3)
    cell.set("command.conveyor[1].speed", 0.2)
    cell.step(CYCLE_US, 12)
    moved = cell.get(*names).reshape(60, 3) - before
    travel = cell.get("conveyor[1].travel")[0] if support == "conveyor[1]" else 0.0
    np.testing.assert_allclose(moved, np.tile([travel, 0, 0], (60, 1)), atol=1e-6)
    assert cell.get_int("truth.contact.truncated") == 0


def box_corners(cell: CellFmu) -> Array:
    """Corners (8, 3) of the box of `cell_description`, 60 mm x 40 mm x 50 mm, in the world."""
    corners = np.array([[x, y, z, 1.0] for x in (-0.03, 0.03) for y in (-0.02, 0.02) for z in (0.0, 0.05)])
    return (corners @ cell.body("part[1]").T)[:, :3]


def test_part_that_falls_off_a_belt_lies_on_the_floor(build: Build) -> None:
    description = cell_description(fixture="free", stands_on="conveyor[1]", support_from_part=pose([0.5, 0, 0]))
    description["conveyors"] = [conveyor()]
    floor = {"name": "floor", "frame": "world", "hull": slab(0.0)}
    description["contact"] = {**description["contact"], "bodies": [floor]}
    cell = build(3, description)
    cell.set("command.conveyor[1].speed", 0.3)
    cell.step(CYCLE_US, 190)
    assert abs(box_corners(cell)[:, 2].min()) < 0.5e-3
    before = box_corners(cell)
    cell.step(CYCLE_US, 30)
    np.testing.assert_allclose(box_corners(cell), before, atol=1e-5)


def test_kinematic_arm_pushes_free_part(build: Build) -> None:
    """The tool moves horizontally against a box, which slides along in front of it."""
    corners = (CORNERS @ build().body("link[6]").T)[:, :3]
    bottom = corners[:, 2].min() - 0.02
    place = [corners[:, 0].max() + 0.04, corners[:, 1].mean(), bottom]
    description = cell_description(fixture="free", stands_on="world", support_from_part=pose(place))
    tool = ("tool", "link[6]", box_hull(*TOOL_SIZE))
    bodies = [{"name": n, "frame": f, "hull": hull} for n, f, hull in (tool, ("floor", "world", slab(bottom)))]
    description["contact"]["bodies"] = bodies
    meshes = (tool, ("box", "part[1]", box_hull(0.06, 0.04, 0.05)))
    description["bodies"] = [{"name": n, "frame": f, "mesh": mesh} for n, f, mesh in meshes]
    description["collision"] = collision(("tool", "box"))
    cell = build(3, description)
    start = cell.body("part[1]")[0, 3]
    cell.command(mode=JOG)
    cell.set("command.operation", MANUAL)
    cell.set("command.jog[1]", 0.4)
    clearance, depth = [], []
    for _ in range(60):
        cell.step(CYCLE_US)
        clearance.append(float(cell.get("truth.clearance.distance")[0]))
        depth.append(float(cell.get("truth.collision.depth")[0]))
    assert clearance[0] > 5e-3
    assert cell.body("part[1]")[0, 3] > start + 0.03
    assert max(clearance[-20:]) < 2e-3
    assert max(depth) < 1e-3
