"""Taught programs: edits, the text of their files, and what is rejected as data."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from scancell import Scanner
from scancell.browser.panels.teach_panel import step_label
from scancell.config.loading import assets_dir, load_setup
from scancell.errors import DescriptionError
from scancell.geometry import pose
from scancell.programs.program import run_program
from scancell.programs.robot import deg, location, mm
from scancell.programs.taught import (
    COMMANDS,
    MAX_STEPS,
    JointPoint,
    PosePoint,
    TaughtFile,
    TaughtProgram,
    TaughtStep,
    program_text,
    read_program,
)

WITH_GRIPPER = Path(__file__).parents[2] / "assets" / "exercises" / "gripper.toml"
START = location(430 * mm, 0, 230 * mm, rx=180 * deg)
END = START @ location(20 * mm, 0, 0)
HOME = JointPoint((0.0, -60 * deg, 185 * deg, 0.0, 55 * deg, 0.0))


def taught() -> TaughtProgram:
    """A motion to joint angles, a line, a scan."""
    program = TaughtProgram()
    program = program.with_step(0, TaughtStep("move_joints", "above", 0.0, 0.5), HOME)
    program = program.with_step(1, TaughtStep("move_line", "start", speed=0.5), PosePoint.of(START))
    return program.with_step(2, TaughtStep("scan_line", "end", 1 * mm, 0.2), PosePoint.of(END))


def every_command() -> TaughtProgram:
    program = taught()
    program = program.with_step(1, TaughtStep("open_gripper", value=60 * mm))
    program = program.with_step(2, TaughtStep("move_line", "grip", speed=0.3, tool="gripper"), PosePoint.of(START))
    program = program.with_step(3, TaughtStep("close_gripper", value=20.0)).with_step(4, TaughtStep("wait", value=0.5))
    program = program.with_step(5, TaughtStep("turn_table", value=-30 * deg, speed=0.3))
    program = program.with_step(6, TaughtStep("move_axis", value=-1234.567 * mm, speed=0.3, axis="track", unit="mm"))
    return program.with_step(7, TaughtStep("move_axis", value=30 * deg, axis="tilt_2", unit="deg"))


def names(program: TaughtProgram) -> list[str]:
    return [step.point or step.command for step in program.steps]


def main_of(*lines: str) -> str:
    return "\n".join(["from scancell import Robot, deg, location, mm", "def main(robot: Robot) -> None:", *lines])


@pytest.mark.parametrize("program", [TaughtProgram(), taught(), every_command()], ids=["empty", "scan", "every"])
def test_text_is_read_back(program: TaughtProgram) -> None:
    text = program_text(program)
    again = read_program(text, "taught.py")
    assert program_text(again) == text
    assert [(step.command, step.point, step.tool) for step in again.steps] == [
        (step.command, step.point, step.tool) for step in program.steps
    ]
    for step, back in zip(program.steps, again.steps, strict=True):
        np.testing.assert_allclose(back.value or 0.0, step.value or 0.0, atol=1e-9)
    compile(text, "taught.py", "exec")


def test_every_command_is_in_the_text() -> None:
    text = program_text(every_command())
    assert all(f"robot.{command}(" in text for command in COMMANDS)


def test_any_pose_is_kept_to_a_micrometre() -> None:
    """Also at a distance of 0.3 m from the tool, in orientations where Euler angles are singular."""
    random = np.random.default_rng(1)
    angles = [*random.uniform(-np.pi, np.pi, (50, 3)), (0.3, np.pi / 2, 0.2), (np.pi, 0.0, 0.0), (-0.1, -np.pi / 2, 0)]
    for turn in angles:
        world_from_tool = pose.from_euler_xyz(random.uniform(-0.8, 0.8, 3), turn)
        program = TaughtProgram().with_step(0, TaughtStep("move_line", "p1"), PosePoint.of(world_from_tool))
        point = read_program(program_text(program), "taught.py").points["p1"]
        assert isinstance(point, PosePoint)
        np.testing.assert_allclose(point.world_from_tool[:3, 3], world_from_tool[:3, 3], atol=0.51e-6)
        np.testing.assert_allclose(0.3 * point.world_from_tool[:3, :3], 0.3 * world_from_tool[:3, :3], atol=1e-6)


def test_saved_program_runs_and_measures(ideal_scanner: Scanner, tmp_path: Path) -> None:
    file = TaughtFile(tmp_path / "taught.py")
    file.write(taught())
    with ideal_scanner.session(guarded=True) as session:
        done = run_program(file.path, session, "geometric", tmp_path / "run")
        np.testing.assert_allclose(session.world_from_tool(), END, atol=1e-6)
    text = file.path.read_text().splitlines()
    assert [step.command for _, step in done.steps] == ["move_joints", "move_line", "scan_line"]
    assert all(step.command in text[line - 1] for line, step in done.steps)
    line = done.steps[2][1]
    slow = np.linalg.norm((END - START)[:3, 3]) / (line.end - line.begin)
    assert slow < 0.2 * 0.5  # m/s, below a fifth of the line speed of the arm


def test_taught_grasp_lifts_the_part(tmp_path: Path) -> None:
    """As exercise 2; poses of lines are those of the gripper."""
    pick = location(450 * mm, 0, 149 * mm, rx=180 * deg, rz=-90 * deg)
    above = pick @ location(0, 0, -80 * mm)
    with (
        Scanner(setup=load_setup(WITH_GRIPPER, ideal=True), threads=1) as scanner,
        scanner.session(assets_dir() / "parts" / "step_block.stl", guarded=True) as session,
    ):
        joints = JointPoint(tuple(session.joints_for(above, "gripper").tolist()))
        points = {"above": joints, "pick": PosePoint.of(pick), "up": PosePoint.of(above)}
        steps = (
            TaughtStep("open_gripper", value=65 * mm),
            TaughtStep("move_joints", "above", 0.0, 0.3),
            TaughtStep("move_line", "pick", speed=0.3, tool="gripper"),
            TaughtStep("close_gripper", value=30.0),
            TaughtStep("move_line", "up", speed=0.3, tool="gripper"),
        )
        file = TaughtFile(tmp_path / "taught.py")
        file.write(TaughtProgram(points, steps))
        done = run_program(file.path, session, "geometric", tmp_path)
        height = session.cell.get(session.cell.real_group(["truth.part[1].position[3]"]))[0]
    assert done.contacts == []
    assert height == pytest.approx(180 * mm, abs=1 * mm)


def test_steps_are_reordered_copied_and_deleted() -> None:
    program = taught()
    assert names(program.moved(2, -1)) == ["above", "end", "start"]
    assert names(program.moved(0, 1)) == ["start", "above", "end"]
    assert names(program.moved(0, -1)) == names(program.moved(2, 1)) == names(program)
    twice = program.with_copy(0)
    assert names(twice) == ["above", "above", "start", "end"]
    assert set(twice.without(0).points) == {"above", "start", "end"}
    assert set(program.without(0).points) == {"start", "end"}  # a point that no step uses is dropped
    with pytest.raises(DescriptionError, match="there is no step 4; expected 1 to 3"):
        program.without(3)


def test_point_is_renamed_and_replaced_in_all_its_steps() -> None:
    twice = taught().with_copy(1).renamed("start", "corner")
    assert names(twice) == ["above", "corner", "corner", "end"]
    moved = twice.with_point("corner", PosePoint.of(END))
    np.testing.assert_allclose(moved.points["corner"].world_from_tool, END, atol=1e-12)  # type: ignore[union-attr]
    with pytest.raises(DescriptionError, match="name = 'end': expected a name that no other point has"):
        twice.renamed("corner", "end")


def test_line_turns_the_table_to_where_it_was_taught() -> None:
    step = TaughtStep("move_line", "seen", speed=0.4)
    there, same = (taught().with_line(3, step, PosePoint.of(START), angle) for angle in (30 * deg, 0.001 * deg))
    assert names(there) == ["above", "start", "end", "turn_table", "seen"]
    assert (there.steps[3].value, there.steps[3].speed) == (30 * deg, 0.4)
    assert names(same) == ["above", "start", "end", "seen"]
    assert names(TaughtProgram().with_line(0, step, PosePoint.of(START), 0.0)) == ["turn_table", "seen"]


@pytest.mark.parametrize(
    "name", ["", "1st", "two words", "for", "robot", "a" * 41, "x\nimport os", "é", "__import__('os')"]
)
def test_name_that_is_no_name_is_rejected(name: str) -> None:
    with pytest.raises(DescriptionError, match=r"name = .*expected a Python name"):
        taught().renamed("start", name)


@pytest.mark.parametrize(
    ("command", "value", "speed"),
    [
        ("scan_line", 0.0, 1.0),
        ("scan_line", float("nan"), 1.0),
        ("wait", -1.0, 1.0),
        ("wait", None, 1.0),
        ("move_line", 1.0, 1.0),
        ("wait", 1.0, 0.5),
        ("turn_table", 0.0, 0.0),
        ("turn_table", 0.0, float("inf")),
    ],
)
def test_number_out_of_range_is_rejected(command, value, speed) -> None:
    with pytest.raises(DescriptionError):
        TaughtStep(command, value=value, speed=speed)


@pytest.mark.parametrize("number", [float("nan"), float("inf"), 1e3])
def test_point_out_of_range_is_rejected(number: float) -> None:
    with pytest.raises(DescriptionError, match=r"p1 = .*expected finite numbers from -100 to 100"):
        TaughtProgram().with_step(0, TaughtStep("move_joints", "p1", 0.0), JointPoint((0.0, number)))


def test_number_of_steps_is_limited() -> None:
    step = TaughtStep("wait", value=1.0)
    full = TaughtProgram(steps=(step,) * MAX_STEPS)
    with pytest.raises(DescriptionError, match=f"expected at most {MAX_STEPS}"):
        full.with_step(0, step)


def test_values_edited_by_hand_are_read() -> None:
    text = """from scancell import Robot, deg, location, mm

# where the scan begins
start = location(0.43, 0, 230 * mm, rx=180 * deg)  # metres are allowed, too
"""
    text += main_of('    """Comments are allowed."""', "    robot.move_line(", "        start", "    )")
    (step,) = (program := read_program(text, "taught.py")).steps
    assert (step.command, step.point, step.speed) == ("move_line", "start", 1.0)
    np.testing.assert_allclose(program.points["start"].world_from_tool, START, atol=1e-12)  # type: ignore[union-attr]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("import os\n", r"taught\.py:1: import os; expected a command as the workspace writes it"),
        ("from scancell import deg as mm\n", r"taught\.py:1: from scancell import deg as mm"),
        ("start = open('x')\n", r"taught\.py:1: open\('x'\)"),
        ("start = location(1 + 1, 0, 0)\n", r"taught\.py:1: 1 \+ 1"),
        ("start = location(1, 0, 0, **{})\n", r"taught\.py:1: "),
        ("start = (True,)\n", r"taught\.py:1: True"),
        ("x = 1", r"taught\.py:1: 1; expected"),
        ("", r"taught\.py: has no function main; expected def main"),
        ("@exit\ndef main(robot): pass", r"taught\.py:2: "),
        ("def main(robot): pass\ndef main(robot): pass", r"taught\.py:2: "),
        ("def main(robot", r"taught\.py:1: '\(' was never closed"),
        (main_of("    robot.wait(1)", "    robot.save(1)"), r"taught\.py:4: robot\.save\(1\)"),
        (main_of("    robot.wait(-1)"), r"taught\.py:3: wait: duration = -1\.0"),
        (main_of("    robot.wait(1e999)"), r"taught\.py:3: wait: duration = inf"),
        (main_of("    robot.wait(0 if exit() else 1)"), r"taught\.py:3: 0 if exit\(\) else 1"),
        (main_of("    robot.set_speed(2)", "    robot.turn_table(1)"), r"taught\.py:4: speed = 2"),
        (main_of("    robot.move_line(start)"), r"taught\.py: move_line: the point start is not there"),
        (main_of("    for i in (1, 2): pass"), r"taught\.py:3: for i in \(1, 2\)"),
        ("a\0b", r"taught\.py"),
        ("a = " + "(" * 5000, r"taught\.py"),
        ("a = " + "-" * 100_000 + "1", r"taught\.py"),
        ("a = (" + "1 * " * 100_000 + "mm,)", r"taught\.py"),
        ("a = 1" + "0" * 10_000, r"taught\.py"),
        ("#" * 1_000_001, r"taught\.py: 1000001 characters; expected at most 1000000"),
    ],
)
def test_other_text_is_rejected_with_its_line(text: str, message: str) -> None:
    with pytest.raises(DescriptionError, match=message):
        read_program(text, "taught.py")


def test_file_follows_edits_by_hand_and_keeps_what_it_cannot_read(tmp_path: Path) -> None:
    file = TaughtFile(tmp_path / "out" / "taught.py")
    assert file.program.steps == ()
    file.edit(lambda _: taught())
    assert names(file.program) == ["above", "start", "end"]
    file.path.write_text(file.path.read_text() + "    robot.wait(2)\n")
    assert names(file.program) == ["above", "start", "end", "wait"]
    own = file.path.read_text() + "    print('own code')\n"
    file.path.write_text(own)
    for _ in range(2):
        with pytest.raises(DescriptionError, match=r"taught\.py:\d+: print\('own code'\)"):
            file.edit(lambda program: program.without(0))
    assert file.path.read_text() == own


@pytest.mark.parametrize(
    ("degrees", "text"),
    [(0, "0.0°"), (-40, "-40.0°"), (360, "360.0°"), (1575, "1575.0°"), (-400, "-400.0°")],
)
def test_label_of_a_table_states_its_angle_with_its_turns(degrees: float, text: str) -> None:
    """The label states whole turns as the slider of the table does."""
    assert step_label(1, TaughtStep("turn_table", value=np.radians(degrees))).split(", ")[0] == f"1 table at {text}"
