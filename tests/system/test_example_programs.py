"""The robot programs of docs/examples, run as `scancell run` runs them, with the guard in force."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest

from scancell import Scanner
from scancell.config.loading import assets_dir, load_setup
from scancell.programs.program import ProgramRun, run_program
from scancell.programs.robot import Step
from scancell.scanning.session import ScanSession

EXAMPLES = Path(__file__).parents[2] / "docs" / "examples"
SOLUTIONS = EXAMPLES / "exercises"
PARTS = assets_dir() / "parts"


Ran = tuple[ProgramRun, str, ScanSession]


@pytest.fixture
def exercise(capsys) -> Iterator[Callable[..., Ran]]:
    """Runs a solution with a part, in a cell of the exercises or the default one: what it did and printed."""
    with ExitStack() as stack:

        def solve(name: str, part: str | None = None, cell: str | None = None, *words: str) -> Ran:
            setup = load_setup(assets_dir() / "exercises" / cell if cell else None, settings=words)
            scanner = stack.enter_context(Scanner(setup=setup, threads=1))
            session = stack.enter_context(scanner.session(PARTS / part if part else None, guarded=True))
            done = run_program(SOLUTIONS / name, session, "geometric", Path(stack.enter_context(TemporaryDirectory())))
            assert done.contacts == []
            return done, capsys.readouterr().out, session

        yield solve


def numbers(text: str, *names: str) -> list[float]:
    """The numbers after words of a text."""
    return [float(re.search(rf"{name}:? (-?[0-9.]+)", text)[1]) for name in names]


def test_every_solution_is_tested_and_described() -> None:
    names = {path.stem for path in SOLUTIONS.glob("*.py")}
    described = (EXAMPLES.parent / "exercises.md").read_text()
    assert names == {"kinematics", "grasping", "sensors", "conveyor", "scanning", "seam", "taught"}
    assert all(f"exercises/{name}.py" in described for name in names)


def test_kinematics_exercise(exercise) -> None:
    """Two more configurations give the same pose of the sensor on the flange, but for the noise of the encoders."""
    _, out, _ = exercise("kinematics.py")
    errors = [float(line.split()[1]) for line in out.splitlines()]
    assert len(errors) == 2
    assert max(errors) < 1e-3


def test_grasping_exercise(exercise) -> None:
    _, _, session = exercise("grasping.py", "step_block.stl", "gripper.toml")
    cell = session.cell
    moved = cell.get(cell.real_group([f"truth.part[1].position[{i}]" for i in (1, 2, 3)])).copy()
    np.testing.assert_allclose(moved, [0.45, 0.04, 0.1], atol=0.1e-3)
    w, x, y, z = cell.get(cell.real_group([f"truth.part[1].orientation[{i}]" for i in (1, 2, 3, 4)]))
    assert abs(np.degrees(2 * np.arctan2(z, w))) == pytest.approx(90, abs=0.1)
    assert np.hypot(x, y) < 1e-3


def test_sensors_exercise(exercise) -> None:
    """The barrier is read every 16 ms, 0.8 mm of belt; below the distance sensor the part is 19 mm high."""
    _, out, _ = exercise("sensors.py", "step_block.stl", "belt.toml")
    length, height = numbers(out, "length", "height")
    assert length == pytest.approx(50, abs=1.6)
    assert height == pytest.approx(19, abs=0.05)


def test_conveyor_exercise(exercise) -> None:
    _, _, session = exercise("conveyor.py", "step_block.stl", "belt.toml")
    front = session.cell.get(session.cell.real_group(["truth.part[1].position[2]"]))[0] + 0.025
    assert front - -0.400 == pytest.approx(60e-3, abs=1.6e-3)
    assert session.value("conveyor[1].speed") == 0


def test_scanning_exercise(exercise) -> None:
    done, out, _ = exercise("scanning.py", "sphere_on_foot.stl")
    assert numbers(out, "radius")[0] == pytest.approx(25.0, abs=0.01)
    assert [file.name for file in done.files] == ["sphere.ply"]


def test_taught_exercise(exercise) -> None:
    done, _, _ = exercise("taught.py", "sphere_on_foot.stl")
    assert [step.command for _, step in done.steps] == ["move_joints", "move_line", "scan_line", "move_joints"]


@pytest.mark.parametrize("angle", [10.0, -6.0])
def test_seam_exercise(exercise, angle: float) -> None:
    _, out, _ = exercise("seam.py", "step_block.stl", None, f"cell.part.rz_deg={angle}")
    assert numbers(out, "edge at")[0] == pytest.approx(angle, abs=0.2)


@pytest.mark.parametrize(("angle", "offset"), [(15.0, 0.0), (-8.0, 3.0)])
def test_follow_seam_stays_on_groove(angle: float, offset: float, capsys) -> None:
    """The groove is the part's x axis; the program does not know how the part lies."""
    words = [f"cell.part.rz_deg={angle}", f"cell.part.y_mm={offset}"]
    visited: list[np.ndarray] = []
    with (
        Scanner(setup=load_setup(settings=words), threads=1) as scanner,
        scanner.session(PARTS / "step_block.stl", guarded=True) as session,
    ):

        def show(_line: int, step: Step) -> None:
            if step.command == "profile":
                visited.append(session.world_from_tool()[:3, 3])

        done = run_program(EXAMPLES / "follow_seam.py", session, "geometric", show=show)
        part_from_world = np.linalg.inv(scanner.pipeline.load(scanner.setup, None).nominal.world_from("part"))
    assert done.contacts == []
    in_part = np.array(visited) @ part_from_world[:3, :3].T + part_from_world[:3, 3]
    # The first step goes straight on; from the third on the heading is that of the groove.
    assert np.abs(in_part[3:, 1]).max() < 0.3e-3
    assert np.ptp(in_part[:, 0]) > 55e-3
    np.testing.assert_allclose(np.diff(in_part[3:, 0]), 4e-3, atol=0.1e-3)
    printed = float(capsys.readouterr().out.split("groove at ")[1].split()[0])
    assert printed == pytest.approx(angle, abs=0.2)
