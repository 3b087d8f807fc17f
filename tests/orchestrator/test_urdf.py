"""Arms from URDF files: kinematics, masses and meshes against dartpy's reading of the same file, and faults named."""

from __future__ import annotations

import re
import shutil
from pathlib import Path
from typing import Any

import dartpy
import numpy as np
import pytest
import trimesh

from scancell.config.files import plain_data
from scancell.config.loading import assets_dir, load_setup
from scancell.config.robot import RobotDescription
from scancell.errors import CellError, DescriptionError
from scancell.geometry import pose
from scancell.nominal.cell import arm_of
from scancell.nominal.from_urdf import ConvertedRobot, robot_from_urdf
from scancell.planning.motion.trajectory import arm_skeleton, joint_torques

RNG = np.random.default_rng(12)
FOLDER = assets_dir() / "robots" / "seven_axis_urdf"
SEVEN = FOLDER / "seven_axis.urdf"
SHIPPED = assets_dir() / "robots" / "seven_axis.toml"


def dart_arm(urdf: Path) -> Any:
    """The skeleton of a URDF file in DART, its root fixed at the world's origin."""
    loader = dartpy.utils.DartLoader()
    options = dartpy.utils.DartLoaderOptions()
    options.mDefaultRootJointType = dartpy.utils.DartLoaderRootJointType.FIXED
    loader.setOptions(options)
    loader.addPackageDirectory("seven_axis_urdf", str(FOLDER))
    skeleton = loader.parseSkeleton(str(urdf))
    assert skeleton is not None
    skeleton.setGravity(np.array([0.0, 0.0, -9.80665]))
    return skeleton


def words(values: Any) -> str:
    return " ".join(repr(float(value)) for value in values)


def origin() -> str:
    return f'<origin xyz="{words(RNG.uniform(-0.3, 0.3, 3))}" rpy="{words(RNG.uniform(-3, 3, 3))}"/>'


def any_arm(folder: Path, joints: int) -> Path:
    """A URDF file with origins and axes in no special position, fixed joints between, and a branch to leave out."""
    lines = ['<robot name="any">', '<link name="root"/>']
    link = "root"
    for k in range(1, joints + 1):
        for name, kind in ((f"plate{k}", "fixed"), (f"link{k}", "revolute")):
            xx, yy, zz, mass = (float(value) for value in RNG.uniform([0.01, 0.01, 0.01, 1], [0.02, 0.02, 0.02, 4]))
            lines += [
                f'<link name="{name}"><inertial>{origin()}<mass value="{mass!r}"/>',
                f'<inertia ixx="{xx!r}" iyy="{yy!r}" izz="{zz!r}" ixy="0.001" ixz="0" iyz="-0.002"/></inertial>',
                f'<visual>{origin()}<geometry><box size="0.1 0.2 0.3"/></geometry></visual></link>',
                f'<joint name="to_{name}" type="{kind}"><parent link="{link}"/><child link="{name}"/>{origin()}',
                f'<axis xyz="{words(RNG.normal(size=3))}"/>',
                '<limit lower="-3" upper="3" velocity="2" effort="9"/></joint>',
            ]
            link = name
    lines += [
        '<link name="finger"/>',
        f'<joint name="grip" type="prismatic"><parent link="{link}"/><child link="finger"/>'
        '<limit lower="0" upper="1" velocity="1" effort="1"/></joint>',
        "</robot>",
    ]
    file = folder / "any.urdf"
    file.write_text("\n".join(lines))
    return file


def converted(urdf: Path, folder: Path, joints: int) -> tuple[ConvertedRobot, str]:
    tip = "flange" if urdf == SEVEN else f"link{joints}"
    hold = list(range(3, 3 + max(0, joints - 6)))
    return robot_from_urdf(urdf, tip, folder / "arm.toml", hold=hold), tip


@pytest.fixture(scope="module", params=["seven_axis", 4, 6, 8])
def arm_files(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[Any, Any, str]:
    """A URDF file in DART, and converted; the name of the tip link."""
    folder = tmp_path_factory.mktemp("urdf")
    joints = 7 if request.param == "seven_axis" else request.param
    urdf = SEVEN if request.param == "seven_axis" else any_arm(folder, joints)
    return dart_arm(urdf), *converted(urdf, folder, joints)


def at(skeleton: Any, q: np.ndarray) -> None:
    """Set the joints q of the arm; joints beside it stay at 0."""
    skeleton.setPositions(np.concatenate([q, np.zeros(skeleton.getNumDofs() - len(q))]))


def test_kinematics_are_those_of_dart(arm_files: tuple[Any, ConvertedRobot, str]) -> None:
    skeleton, made, tip = arm_files
    arm = arm_of(RobotDescription.from_toml(made.files[0]))
    joints = len(arm.joints)
    body = skeleton.getBodyNode(tip)
    for q in RNG.uniform(-3, 3, (20, joints)):
        at(skeleton, q)
        assert np.abs(arm.fk(q) @ made.flange_from_tip - body.getWorldTransform().matrix()).max() < 1e-9
        # DART's Jacobian is angular before linear; the flange's origin is a point of the tip link.
        flange = pose.inverse(made.flange_from_tip)[:3, 3]
        theirs = body.getWorldJacobian(flange)[:, :joints]
        assert np.abs(arm.jacobian(q) - np.concatenate([theirs[3:], theirs[:3]])).max() < 1e-9


def test_torques_are_those_of_dart(arm_files: tuple[Any, ConvertedRobot, str]) -> None:
    skeleton, made, _ = arm_files
    cell = bare_cell(made.description)
    joints = len(made.description.joint)
    q, qd, qdd = RNG.uniform(-2, 2, (3, 5, joints))
    expected = []
    for k in range(5):
        at(skeleton, q[k])
        rest = np.zeros(skeleton.getNumDofs() - joints)
        skeleton.setVelocities(np.append(qd[k], rest))
        skeleton.setAccelerations(np.append(qdd[k], rest))
        # DART gives links without a mass one of its own.
        for body in (skeleton.getBodyNode(name) for name in ("finger", "flange")):
            if body is not None:
                body.setInertia(dartpy.dynamics.Inertia(1e-12, np.zeros(3), 1e-12 * np.eye(3)))
        skeleton.computeInverseDynamics()
        expected.append(skeleton.getForces()[:joints])
    weight = np.abs(expected).max()
    assert weight > 1
    assert np.abs(joint_torques(arm_skeleton(cell), q, qd, qdd) - expected).max() < 1e-6 * weight


def bare_cell(robot: RobotDescription) -> Any:
    """The shipped cell with an arm that carries nothing."""
    return load_setup().cell.model_copy(update={"robot": robot, "sensor_mesh": None})


def test_torques_do_the_work_that_energy_gains() -> None:
    """The power of the torques along a motion is the rate of the links' kinetic and potential energy."""
    cell = load_setup(assets_dir() / "cells" / "seven_axis.toml").cell
    arm, amplitude = arm_of(cell.robot), np.radians([30, 20, 10, 25, 40, 30, 50])

    def motion(t: np.ndarray) -> tuple[np.ndarray, ...]:
        phase = np.multiply.outer(t, np.arange(1.0, 8.0)) + np.arange(7)
        rate = np.arange(1.0, 8.0)
        return amplitude * np.sin(phase), amplitude * rate * np.cos(phase), -amplitude * rate**2 * np.sin(phase)

    from scancell.cell.fmu_file import dynamics_json  # noqa: PLC0415

    def energy(t: float) -> float:
        """By finite differences of the links' poses, without DART."""
        h = 1e-5
        frames = arm.link_poses(motion(np.array([t - h, t, t + h]))[0])[:, 1:]
        total = 0.0
        for k, link in enumerate(dynamics_json(cell)["links"]):
            before, now, after = frames[:, k]
            centre = np.array(link["centre_of_mass"])
            velocity = (pose.transform_points(after, centre[None]) - pose.transform_points(before, centre[None])) / (
                2 * h
            )
            spin = now[:3, :3].T @ pose.log_rotation(after[:3, :3] @ before[:3, :3].T) / (2 * h)
            height = pose.transform_points(now, centre[None])[0, 2]
            total += link["mass"] * (0.5 * (velocity**2).sum() + 9.80665 * height)
            total += 0.5 * spin @ np.array(link["inertia"]) @ spin
        return total

    times = np.linspace(0.1, 1.3, 7)
    q, qd, qdd = motion(times)
    power = (joint_torques(arm_skeleton(cell), q, qd, qdd) * qd).sum(1)
    h = 1e-3
    gained = [(energy(t + h) - energy(t - h)) / (2 * h) for t in times]
    assert np.abs(power - gained).max() < 1e-4 * np.abs(power).max()


def test_torques_need_masses() -> None:
    robot = load_setup().cell.robot
    joints = (robot.joint[0].model_copy(update={"mesh": None}), *robot.joint[1:])
    cell = load_setup().cell.model_copy(update={"robot": robot.model_copy(update={"joint": joints})})
    with pytest.raises(CellError, match=r"robot\.joint\[1\]: torques need an inertia"):
        arm_skeleton(cell)


def test_meshes_lie_where_the_urdf_has_them(tmp_path: Path) -> None:
    made, _ = converted(SEVEN, tmp_path, 7)
    arm, skeleton = arm_of(made.description), dart_arm(SEVEN)
    q = RNG.uniform(-2, 2, 7)
    at(skeleton, q)
    for k, frame in enumerate(arm.link_poses(q)):
        file = made.description.base_mesh if k == 0 else made.description.joint[k - 1].mesh
        ours = pose.transform_points(frame, np.asarray(trimesh.load(str(file)).vertices) * 1e-3)
        source = trimesh.load(FOLDER / "meshes" / f"link{k}.stl")
        world_from_link = skeleton.getBodyNode(f"link{k}").getWorldTransform().matrix()
        theirs = pose.transform_points(world_from_link, np.asarray(source.vertices) * 1e-3)
        assert np.abs(ours.min(0) - theirs.min(0)).max() < 1e-6
        assert np.abs(ours.max(0) - theirs.max(0)).max() < 1e-6


def test_shipped_arm_is_that_of_its_urdf(tmp_path: Path) -> None:
    home = list(RobotDescription.from_toml(SHIPPED).home_deg)
    made = robot_from_urdf(SEVEN, "flange", tmp_path / "seven_axis.toml", home, [3])
    ours, shipped = (plain_data(d) for d in (made.description, RobotDescription.from_toml(SHIPPED)))
    for data in (ours, shipped):
        for row in [data, *data["joint"]]:
            row.pop("mesh", None)
            row.pop("base_mesh", None)
    assert ours == shipped
    assert np.abs(made.flange_from_tip - np.eye(4)).max() < 1e-12
    for file in made.files[1:]:
        old, new = trimesh.load(SHIPPED.with_suffix("") / file.name), trimesh.load(file)
        np.testing.assert_allclose(new.vertices, old.vertices, atol=1e-3)


def test_rounded_right_angles_are_right(tmp_path: Path) -> None:
    text = SEVEN.read_text().replace("1.5707963267948966", "1.5708")
    shutil.copytree(FOLDER / "meshes", tmp_path / "seven_axis_urdf" / "meshes")
    file = tmp_path / "seven_axis_urdf" / "rounded.urdf"
    file.write_text(text)
    rounded = arm_of(robot_from_urdf(file, "flange", tmp_path / "arm.toml", hold=[3]).description)
    assert rounded.has_closed_form
    assert np.abs(rounded.fk(np.zeros(7)) - arm_of(RobotDescription.from_toml(SHIPPED)).fk(np.zeros(7))).max() < 1e-12


def test_joint_beside_chain_is_reported(tmp_path: Path) -> None:
    made, _ = converted(any_arm(tmp_path, 5), tmp_path, 5)
    assert made.warnings == ("left out joint 'grip' and what it carries, link 'finger': it is beside the chain",)
    assert len(made.description.joint) == 5


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        (
            "meshes/link3.stl",
            "meshes/lost.stl",
            "link 'link3': mesh 'package://seven_axis_urdf/meshes/lost.stl': no such",
        ),
        (
            "package://seven_axis_urdf/meshes/link3.stl",
            "lost.stl",
            "link 'link3': mesh 'lost.stl': no such file; tried",
        ),
        ("meshes/link3.stl", "seven_axis.urdf", "expected a file of .stl, .obj, .ply"),
        ('name="joint4" type="revolute"', 'name="joint4" type="prismatic"', "joint 'joint4': type 'prismatic'"),
        ('velocity="1.71042266695"', 'velocity="-1"', "joint 'joint1': velocity -1 rad/s"),
        ('velocity="1.71042266695"', 'velocity="fast"', "joint 'joint1': velocity = 'fast': expected 1 number"),
        ('<link name="link2">', '<link name="link1">', "link 'link1': 2 of this name"),
        ('<axis xyz="0 0 1"/>', '<axis xyz="0 0 1"/><mimic joint="joint7"/>', "joint 'joint1': follows joint 'joint7'"),
        ('<parent link="link3"/>', '<parent link="link9"/>', "joint 'joint4': parent 'link9' is not a link"),
        ('<parent link="link0"/>', '<parent link="flange"/>', "is part of a loop"),
        ('xyz="0 0.08 0"', 'xyz="0 eight 0"', ": xyz = '0 eight 0': expected 3 numbers"),
        ('"flange"', '"hand"', "no link 'flange'; expected one of link0"),
        ("<robot", "<model", "not readable as URDF"),
        ('name="joint3" type="revolute"', 'name="joint3" type="fixed"', "held names 1 joints: expected 0"),
        ('type="revolute"', 'type="fixed"', "0 joints from the root to 'flange'; expected 4 to 8"),
    ],
)
def test_faults_are_named(tmp_path: Path, old: str, new: str, expected: str) -> None:
    folder = tmp_path / "seven_axis_urdf"
    shutil.copytree(FOLDER, folder)
    file = folder / "seven_axis.urdf"
    text = SEVEN.read_text()
    assert old in text
    file.write_text(text.replace(old, new))
    with pytest.raises(DescriptionError) as caught:
        robot_from_urdf(file, "flange", tmp_path / "arm.toml", hold=[3])
    assert str(file) in str(caught.value)
    assert expected in str(caught.value)


def test_missing_urdf_is_named(tmp_path: Path) -> None:
    with pytest.raises(DescriptionError, match=r"none\.urdf: no such file"):
        robot_from_urdf(tmp_path / "none.urdf", "flange", tmp_path / "arm.toml")


def changed(folder: Path, *changes: tuple[str, str]) -> Path:
    """The shipped URDF file in `folder` with parts of its text replaced."""
    shutil.copytree(FOLDER, folder / "seven_axis_urdf", dirs_exist_ok=True)
    text = SEVEN.read_text()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new, 1)
    file = folder / "seven_axis_urdf" / "changed.urdf"
    file.write_text(text)
    return file


def test_quaternions_are_the_rotations_of_their_angles(tmp_path: Path) -> None:
    arm = any_arm(tmp_path, 6)
    text = arm.read_text()

    def as_quaternion(found: re.Match[str]) -> str:
        r, p, y = map(float, found[1].split())
        rotation = pose.rotation_about(2, y) @ pose.rotation_about(1, p) @ pose.rotation_about(0, r)
        w, *xyz = pose.quaternion_from_rotation(rotation)
        return f'quat_xyzw="{xyz[0]!r} {xyz[1]!r} {xyz[2]!r} {w!r}"'.replace("np.float64(", "").replace(")", "")

    other = tmp_path / "quaternions.urdf"
    other.write_text(re.sub('rpy="([^"]*)"', as_quaternion, text))
    assert other.read_text() != text
    one, two = (arm_of(robot_from_urdf(file, "link6", tmp_path / "a.toml").description) for file in (arm, other))
    q = RNG.uniform(-2, 2, (20, 6))
    np.testing.assert_allclose(two.fk(q), one.fk(q), atol=1e-9)


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ('velocity="1.71042266695"', "", "joint 'joint1' states no velocity: 90 deg/s are assumed"),
        ('velocity="1.71042266695"', 'velocity="98"', "joint 'joint1': velocity 98 rad/s: is it in degrees?"),
        ('lower="-2.96705972839"', 'lower="-170"', "joint 'joint1': limits -170 to 2.96706 rad: are they in degrees?"),
        ('xyz="0 0.08 0"', 'xyz="0 80 0"', "apart along the arm: are the lengths in mm?"),
        ('scale="0.001 0.001 0.001"', "", ": its mesh is"),
    ],
)
def test_what_is_assumed_or_not_plausible_is_a_warning(tmp_path: Path, old: str, new: str, expected: str) -> None:
    made = robot_from_urdf(changed(tmp_path, (old, new)), "flange", tmp_path / "arm.toml", hold=[3])
    assert any(expected in warning for warning in made.warnings), made.warnings


def test_meshes_for_collisions_stand_for_formats_that_are_not_read(tmp_path: Path) -> None:
    text = SEVEN.read_text()
    (found,) = re.findall(r"<visual>(?:(?!</visual>).)*link3\.stl.*?</visual>", text, re.S)
    collada = found.replace("link3.stl", "link3.dae") + found.replace("visual>", "collision>")
    made = robot_from_urdf(changed(tmp_path, (found, collada)), "flange", tmp_path / "arm.toml", hold=[3])
    assert made.warnings == (
        "link 'link3': its collision meshes are used instead of 'package://seven_axis_urdf/meshes/link3.dae', "
        "which is not read",
    )
    plain = robot_from_urdf(changed(tmp_path), "flange", tmp_path / "plain.toml", hold=[3])
    for one, two in zip(made.files[1:], plain.files[1:], strict=True):
        assert one.read_bytes() == two.read_bytes()


def test_remarks_on_mesh_files_are_warnings(tmp_path: Path) -> None:
    file = changed(tmp_path, ("meshes/link3.stl", "meshes/warped.obj"))
    corners = [(x, y, z) for x in (0, 100) for y in (0, 100) for z in (0, 100)]
    corners[-1] = (100, 100, 100.4)
    faces = ["1 2 4 3", "5 7 8 6", "1 5 6 2", "3 4 8 7", "1 3 7 5", "2 6 8 4"]
    lines = [*(f"v {x} {y} {z}" for x, y, z in corners), *(f"f {face}" for face in faces)]
    mesh = file.parent / "meshes" / "warped.obj"
    mesh.write_text("\n".join(lines))
    (warning,) = robot_from_urdf(file, "flange", tmp_path / "arm.toml", hold=[3]).warnings
    assert warning.startswith(f"{mesh.resolve()}: 1 of 6 faces are not plane")


def test_packages_are_found_by_their_package_file(tmp_path: Path) -> None:
    file = changed(tmp_path)
    (tmp_path / "seven_axis_urdf").rename(tmp_path / "checkout")
    (tmp_path / "checkout" / "package.xml").write_text("<package><name>seven_axis_urdf</name></package>")
    made = robot_from_urdf(tmp_path / "checkout" / file.name, "flange", tmp_path / "arm.toml", hold=[3])
    assert len(made.files) > 5
    assert made.warnings == ()
