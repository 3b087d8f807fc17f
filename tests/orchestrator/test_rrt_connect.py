"""Search of joint space, where retreat points and the home position do not lead around an obstacle."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from cells import block, planning_cell

from scancell.config.material import Material
from scancell.errors import PlanningError
from scancell.geometry import pose
from scancell.geometry.mesh import box_mesh
from scancell.nominal.parts import Body
from scancell.planning.model import MOTION_SHARE, PlanningCell
from scancell.planning.motion.connection import Connector, RrtConnect

CLEARANCE = 0.005
DOWN = np.diag([1.0, -1.0, -1.0, 1.0])


@pytest.fixture(scope="module")
def walled() -> PlanningCell:
    """A wall in front of the arm, 1.2 m high, instead of the table: the arm gets past it only by folding up."""
    cell = planning_cell(block(0.04, 0.03, 0.02))
    wall = box_mesh((0.7, 0.01, 1.2)).transformed(pose.translation((0.7, 0.0, 0.5)))
    arm = [item for item in cell.nominal.bodies if item.name not in ("table", "table_base", "part")]
    return replace(cell, nominal=replace(cell.nominal, bodies=(*arm, body("wall", wall))))


def body(name: str, mesh) -> Body:
    return Body(name, "world", mesh, Material(0.3))


def looking_down(cell: PlanningCell, x: float, y: float, z: float) -> np.ndarray:
    """Joints nearest to home, and the table at 0."""
    nominal = cell.nominal
    world_from_flange = pose.translation((x, y, z)) @ DOWN @ pose.inverse(nominal.flange_from_sensor)
    q = nominal.arm.ik(world_from_flange[None], nominal.home)[0]
    return np.append(q[np.nanargmin(np.abs(q - nominal.home).max(-1))], 0.0)


@pytest.fixture(scope="module")
def ends(walled) -> tuple[np.ndarray, np.ndarray]:
    """Either side of the wall."""
    return looking_down(walled, 0.4, 0.25, 0.3), looking_down(walled, 0.4, -0.25, 0.3)


def test_retreat_points_and_home_do_not_lead_past_the_wall(walled, ends, monkeypatch) -> None:
    monkeypatch.setattr(RrtConnect, "path", lambda *_: None)
    with pytest.raises(PlanningError, match=r"no collision-free path to the other side: .*wall.* on the direct path"):
        Connector(walled, CLEARANCE).connect(*ends, "the other side")


def test_start_within_the_clearance_is_named(walled, ends) -> None:
    start = looking_down(walled, 0.4, 0.0, 0.3)  # in the wall
    with pytest.raises(PlanningError, match=r"path to the other side: .*wall.* at the start; move away first"):
        Connector(walled, CLEARANCE).connect(start, ends[1], "the other side")


def test_search_is_tried_from_either_end(walled, ends, monkeypatch) -> None:
    """Trees that start at the other end are other trees."""
    start, goal = ends
    found = {start[0]: None, goal[0]: [goal, 0.5 * (start + goal), start]}
    monkeypatch.setattr(RrtConnect, "path", lambda _, one, other: found[one[0]])
    path = np.concatenate(Connector(walled, CLEARANCE).connect(start, goal, "the other side"))
    np.testing.assert_allclose(path[[0, -1]], ends, atol=1e-12)


def test_search_leads_past_the_wall(walled, ends) -> None:
    motions = Connector(walled, CLEARANCE).connect(*ends, "the other side")
    assert len(motions) >= 2
    path = np.concatenate(motions)
    np.testing.assert_allclose(path[0], ends[0], atol=1e-12)
    np.testing.assert_allclose(path[-1], ends[1], atol=1e-12)
    assert walled.nominal.arm.within_limits(path[:, :-1]).all()
    # Every 0.2 degrees at most.
    steps = [max(2, int(np.ceil(np.abs(b - a).max() / np.radians(0.2)))) for a, b in pairwise(path)]
    fine = np.concatenate([np.linspace(a, b, n) for (a, b), n in zip(pairwise(path), steps, strict=True)])
    distance = walled.proximity.distances(walled.nominal.body_poses(fine), 0.02)
    assert (distance >= MOTION_SHARE * walled.clearances(CLEARANCE) - 1e-9).all()


def search(cell: PlanningCell, **options: int) -> RrtConnect:
    lower, upper = cell.nominal.arm.limits
    return RrtConnect(cell.motion_check(CLEARANCE), np.append(lower, 0.0), np.append(upper, 0.0), **options)


def test_same_seed_gives_the_same_path(walled, ends) -> None:
    first, second = (search(walled, seed=3).path(*ends) for _ in range(2))
    assert first is not None
    assert second is not None
    np.testing.assert_array_equal(first, second)


def test_path_in_free_space_is_straight() -> None:
    cell = planning_cell(block(0.04, 0.03, 0.02))
    start = np.append(cell.nominal.home, 0.0)
    end = start + np.radians([30.0, -5.0, 5.0, 10.0, 0.0, 20.0, 0.0])
    path = search(cell).path(start, end)
    assert path is not None
    assert len(path) == 2


def test_goal_behind_walls_on_all_sides_is_not_reached(walled, ends) -> None:
    """The sensor stands in a box without a lid that is too narrow for it to get out."""
    goal = ends[1]
    x, y, z = walled.nominal.world_from_sensor(goal[:-1])[:3, 3]
    floor = box_mesh((0.4, 0.4, 0.01)).transformed(pose.translation((x, y, z - 0.05)))
    lid = box_mesh((0.4, 0.4, 0.01)).transformed(pose.translation((x, y, z + 0.9)))
    sides = [
        box_mesh(size).transformed(pose.translation((x + dx, y + dy, z + 0.425)))
        for size, dx, dy in (((0.01, 0.4, 0.95), 0.2, 0), ((0.4, 0.01, 0.95), 0, -0.2), ((0.4, 0.01, 0.95), 0, 0.2))
    ]
    bodies = [body(f"side{i}", mesh) for i, mesh in enumerate([floor, lid, *sides])]
    nominal = replace(walled.nominal, bodies=(*walled.nominal.bodies, *bodies))
    cell = replace(walled, nominal=nominal)
    assert search(cell, iterations=40).path(*ends) is None
