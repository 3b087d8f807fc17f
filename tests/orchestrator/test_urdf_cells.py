"""Cells from URDF files: poses of arm, table and obstacles against DART's reading of the file, and faults named."""

from __future__ import annotations

import re
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import dartpy
import numpy as np
import pytest
from scipy.spatial import cKDTree

from scancell.config.cell import CellDescription
from scancell.errors import DescriptionError
from scancell.geometry import pose
from scancell.geometry.mesh_files import read_mesh
from scancell.nominal.cell import NominalCell, nominal_cell
from scancell.nominal.from_urdf import ConvertedRobot, robot_from_urdf
from scancell.nominal.parts import pose_matrix

POSE = 1e-9  # m, and elements of rotation matrices
MESH = 2e-6  # m: single precision of STL files at a distance of 10 m


def words(values: Any) -> str:
    return " ".join(repr(float(value)) for value in values)


class Urdf:
    """The text of a URDF file with origins and axes in no special position, and shapes without symmetry."""

    def __init__(self, seed: int) -> None:
        self._rng = np.random.default_rng(seed)
        self.lines = ['<robot name="cell"><link name="root"/>']

    def origin(self) -> str:
        return f'<origin xyz="{words(self._rng.uniform(-0.3, 0.3, 3))}" rpy="{words(self._rng.uniform(-3, 3, 3))}"/>'

    def link(self, name: str, shape: bool = True) -> None:
        size = words(self._rng.uniform(0.05, 0.2, 3))
        box = f'<visual>{self.origin()}<geometry><box size="{size}"/></geometry></visual>'
        self.lines.append(f'<link name="{name}">{2 * box if shape else ""}</link>')

    def joint(self, parent: str, name: str, kind: str = "revolute", more: str = "", origin: str = "") -> str:
        """A joint ``to_NAME`` and the link `name` that it carries; returns the name of the link."""
        self.link(name)
        axis = f'<axis xyz="{words(self._rng.normal(size=3))}"/>'
        limit = '<limit lower="-3" upper="2.5" velocity="2" effort="9"/>'
        parts = f'<parent link="{parent}"/><child link="{name}"/>{origin or self.origin()}{axis}{limit}{more}'
        self.lines.append(f'<joint name="to_{name}" type="{kind}">{parts}</joint>')
        return name

    def arm(self, parent: str, joints: int = 6) -> str:
        """An arm on links fixed to a parent; returns the link of its tip."""
        link = self.joint(self.joint(parent, "stand", "fixed"), "base_plate", "fixed")
        self.joint(link, "plug", "fixed")
        for number in range(1, joints + 1):
            link = self.joint(self.joint(link, f"arm{number}"), f"cover{number}", "fixed")
        return self.joint(link, "tip", "fixed")

    def write(self, folder: Path) -> Path:
        file = folder / "cell.urdf"
        file.write_text("\n".join([*self.lines, "</robot>"]))
        return file


@dataclass
class Case:
    """A URDF file, what it became, and what moves the axes of the cell in the file."""

    urdf: Path
    made: ConvertedRobot
    nominal: NominalCell
    moved_by: dict[str, str]
    table: str = ""


def track() -> tuple[Urdf, dict[str, str], dict[str, Any]]:
    urdf = Urdf(1)
    urdf.joint("root", "fence", "fixed")
    urdf.joint(urdf.joint("root", "carriage", "prismatic"), "hose", "fixed")
    urdf.arm("carriage")
    return urdf, {"to_carriage": "to_carriage"}, {}


def turret() -> tuple[Urdf, dict[str, str], dict[str, Any]]:
    """Three axes before an arm of five joints: the first would be a joint of the arm, but for a lift behind it."""
    urdf = Urdf(2)
    link = urdf.joint(urdf.joint(urdf.joint("root", "Turret-1"), "lift", "prismatic"), "swivel", "continuous")
    urdf.arm(link, 5)
    moved_by = {"to_turret_1": "to_Turret-1", "to_lift": "to_lift", "to_swivel": "to_swivel"}
    return urdf, moved_by, {"base": "stand"}


def tilt_turn() -> tuple[Urdf, dict[str, str], dict[str, Any]]:
    urdf = Urdf(3)
    urdf.arm("root")
    link = urdf.joint(urdf.joint(urdf.joint("root", "frame", "fixed"), "tilt"), "cradle", "fixed")
    urdf.joint(urdf.joint(link, "turn", "continuous"), "face", "fixed")
    return urdf, {"to_tilt": "to_tilt", "table": "to_turn"}, {"table": "face"}


def both() -> tuple[Urdf, dict[str, str], dict[str, Any]]:
    """An axis that carries arm and table, and one more for each."""
    urdf = Urdf(4)
    urdf.joint("root", "portal", "prismatic")
    urdf.arm(urdf.joint("portal", "slide", "prismatic"), 7)
    urdf.joint(urdf.joint(urdf.joint("portal", "tilt"), "turn"), "face", "fixed")
    moved_by = {"to_portal": "to_portal", "to_slide": "to_slide", "to_tilt": "to_tilt", "table": "to_turn"}
    return urdf, moved_by, {"table": "face", "hold": [3]}


def converted(folder: Path, urdf: Urdf, moved_by: dict[str, str], options: dict[str, Any]) -> Case:
    file = urdf.write(folder)
    made = robot_from_urdf(file, "tip", folder / "arm.toml", cell=folder / "the_cell.toml", **options)
    cell = CellDescription.from_toml(folder / "the_cell.toml")
    return Case(file, made, nominal_cell(cell, None), moved_by, options.get("table", ""))


@pytest.fixture(scope="module", params=[track, turret, tilt_turn, both])
def case(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Case:
    return converted(tmp_path_factory.mktemp("urdf"), *request.param())


def dart_tree(urdf: Path) -> Any:
    """The skeleton of a URDF file in DART, its root fixed at the world's origin."""
    loader = dartpy.utils.DartLoader()
    options = dartpy.utils.DartLoaderOptions()
    options.mDefaultRootJointType = dartpy.utils.DartLoaderRootJointType.FIXED
    loader.setOptions(options)
    skeleton = loader.parseSkeleton(str(urdf))
    assert skeleton is not None
    return skeleton


def placed(case: Case, seed: int, count: int = 10) -> list[tuple[dict[str, Any], dict[str, Any]]]:
    """Poses of the frames of the cell, and of the links of the file by DART, at random positions of all axes."""
    tree = dart_tree(case.urdf)
    sign = -1.0 if any("other sign" in warning for warning in case.made.warnings) else 1.0
    arm = [tree.getJoint(i).getName() for i in range(tree.getNumJoints())]
    arm = [joint for joint in arm if joint.startswith("to_arm")]
    names = {f"joint[{number}]": f"to_arm{number}" for number in range(1, len(arm) + 1)} | case.moved_by
    assert set(case.nominal.axes) - {"table"} == set(names) - {"table"}
    found = []
    for axes in np.random.default_rng(seed).uniform(-2, 2, (count, len(case.nominal.axes))):
        at = dict(zip(case.nominal.axes, axes.tolist(), strict=True))
        signed = at | {"table": sign * at["table"]}
        for axis, joint in names.items():
            tree.getJoint(joint).setPosition(0, signed[axis])
        bodies = [tree.getBodyNode(i) for i in range(tree.getNumBodyNodes())]
        links = {body.getName(): body.getWorldTransform().matrix() for body in bodies}
        found.append((case.nominal.frame_poses(axes), links))
    return found


def test_flange_is_where_the_file_has_its_tip(case: Case) -> None:
    last = f"link[{len(case.nominal.arm.joints)}]"
    for frames, links in placed(case, 5):
        assert np.abs(frames[last] @ case.made.flange_from_tip - links["tip"]).max() < POSE
        sensor = links["tip"] @ pose.translation((0.0, 0.0, 0.08))  # the fixture of the default cell
        assert np.abs(frames["sensor"] - sensor).max() < POSE


def test_links_axes_and_table_move_like_those_of_the_file(case: Case) -> None:
    pairs = {f"link[{number}]": f"arm{number}" for number in range(1, len(case.nominal.arm.joints) + 1)}
    pairs |= {axis: joint.removeprefix("to_") for axis, joint in case.moved_by.items()}
    poses = placed(case, 6)
    for frame, link in pairs.items():
        fixed = [pose.inverse(links[link]) @ frames[frame] for frames, links in poses]
        assert np.abs(fixed - fixed[0]).max() < POSE
    if case.table:
        for frames, links in poses:
            table_from_link = pose.inverse(frames["table"]) @ links[case.table]
            # Its z is that of the joint, about which the link turns.
            joint = links[case.moved_by["table"].removeprefix("to_")]
            axis = joint[:3, :3] @ unit_axis(case.urdf, case.moved_by["table"])
            assert abs(abs(axis @ frames["table"][:3, 2]) - 1) < POSE
            gap = joint[:3, 3] - frames["table"][:3, 3]
            assert np.abs(np.cross(gap, axis)).max() < POSE
            assert np.isfinite(table_from_link).all()


def unit_axis(urdf: Path, joint: str) -> Any:
    (found,) = re.findall(rf'name="{joint}".*?<axis xyz="([^"]*)"', urdf.read_text())
    axis = np.array([float(word) for word in found.split()])
    return axis / np.linalg.norm(axis)


def test_obstacles_are_where_the_file_has_their_links(case: Case) -> None:
    obstacles = {obstacle.name: obstacle for obstacle in case.made.cell.obstacle}  # type: ignore[union-attr]
    assert obstacles
    for frames, links in placed(case, 7):
        for name, obstacle in obstacles.items():
            link = next(link for link in links if link == name)
            at = frames.get(obstacle.moves_with, np.eye(4)) @ pose_matrix(obstacle.pose)
            assert np.abs(at - links[link]).max() < POSE


def test_every_mesh_is_in_the_cell_once(case: Case) -> None:
    """All corners of all boxes of the file, placed by DART, against those of the bodies of the cell."""
    tree = dart_tree(case.urdf)
    ((frames, links),) = placed(case, 8, 1)
    theirs = []
    for name, at in links.items():
        for shape in tree.getBodyNode(name).getShapeNodes():
            corners = np.array(list(product((-0.5, 0.5), repeat=3))) * shape.getShape().getSize()
            theirs.append(pose.transform_points(at @ shape.getRelativeTransform().matrix(), corners))
    bodies = [
        b for b in case.nominal.bodies if b.name not in ("sensor", "part") and (case.table or b.name[:5] != "table")
    ]
    ours = [pose.transform_points(frames.get(b.moves_with, np.eye(4)), b.mesh.vertices) for b in bodies]
    one, two = (np.unique(np.concatenate(points).round(4), axis=0) for points in (ours, theirs))
    assert len(two) > 100
    for a, b in ((ours, theirs), (theirs, ours)):
        assert cKDTree(np.concatenate(a)).query(np.concatenate(b))[0].max() < MESH
    assert one.shape == two.shape


def small(*more: str, joints: int = 6, before: str = "") -> str:
    """A file of an arm with axes along coordinates on a track, on whose last link or beside which is more."""
    lines = ['<robot name="small">', *(f'<link name="{name}"/>' for name in ("root", "base", "slide", "tip"))]
    lines.append(
        '<joint name="track" type="prismatic"><parent link="root"/><child link="slide"/><axis xyz="0 1 0"/>'
        f'<limit lower="0.1" upper="2" velocity="1.5"/>{before}</joint>'
        '<joint name="mount" type="fixed"><parent link="slide"/><child link="base"/></joint>'
    )
    link = "base"
    for number in range(1, joints + 1):
        lines.append(
            f'<link name="a{number}"/><joint name="j{number}" type="revolute"><parent link="{link}"/>'
            f'<child link="a{number}"/><origin xyz="0.1 0 0.2"/><axis xyz="{number % 2} 0 {(number + 1) % 2}"/>'
            '<limit lower="-2" upper="2" velocity="1"/></joint>'
        )
        link = f"a{number}"
    lines.append(f'<joint name="end" type="fixed"><parent link="{link}"/><child link="tip"/></joint>')
    return "\n".join([*lines, *more, "</robot>"])


def branch(name: str, parent: str, kind: str, more: str = "", shape: bool = True) -> str:
    box = '<visual><geometry><box size="0.1 0.2 0.3"/></geometry></visual>' if shape else ""
    return (
        f'<link name="{name}">{box}</link><joint name="to_{name}" type="{kind}"><parent link="{parent}"/>'
        f'<child link="{name}"/><origin xyz="0.5 0.3 0.1"/><axis xyz="0 0 1"/>'
        f'<limit lower="-1" upper="1" velocity="1"/>{more}</joint>'
    )


def made_of(folder: Path, text: str, **options: Any) -> ConvertedRobot:
    file = folder / "small.urdf"
    file.write_text(text)
    return robot_from_urdf(file, "tip", folder / "arm.toml", **{"cell": folder / "out.toml", **options})


def test_joints_that_follow_rest_where_they_start(tmp_path: Path) -> None:
    """A lever on the arm's second joint, one on the lever, and a bellows on the track, whose start is its limit."""
    text = small(
        branch("lever", "a1", "revolute", '<mimic joint="j2" multiplier="-2" offset="0.25"/>'),
        branch("rod", "lever", "revolute", '<mimic joint="to_lever" multiplier="0.5"/>'),
        branch("bellows", "root", "prismatic", '<mimic joint="track" multiplier="0.5" offset="0.01"/>'),
    )
    made = made_of(tmp_path, text, home_deg=[0, 30, 0, 0, 0, 0])
    lever = 0.25 - 2 * np.radians(30)
    held = [warning for warning in made.warnings if "held" in warning]
    assert [float(re.findall(r"held at (\S+)", warning)[0]) for warning in held] == pytest.approx(
        [60.0, np.degrees(lever), np.degrees(0.5 * lever)], rel=1e-5
    )
    for warning, follower, leader in zip(
        held, ("to_bellows", "to_lever", "to_rod"), ("track", "j2", "j2"), strict=True
    ):
        assert warning.startswith(f"joint '{follower}' is held at")
        assert f"it follows joint '{leader}'" in warning
    assert made.cell is not None
    assert made.cell.axis[0].start_mm == 100.0  # type: ignore[union-attr]
    (bellows,) = made.cell.obstacle
    assert (bellows.name, bellows.moves_with, bellows.pose.z_mm) == ("bellows", "world", pytest.approx(160.0))
    # The lever and the rod, turned about z of the first link, are its mesh.
    nominal = nominal_cell(made.cell, None)
    mesh = next(body.mesh for body in nominal.bodies if body.name == "link1")
    first = nominal.frame_poses(nominal.with_further_axes([*nominal.home, 0.0]))["link[1]"]
    corners = np.array(list(product((-0.05, 0.05), (-0.1, 0.1), (-0.15, 0.15))))
    expected, at = [], pose.translation((0.1, 0.1, 0.2))  # of link a1 in the world: the track starts at 0.1 m
    for angle in (lever, 0.5 * lever):
        turned = pose.from_rotation(pose.rotation_about(2, angle))
        at = at @ pose.translation((0.5, 0.3, 0.1)) @ turned
        expected.append(pose.transform_points(at, corners))
    ours = pose.transform_points(first, mesh.vertices)
    assert cKDTree(ours).query(np.concatenate(expected))[0].max() < MESH
    assert len(ours) == 16


def test_what_is_left_out_is_named(tmp_path: Path) -> None:
    text = small(
        branch("palm", "tip", "fixed"),
        branch("thumb", "palm", "revolute"),
        branch("nail", "thumb", "fixed"),
        branch("claw", "nail", "prismatic", '<mimic joint="to_thumb"/>'),
        branch("finger", "palm", "revolute", '<mimic joint="to_thumb"/>'),
        branch("drone", "root", "floating"),
        '<link name="lonely"/>',
    )
    assert made_of(tmp_path, text).warnings[:4] == (
        "left out joint 'to_drone' of type 'floating' and what it carries, link 'drone': it is beside the chain",
        "left out joint 'to_thumb' and what it carries, links 'thumb', 'nail', 'claw', and joint 'to_claw' between"
        " them: it is beside the chain",
        "left out joint 'to_finger' and what it carries, link 'finger': it is beside the chain",
        "left out link 'lonely', which no joint connects to 'root'",
    )


def test_table_of_a_link_along_its_axis(tmp_path: Path) -> None:
    """The platter's mesh is 150 mm high above its link, whose z points against the joint."""
    turn = branch("turn", "stand", "revolute").replace("0 0 1", "0 0 -1")
    text = small(branch("stand", "root", "fixed"), turn, branch("arm_like", "stand", "fixed"))
    made = made_of(tmp_path, text, table="turn")
    assert made.cell is not None
    table = made.cell.table
    assert (table.moves_with, table.pose.x_mm, table.pose.y_mm) == ("world", 1000.0, 600.0)
    assert table.pose.z_mm == pytest.approx(350.0)
    assert (table.pose.rx_deg, table.pose.ry_deg, table.pose.rz_deg) == (0.0, 0.0, 0.0)
    assert (table.radius_mm, table.thickness_mm) == pytest.approx((np.hypot(50, 100), 300.0))
    assert table.max_speed_deg_s == pytest.approx(np.degrees(1.0))
    said = "\n".join(made.warnings)
    assert "the top of the table is that of the meshes of link 'turn', 150.000 mm above its origin" in said
    assert "angles of the table are those of joint 'to_turn' with the other sign" in said
    assert "the table turns without limits; joint 'to_turn' has those from -57.2958 to 57.2958 deg" in said
    assert made.cell.obstacle == ()  # stand and arm_like carry the table: they are its base
    assert table.base_mesh


def test_table_without_mesh(tmp_path: Path) -> None:
    made = made_of(tmp_path, small(branch("turn", "root", "continuous", shape=False)), table="turn")
    assert made.cell is not None
    assert made.cell.table.platter_mesh is None
    assert made.cell.table.pose.z_mm == pytest.approx(100.0)
    assert "link 'turn' has no mesh: radius and thickness of the table are assumed" in made.warnings


def test_names_of_axes_and_obstacles_are_free(tmp_path: Path) -> None:
    text = small(
        branch("table", "root", "fixed"), branch("LINK1", "slide", "fixed"), branch("9.b/c", "root", "fixed")
    ).replace('"track"', '"Q7"')
    made = made_of(tmp_path, text)
    assert made.cell is not None
    assert [axis.name for axis in made.cell.axis] == ["q7_axis"]
    assert {obstacle.name for obstacle in made.cell.obstacle} == {"table_2", "LINK1_2", "link_9_b_c"}
    assert "joint 'Q7' is the axis 'q7_axis'" in made.warnings


def test_meshes_too_large_for_a_cell_are_left_out(tmp_path: Path) -> None:
    text = small(branch("floor", "root", "fixed").replace("0.1 0.2 0.3", "9 9 0.01"))
    made = made_of(tmp_path, text)
    assert made.cell is not None
    assert made.cell.obstacle == ()
    assert any(warning.startswith("left out the mesh of link 'floor', which no cell") for warning in made.warnings)
    nominal_cell(CellDescription.from_toml(tmp_path / "out.toml"), None)


def test_empty_and_repeated_shapes_are_named(tmp_path: Path) -> None:
    empty = branch("post", "root", "fixed").replace('<box size="0.1 0.2 0.3"/>', "")
    twice = branch("fence", "root", "fixed").replace("<box", '<sphere radius="0.2"/><box')
    made = made_of(tmp_path, small(empty, twice))
    assert made.warnings[:2] == (
        "link 'post' has a <visual> without a shape",
        "link 'fence' has a <visual> of several shapes, of which the first is taken",
    )
    assert made.cell is not None
    assert [obstacle.name for obstacle in made.cell.obstacle] == ["fence"]


def test_all_that_is_fixed_to_the_root_is_the_base_without_a_cell(tmp_path: Path) -> None:
    text = small(branch("fence", "root", "fixed"), branch("plate", "base", "fixed")).replace("prismatic", "fixed")
    alone, within = made_of(tmp_path, text, cell=None), made_of(tmp_path, text)
    assert alone.cell is None
    assert [file.name for file in alone.files] == ["arm.toml", "base.stl"]
    assert within.cell is not None
    assert [obstacle.name for obstacle in within.cell.obstacle] == ["fence"]
    assert within.description.base == alone.description.base


FAULTS: list[tuple[str, dict[str, Any], str]] = [
    (small(), {"cell": None}, "the joints 'track' move the base of the arm, .* expected `cell`, the file of a cell"),
    (small(branch("t", "root", "continuous")), {"cell": None, "table": "t"}, "table = 't': a table needs a cell"),
    (small(), {"base": "a3"}, r"small.urdf: 3 joints from link 'a3' to 'tip'; expected 4 to 8"),
    (small(), {"base": "root"}, "joint 'track': type 'prismatic' between base 'root' and tip; expected revolute"),
    (small(), {"base": "lost"}, "no link 'lost' before the arm; expected one of root, slide, base, a1"),
    (small(), {"base": "tip"}, "no link 'tip' before the arm"),
    (small(joints=3), {}, "joint 'track': type 'prismatic', with 3 joints behind it up to 'tip'; expected 4 to 8 that"),
    (small(joints=9), {}, "9 joints .*expected 4 to 8"),
    (small(before='<mimic joint="j1"/>'), {}, r"joint 'track': follows joint 'j1' \(<mimic>\) between root and tip"),
    (small(), {"table": "lost"}, "no link 'lost'; expected one of root, base, slide, tip, a1"),
    (small(), {"table": "root"}, "link 'root': no joint moves the table; expected a revolute or continuous joint"),
    (small(), {"table": "slide"}, "link 'slide': the table and the arm both move with joint 'track'; expected a joint"),
    (small(), {"table": "tip"}, "link 'tip': the table and the arm both move with joint 'j1'"),
    (small(branch("t", "a2", "continuous")), {"table": "t"}, "the table and the arm both move with joint 'j1'"),
    (small(branch("t", "root", "prismatic")), {"table": "t"}, "link 't': joint 'to_t' slides the table; expected"),
    (small('<link name="t"/>'), {"table": "t"}, "link 't': the table is not connected to the arm; expected a"),
    (
        small(branch("t", "root", "revolute", '<mimic joint="j1"/>')),
        {"table": "t"},
        "joint 'to_t': follows joint 'j1' (<mimic>) between root and table; expected a joint of its own",
    ),
    (small(branch("t", "root", "planar")), {"table": "t"}, "type 'planar' between root and table; expected revolute"),
    (
        small(branch("u", "root", "revolute"), branch("v", "u", "revolute"), branch("w", "v", "prismatic"),
              branch("t", "w", "revolute")),
        {"table": "t"},
        "the joints 'track', 'to_u', 'to_v', 'to_w' are 4 axes beside arm and table; expected at most 3",
    ),
    (small(branch("b", "a1", "revolute", '<mimic joint="lost"/>')), {}, "joint 'to_b': follows joint 'lost' (<mimic>)"),
    (small(branch("b", "a1", "revolute", '<mimic joint="to_b"/>')), {}, "joint 'to_b': follows itself (<mimic>)"),
    (
        small(branch("b", "a1", "revolute", '<mimic joint="j1" multiplier="x"/>')),
        {},
        "joint 'to_b': multiplier = 'x': expected 1 number",
    ),
    (
        small(branch("b", "a1", "revolute", '<mimic joint="j1" offset="nan"/>')),
        {},
        "joint 'to_b': offset = 'nan': expected 1 number",
    ),
    (
        small(branch("b", "root", "fixed"), '<joint name="again"><parent link="a2"/><child link="b"/></joint>'),
        {},
        "joint 'again': carries link 'b' like joint 'to_b'; expected one joint per link",
    ),
    (small().replace('lower="0.1"', 'lower="5"'), {}, "joint 'track': limits 5 to 2 m; expected lower below upper"),
    (small().replace('upper="2" velocity="1.5"', ""), {}, "joint 'track': limits 0.1 to 0 m; expected lower"),
    (small().replace('"1.5"', '"-1.5"'), {}, "joint 'track': velocity -1.5 m/s; expected a number above 0"),
    (small().replace('"1.5"', '"inf"'), {}, "joint 'track': velocity = 'inf': expected 1 number"),
    (small().replace('"1.5"', '"1_5"'), {}, "joint 'track': velocity = '1_5': expected 1 number"),
    (small().replace('"0.1 0 0.2"', '"0.1 nan 0.2"'), {}, "joint 'j1': xyz = '0.1 nan 0.2': expected 3 numbers"),
    (small().replace('upper="2" velocity="1.5"', 'upper="2e5"'), {}, "max_mm = 200000000.0: must be less than"),
    (
        small(branch("b", "root", "fixed").replace("0.1 0.2 0.3", "0.1 -0.2 0.3")),
        {},
        "link 'b': size = '0.1 -0.2 0.3': expected at least 0",
    ),
]  # fmt: skip


@pytest.mark.parametrize(("text", "options", "expected"), FAULTS, ids=[str(number) for number in range(len(FAULTS))])
def test_faults_are_named(tmp_path: Path, text: str, options: dict[str, Any], expected: str) -> None:
    with pytest.raises(DescriptionError) as caught:
        made_of(tmp_path, text, **options)
    pattern = expected if ".*" in expected or "\\" in expected else re.escape(expected)
    assert re.search(pattern, str(caught.value)), str(caught.value)
    assert "a table needs" in expected or "small.urdf" in str(caught.value)
    assert sorted(file.name for file in tmp_path.iterdir()) == ["small.urdf"]


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ({"home_deg": [0, float("nan"), 0, 0, 0, 0]}, "home_deg"),
        ({"home_deg": ["0", 0, 0, 0, 0, 0]}, "home_deg"),
        ({"home_deg": [0, 0, 0, 0, 0]}, "home_deg has 5 angles: expected one for each of the 6 joints"),
        ({"home_deg": [0, 0, 0, 0, 0, 200]}, "home_deg.6. = 200: expected an angle between"),
        ({"table": 3}, "table"),
        ({"base": ""}, "no link '' before the arm"),
        ({"hold": [1]}, "held names 1 joints: expected 0"),
    ],
)
def test_wrong_arguments_are_named(tmp_path: Path, options: dict[str, Any], expected: str) -> None:
    with pytest.raises(DescriptionError, match=expected):
        made_of(tmp_path, small(branch("b", "a1", "revolute", '<mimic joint="j2"/>')), **options)
    assert sorted(file.name for file in tmp_path.iterdir()) == ["small.urdf"]


def test_outputs_are_not_inputs(tmp_path: Path) -> None:
    with pytest.raises(DescriptionError, match=r"cell = '.*arm\.toml': expected another file than that of the robot"):
        made_of(tmp_path, small(), cell=tmp_path / "arm.toml")
    made_of(tmp_path, small(branch("fence", "root", "fixed")))
    mesh = '<mesh filename="out/fence.stl" scale="0.001 0.001 0.001"/>'
    text = small(branch("fence", "root", "fixed").replace('<box size="0.1 0.2 0.3"/>', mesh))
    file, before = tmp_path / "out" / "fence.stl", (tmp_path / "out" / "fence.stl").read_bytes()
    with pytest.raises(DescriptionError, match=r"fence\.stl: would overwrite a mesh of the URDF file"):
        made_of(tmp_path, text)
    assert file.read_bytes() == before


def test_mirrored_meshes_keep_their_outside(tmp_path: Path) -> None:
    made_of(tmp_path, small(branch("fence", "root", "fixed")))
    (tmp_path / "out" / "fence.stl").rename(tmp_path / "box.stl")
    mesh = '<mesh filename="box.stl" scale="-0.001 0.001 0.001"/>'
    made = made_of(tmp_path, small(branch("wall", "root", "fixed").replace('<box size="0.1 0.2 0.3"/>', mesh)))
    assert made.cell is not None
    (wall,) = made.cell.obstacle
    vertices, faces, _ = read_mesh(Path(wall.mesh))
    corners = np.asarray(vertices, float)[faces]
    assert np.einsum("ij,ij->", np.cross(corners[:, 0], corners[:, 1]), corners[:, 2]) / 6 == pytest.approx(6e6)
