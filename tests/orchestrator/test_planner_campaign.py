"""A small run of the planner's campaign: concave parts among hooks and posts, each kind of part once."""

from __future__ import annotations

import numpy as np
import pytest

from bench.plain_planner import PlainPlanner, judged
from bench.planner_campaign import KINDS, Row, make_cell, run_cell
from scancell.cell.program import Program, Segment
from scancell.planning.plan import Plan

SEEDS = {"bracket": 0, "ring": 5, "fin": 2, "hooked bar": 3}  # default arm, seven axes (twice), gripper


@pytest.mark.parametrize("kind", KINDS)
def test_plans_of_concave_parts_among_obstacles_have_no_contact(kind: str) -> None:
    row: Row = run_cell(SEEDS[kind], step=5e-3, view_seconds=0.0, motion_seconds=0.0, profiles=40)
    assert row.kind == kind
    assert row.contact == ""
    assert row.outcome == "planned" or "cannot turn" in row.reason


def test_judge_shifts_bodies_towards_each_other_by_their_errors() -> None:
    _, _, _, _, cell = make_cell(8)  # a hook in the world
    start = np.append(cell.nominal.home, 0.0)
    axes = start + np.array([0.0, 0.01, 0.02])[:, None] * np.eye(len(start))[-1]
    times = cell.cycle * np.arange(3)
    program = Program((Segment(1, times, axes, name="turn"),))
    made = Plan(program, np.zeros(0, np.int64), axes[:0], None, ())
    apart = judged(cell.nominal, made, 1e-3, {})
    assert apart.contact == "" and apart.poses > 3
    shifted = judged(cell.nominal, made, 1e-3, {"part": 0.2, "hook": 0.2})
    assert "hook" in shifted.contact and shifted.margin < 0


def test_plain_planner_finds_a_free_motion_and_none_from_a_contact() -> None:
    _, _, clearance, _, cell = make_cell(0)
    plain = PlainPlanner(cell.nominal, cell.range, clearance, clearance)
    start = np.append(cell.nominal.home, 0.0)
    goal = start + np.append(0.1, np.zeros(len(start) - 1))
    path = plain.finds_motion(start, goal, 5.0)
    assert path is not None and np.allclose(path[0], start) and np.allclose(path[-1], goal)
    lower, upper = cell.nominal.arm.limits
    q = np.random.default_rng(0).uniform(lower, upper, (300, len(lower)))
    hit = next(at for at in np.column_stack([q, np.zeros(len(q))]) if not plain.is_free(at, clearance))
    assert plain.finds_motion(start, hit, 5.0) is None
