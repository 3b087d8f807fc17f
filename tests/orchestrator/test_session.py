"""Interactive commands to a running cell: results, blocking behaviour, error messages."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from enum import IntEnum
from pathlib import Path

import fmpy
import numpy as np
import pytest
from cells import GRIPPER, ball, block, export_mm
from fmu_cells import CYCLE_US, moves_with_stops, turn_of_table

from scancell import Scanner
from scancell.cell.driver import GripperMode, JogFrame, Mode, Operation
from scancell.cell.fmu_file import cell_json, make_temporary_fmu
from scancell.cell.fmu_package import FmiVersion
from scancell.cell.instance import CellInstance, SignalLog
from scancell.cell.session import CellSession
from scancell.config.loading import load_setup
from scancell.errors import CommandError, DescriptionError
from scancell.geometry import pose
from scancell.nominal.cell import NominalCell, nominal_cell

MOVING_PARTS = ("part[1]", "part[2]", "finger[1]", "finger[2]")
Start = Callable[..., CellSession]


def words(part: Path) -> list[str]:
    """Overrides: a belt along y with a block, a presence sensor, and a distance sensor above."""
    return [
        'cell.conveyor=[{ name = "belt", pose = { x_mm = 300, y_mm = -300, z_mm = 100, rz_deg = 90 }, '
        "length_mm = 400, width_mm = 100 }]",
        f'cell.further_part=[{{ name = "block", mesh = "{part}", stands_on = "conveyor[1]", fixture = "free", '
        "pose = { x_mm = -100 } }]",
        'cell.presence_sensor=[{ name = "gate", pose = { x_mm = 300, y_mm = -250, z_mm = 110 }, '
        "x_size_mm = 80, y_size_mm = 2, z_size_mm = 10 }]",
        'cell.distance_sensor=[{ name = "eye", farthest_mm = 300, '
        "pose = { x_mm = 300, y_mm = -300, z_mm = 320, rx_deg = 180 } }]",
    ]  # fmt: skip


@pytest.fixture(scope="module")
def cell(tmp_path_factory) -> tuple[NominalCell, dict[int, Path]]:
    folder = tmp_path_factory.mktemp("session")
    part = export_mm(block(0.04, 0.03, 0.02), folder / "block.stl")
    setup = load_setup(settings=[*GRIPPER, *words(part)], ideal=True)
    nominal = nominal_cell(setup.cell, ball())
    description = cell_json(setup.cell, nominal, 0)
    versions: tuple[FmiVersion, ...] = (2, 3)
    return nominal, {v: make_temporary_fmu(description, folder / f"RobotCell{v}", v) for v in versions}


@pytest.fixture
def start(cell) -> Iterator[Start]:
    running: list[CellInstance] = []

    def begin(version: int = 3) -> CellSession:
        nominal, fmus = cell
        running.append(CellInstance(fmus[version]))
        return CellSession(running[-1], nominal, CYCLE_US)

    yield begin
    for instance in running:
        instance.close()


@pytest.mark.parametrize(
    ("enumeration", "variable"),
    [
        (Mode, "command.mode"),
        (JogFrame, "command.jog_frame"),
        (Operation, "command.operation"),
        (GripperMode, "command.gripper.mode"),
    ],
)
def test_enumerations_have_numbers_and_words_of_fmu(cell, enumeration: type[IntEnum], variable: str) -> None:
    description = fmpy.read_model_description(str(cell[1][3]))
    declared = next(one.declaredType for one in description.modelVariables if one.name == variable)
    words = {int(item.value): item.name for item in declared.items}
    assert {one.value: one.name.lower() for one in enumeration} == words


@pytest.mark.parametrize("version", [2, 3])
def test_move_joints_reaches_target(start: Start, version: int) -> None:
    session = start(version)
    goal = session.joints + np.radians([10, 5, -5, 20, -10, 30])
    session.move_joints(goal, 0.5, speed=0.5)
    np.testing.assert_allclose(session.joints, goal, atol=1e-12)
    assert session.table_angle == pytest.approx(0.5, abs=1e-12)
    np.testing.assert_array_equal(session.destination, [*goal, 0.5])
    session.turn_table(0.1)
    np.testing.assert_allclose(session.joints, goal, atol=1e-12)
    assert session.table_angle == pytest.approx(0.1, abs=1e-12)


@pytest.mark.parametrize(
    ("command", "expected"),
    [
        (lambda session: session.move_joints([0.0] * 7), "move_joints: joints = .*: expected 6 angles"),
        (
            lambda session: session.jog_joints([0.1] * 8, 0.1),
            "jog_joints: deflections = .*: expected at most 7 numbers",
        ),
        (lambda session: session.run_conveyor(2, 0.1), "run_conveyor: conveyor = 2: expected 1 to 1"),
    ],
)
def test_wrong_number_of_axes_or_of_a_conveyor_is_rejected(
    start: Start, command: Callable[[CellSession], None], expected: str
) -> None:
    with pytest.raises(CommandError, match=expected):
        command(start())


@pytest.mark.parametrize(
    ("command", "expected"),
    [
        (
            lambda session: session.jog_sensor([0.1] * 5, 0.1),
            r"deflections = .*shape is \(5,\); expected finite numbers of shape \(6,",
        ),
        (lambda session: session.jog_joints([1.1], 0.1), r"deflections = .*: expected finite numbers .* from -1 to 1"),
        (lambda session: session.move_tool(np.eye(3)), r"world_from_tool = (?s:.*)expected .* of shape \(4, 4\)"),
        (lambda session: session.move_tool(2 * np.eye(4)), r"world_from_tool = (?s:.*): expected a pose \(4, 4\)"),
        (lambda session: session.move_line(np.eye(4), "flange"), "tool = 'flange': expected 'sensor', 'gripper'"),
        (lambda session: session.move_joints([np.nan] * 6), "joints = .*6 are not finite.*expected finite numbers"),
        (lambda session: session.turn_table(np.inf), "table_angle = inf: expected a finite number"),
        (
            lambda session: session.move_tool(np.full((4, 4), np.nan)),
            r"(?s:.*)not finite.*shape \(4, 4\)",
        ),
        (lambda session: session.move_joints(session.home, speed=0.0), "speed = 0.0: expected .* above 0 to 1"),
        (lambda session: session.move_line(session.world_from_tool(), speed=2), "speed = 2: expected .* above 0 to 1"),
        (lambda session: session.jog_sensor([np.nan] * 6, 0.1), "deflections = .*not finite.*expected finite numbers"),
        (lambda session: session.open_gripper(np.nan), "width = nan: expected a finite number"),
        (lambda session: session.close_gripper(-1.0), "force = -1.0: expected a finite number from 0"),
        (lambda session: session.run_conveyor(1, np.inf), "speed = inf: expected a finite number from -10 to 10"),
        (lambda session: session.set_monitor_speed(np.nan), "share = nan: expected a finite number from 0 to 1"),
        (
            lambda session: session.record_line(session.world_from_tool(), 0.0, 1e-3),
            "spacing = 0.0: expected .* above 0",
        ),
    ],
)
def test_wrong_argument_of_command_is_named(
    start: Start, command: Callable[[CellSession], None], expected: str
) -> None:
    session = start()
    begin = session.time
    with pytest.raises(DescriptionError, match=expected):
        command(session)
    assert session.time == pytest.approx(begin, abs=1e-9)
    session.step()  # the cell goes on


def test_speed_scales_move_duration(start: Start, cell) -> None:
    session = start()
    session.move_joints(session.joints + 0.8, speed=0.1)
    cruise = 0.8 / (0.1 * cell[0].arm.max_speed.min())
    assert cruise < session.time < cruise + 0.2  # plus the ramps


@pytest.mark.parametrize("tool", ["sensor", "gripper"])
def test_move_line_follows_straight_path(start: Start, tool) -> None:
    session = start()
    begin = session.world_from_tool(tool)
    goal = pose.translation((0.02, -0.03, 0.01)) @ begin
    path: list[np.ndarray] = []
    session.cell.on_step(lambda: path.append(session.world_from_tool(tool)[:3, 3]))
    session.move_line(goal, tool, speed=0.2)
    np.testing.assert_allclose(session.world_from_tool(tool), goal, atol=1e-9)
    direction = (goal - begin)[:3, 3] / np.linalg.norm((goal - begin)[:3, 3])
    lateral = np.array(path) - begin[:3, 3]
    lateral -= np.outer(lateral @ direction, direction)
    assert len(path) > 5
    assert np.linalg.norm(lateral, axis=1).max() < 1e-6


def test_ik_selects_nearest_branch(start: Start) -> None:
    session = start()
    q = session.joints + 0.2
    session.move_joints(q)
    target = session.world_from_tool("gripper")
    np.testing.assert_allclose(session.joints_for(target, "gripper"), q, atol=1e-9)
    session.move_joints(q + 0.1)
    session.move_tool(target, "gripper")
    np.testing.assert_allclose(session.joints, q, atol=1e-9)
    with pytest.raises(CommandError, match=r"the gripper cannot be brought to \(5\d\d\d\."):
        session.joints_for(pose.translation((5, 0, 0)) @ target, "gripper")


def test_jog_and_move_require_matching_mode(start: Start) -> None:
    session = start()
    begin = session.joints
    with pytest.raises(CommandError, match=r"jog_joints: .*automatic operation"):
        session.jog_joints([0.5, 0, 0, 0, 0, 0, 0], 0.5)
    np.testing.assert_allclose(session.joints, begin, atol=1e-12)
    session.set_operation(Operation.MANUAL)
    session.jog_joints([0.5, 0, 0, 0, 0, 0, -0.5], 0.5)
    moved = session.joints - begin
    assert moved[0] > 0.01
    np.testing.assert_allclose(moved[1:], 0, atol=1e-12)
    assert session.table_angle < -0.01
    with pytest.raises(CommandError, match=r"move_joints: .*manual operation.*change to automatic"):
        session.move_joints(begin)
    with pytest.raises(CommandError, match=r"run_program: .*manual operation"):
        session.run_program(turn_of_table(session.joints, "time", 0.02), 1e-3)
    session.set_operation(Operation.AUTOMATIC)
    session.move_joints(begin)
    np.testing.assert_allclose(session.joints, begin, atol=1e-12)


@pytest.mark.parametrize("frame", list(JogFrame))
def test_jog_moves_along_tool_axis(start: Start, frame: JogFrame) -> None:
    session = start()
    session.set_operation(Operation.MANUAL)
    begin = session.world_from_tool()
    session.jog_sensor([0, 0, 0.4, 0, 0, 0], 0.4, frame)
    end = session.world_from_tool()
    travel = (end - begin)[:3, 3]
    axis = np.array([0, 0, 1]) if frame == JogFrame.WORLD else begin[:3, 2]
    assert travel @ axis > 0.01
    np.testing.assert_allclose(travel, (travel @ axis) * axis, atol=1e-6)
    np.testing.assert_allclose(end[:3, :3], begin[:3, :3], atol=1e-6)


def test_limit_and_unreachable_pose_errors(start: Start) -> None:
    session = start()
    q = session.joints
    beyond = q.copy()
    beyond[4] = np.radians(130)
    with pytest.raises(CommandError, match=r"move_joints: the target of joint 5 is outside its limits"):
        session.move_joints(beyond)
    with pytest.raises(CommandError, match=r"move_line: .*out of reach"):
        session.move_line(pose.translation((0, 0, 3.0)) @ session.world_from_tool())
    session.move_joints(q + 0.1)


def test_emergency_stop_blocks_motion_until_reset(start: Start) -> None:
    session = start()
    goal = session.joints + 1.0
    session.cell.on_step(
        lambda: (
            session.cell.set_boolean("command.emergency_stop", True) if session.time == pytest.approx(0.16) else None
        )
    )
    with pytest.raises(CommandError, match=r"move_joints: an emergency stop is in force"):
        session.move_joints(goal)
    session.emergency_stop()
    stopped = session.joints
    assert 0 < np.abs(stopped - goal).min() < 1.0
    with pytest.raises(CommandError, match=r"emergency stop"):
        session.move_joints(goal)
    session.reset()
    np.testing.assert_array_equal(session.joints, stopped)
    session.move_joints(goal)
    np.testing.assert_allclose(session.joints, goal, atol=1e-12)


def test_paused_move_times_out_with_reason(start: Start) -> None:
    session = start()
    session.set_monitor_speed(0.0)
    with pytest.raises(CommandError, match=r"not at its destination after 1 s \(0% of the way done, monitor speed 0\)"):
        session.move_joints(session.joints + 0.5, timeout=1.0)
    session.set_monitor_speed(1.0)
    session.move_joints(session.joints)


@pytest.mark.parametrize("version", [2, 3])
def test_presence_sensor_detects_part_on_belt(start: Start, version: int) -> None:
    session = start(version)
    assert session.distance(1) is None  # before the first reading
    session.wait(0.1)
    assert not session.presence(1)
    assert session.distance(1) == pytest.approx(0.220, abs=1e-9)  # the belt
    begin = session.time
    session.run_conveyor(1, 0.1)
    session.wait_until(lambda: session.distance(1) == pytest.approx(0.200, abs=1e-5), "the block below the eye", 5.0)
    session.wait_until(lambda: session.presence(1), "the block at the gate", 5.0)
    # Its front travels from -80 mm to +49 mm at 0.1 m/s, accelerated for 0.1 s; polled once per cycle.
    assert 0 <= session.time - begin - (1.29 + 0.05) < 3 * CYCLE_US * 1e-6
    # After the ramp of 0.1 s; the command takes effect within a cycle.
    assert session.conveyor_travel(1) == pytest.approx(0.1 * (session.time - begin - 0.05), abs=0.1 * CYCLE_US * 1e-6)
    session.run_conveyor(1, 0.0)
    session.wait(0.5)
    assert session.value("conveyor[1].speed") == 0
    with pytest.raises(CommandError, match=r"timed out after 0\.2 s waiting for another block; "):
        session.wait_until(lambda: not session.presence(1), "another block", 0.2)


def test_gripper_opens_and_reports_empty_grip(start: Start) -> None:
    session = start()
    session.open_gripper(0.03)
    assert session.gripper_width == pytest.approx(0.03, abs=1e-4)
    with pytest.raises(CommandError, match=r"pads 80\.0 mm apart"):
        session.open_gripper(0.08, timeout=1.0)
    with pytest.raises(CommandError, match=r"something between the pads"):
        session.close_gripper(10.0, timeout=2.0)


@pytest.mark.parametrize("kind", ["table_angle", "request"])
def test_second_program_records_own_exposures(start: Start, kind) -> None:
    session = start()
    home = session.joints
    program = moves_with_stops(home) if kind == "request" else turn_of_table(home, kind, np.radians(1.0))
    first = session.run_program(program, 2e-3).measured
    session.move_joints(home, 0.0)
    second = session.run_program(program, 2e-3).measured
    assert second.index.tolist() == (first.index + len(first.index)).tolist()
    assert second.time.min() > first.time.max()
    np.testing.assert_allclose(second.q, first.q, atol=1e-12)
    np.testing.assert_allclose(second.table, first.table, atol=1e-9)


def test_gripper_commands_need_a_gripper(ideal_scanner: Scanner) -> None:
    with ideal_scanner.session() as session:
        for command in (lambda: session.open_gripper(0.02), lambda: session.close_gripper(5.0)):
            with pytest.raises(CommandError, match="the cell has no gripper"):
                command()


def test_session_rejects_true_values(start: Start) -> None:
    session = start()
    for name in ("truth.q[1]", "trigger.truth.table.position[1]", "truth.clearance.distance"):
        with pytest.raises(CommandError, match=r"truth.*: a session reads measured values only.*Recording\.truth"):
            session.value(name)
    assert session.value("measured.q[1]") == session.joints[0]


@pytest.mark.parametrize("moving", [False, True])
def test_snapshot_matches_exposure_record(start: Start, moving: bool) -> None:
    """Of the same instant as one that the trigger takes."""
    exposure = 2e-3
    session = start()
    cell = session.cell
    if moving:
        session.run_conveyor(1, 0.1)
        cell.set(cell.real_group(["command.table"]), np.array([1.0]))
        cell.set_integer("command.mode", 1)
    session.wait(0.1)
    cell.set(cell.real_group(["command.exposure"]), np.array([exposure]))
    cell.set_integer("command.trigger.mode", 4)
    cell.set_integer("command.trigger.request", 1)
    cell.step_to(cell.time_us + 1000)  # the middle of that exposure
    before = cell.time_us
    taken = session.snapshot(exposure)
    assert (len(taken), cell.time_us, cell.get_integer("trigger.count")) == (1, before, 1)
    assert cell.get_integer("trigger.index") == 1
    for name, values in taken.columns.items():
        if name not in ("trigger.index", "trigger.segment"):
            latched = cell.get(cell.real_group([name]))
            np.testing.assert_allclose(values, latched, atol=1e-12, err_msg=name)
    assert set(taken.measured.index) & set(session.snapshot(exposure).measured.index) == set()
    assert list(taken.truth.world_from_frame) == [
        *(f"link[{i}]" for i in range(1, 7)),
        "sensor",
        "table",
        *MOVING_PARTS,
    ]
    with pytest.raises(DescriptionError, match=r"exposure = 0\S*: expected a finite number above 0"):
        session.snapshot(0.0)


def test_program_must_start_at_current_position(start: Start) -> None:
    session = start()
    program = turn_of_table(session.joints, "table_angle", np.radians(1.0))
    session.move_joints(session.joints + np.radians([0, 0, 2.0, 0, 0, 0]))
    with pytest.raises(CommandError, match=r"starts elsewhere: joint 3 is off by 2\.000 deg"):
        session.run_program(program, 1e-3)


def test_signals_persist_between_steps(start: Start) -> None:
    session = start()
    log = SignalLog(session.cell, ["measured.q[1]", "measured.table"], ["controller.moving"])
    begin, moving = session.joints, session.joints + 0.2
    session.move_joints(moving, 0.1)
    np.testing.assert_allclose(np.diff(log.time), CYCLE_US * 1e-6, atol=1e-12)
    assert (log["measured.q[1]"][[0, -1]] == [begin[0], moving[0]]).all()
    assert (np.diff(log["measured.table"]) >= 0).all()
    assert set(log["controller.moving"]) == {0.0, 1.0}
