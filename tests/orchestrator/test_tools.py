"""Named tools and user frames of the description: names, poses, straight lines, jogs, programs, guard."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from scancell import Scanner
from scancell.cell.driver import JogFrame, Operation
from scancell.config.loading import load_setup
from scancell.errors import CommandError, DescriptionError
from scancell.geometry import pose
from scancell.programs.program import run_program
from scancell.programs.robot import deg, location, mm

Array = np.ndarray
TOOL = '{{ name = "{}", flange_from_tcp = {{ x_mm = 90, y_mm = -20, z_mm = 120, rx_deg = 15, ry_deg = -30 }} }}'
FRAME = '{{ name = "{}", moves_with = "{}", pose = {{ x_mm = {}, z_mm = 20, rx_deg = 10, rz_deg = 40 }} }}'
SETTINGS = [
    f"cell.tcp=[{TOOL.format('tip')}]",
    f"cell.frame=[{FRAME.format('fixture', 'world', 430)}, {FRAME.format('jig', 'table', 30)}]",
]
FLANGE_FROM_TIP = location(90 * mm, -20 * mm, 120 * mm, rx=15 * deg, ry=-30 * deg)


@pytest.fixture(scope="module")
def scanner() -> Iterator[Scanner]:
    with Scanner(setup=load_setup(settings=SETTINGS, ideal=True), threads=1) as made:
        yield made


def frame(x: float) -> Array:
    return location(x, 0, 20 * mm, rx=10 * deg, rz=40 * deg)


@pytest.mark.parametrize(
    ("key", "text", "names", "message"),
    [
        ("tcp", TOOL, ["sensor"], r"tcp\[1\]\.name = 'sensor': expected .* taken: gripper, sensor"),
        ("tcp", TOOL, ["tip", "gripper"], r"tcp\[2\]\.name = 'gripper': expected a name that no other tool has"),
        ("tcp", TOOL, ["tip", "tip"], r"tcp\[2\]\.name = 'tip': expected .* taken: gripper, sensor, tip"),
        ("frame", FRAME, ["table"], r"frame\[1\]\.name = 'table': expected a name that no other frame has"),
        ("frame", FRAME, ["jig", "jig"], r"frame\[2\]\.name = 'jig': expected a name that no other frame has"),
    ],
)
def test_taken_name_is_rejected_with_file_key_and_value(key: str, text: str, names: list[str], message: str) -> None:
    items = ", ".join(text.format(name, "world", 0) for name in names)
    with pytest.raises(DescriptionError, match=rf"default\.toml.*{message}"):
        load_setup(settings=[f"cell.{key}=[{items}]"])


def test_frames_have_their_poses_at_any_table_angle(scanner: Scanner) -> None:
    with scanner.session() as session:
        session.turn_table(0.7)
        table = session.nominal.world_from_table @ pose.from_rotation(pose.rotation_about(2, 0.7))
        np.testing.assert_allclose(session.world_from_frame("table"), table, atol=1e-12)
        np.testing.assert_allclose(session.world_from_frame("jig"), table @ frame(30 * mm), atol=1e-12)
        np.testing.assert_allclose(session.world_from_frame("fixture"), frame(430 * mm), atol=1e-12)


def test_unknown_tool_or_frame_is_named_with_those_of_the_cell(scanner: Scanner) -> None:
    with scanner.session() as session:
        with pytest.raises(DescriptionError, match=r"tool = 'nozzle': expected 'sensor', 'tip'"):
            session.move_line(session.world_from_tool(), "nozzle")
        with pytest.raises(DescriptionError, match=r"frame = 'jigg': expected 'base', 'table', 'fixture', 'jig'"):
            session.world_from_frame("jigg")
        with pytest.raises(CommandError, match="the cell has no gripper"):
            session.move_tool(session.world_from_tool(), "gripper")


def test_line_of_named_tool_is_straight_while_it_turns(scanner: Scanner) -> None:
    with scanner.session() as session:
        start = session.nominal.arm.fk(session.joints) @ FLANGE_FROM_TIP
        np.testing.assert_allclose(session.world_from_tool("tip"), start, atol=1e-12)
        goal = pose.translation((0.03, -0.05, -0.04)) @ start @ location(0, 0, 0, rx=12 * deg, rz=-15 * deg)
        flanges: list[Array] = []
        session.cell.on_step(lambda: flanges.append(session.snapshot(1e-6).truth.world_from_frame["link[6]"][0, 0]))
        session.move_line(goal, "tip", speed=0.3)
        np.testing.assert_allclose(session.world_from_tool("tip"), goal, atol=1e-9)
    travel = (np.array(flanges) @ FLANGE_FROM_TIP)[:, :3, 3] - start[:3, 3]
    along = goal[:3, 3] - start[:3, 3]
    across = travel - np.outer(travel @ along, along) / (along @ along)
    assert len(travel) > 10
    assert np.linalg.norm(across, axis=1).max() < 1e-6


def test_jog_about_own_axes_keeps_origin_of_named_tool(scanner: Scanner) -> None:
    with scanner.session() as session:
        session.set_operation(Operation.MANUAL)
        start = session.world_from_tool("tip")
        session.start_jog_sensor([0, 0, 0, 0.3, 0.0, -0.4], JogFrame.SENSOR, "tip")
        session.wait(0.5)
        end = session.world_from_tool("tip")
    np.testing.assert_allclose(end[:3, 3], start[:3, 3], atol=1e-6)
    turn = start[:3, :3].T @ end[:3, :3]
    axis = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    np.testing.assert_allclose(axis / np.linalg.norm(axis), [0.6, 0.0, -0.8], atol=1e-4)


@pytest.mark.parametrize("name", ["fixture", "jig"])
def test_jog_follows_axes_of_a_frame(scanner: Scanner, name: str) -> None:
    """Also with full deflections along two axes, which the frame may turn beyond 1 along an axis of the world."""
    with scanner.session() as session:
        session.turn_table(0.5)
        session.set_operation(Operation.MANUAL)
        start, axes = session.world_from_tool("tip"), session.world_from_frame(name)[:3, :3]
        session.start_jog_sensor([1, -1, 0, 0, 0, 0], name, "tip")
        session.wait(0.3)
        end = session.world_from_tool("tip")
    travel = axes.T @ (end - start)[:3, 3]
    np.testing.assert_allclose(travel / np.linalg.norm(travel), np.array([1, -1, 0]) / np.sqrt(2), atol=1e-4)
    assert np.linalg.norm(travel) > 0.01
    np.testing.assert_allclose(end[:3, :3], start[:3, :3], atol=1e-6)


def test_program_uses_named_tool_and_frame(scanner: Scanner, tmp_path: Path) -> None:
    (tmp_path / "program.py").write_text("""
from scancell import Robot, deg, location, mm

def main(robot: Robot) -> None:
    robot.set_tool("tip")
    over = robot.world_from_frame("fixture") @ location(20 * mm, 10 * mm, 200 * mm, rx=170 * deg)
    robot.move_tool(over)
    robot.set_speed(0.3)
    robot.move_line(over @ location(0, 0, 30 * mm, rz=10 * deg))
""")
    with scanner.session(guarded=True) as session:
        run_program(tmp_path / "program.py", session, "geometric", tmp_path)
        reached = session.world_from_tool("tip")
    expected = location(20 * mm, 10 * mm, 200 * mm, rx=170 * deg) @ location(0, 0, 30 * mm, rz=10 * deg)
    np.testing.assert_allclose(reached, frame(430 * mm) @ expected, atol=1e-9)


def test_guard_holds_jog_of_named_tool_before_table(scanner: Scanner) -> None:
    """About the axes of a tip beside the sensor, which swings into the table."""
    with scanner.session(guarded=True) as session:
        session.move_tool(location(480 * mm, 0, 150 * mm, rx=170 * deg))
        pairs: list[int] = []
        session.cell.on_step(lambda: pairs.append(session.cell.get_integer("truth.collision.pairs")))
        session.set_operation(Operation.MANUAL)
        origin = session.world_from_tool("tip")[:3, 3]
        with pytest.raises(CommandError, match=r"held by the guard: no jog: sensor - table: \d mm"):
            session.jog_sensor([0, 0, 0, 0, -1, 0], 10.0, tool="tip")
        session.wait(1.0)
        turned = session.world_from_tool("tip")
    assert max(pairs) == 0
    np.testing.assert_allclose(turned[:3, 3], origin, atol=1e-3)
