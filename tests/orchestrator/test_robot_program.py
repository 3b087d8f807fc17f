"""Robot programs: words, straight lines, measurement, and what a guard makes of mistakes."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from fmu_cells import moves_with_stops

from scancell import Scanner
from scancell.cell.driver import Operation
from scancell.config.loading import assets_dir, load_setup
from scancell.errors import CommandError, DescriptionError, ProgramError
from scancell.geometry import pose
from scancell.geometry.mesh import load_mesh
from scancell.programs.program import ProgramRun, run_program
from scancell.programs.robot import Robot, deg, location, mm
from scancell.scanning.session import ScanSession
from scancell.sensor import MeshSurface

PART = assets_dir() / "parts" / "step_block.stl"
WITH_GRIPPER = Path(__file__).parents[2] / "assets" / "exercises" / "gripper.toml"
ABOVE = location(450 * mm, 0, 300 * mm, rx=180 * deg)
WORDS = "from scancell import Robot, deg, location, mm\n"
INTO_TABLE = """
def main(robot):
    robot.move_tool(location(450 * mm, 0, 300 * mm, rx=180 * deg))
    robot.move_line(location(450 * mm, 0, 50 * mm, rx=180 * deg))
"""
Run = Callable[[str, ScanSession], ProgramRun]


@pytest.fixture
def run(tmp_path) -> Run:
    """Runs the text of a program."""

    def written(text: str, session: ScanSession) -> ProgramRun:
        file = tmp_path / "program.py"
        file.write_text(WORDS + text)
        return run_program(file, session, "geometric", tmp_path)

    return written


def contacts(session: ScanSession) -> list[int]:
    """Number of colliding pairs at every step from now on."""
    seen: list[int] = []
    session.cell.on_step(lambda: seen.append(session.cell.get_integer("truth.collision.pairs")))
    return seen


def test_guard_stops_program_before_table(ideal_scanner: Scanner, run: Run) -> None:
    with ideal_scanner.session(guarded=True) as session:
        seen = contacts(session)
        with pytest.raises(ProgramError, match=r"program\.py:5: move_line: held by the guard .*sensor - table"):
            run(INTO_TABLE, session)
        assert len(seen) > 100
        assert max(seen) == 0
        assert not session.cell.get_boolean("controller.moving")
        Robot(session).move_tool(ABOVE)  # the cell goes on
        np.testing.assert_allclose(session.world_from_tool(), ABOVE, atol=1e-9)


def test_same_program_without_guard_hits_table(ideal_scanner: Scanner, run: Run) -> None:
    with ideal_scanner.session() as session:
        assert run(INTO_TABLE, session).contacts == ["sensor - table"]


def test_table_without_mesh_is_the_cylinder_of_its_dimensions(run: Run) -> None:
    words = {"table.platter_mesh": None, "table.base_mesh": None}
    setup = load_setup(load_setup().cell.replace(words), ideal=True)
    with Scanner(setup=setup, threads=1) as scanner, scanner.session() as session:
        (table,) = [body for body in session.nominal.bodies if body.name.startswith("table")]
        assert run(INTO_TABLE, session).contacts == ["sensor - table"]
    assert table.mesh.is_closed
    assert np.linalg.norm(table.mesh.vertices[:, :2], axis=1) == pytest.approx(0.12, rel=1e-3)
    assert table.mesh.bounds[:, 2] == pytest.approx([-0.02, 0.0])


def test_guard_stops_jog_before_table(ideal_scanner: Scanner) -> None:
    with ideal_scanner.session(guarded=True) as session:
        Robot(session).move_tool(ABOVE)
        seen = contacts(session)
        session.set_operation(Operation.MANUAL)
        with pytest.raises(CommandError, match=r"jog_sensor: held by the guard: no jog: sensor - table: \d mm"):
            session.jog_sensor([0, 0, -1, 0, 0, 0], 10.0)
        session.jog_sensor([0, 0, 1, 0, 0, 0], 1.0)
        assert max(seen) == 0


def test_operator_cannot_exceed_monitor_speed_of_guard(ideal_scanner: Scanner) -> None:
    """Set again and again on the way to the table, the operator's full speed changes nothing."""

    def course(share: float | None) -> list[float]:
        with ideal_scanner.session(guarded=True) as session:
            Robot(session).move_tool(ABOVE)
            speeds: list[float] = []
            session.cell.on_step(lambda: speeds.append(session.value("command.monitor_speed")))
            if share is not None:
                session.cell.on_step(lambda: session.set_monitor_speed(share))
            with pytest.raises(CommandError, match="held by the guard"):
                session.move_line(location(450 * mm, 0, 50 * mm, rx=180 * deg))
            return speeds

    of_guard, halved = course(None), course(0.5)
    assert min(of_guard) == 0.0
    assert course(1.0) == of_guard
    assert max(halved[1:]) == 0.5


def test_long_settling_of_program_is_guarded(ideal_scanner: Scanner) -> None:
    """The robot rests for longer than an answer of the guard permits motion, and goes on."""
    with ideal_scanner.session(guarded=True) as session:
        assert len(session.run_program(moves_with_stops(session.joints), 2e-3)) == 3


def test_moves_reach_pose_and_report_steps(ideal_scanner: Scanner, run: Run) -> None:
    text = """
def main(robot: Robot) -> None:
    target = location(450 * mm, 20 * mm, 260 * mm, rx=170 * deg, ry=5 * deg, rz=30 * deg)
    robot.approach(target, 40 * mm)
    robot.set_speed(0.5)
    robot.move_line(target)
    robot.turn_table(30 * deg)
"""
    with ideal_scanner.session(guarded=True) as session:
        done = run(text, session)
        target = location(450 * mm, 20 * mm, 260 * mm, rx=170 * deg, ry=5 * deg, rz=30 * deg)
        np.testing.assert_allclose(Robot(session).world_from_tool(), target, atol=1e-9)
        assert session.table_angle == pytest.approx(30 * deg, abs=1e-9)
    assert [(line, step.command) for line, step in done.steps] == [
        (5, "approach"),
        (7, "move_line"),
        (8, "turn_table"),
    ]
    assert done.steps[-1][1].end == done.duration
    assert all(step.begin < step.end for _, step in done.steps)
    assert done.contacts == []


def test_depart_is_straight_along_tool(ideal_scanner: Scanner) -> None:
    with ideal_scanner.session(guarded=True) as session:
        robot = Robot(session)
        start = location(430 * mm, 30 * mm, 260 * mm, rx=165 * deg, ry=8 * deg)
        robot.move_tool(start)
        path: list[np.ndarray] = []
        session.cell.on_step(lambda: path.append(pose.inverse(start) @ robot.world_from_tool()))
        robot.depart(60 * mm)
        poses = np.array(path)
    np.testing.assert_allclose(poses[:, :2, 3], 0, atol=1e-6)
    np.testing.assert_allclose(poses[:, :3, :3], np.broadcast_to(np.eye(3), (len(poses), 3, 3)), atol=1e-6)
    assert poses[-1, 2, 3] == pytest.approx(-60 * mm, abs=1e-9)
    assert (np.diff(poses[:, 2, 3]) < 1e-12).all()


def test_scan_measures_surface_of_part(ideal_scanner: Scanner, run: Run) -> None:
    text = """
def main(robot):
    robot.move_tool(location(420 * mm, 0, 190 * mm, rx=180 * deg))
    robot.set_speed(0.2)
    cloud = robot.scan_line(robot.world_from_tool() @ location(60 * mm, 0, 0), spacing=1 * mm)
    robot.save(cloud, "pass.npz")
"""
    with ideal_scanner.session(PART, guarded=True) as session:
        done = run(text, session)
        again = Robot(session, "geometric")
        assert again.time == done.duration
    data = np.load(done.files[0])
    points = data["points_in_part_mm"] * mm
    profiles = np.unique(data["profile"])
    assert len(profiles) == 61
    assert len(points) > 10_000
    mesh = load_mesh(PART)
    distance, _ = MeshSurface(mesh.vertices, mesh.faces).signed_distances(points, 1)
    assert np.abs(distance).max() < 20e-6
    middle = [points[data["profile"] == number, 0].mean() for number in profiles]
    np.testing.assert_allclose(np.diff(middle), 1 * mm, atol=20e-6)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("def main(robot):\n    robot.move_tool(\n", r"program\.py:3: '\(' was never closed"),
        ("def main(robot):\n    robot.set_speed(1 / 0)\n", r"program\.py:3: ZeroDivisionError: division by zero"),
        (
            "def main(robot):\n    robot.set_speed(2)\n",
            r"program\.py:3: share = 2: expected a finite number above 0",
        ),
        ("def main(robot):\n    raise SystemExit(3)\n", r"program\.py:3: SystemExit: 3"),
        ("go = 1\n", r"program\.py: has no function main; expected def main\(robot\)"),
        ("import nothing_here\n", r"program\.py:2: ModuleNotFoundError"),
        (
            "def far(robot):\n    robot.move_tool(location(3, 0, 0))\ndef main(robot):\n    far(robot)\n",
            r"program\.py:3: the sensor cannot be brought to \(3000\.0, 0\.0, 0\.0\) mm",
        ),
        ("def main(robot):\n    robot.set_tool('gripper')\n", r"program\.py:3: the cell has no gripper"),
        (
            "def main(robot):\n    robot.wait_until(lambda: False, 'nothing', 0.1)\n",
            r"program\.py:3: timed out after 0\.1 s waiting for nothing",
        ),
    ],
)
def test_error_states_file_and_line(ideal_scanner: Scanner, run: Run, text: str, message: str) -> None:
    with ideal_scanner.session() as session, pytest.raises(ProgramError, match=message):
        run(text, session)


@pytest.mark.parametrize("fixture", ["free", "clamped"])
def test_guard_keeps_the_sensor_away_from_a_part_that_a_gripper_can_move(fixture: str, run: Run) -> None:
    """The cell follows a free part by what is measured; it is where it was placed until the gripper takes it."""
    setup = load_setup(WITH_GRIPPER, settings=[f'cell.part.fixture="{fixture}"'], ideal=True)
    through = location(450 * mm, 0, 122 * mm, rx=180 * deg)
    with (
        Scanner(setup=setup, threads=1) as other,
        other.session(PART, guarded=True) as session,
    ):
        robot = Robot(session)
        robot.move_tool(ABOVE)
        with pytest.raises(CommandError, match=r"held by the guard .*sensor - part"):
            robot.move_line(through)


def test_argument_that_is_no_pose_is_named(ideal_scanner: Scanner) -> None:
    with (
        ideal_scanner.session() as session,
        pytest.raises(
            DescriptionError, match=r"world_from_tool = .*shape is \(3, 3\); expected finite numbers of shape"
        ),
    ):
        Robot(session).approach(np.eye(3), 0.1)


def test_missing_file_and_missing_part(ideal_scanner: Scanner, tmp_path: Path) -> None:
    with (
        ideal_scanner.session() as session,
        pytest.raises(ProgramError, match=r"none\.py: no such file"),
    ):
        run_program(tmp_path / "none.py", session)
    free = load_setup(settings=['cell.part.fixture="free"'])
    with (
        Scanner(setup=free) as other,
        pytest.raises(DescriptionError, match=r"part\.fixture = 'free': there is no part; expected its mesh"),
        other.session(),
    ):
        pass


def test_program_imports_from_its_folder(ideal_scanner: Scanner, run: Run, tmp_path: Path) -> None:
    (tmp_path / "my_places.py").write_text("DOWN = 0.25\n")
    text = "import my_places\ndef main(robot):\n    robot.wait(my_places.DOWN)\n"
    with ideal_scanner.session() as session:
        assert run(text, session).steps[0][1].about == "0.25 s"


def test_main_without_the_robot_is_named(ideal_scanner: Scanner, run: Run) -> None:
    with (
        ideal_scanner.session(None) as session,
        pytest.raises(ProgramError, match=r"main does not take the robot; expected def"),
    ):
        run("def main() -> int:\n    return 0\n", session)


def test_output_of_a_program_is_forwarded(
    ideal_scanner: Scanner, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file, printed = tmp_path / "program.py", []
    file.write_text("def main(robot):\n    print('at', 1.5, sep='=')\n    print()\n")
    with ideal_scanner.session(None) as session:
        run_program(file, session, "geometric", tmp_path, printed=printed.append)
    assert printed == ["at=1.5", ""]
    assert capsys.readouterr().out == ""


def test_changed_helper_module_is_read_again(ideal_scanner: Scanner, tmp_path: Path) -> None:
    said: list[str] = []
    for word in ("one", "two"):
        (tmp_path / "own_helper.py").write_text(f"WORD = {word!r}\n")
        with ideal_scanner.session() as session:
            printed: list[str] = []
            file = tmp_path / "program.py"
            file.write_text("import own_helper\ndef main(robot):\n    print(own_helper.WORD)\n")
            run_program(file, session, "geometric", tmp_path, printed=printed.append)
        said += printed
    assert said == ["one", "two"]
    assert "own_helper" not in sys.modules
