"""Masses and drives of the arm: conversion of the description for the FMU, deflection under gravity."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from cells import GRIPPER, ball

from scancell.cell.fmu_file import cell_json, make_temporary_fmu
from scancell.cell.instance import CellInstance
from scancell.config.loading import load_setup
from scancell.geometry import pose
from scancell.geometry.mesh import MassProperties, box_mesh, load_mesh, mass_properties
from scancell.nominal.cell import nominal_cell

DYNAMIC = ['cell.robot.drive="dynamic"']
DENSITY = 2000.0


def box(x: float, y: float, z: float) -> MassProperties:
    return mass_properties(box_mesh((x, y, z)), DENSITY)


def test_combined_inertia_of_two_halves() -> None:
    half, whole = box(0.1, 0.06, 0.04), box(0.2, 0.06, 0.04)
    joined = half.seen_from(pose.translation((-0.05, 0, 0))).joined_with(half.seen_from(pose.translation((0.05, 0, 0))))
    assert joined.mass == pytest.approx(whole.mass)
    np.testing.assert_allclose(joined.centre_of_mass, 0, atol=1e-15)
    np.testing.assert_allclose(joined.inertia, whole.inertia, rtol=1e-12, atol=1e-15)


def test_inertia_of_rotated_box() -> None:
    turned = box(0.1, 0.06, 0.04).seen_from(pose.from_rotation(pose.rotation_about(2, np.pi / 2)))
    np.testing.assert_allclose(turned.inertia, box(0.06, 0.1, 0.04).inertia, rtol=1e-12, atol=1e-18)


def test_drives_are_kinematic_by_default() -> None:
    setup = load_setup()
    assert cell_json(setup.cell, nominal_cell(setup.cell, ball()), 0)["robot"]["dynamics"] is None


def test_link_masses_from_meshes_and_tools() -> None:
    setup = load_setup(settings=[*DYNAMIC, *GRIPPER])
    dynamics = cell_json(setup.cell, nominal_cell(setup.cell, ball()), 0)["robot"]["dynamics"]
    links, joints = dynamics["links"], setup.cell.robot.joint
    alone = [mass_properties(load_mesh(Path(str(joint.mesh))), DENSITY).mass for joint in joints]
    sensor = mass_properties(load_mesh(Path(str(setup.cell.sensor_mesh))), DENSITY).mass
    assert [link["mass"] for link in links[:5]] == pytest.approx(alone[:5])
    assert links[5]["mass"] == pytest.approx(alone[5] + sensor + DENSITY * 0.070 * 0.040 * 0.045)
    assert all((np.linalg.eigvalsh(link["inertia"]) > 0).all() for link in links)
    assert dynamics["drives"][0]["backlash"] == pytest.approx(np.radians(0.002))


def test_gripper_without_housing_adds_no_mass() -> None:
    """Its fingers are bodies of their own."""
    bare = [word for word in GRIPPER if "housing" not in word]
    last = []
    for gripper in ([], bare):
        setup = load_setup(settings=[*DYNAMIC, *gripper])
        last.append(cell_json(setup.cell, nominal_cell(setup.cell, ball()), 0)["robot"]["dynamics"]["links"][-1])
    assert last[1]["mass"] == pytest.approx(last[0]["mass"])


def test_described_inertia_overrides_mesh() -> None:
    inertia = "{ mass_kg = 3.0, centre_of_mass_mm = [10, 0, -20], inertia_kg_m2 = [0.01, 0.02, 0.03] }"
    setup = load_setup(settings=[*DYNAMIC, f"cell.robot.joint[2].inertia={inertia}"])
    link = cell_json(setup.cell, nominal_cell(setup.cell, ball()), 0)["robot"]["dynamics"]["links"][1]
    assert link["mass"] == 3.0
    np.testing.assert_allclose(link["centre_of_mass"], [0.01, 0, -0.02])
    np.testing.assert_allclose(link["inertia"], np.diag([0.01, 0.02, 0.03]))


def test_dynamic_robot_requires_drives(tmp_path) -> None:
    setup = load_setup()
    joints = [joint.model_dump(exclude={"drive"}) for joint in setup.cell.robot.joint]
    robot = setup.cell.robot.model_dump() | {"joint": joints, "drive": "dynamic"}
    with pytest.raises(ValueError, match=r"joint\[1\]\.drive is missing"):
        type(setup.cell.robot).model_validate(robot)


@pytest.mark.parametrize("version", [2, 3])
def test_default_arm_sags_under_gravity(tmp_path, version) -> None:
    """Deflection of joint 2 at rest: gravity moment over gear stiffness, plus half the backlash."""
    setup = load_setup(settings=DYNAMIC, ideal=True)
    nominal = nominal_cell(setup.cell, ball())
    description = cell_json(setup.cell, nominal, 0)
    with CellInstance(make_temporary_fmu(description, tmp_path / "fmu", version)) as cell:
        cell.step_to(160_000)
        truth = cell.get(cell.real_group([f"truth.q[{i}]" for i in range(1, 7)])).copy()
        measured = cell.get(cell.real_group([f"measured.q[{i}]" for i in range(1, 7)])).copy()
    np.testing.assert_allclose(measured, nominal.home, atol=1e-12)
    poses = nominal.arm.link_poses(truth)
    links = description["robot"]["dynamics"]["links"]
    masses = np.array([link["mass"] for link in links])
    centres = np.array([(poses[i + 1] @ [*link["centre_of_mass"], 1])[:3] for i, link in enumerate(links)])
    axis, origin = poses[1][:3, 2], poses[1][:3, 3]
    weights = masses[1:, None] * [0, 0, -setup.cell.world.gravity_m_s2]
    moment = axis @ np.cross(centres[1:] - origin, weights).sum(0)
    drive = description["robot"]["dynamics"]["drives"][1]
    expected = moment / drive["gear_stiffness"] + np.sign(moment) * drive["backlash"] / 2
    # Friction limits the accuracy.
    assert truth[1] - nominal.home[1] == pytest.approx(
        expected, abs=drive["coulomb_friction"] / drive["gear_stiffness"]
    )
    assert abs(expected) > 1e-4


def test_contact_shapes_only_where_something_moves_by_forces() -> None:
    def shapes(*words: str) -> set[str]:
        setup = load_setup(settings=[f"cell.{word}" for word in words])
        contact = cell_json(setup.cell, nominal_cell(setup.cell, box_mesh((0.05, 0.05, 0.05))), 0)["contact"]
        return {body["name"] for body in contact["bodies"]}

    whole = {"base", "table_base", "sensor", "floor", *(f"link{i}" for i in range(1, 7))}
    assert shapes() == set()
    assert shapes('robot.drive="dynamic"') == whole
    assert shapes("part.fixture=free", "part.z_mm=0") == whole
    assert shapes("part.fixture=free", "contact.cell_bodies=false") == set()


@pytest.mark.parametrize("response", [True, False])
def test_table_under_the_sensor_stops_it(tmp_path, response: bool) -> None:
    """Jogged down with dynamic drives, the sensor comes to rest on the table; without response it passes through."""
    table_height = 0.25
    setup = load_setup(
        settings=[
            *DYNAMIC,
            f"cell.table.pose={{ x_mm = 292, y_mm = 228, z_mm = {1e3 * table_height} }}",
            "cell.table.radius_mm=600",
            f'cell.contact.pair=[{{ bodies = ["sensor", "table"], response = {str(response).lower()} }}]',
        ],
        ideal=True,
    )
    nominal = nominal_cell(setup.cell, ball())
    hull = next(body.mesh.hull.vertices for body in nominal.bodies if body.name == "sensor")
    with CellInstance(make_temporary_fmu(cell_json(setup.cell, nominal, 0), tmp_path / "fmu")) as cell:
        cell.set_integer("command.mode", 5)  # Cartesian jog
        cell.set_integer("command.operation", 0)  # manual
        cell.set(cell.real_group(["command.jog[3]"]), np.array([-1.0]))
        cell.step_to(1_008_000)
        truth = cell.get(cell.real_group([f"truth.q[{i}]" for i in range(1, 7)])).copy()
    height = pose.transform_points(nominal.world_from_sensor(truth), hull)[:, 2].min()
    if response:
        assert height == pytest.approx(table_height, abs=2e-3)
    else:
        assert height < table_height - 0.05
