"""Arms whose axes deviate from parallel and right angles: rows, poses and solutions against products of matrices."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from bench.calibrated_arms import LIMIT, OWN, POSE, campaign, judged_pose, links_of
from scancell.config.robot import RobotDescription
from scancell.geometry import pose
from scancell.geometry.arm import Arm
from scancell.nominal.cell import arm_of
from scancell.nominal.from_urdf import robot_from_urdf

RIGHT = np.pi / 2

# Origins (x, y, z in m; r, p, y in rad) and axes of published arms.
UR5E = [
    ((0, 0, 0.1625), (0, 0, 0), (0, 0, 1)),
    ((0, 0, 0), (RIGHT, 0, 0), (0, 0, 1)),
    ((-0.425, 0, 0), (0, 0, 0), (0, 0, 1)),
    ((-0.3922, 0, 0.1333), (0, 0, 0), (0, 0, 1)),
    ((0, -0.0997, 0), (RIGHT, 0, 0), (0, 0, 1)),
    ((0, 0.0996, 0), (-RIGHT, 0, 0), (0, 0, 1)),
]
IRB6640 = [
    ((0, 0, 0.78), (0, 0, 0), (0, 0, 1)),
    ((0.32, 0, 0), (0, 0, 0), (0, 1, 0)),
    ((0, 0, 1.075), (0, 0, 0), (0, 1, 0)),
    ((0, 0, 0.2), (0, 0, 0), (1, 0, 0)),
    ((1.392, 0, 0), (0, 0, 0), (0, 1, 0)),
    ((0.2, 0, 0), (0, 0, 0), (1, 0, 0)),
]


def words(values: tuple[float, ...]) -> str:
    return " ".join(repr(float(value)) for value in values)


def urdf(rows: list[tuple[tuple[float, ...], ...]], tool_pitch: float = RIGHT) -> str:
    lines = ['<robot name="arm"><link name="link0"/>']
    for k, (xyz, rpy, axis) in enumerate(rows, 1):
        lines.append(
            f'<link name="link{k}"/><joint name="joint{k}" type="revolute"><parent link="link{k - 1}"/>'
            f'<child link="link{k}"/><origin xyz="{words(xyz)}" rpy="{words(rpy)}"/><axis xyz="{words(axis)}"/>'
            f'<limit lower="-3.1" upper="3.1" velocity="2" effort="9"/></joint>'
        )
    lines.append(
        '<link name="tool"/><joint name="end" type="fixed"><parent link="link6"/><child link="tool"/>'
        f'<origin xyz="0 0 0" rpy="0 {tool_pitch} 0"/></joint></robot>'
    )
    return "\n".join(lines)


def converted(text: str, folder: Path) -> tuple[Arm, np.ndarray]:
    """The arm, and its pose of the flange from that of the tip."""
    file = folder / "arm.urdf"
    file.write_text(text)
    made = robot_from_urdf(file, "tool", folder / "arm.toml")
    return arm_of(RobotDescription.from_toml(made.files[0])), made.flange_from_tip


@pytest.mark.parametrize(("rows", "arms"), [(UR5E, 1), (IRB6640, 4)], ids=["parallel axes", "spherical wrist"])
def test_perturbed_arms_find_the_joints_of_their_poses(rows: list[tuple[tuple[float, ...], ...]], arms: int) -> None:
    """`bench.calibrated_arms` measures the same with published files and a thousand perturbations of each."""
    found = campaign(urdf(rows), "tool", [], arms, 20)
    assert found.poses[False] > 18 * arms
    assert found.found[False] == found.poses[False]
    assert found.lost < LIMIT
    assert found.own < OWN
    assert found.pose < POSE
    assert found.offset < 1.6, "no row is longer than the longest link"


@pytest.mark.parametrize("skew_deg", [0.0, 0.006, 0.4, 3.0])
def test_rows_of_nearly_parallel_axes_are_short(tmp_path: Path, skew_deg: float) -> None:
    rows = list(IRB6640)
    for k, angles in ((2, (0.3, 0.0, 1.0)), (5, (-0.2, 0.1, 0.05))):
        rows[k] = (rows[k][0], tuple(np.radians(skew_deg) * np.array(angles)), rows[k][2])
    text = urdf(rows, RIGHT + float(np.radians(skew_deg)))
    arm, flange_from_tip = converted(text, tmp_path)
    assert np.abs([arm.column("a"), arm.column("d")]).max() < 1.5
    assert (arm.joints[1].beta != 0) == (skew_deg != 0)
    links = links_of(text, "tool")
    for q in np.random.default_rng(1).uniform(-3, 3, (20, 6)):
        assert np.abs(arm.fk(q) @ flange_from_tip - judged_pose(links, q)[0]).max() < 1e-11
    assert np.abs(flange_from_tip - np.eye(4)).max() < 1e-9, "five parameters express a tilted tool"


def test_tilted_tool_leaves_the_closed_form(tmp_path: Path) -> None:
    arm, _ = converted(urdf(IRB6640, RIGHT + 0.03), tmp_path)
    assert arm.joints[5].beta != 0 or arm.joints[5].alpha != 0
    assert arm.has_closed_form
    q = np.random.default_rng(2).uniform(-3, 3, (50, 6))
    found = arm.ik(arm.fk(q))
    assert np.nanmin(np.abs(found - q[:, None]).max(-1), axis=1).max() < 1e-9


def test_names_of_branches_are_those_of_the_ideal_arm(tmp_path: Path) -> None:
    """Also where two branches nearly meet: the arm is nearly extended there, or the wrist straight."""
    ideal, _ = converted(urdf(IRB6640), tmp_path)
    rows = list(IRB6640)
    rows[2] = (rows[2][0], (2e-3, 0.0, -3e-3), rows[2][2])
    rows[4] = (rows[4][0], (0.0, 2e-3, 4e-3), rows[4][2])
    arm, _ = converted(urdf(rows), tmp_path)
    assert arm.branch_names == ideal.branch_names
    q = np.random.default_rng(3).uniform(-2.5, 2.5, (80, 6))
    q[:20, 4] *= 0.02
    q[20:40, 2] = np.arctan2(1.392, 0.2) - np.pi / 2 + 0.02 * q[20:40, 2]
    found, own = arm.ik(arm.fk(q), filtered=False), ideal.ik(ideal.fk(q), filtered=False)
    gap = np.abs(np.remainder(found - q[:, None] + np.pi, 2 * np.pi) - np.pi).max(-1)
    assert np.nanmin(gap, axis=1).max() < OWN
    named = np.nanargmin(np.abs(np.remainder(own - q[:, None] + np.pi, 2 * np.pi) - np.pi).max(-1), axis=1)
    assert (np.nanargmin(gap, axis=1) == named).mean() > 0.95


@pytest.mark.parametrize(
    ("angle", "right"),
    [
        *[("1.5708", True), ("1.570796", True), ("3.14159265359", True), ("4.71238", True), ("6.1e-17", True)],
        *[("0.000004", False), ("1.570799", False), ("1.5707903267948966", False), ("-3.1415966535897", False)],
    ],
)
def test_only_rounded_right_angles_are_right(tmp_path: Path, angle: str, right: bool) -> None:
    text = re.sub('xyz="0.32 0.0 0.0" rpy="[^"]*"', f'xyz="0.32 0 0" rpy="{angle} 0 0"', urdf(IRB6640))
    assert angle in text
    arm, _ = converted(text, tmp_path)
    exact = round(float(angle) / RIGHT) * RIGHT if right else float(angle)
    links = links_of(text.replace(angle, repr(exact)), "tool")
    q = np.full(6, 0.3)
    flange_from_tip = pose.inverse(arm.fk(q)) @ judged_pose(links, q)[0]
    again = pose.inverse(arm.fk(0 * q)) @ judged_pose(links, 0 * q)[0]
    assert np.abs(flange_from_tip - again).max() < 1e-11
