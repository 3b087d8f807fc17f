"""Exercises check themselves: solutions tick all items and pass, wrong attempts do not."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest
from live_cells import run_until

from bench.exercise_page import updated
from scancell import Scanner
from scancell.config.loading import load_setup
from scancell.errors import DescriptionError
from scancell.exercises import EXERCISES, Attempt, Question, find_exercise, sheet_file, sheet_html, write_sheet
from scancell.live.cell import LiveCell
from scancell.programs.program import LiveProgram, LiveProgramState
from scancell.programs.taught import TaughtFile

SOLUTIONS = Path(__file__).parents[2] / "docs" / "examples" / "exercises"
PAGE = SOLUTIONS.parents[1] / "exercises.md"
BY_NAME = {exercise.name: exercise for exercise in EXERCISES}


class Student:
    """Does an exercise in a live cell without a browser."""

    def __init__(self, name: str, folder: Path, stack: ExitStack, guarded: bool, seed: int = 0) -> None:
        self.exercise, self._folder = find_exercise(name), folder
        setup = load_setup(self.exercise.cell_file, settings=self.exercise.settings(seed))
        scanner = stack.enter_context(Scanner(setup=setup, threads=1))
        self.session = stack.enter_context(scanner.session(self.exercise.part_file, seed=seed, guarded=guarded))
        self.live = LiveCell(self.session, state_cycles=4)
        self.program = LiveProgram(self.live, "geometric", folder)
        self.taught = TaughtFile(folder / "taught.py")
        self.attempt = Attempt(self.exercise, self.live, self.session, self.program, self.taught)

    def runs(self, changes: Mapping[str, str] = {}, name: str = "") -> LiveProgramState:
        """Run the solution, after changes of its text, as a file of another name if one is given."""
        file = self._folder / (name or f"{self.exercise.name}.py")
        text = (SOLUTIONS / f"{self.exercise.name}.py").read_text()
        for old, new in changes.items():
            assert old in text
            text = text.replace(old, new)
        file.write_text(text)
        self.program.start(file)
        return self.ends()

    def ends(self) -> LiveProgramState:
        run_until(self.live, lambda: not self._state.is_active)
        now = self.live.state.time
        run_until(self.live, lambda: self.live.state.time > now + 0.1)
        return self._state

    @property
    def _state(self) -> LiveProgramState:
        assert self.program.state is not None
        return self.program.state

    def answers(self, *figures: float) -> None:
        questions = [item for item in self.exercise.items if isinstance(item, Question)]
        for question, figure in zip(questions, figures, strict=True):
            self.attempt.answer(question, figure)

    def printed(self, *names: str) -> list[float]:
        """Numbers after words that the program printed."""
        text = "\n".join(self._state.output)
        return [float(re.search(rf"{name}:? (-?[0-9.]+)", text)[1]) for name in names]  # type: ignore[index]

    @property
    def missed(self) -> list[str]:
        """Items that are not reached."""
        return [result.item.text for result in self.attempt.results if not result.is_reached]


@pytest.fixture
def student(tmp_path: Path) -> Iterator[Callable[..., Student]]:
    with ExitStack() as stack:

        def begin(name: str, *, guarded: bool = True, seed: int = 0) -> Student:
            return Student(name, tmp_path, stack, guarded, seed)

        yield begin


def flange(student: Student) -> list[float]:
    """Position of the flange by the measured joints, mm, and the distance of the sensor from it."""
    arm = student.session.nominal.arm
    joints = student.live.state.joints
    at = np.asarray(arm.fk(joints))[:3, 3]
    return [*(1e3 * at), 1e3 * float(np.linalg.norm(student.session.nominal.world_from_sensor(joints)[:3, 3] - at))]


def passes(student: Student) -> None:
    assert student.missed == []
    assert "<td>passed</td></tr>\n<tr><th>seed" in sheet_html(student.attempt, "")


def fails(student: Student, *items: str) -> None:
    assert student.missed == list(items)
    assert "<td>not passed</td></tr>\n<tr><th>seed" in sheet_html(student.attempt, "")


def test_numbers_and_names_select_exercises() -> None:
    assert [find_exercise(str(number)).number for number in range(1, 8)] == list(range(1, 8))
    assert {find_exercise(name).name for name in BY_NAME} == {path.stem for path in SOLUTIONS.glob("*.py")}


@pytest.mark.parametrize("wrong", ["0", "8", "-1", "1.0", "", "Grasping", "two", "１"])
def test_unknown_exercise_is_named(wrong: str) -> None:
    with pytest.raises(DescriptionError, match=r"expected a number from 1 to 7, or kinematics, grasping") as caught:
        find_exercise(wrong)
    assert caught.value.value == wrong


def test_kinematics(student) -> None:
    one = student("1")
    assert one.missed == [item.text for item in one.exercise.items]
    one.runs({"-15, 10, -5, 40, -20, -60": "1, 1, 1, 1, 1, 1"})
    one.answers(*flange(one))
    fails(one, "All joints have moved away from the home position")
    one.runs()
    passes(one)
    one.answers(*(figure + 0.2 for figure in flange(one)))
    assert len(one.missed) == 4


def test_grasping(student) -> None:
    one = student("grasping")
    one.runs()
    passes(one)


def test_contact_is_not_passed_by_a_later_run_without_contact(student) -> None:
    """The fingers touch the table, and put the part down 2 mm beyond the goal."""
    one = student("grasping", guarded=False)
    changes = {"GOAL = location(450 * mm, 40 * mm, TABLE + 4.2": "GOAL = location(450 * mm, 42 * mm, TABLE - 0.5"}
    one.runs(changes)
    missed = ("No bodies touch from the opening of the cell on", "The part is 40 mm further along y")
    fails(one, *missed)
    one.runs({"robot.": "robot.wait(0.1), robot.wait(0.1)  # "})
    fails(one, *missed)


def test_sensors(student) -> None:
    one = student("sensors")
    one.runs()
    length, height = one.printed("length", "height")
    one.answers(length, height + 0.2)
    fails(one, "height of the part")
    one.answers(length, height)
    passes(one)


def test_conveyor(student) -> None:
    one = student("conveyor")
    one.runs()
    passes(one)


def test_belt_that_runs_on_is_not_passed(student) -> None:
    one = student("conveyor")
    one.runs({"GOAL = 60": "GOAL = 65", "run_conveyor(1, 0)": "run_conveyor(1, 1 * mm)"})
    fails(one, "The belt is at rest", "The front of the part is 60 mm past the barrier")


def test_scanning(student) -> None:
    one = student("scanning")
    one.runs()
    radius = one.printed("radius")[0]
    one.answers(radius + 0.1)
    fails(one, "radius of the sphere")
    one.answers(radius)
    passes(one)
    one.runs({"0.5 * mm)": "18 * mm)", "    robot.save": "    robot.wait(10.0)\n    robot.save"})
    fails(one, "The cloud has enough points", "The program is fast enough, in simulated time")


def test_seam(student) -> None:
    one = student("seam", seed=3)
    one.runs()
    angle = one.printed("edge at")[0]
    one.answers(-angle)
    fails(one, "angle of the edge from the world's x axis")
    one.answers(angle)
    passes(one)
    one.runs({"STEP * heading\n": "STEP * heading + [0, 2 * mm, 0]\n"})
    fails(one, "The sensor is above the edge from the third profile on")
    one.runs({"    print": "    raise RuntimeError\n    print"})
    assert one.missed == [item.text for item in one.exercise.items[:4]]


def test_seed_chooses_the_angle_of_the_seam() -> None:
    settings = {tuple(BY_NAME["seam"].settings(seed)) for seed in range(10)}
    angles = [float(words[0].removeprefix("cell.part.rz_deg=")) for words in settings]
    assert len(angles) == 10
    assert max(np.abs(angles)) <= 10


def test_taught(student) -> None:
    one = student("taught")
    one.runs({"location(468": "location(466"}, "not_taught.py")
    fails(one, "The taught program runs to its end", "The scan ends at 468, 0, 260 mm")
    one.runs()
    passes(one)


# The sheet


def test_sheet_holds_items_and_needs_nothing_else(student, tmp_path: Path) -> None:
    one = student("sensors", seed=5)
    one.answers(float("1e3"), 2.5)
    file = sheet_file(tmp_path, "a b")
    write_sheet(file, one.attempt, '<b>Eve</b> & "Co"', b"\x89PNG")
    text = file.read_text()
    assert file.name == "a b.html"
    assert "&lt;b&gt;Eve&lt;/b&gt; &amp; &quot;Co&quot;" in text
    assert "<b>Eve" not in text
    assert "<th>seed</th><td>5</td>" in text
    assert "<td>1000 mm</td><td>within 0.5 mm of the simulated value</td><td>not passed</td>" in text
    assert all(item.limit in text for item in one.exercise.items)
    assert re.findall(r'(?:src|href)="([^"]{0,20})', text) == ["data:image/png;base6"]
    assert list(tmp_path.glob(".*")) == []


@pytest.mark.parametrize("name", ["", "../a", "a/b.html", "a\\b", ".hidden", "a\nb", "x" * 300, "C:a"])
def test_file_of_the_sheet_stays_in_its_folder(tmp_path: Path, name: str) -> None:
    with pytest.raises(DescriptionError, match="expected a file name without folders"):
        sheet_file(tmp_path, name)


@pytest.mark.parametrize("figure", [float("nan"), float("inf")])
def test_figure_is_a_finite_number(student, figure: float) -> None:
    one = student("sensors")
    with pytest.raises(DescriptionError, match="expected a finite number, mm"):
        one.answers(figure, 1.0)


def test_page_has_the_texts_of_the_declarations() -> None:
    page = PAGE.read_text(encoding="utf-8")
    assert updated(page) == page, "run: python -m bench.exercise_page docs/exercises.md"
    assert re.findall(r"<!-- exercise (\w+) -->", page) == list(BY_NAME)
