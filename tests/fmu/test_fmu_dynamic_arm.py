"""The arm with masses and real drives: sag, swing, torque, state; kinematic drives beside it."""

from __future__ import annotations

import subprocess
from typing import Any

import numpy as np
import pytest
from cell_fixture import CYCLE_US, START_DEG, Array, CellFmu, all_reals, cell_description
from conftest import Build

START = np.radians(START_DEG)
MASSES = [9.0, 4.0, 5.0, 2.0, 0.4, 1.2]
CENTRES = [[-0.04, 0.05, 0.0], [-0.15, 0, 0.08], [0.04, 0, 0], [0, 0.12, 0], [0, 0, 0.01], [0, 0, 0.04]]
STIFFNESS = np.array([6e4, 6e4, 3e4, 6e3, 6e3, 4e3])


def dynamic_cell(**drive: float) -> dict[str, Any]:
    """The test cell with masses; keyword arguments go into every drive."""
    cell = cell_description()
    cell["robot"]["dynamics"] = {
        "links": [
            {"mass": m, "centre_of_mass": c, "inertia": np.diag([0.01 * m] * 3).tolist()}
            for m, c in zip(MASSES, CENTRES, strict=True)
        ],
        "drives": [
            {
                "motor_inertia": k / 1e5, "max_torque": 300.0, "gear_stiffness": k, "gear_damping": k / 500,
                "backlash": 0.0, "coulomb_friction": 0.0, "viscous_friction": 0.0, **drive,
            }
            for k in STIFFNESS.tolist()
        ],
    }  # fmt: skip
    return cell


def gravity_torques(cell: CellFmu) -> Array:
    """Torques (6,) that hold the arm, by the lever of each link's centre of mass about each axis."""
    links = [cell.body(f"link[{i}]") for i in range(1, 7)]
    axes = [np.eye(4), *links[:-1]]
    torques = np.zeros(6)
    for j, axis in enumerate(axes):
        for i in range(j, 6):
            centre = links[i][:3, :3] @ CENTRES[i] + links[i][:3, 3]
            weight = np.array([0, 0, MASSES[i] * 9.80665])
            torques[j] += axis[:3, 2] @ np.cross(centre - axis[:3, 3], weight)
    return torques


@pytest.mark.parametrize("version", [2, 3])
def test_every_joint_sags_by_its_load_and_the_encoders_do_not_see_it(build: Build, version: int) -> None:
    cell = build(version, dynamic_cell())
    sag = cell.vector("truth.q", 6) - START
    np.testing.assert_allclose(sag, -gravity_torques(cell) / STIFFNESS, atol=1e-9)
    np.testing.assert_array_equal(cell.vector("measured.q", 6), START)
    np.testing.assert_allclose(cell.vector("measured.torque", 6), gravity_torques(cell), atol=1e-4)
    assert np.abs(sag).max() > 1e-4
    cell.step(CYCLE_US, 60)
    np.testing.assert_allclose(cell.vector("truth.q", 6) - START, sag, atol=1e-9)


def test_motors_follow_a_move_exactly_and_links_swing_about_it(build: Build) -> None:
    cell, ideal = build(3, dynamic_cell()), build()
    target = START + np.array([0.3, 0.2, -0.3, 0.5, -0.2, 0.8])
    for each in (cell, ideal):
        each.command(target, mode=2)
        each.set("command.start", 1)
    swing = 0.0
    for _ in range(1200):
        cell.step(1000)
        ideal.step(1000)
        np.testing.assert_allclose(cell.vector("measured.q", 6), ideal.vector("measured.q", 6), atol=1e-12)
        swing = max(swing, float(np.abs(cell.vector("truth.q", 6) - ideal.vector("truth.q", 6)).max()))
    assert 1e-4 < swing < 2e-2
    np.testing.assert_allclose(cell.vector("truth.q", 6) - target, -gravity_torques(cell) / STIFFNESS, atol=2e-6)


def test_a_weak_motor_gives_its_torque_and_arrives_late(build: Build) -> None:
    cell = build(3, dynamic_cell(max_torque=60.0))
    target = START.copy()
    target[1] -= 0.6
    cell.command(target, mode=2)
    cell.set("command.start", 1)
    torques, lags = [], []
    for _ in range(3000):
        cell.step(1000)
        torques.append(cell.vector("measured.torque", 6))
        lags.append(abs(float(cell.get("controller.destination.q[2]")[0] - cell.get("measured.q[2]")[0])))
    assert np.abs(torques).max() == pytest.approx(60.0)
    assert lags[-1] < 1e-6


def test_friction_leaves_the_arm_where_it_does_not_pull_enough(build: Build) -> None:
    ends = []
    for friction in (0.0, 3.0):
        cell = build(3, dynamic_cell(coulomb_friction=friction))
        ways = []
        for offset in (0.05, -0.05):  # from above and from below
            for target in (START + offset, START):
                cell.command(target, mode=2)
                cell.set("command.start", cell.get_int("command.start") + 1)
                cell.step(CYCLE_US, 60)
            ways.append(cell.vector("truth.q", 6))
        ends.append(np.abs(ways[0] - ways[1]))
    assert (ends[0] < 1e-6).all()
    # Static friction can hold a gear wound up by friction over stiffness, from either side.
    assert (ends[1] <= 2 * 3.0 / STIFFNESS + 1e-9).all()
    assert ends[1].max() > 2e-5


def test_dynamic_drives_do_not_depend_on_the_communication_step_and_restore_exactly(build: Build) -> None:
    description = dynamic_cell(backlash=3e-4, coulomb_friction=1.0, max_torque=90.0)
    ends, state = [], b""
    for step_us in (1000, 700, CYCLE_US):
        cell = build(3, description)
        cell.command(START + 0.2, 0.4, mode=2)
        cell.set("command.start", 1)
        while cell.time_us < 224_000:
            cell.step(step_us)
            if step_us == 700 and cell.time_us == 112_000:
                state = cell.serialize(cell.save())
        ends.append(all_reals(cell)[1:])
    other = build(3, description)
    other.restore(other.deserialize(state), 112_000)
    other.step(1600, 70)
    ends.append(all_reals(other)[1:])
    for end in ends[1:]:
        np.testing.assert_array_equal(end, ends[0])


def test_initial_values_of_a_sagging_arm_depend_on_its_geometry(build: Build) -> None:
    cell = build(3, dynamic_cell())
    names = [n for n, v in cell.variables.items() if v.type == "Float64" and v.causality == "output"]
    before = cell.get(*names)
    declared = {u.variable.name: {d.name for d in u.dependencies} for u in cell.description.initialUnknowns}
    for parameter in ("as_built.dh[2].a", "as_built.dh[4].theta"):
        cell.slave.reset()
        cell.initialize({parameter: 0.01})
        moved = {n for n, old, new in zip(names, before, cell.get(*names), strict=True) if old != new}
        assert "truth.q[2]" in moved
        assert [name for name in sorted(moved) if parameter not in declared[name]] == []


def test_a_gear_too_stiff_for_the_steps_is_refused(build: Build) -> None:
    with pytest.raises(subprocess.CalledProcessError) as refused:
        build(3, dynamic_cell(motor_inertia=1e-3))
    assert b"robot.dynamics.drives[0].motor_inertia" in refused.value.stderr
