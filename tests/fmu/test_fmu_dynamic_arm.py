"""Dynamic drives: deflection, oscillation, torque, state; compared with kinematic drives."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from cell_fixture import CYCLE_US, START, Array, Build, CellFmu, all_reals, cell_description, rejection

MASSES = [9.0, 4.0, 5.0, 2.0, 0.4, 1.2]
CENTRES = [[-0.04, 0.05, 0.0], [-0.15, 0, 0.08], [0.04, 0, 0], [0, 0.12, 0], [0, 0, 0.01], [0, 0, 0.04]]
STIFFNESS = np.array([6e4, 6e4, 3e4, 6e3, 6e3, 4e3])


def dynamic_cell(**drive: float) -> dict[str, Any]:
    """The test cell with dynamic drives; keyword arguments override keys of every drive."""
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
    """Holding torques (6,) from the lever arms of the links' centres of mass."""
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
def test_joints_deflect_by_load_unseen_by_encoders(build: Build, version: int) -> None:
    cell = build(version, dynamic_cell())
    sag = cell.vector("truth.q", 6) - START
    np.testing.assert_allclose(sag, -gravity_torques(cell) / STIFFNESS, atol=1e-9)
    np.testing.assert_array_equal(cell.vector("measured.q", 6), START)
    np.testing.assert_allclose(cell.vector("measured.torque", 6), gravity_torques(cell), atol=1e-4)
    assert np.abs(sag).max() > 1e-4
    cell.step(CYCLE_US, 60)
    np.testing.assert_allclose(cell.vector("truth.q", 6) - START, sag, atol=1e-9)


def test_motors_follow_move_exactly_and_links_oscillate(build: Build) -> None:
    cell, ideal = build(3, dynamic_cell()), build()
    target = START + np.array([0.3, 0.2, -0.3, 0.5, -0.2, 0.8])
    for each in (cell, ideal):
        each.start_move(target)
    swing = 0.0
    for _ in range(1200):
        cell.step(1000)
        ideal.step(1000)
        np.testing.assert_allclose(cell.vector("measured.q", 6), ideal.vector("measured.q", 6), atol=1e-12)
        swing = max(swing, float(np.abs(cell.vector("truth.q", 6) - ideal.vector("truth.q", 6)).max()))
    assert 1e-4 < swing < 2e-2
    np.testing.assert_allclose(cell.vector("truth.q", 6) - target, -gravity_torques(cell) / STIFFNESS, atol=2e-6)


def test_static_friction_holds_deflected_arm(build: Build) -> None:
    ends = []
    for friction in (0.0, 3.0):
        cell = build(3, dynamic_cell(coulomb_friction=friction))
        ways = []
        for offset in (0.05, -0.05):  # from above and from below
            for target in (START + offset, START):
                cell.start_move(target)
                cell.step(CYCLE_US, 60)
            ways.append(cell.vector("truth.q", 6))
        ends.append(np.abs(ways[0] - ways[1]))
    assert (ends[0] < 1e-6).all()
    # Static friction can hold a gear deflection of friction over stiffness in either direction.
    assert (ends[1] <= 2 * 3.0 / STIFFNESS + 1e-9).all()
    assert ends[1].max() > 2e-5


def inertia_about_joint_1(cell: CellFmu) -> float:
    """Moment of inertia of all links about the vertical axis (parallel axis theorem), kg m^2."""
    total = 0.0
    for i, (mass, centre) in enumerate(zip(MASSES, CENTRES, strict=True), 1):
        link = cell.body(f"link[{i}]")
        x, y = (link[:3, :3] @ centre + link[:3, 3])[:2]
        total += mass * (x * x + y * y) + 0.01 * mass
    return total


def ringing_cell(stiffness: float) -> dict[str, Any]:
    """The test cell with a soft, undamped gear in joint 1 and practically rigid others."""
    cell = dynamic_cell(gear_stiffness=1e9, motor_inertia=1e4, gear_damping=1e5, max_torque=1e6)
    cell["time_step_us"] = 500
    cell["robot"]["dynamics"]["drives"][0] |= {"gear_stiffness": stiffness, "gear_damping": 0.0}
    return cell


def ringing_frequency(cell: CellFmu) -> float:
    """Oscillation frequency (Hz) of link 1 after a move, from zero crossings."""
    target = START + np.array([0.2, 0, 0, 0, 0, 0])
    cell.start_move(target)
    cell.step(CYCLE_US)
    while not cell.get_int("controller.at_destination"):
        cell.step(CYCLE_US)
    swing = []
    for _ in range(2000):
        cell.step(500)
        swing.append(float(cell.get("truth.q[1]")[0] - target[0]))
    late = np.array(swing)
    rising = np.flatnonzero((late[:-1] < 0) & (late[1:] >= 0))
    crossings = (rising - late[rising] / (late[rising + 1] - late[rising])) * 500e-6
    assert len(crossings) >= 4
    return float((len(crossings) - 1) / (crossings[-1] - crossings[0]))


@pytest.mark.parametrize("stiffness", [2e3, 8e3])
def test_link_oscillates_at_gear_resonance(build: Build, stiffness: float) -> None:
    cell = build(3, ringing_cell(stiffness))
    expected = np.sqrt(stiffness / inertia_about_joint_1(cell)) / (2 * np.pi)
    assert ringing_frequency(cell) == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize("backlash", [0.0, 2e-3])
def test_backlash_is_lost_motion_at_load_reversal(build: Build, backlash: float) -> None:
    """Joint 2 moves the arm over its highest point: the load reverses and the link crosses the backlash."""
    cell = build(3, dynamic_cell(backlash=backlash, gear_damping=100.0))
    sags, loads = [], []
    for angle in (-0.5, -2.6):
        target = START.copy()
        target[[1, 2]] = angle, np.pi / 2
        cell.start_move(target)
        cell.step(CYCLE_US, 300)
        sags.append(float(cell.get("truth.q[2]")[0] - angle))
        loads.append(float(cell.get("measured.torque[2]")[0]))
        np.testing.assert_allclose(gravity_torques(cell)[1], loads[-1], rtol=1e-4)
    assert loads[0] < -10
    assert loads[1] > 10
    assert sags[0] - sags[1] == pytest.approx(backlash + (loads[1] - loads[0]) / STIFFNESS[1], abs=2e-7)


def test_motor_encoders_have_latency_and_resolution(build: Build) -> None:
    description, step = dynamic_cell(), np.radians(0.01)
    for joint in description["robot"]["joints"]:
        joint |= {"encoder_resolution": step, "encoder_latency": 0.005}
    cell, exact = build(3, description), build(3, dynamic_cell())
    for each in (cell, exact):
        each.start_move(START + 0.3)
    ways = []
    for _ in range(400):
        for each in (cell, exact):
            each.step(1000)
        ways.append((cell.vector("measured.q", 6), exact.vector("measured.q", 6), exact.vector("truth.q", 6)))
    late, motor, link = np.moveaxis(np.array(ways), 1, 0)
    np.testing.assert_allclose(late[5:] / step, np.round(late[5:] / step), atol=1e-6)
    assert np.abs(late[5:] - motor[:-5]).max() <= step / 2 + 1e-12
    assert np.abs(motor - link).max() > 3 * step


def test_dynamic_drives_are_independent_of_communication_step(build: Build) -> None:
    """From 40 us to 1 s, with backlash, friction and a saturated motor; bit-identical."""
    ends = []
    for step_us in (40, 1000, CYCLE_US, 1_000_000):
        cell = build(3, dynamic_cell(backlash=3e-4, coulomb_friction=1.0, max_torque=60.0))
        cell.start_move(START + 0.4, 0.4)
        # The cycle does not divide a second: the last step is shorter.
        while cell.time_us < 1_000_000:
            cell.step(min(step_us, 1_000_000 - cell.time_us))
        ends.append(all_reals(cell)[1:])
    for end in ends[1:]:
        np.testing.assert_array_equal(end, ends[0])


def test_state_during_oscillation_restores_exactly(build: Build) -> None:
    description = dynamic_cell(backlash=3e-4, coulomb_friction=1.0, max_torque=90.0)
    cell, other = build(3, description), build(3, description)
    cell.start_move(START + 0.2, 0.4)
    cell.step(700, 160)
    state = cell.serialize(cell.save())
    other.restore(other.deserialize(state), cell.time_us)
    cell.step(1000, 112)
    other.step(1600, 70)
    np.testing.assert_array_equal(all_reals(other)[1:], all_reals(cell)[1:])


def test_initial_values_of_dynamic_arm_depend_on_geometry(build: Build) -> None:
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


def test_gear_too_stiff_for_time_step_is_rejected() -> None:
    assert "robot.dynamics.drives[0].motor_inertia" in rejection(dynamic_cell(motor_inertia=1e-3))


@pytest.mark.parametrize("friction", [1.0, 30.0])
def test_friction_of_the_joints_converges_in_every_step(build: Build, friction: float) -> None:
    """Steps where it does not are counted among the approximate contact forces."""
    cell = build(3, dynamic_cell(coulomb_friction=friction, gear_stiffness=2000.0), loggingOn=True)
    for k in range(40):
        cell.command(START + 0.2 * np.sin(0.15 * k + np.arange(6)), 0.0)
        cell.step(CYCLE_US)
    assert cell.get_int("truth.contact.solver_fallbacks") == 0
    assert not any("approximate" in text for text in cell.messages)
