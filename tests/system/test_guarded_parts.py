"""Parts that the gripper moves under a guard: where the guard places them, and what they may come near."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import trimesh

from scancell.config.loading import assets_dir, load_setup
from scancell.errors import CommandError
from scancell.geometry import pose
from scancell.geometry.mesh import box_mesh
from scancell.scanner import Scanner

SCRIPT = Path(__file__).parents[2] / "docs/examples/pick_and_place.py"
CELL = assets_dir() / "cells/pick_and_place.toml"
PART = assets_dir() / "parts/step_block.stl"
JOINTS = 6


@pytest.fixture(scope="module")
def example() -> Iterator[object]:
    spec = importlib.util.spec_from_file_location("pick_and_place", SCRIPT)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["pick_and_place"] = module
    spec.loader.exec_module(module)
    yield module


def test_part_is_where_the_guard_places_it_from_belt_to_table(example) -> None:
    """On the belt, in the gripper and on the table within the 2 mm that two bodies may be off; nothing stops."""
    setup = load_setup(CELL)
    with Scanner(setup=setup) as scanner, scanner.session(PART, guarded=True) as session:
        task = example.PickAndPlace(setup, session.nominal)
        truth = session.cell.real_group(
            [
                *(f"truth.part[1].position[{i}]" for i in (1, 2, 3)),
                *(f"truth.part[1].orientation[{i}]" for i in (1, 2, 3, 4)),
            ]
        )
        off: dict[int, list[float]] = {}
        stops = 0

        def compare() -> None:
            nonlocal stops
            stops += session.cell.get_boolean("command.emergency_stop")
            placed = session._guarded.state().parts
            if not placed:
                return
            (part,) = placed
            joints, table = session.joints, session.table_angle
            carrier = {0: np.eye(4), JOINTS: session.nominal.arm.fk(joints)}.get(part.carrier)
            carrier = session.nominal.world_from("table", [*joints, table]) if carrier is None else carrier
            assumed = carrier @ pose.pose(part.pose[:3], part.pose[3:])
            values = session.cell.get(truth)
            found = pose.pose(values[:3], values[3:])
            corners = session.nominal.part.hull.vertices
            apart = pose.transform_points(assumed, corners) - pose.transform_points(found, corners)
            off.setdefault(part.carrier, []).append(float(np.linalg.norm(apart, axis=1).max()))

        session.cell.on_cycle(setup.cell.world.controller_cycle_us, compare)
        task(session)
        assert stops == 0
        assert set(off) == {0, JOINTS, JOINTS + 1}
        assert min(len(one) for one in off.values()) > 50
        for apart in off.values():
            assert max(apart) < 2e-3


def test_held_part_keeps_away_from_an_obstacle(example, tmp_path: Path) -> None:
    """A post in the way of the part, which is longer than the fingers are wide."""
    free = load_setup(CELL)
    with Scanner(setup=free) as scanner, scanner.session(PART, guarded=True) as session:
        task = example.PickAndPlace(free, session.nominal)
        grip = task.pick(session, task.fetch(session))
        lifted = example.lifted(grip)[:3, 3]
        half = float(session.nominal.part.bounds[1, 0])  # across the belt
    part_low = lifted[2] - free.cell.gripper.finger_length_mm * 1e-3 - example.GRIP_HEIGHT  # type: ignore[union-attr]
    post = box_mesh((0.02, 0.02, 0.03)).transformed(pose.translation((lifted[0] + half + 0.03, lifted[1], part_low)))
    file = tmp_path / "post.stl"
    trimesh.Trimesh(post.vertices * 1e3, post.faces, process=False).export(file)
    setup = load_setup(CELL, settings=[f'cell.obstacle=[{{ name = "post", mesh = "{file}", pose = {{}} }}]'])
    with Scanner(setup=setup) as scanner, scanner.session(PART, guarded=True) as session:
        task = example.PickAndPlace(setup, session.nominal)
        task.pick(session, task.fetch(session))
        start = session.joints
        target = pose.translation((0.06, 0.0, 0.0)) @ example.lifted(grip)
        with pytest.raises(CommandError, match="part - post"):
            session.move_line(target, "gripper", speed=0.1)
        assert session.cell.get_integer("truth.collision.pairs") == 0
        assert np.abs(session.joints - start).max() > 0.01  # it went up to the post
