"""python-fcl as the judge of finished plans: what it finds, what it passes over, and that plans ask it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from cells import block, planning_cell

from scancell.config.loading import load_setup
from scancell.errors import PlanningError
from scancell.geometry import pose
from scancell.geometry.mesh import box_mesh
from scancell.nominal.cell import with_table
from scancell.planning.motion import assembly
from scancell.planning.options import scan_options
from scancell.planning.planner import plan
from scancell.proximity.judge import Judge

MESHES = {"a": box_mesh((0.1, 0.1, 0.1), "a"), "b": box_mesh((0.2, 0.02, 0.02), "b"), "c": box_mesh((1, 1, 1), "c")}
NAMES = ("a", "b", "c")
# b begins 1 m away from a, inside c.
START = np.stack([np.eye(4), pose.translation((0.0, 0.3, 0.3)), np.eye(4)])
JUDGE = Judge(MESHES, NAMES, START)


def poses(b: np.ndarray) -> np.ndarray:
    """a at the origin, b at poses (n, 4, 4), c through everything."""
    rest = np.broadcast_to(np.eye(4), b.shape)
    return np.stack([rest, b, rest], 1)


def test_the_first_colliding_pose_is_found() -> None:
    way = np.array([pose.translation((0.0, y, 0.0)) for y in np.linspace(0.2, 0.0, 38)])
    clash = JUDGE.first_collision(poses(way))
    assert clash is not None
    assert (clash.body_a, clash.body_b) == ("a", "b")
    # Half of the edges add up to 0.06.
    assert way[clash.index, 1, 3] < 0.06 <= way[clash.index - 1, 1, 3] + 1e-9


def test_turned_bodies_that_pass_closely_do_not_collide() -> None:
    turned = pose.from_rotation(pose.rotation_about(2, np.radians(np.arange(0, 360, 5))))
    beside = turned @ pose.translation((0.0, 0.082, 0.0))  # the corners of a are 0.0707 from the axis
    assert JUDGE.first_collision(poses(beside)) is None
    nearer = turned @ pose.translation((0.0, 0.078, 0.0))
    assert JUDGE.first_collision(poses(nearer)) is not None


def test_bodies_that_move_together_are_checked_once() -> None:
    way = np.array([pose.translation((0.01 * k, 0.0, 0.0)) for k in range(5)])
    clash = JUDGE.first_collision(np.stack([way, way @ pose.translation((0.0, 0.05, 0.0)), way], 1))
    assert clash is not None
    assert clash.index == 0


def test_a_plan_that_collides_is_refused_by_the_judge() -> None:
    """A planner that takes the straight way down through the part is caught by python-fcl alone."""
    cell = planning_cell(block(0.05, 0.04, 0.03))
    setup = load_setup(settings=["scan.max_profiles=60"])
    options = scan_options(setup.scan, setup.sensor)
    made = plan(cell, options)
    assert made.program.segments
    # The same program with the table where it was and the arm 100 mm lower.
    lower = pose.translation((0.0, 0.0, -0.1))

    def lowered(axes: np.ndarray) -> np.ndarray:
        q = axes[:, :-1]
        sunk = lower @ cell.support_from_sensor(q)
        return with_table(cell.ik(sunk, reference=q, filtered=False)[:, 0], axes[:, -1])

    segment = next(s for s in made.program.segments if s.trigger.kind == "table_angle")
    bad = replace(made.program, segments=(replace(segment, axes=lowered(segment.axes)),))
    with pytest.raises(PlanningError, match=rf"python-fcl finds that \w+ hits \w+ in segment {segment.id}"):
        assembly.verified(cell, options, replace(made, program=bad))
    assert (
        assembly.verified(
            cell, scan_options(setup.scan.replace(verify=False), setup.sensor), replace(made, program=bad)
        ).program
        is bad
    )
