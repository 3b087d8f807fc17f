"""Exercises for students: declarations, what is measured in the live cell, and result sheets."""

from __future__ import annotations

import base64
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from functools import cached_property
from html import escape
from math import inf
from pathlib import Path
from threading import RLock

import numpy as np
from numpy.typing import ArrayLike

from scancell import __version__
from scancell.arrays import Array
from scancell.cell.recording import Recording
from scancell.config.files import assets_dir
from scancell.errors import DescriptionError
from scancell.evaluation.deviation import deviation_from_mesh
from scancell.files import atomic_write
from scancell.geometry import pose
from scancell.geometry.fits import fit_sphere
from scancell.geometry.mesh import Mesh
from scancell.live.cell import LiveCell
from scancell.live.state import ContactWatch, LiveState
from scancell.nominal.parts import pose_matrix
from scancell.output.run_folder import command_words
from scancell.programs.program import LiveProgram, ProgramRun
from scancell.programs.taught import TaughtFile
from scancell.reconstruction.cloud import Cloud
from scancell.scanning.session import ScanSession
from scancell.scanning.world import World

_SUFFIX = ".html"
_LONGEST_NAME = 200  # bytes
_STYLE = """body{font-family:sans-serif;max-width:60em;margin:2em auto;padding:0 1em}
table{border-collapse:collapse}td,th{border:1px solid #999;padding:0.3em 0.6em;text-align:left}
img{max-width:100%}"""


_MM = 1e3
_FLANGE = "link6"
_TOP = 10e-3  # m, of the sphere, over which it is fitted


Measure = Callable[["Situation"], float | None]  # None: there is nothing to measure yet


@dataclass(frozen=True)
class Check:
    """An item that is reached when a measured value is within its limits.

    Attributes
    ----------
    text
        What is to be reached.
    measure
        The value, in `unit`.
    least, most
        Limits.
    """

    text: str
    measure: Measure
    unit: str
    least: float = -inf
    most: float = inf

    @property
    def limit(self) -> str:
        """The limits in words."""
        limits = [("at least", self.least), ("at most", self.most)]
        return " and ".join(f"{word} {value:g} {self.unit}" for word, value in limits if np.isfinite(value))

    def is_reached(self, value: float) -> bool:
        """Whether a value is within the limits."""
        return self.least <= value <= self.most


@dataclass(frozen=True)
class Question:
    """An item that is reached when the student's figure agrees with the value of the simulation.

    Attributes
    ----------
    text
        What is asked for.
    measure
        Value of the simulation when the figure is entered, in `unit`.
    tolerance
        Largest difference.
    """

    text: str
    measure: Measure
    unit: str
    tolerance: float

    @property
    def label(self) -> str:
        """Name of the number field."""
        return f"{self.text}, {self.unit}"

    @property
    def limit(self) -> str:
        """The tolerance in words."""
        return f"within {self.tolerance:g} {self.unit} of the simulated value"


Item = Check | Question


@dataclass(frozen=True)
class Exercise:
    """An exercise, with the cell in which it is done.

    Attributes
    ----------
    number, name
        Both select it.
    task
        A few sentences.
    part
        File name of the part among the shipped ones; None: the table is empty.
    cell
        File name of the cell description among those of the exercises; None: the default cell.
    unknown
        Ranges of values of the descriptions that the random seed chooses.
    """

    number: int
    name: str
    title: str
    task: str
    items: tuple[Item, ...]
    part: str | None = None
    cell: str | None = None
    unknown: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    @property
    def part_file(self) -> Path | None:
        """File of the part."""
        return None if self.part is None else assets_dir() / "parts" / self.part

    @property
    def cell_file(self) -> Path | None:
        """File of the cell description."""
        return None if self.cell is None else assets_dir() / "exercises" / self.cell

    def settings(self, seed: int) -> list[str]:
        """Changes of the descriptions, ``KEY=VALUE``, that `seed` chooses."""
        random = np.random.Generator(np.random.Philox(key=seed))
        return [f"{key}={random.uniform(*limits):.2f}" for key, limits in self.unknown.items()]


@dataclass(frozen=True)
class FinishedRun:
    """A program that ran to its end.

    Attributes
    ----------
    record
        Its commands and simulated time.
    is_taught
        Whether it is the taught program of the workspace.
    exposures, cloud
        What it measured; None without.
    world
        Part and descriptions of the cell.
    """

    record: ProgramRun
    is_taught: bool
    exposures: Recording | None
    cloud: Cloud | None
    world: World

    @classmethod
    def of(
        cls, record: ProgramRun, is_taught: bool, exposures: Sequence[Recording], clouds: Sequence[Cloud], world: World
    ) -> FinishedRun:
        """A run that measured several exposures and clouds, one after another."""
        joined = Recording.joined(list(exposures)) if exposures else None
        return cls(record, is_taught, joined, Cloud.concatenate(list(clouds)) if clouds else None, world)

    @cached_property
    def rms_deviation(self) -> float | None:
        """RMS distance of the cloud from the part, m; None without points."""
        if self.cloud is None or not len(self.cloud):
            return None
        return deviation_from_mesh(self.cloud, self.world.part_surface).rms

    def sensor_at_exposures(self) -> Array:
        """True positions (n, 3) of the sensor at the exposures, m in the world."""
        if self.exposures is None:
            return np.empty((0, 3))
        return np.asarray(self.exposures.truth_at_middle("sensor")[:, :3, 3])


@dataclass(frozen=True)
class Situation:
    """State of an attempt.

    Attributes
    ----------
    start, now
        States of the cell at its beginning and now.
    contacts
        Pairs of bodies that have come into contact since, gripped parts excluded.
    run
        The last program; None unless it ran to its end.
    world
        Part and descriptions of the cell.
    """

    start: LiveState
    now: LiveState
    contacts: tuple[str, ...]
    run: FinishedRun | None
    world: World

    @property
    def part(self) -> Mesh:
        """Mesh of the part."""
        return self.world.nominal.part

    @property
    def part_in_world(self) -> Array:
        """True positions (n, 3) of the corners of the part's mesh, m."""
        return pose.transform_points(self.now.world_from_body["part"], self.part.vertices)


def commands_of_run(situation: Situation) -> float | None:
    """Number of commands of a program that ran to its end."""
    return None if situation.run is None else len(situation.run.record.steps)


def commands_of_taught_run(situation: Situation) -> float | None:
    """Number of commands of the taught program, after it ran to its end."""
    return commands_of_run(situation) if situation.run is not None and situation.run.is_taught else None


def contacts(situation: Situation) -> float | None:
    """Number of pairs of bodies that touched since the cell was opened, once a program has run to its end."""
    return None if situation.run is None else len(situation.contacts)


def duration(situation: Situation) -> float | None:
    """Simulated time of the program, s."""
    return None if situation.run is None else situation.run.record.duration


# Arm


def least_joint_motion(situation: Situation) -> float | None:
    """Smallest angle of a joint from its value at the start, deg."""
    return float(np.degrees(np.abs(situation.now.joints - situation.start.joints).min()))


def flange_coordinate(axis: int) -> Measure:
    """Coordinate of the flange's origin in the world, mm."""
    return lambda situation: float(_MM * situation.now.world_from_body[_FLANGE][axis, 3])


def flange_to_sensor(situation: Situation) -> float | None:
    """Distance of the sensor's origin from the flange's, mm."""
    poses = situation.now.world_from_body
    return float(_MM * np.linalg.norm(poses["sensor"][:3, 3] - poses[_FLANGE][:3, 3]))


# Part


def part_displacement_error(displacement: ArrayLike) -> Measure:
    """Function that measures how far the part is from `displacement` (3,), m, off its place at the start; in mm."""

    def measure(situation: Situation) -> float | None:
        if situation.run is None:
            return None
        start, now = (state.world_from_body["part"][:3, 3] for state in (situation.start, situation.now))
        return float(_MM * np.linalg.norm(now - start - np.asarray(displacement)))

    return measure


def part_turn_error(angle: float) -> Measure:
    """Function that measures how far the part is from a turn by `angle`, rad, about the vertical either way, deg."""

    def measure(situation: Situation) -> float | None:
        if situation.run is None:
            return None
        start, now = (state.world_from_body["part"][:3, :3] for state in (situation.start, situation.now))
        errors = [pose.rotation_about(2, sign * angle) @ start @ now.T for sign in (-1, 1)]
        return float(np.degrees(min(np.linalg.norm(pose.log_rotation(error)) for error in errors)))

    return measure


def part_angle(situation: Situation) -> float | None:
    """Angle of the part's x axis from the world's x axis, about the vertical, deg."""
    x = situation.now.world_from_body["part"][:3, 0]
    return float(np.degrees(np.arctan2(x[1], x[0])))


def sphere_radius(situation: Situation) -> float | None:
    """Radius of the sphere on top of the part, mm."""
    vertices = situation.part.vertices
    return _MM * fit_sphere(vertices[vertices[:, 2] > vertices[:, 2].max() - _TOP]).radius


# Belt


def _along_belt(situation: Situation) -> Array:
    return np.asarray(pose_matrix(situation.world.setup.cell.conveyor[0].pose)[:3, 0])


def part_length(situation: Situation) -> float | None:
    """Extent of the part along the belt, mm."""
    return float(_MM * np.ptp(situation.part_in_world @ _along_belt(situation)))


def part_height(situation: Situation) -> float | None:
    """Greatest height of the part above the belt in the vertical plane along the belt through distance sensor 1, mm."""
    cell = situation.world.setup.cell
    sensor, belt = (pose_matrix(one.pose)[:3, 3] for one in (cell.distance_sensor[0], cell.conveyor[0]))
    along = _along_belt(situation)
    across = np.array([-along[1], along[0], 0.0])
    faces = situation.part_in_world[situation.part.faces]
    begin, end = faces, np.roll(faces, 1, axis=1)
    offset, other = (points @ across - sensor @ across for points in (begin, end))
    cut = offset * other < 0
    share = offset[cut] / (offset[cut] - other[cut])
    heights = begin[cut][:, 2] + share * (end[cut][:, 2] - begin[cut][:, 2])
    return float(_MM * (heights.max() - belt[2])) if len(heights) else None


def front_past_barrier(situation: Situation) -> float | None:
    """Distance of the part's front from the middle of presence sensor 1 along the belt, mm."""
    if situation.run is None:
        return None
    along = _along_belt(situation)
    barrier = pose_matrix(situation.world.setup.cell.presence_sensor[0].pose)[:3, 3]
    return float(_MM * ((situation.part_in_world @ along).max() - barrier @ along))


def belt_speed(situation: Situation) -> float | None:
    """Absolute speed of the belt after the program, mm/s."""
    return None if situation.run is None else _MM * abs(situation.now.conveyors[0][0])


# Measurements of the program


def points(situation: Situation) -> float | None:
    """Number of points of the cloud."""
    return None if situation.run is None or situation.run.cloud is None else len(situation.run.cloud)


def rms_deviation(situation: Situation) -> float | None:
    """RMS distance of the cloud from the part, mm."""
    deviation = None if situation.run is None else situation.run.rms_deviation
    return None if deviation is None else _MM * deviation


def scan_end_error(number: int, target: ArrayLike) -> Measure:
    """Function that measures how far the sensor was from `target` (3,), m, at exposure `number`, 0 or -1; in mm."""

    def measure(situation: Situation) -> float | None:
        places = np.empty((0, 3)) if situation.run is None else situation.run.sensor_at_exposures()
        return float(_MM * np.linalg.norm(places[number] - np.asarray(target))) if len(places) else None

    return measure


def rise_after_scan(situation: Situation) -> float | None:
    """Height of the sensor above its place at the last exposure, mm."""
    places = np.empty((0, 3)) if situation.run is None else situation.run.sensor_at_exposures()
    now = situation.now.world_from_body["sensor"][:3, 3]
    return float(_MM * (now[2] - places[-1, 2])) if len(places) else None


def _sensor_at_edge(situation: Situation) -> Array:
    """Positions (n, 2) of the sensor along and across the part's edge at smaller y, from the third profile on, m."""
    if situation.run is None:
        return np.empty((0, 2))
    part_from_world = pose.inverse(situation.now.world_from_body["part"])
    in_part = pose.transform_points(part_from_world, situation.run.sensor_at_exposures()[2:])
    return np.asarray(in_part[:, :2] - [0.0, situation.part.vertices[:, 1].min()])


def length_of_edge(situation: Situation) -> float | None:
    """Length of the part's edge along which the profiles were measured, mm."""
    places = _sensor_at_edge(situation)
    return float(_MM * np.ptp(places[:, 0])) if len(places) else None


def distance_from_edge(situation: Situation) -> float | None:
    """Greatest horizontal distance of the sensor from the part's edge, from the third profile on, mm."""
    places = _sensor_at_edge(situation)
    return float(_MM * np.abs(places[:, 1]).max()) if len(places) else None


@dataclass(frozen=True)
class Result:
    """An item with its value: measured, or the student's figure; None without."""

    item: Item
    value: float | None
    is_reached: bool

    @property
    def value_text(self) -> str:
        """The value with its unit; empty without."""
        return "" if self.value is None else f"{round(self.value, 3) + 0.0:.15g} {self.item.unit}"


class Attempt:
    """Measures the items of an exercise in a live cell, from now on. All methods are thread-safe.

    Items refer to the last program that was run; without one that ran to its end they have no value. A figure is
    compared with the value that the simulation has when it is entered.

    Parameters
    ----------
    live, session
        The running cell.
    program, taught
        Robot programs of the workspace.

    Attributes
    ----------
    exercise, world
        The exercise, and the part and descriptions of the cell.
    """

    def __init__(
        self, exercise: Exercise, live: LiveCell, session: ScanSession, program: LiveProgram, taught: TaughtFile
    ) -> None:
        self.exercise, self.world = exercise, session.world
        self._live, self._program, self._taught = live, program, taught
        self._lock = RLock()
        self._start = live.state
        self._contacts = ContactWatch(session.cell, [body.name for body in session.true.bodies])
        self._number, self._exposures, self._clouds = 0, list[Recording](), list[Cloud]()  # of the last program
        self._finished: tuple[ProgramRun, FinishedRun] | None = None
        self._answers: dict[Question, tuple[float, bool]] = {}
        session.on_exposures = self._receive

    @property
    def results(self) -> tuple[Result, ...]:
        """Every item with its present value."""
        with self._lock:
            situation = self._situation()
            return tuple(self._result(item, situation) for item in self.exercise.items)

    def answer(self, question: Question, value: float) -> None:
        """Enter a figure.

        Raises
        ------
        DescriptionError
            If it is not finite.
        """
        if not math.isfinite(value):
            raise DescriptionError(key=question.text, value=value, expected=f"a finite number, {question.unit}")
        with self._lock:
            true_value = question.measure(self._situation())
            is_right = true_value is not None and abs(value - true_value) <= question.tolerance
            self._answers[question] = value, is_right

    def _result(self, item: Item, situation: Situation) -> Result:
        if isinstance(item, Question):
            value, is_right = self._answers.get(item, (None, False))
            return Result(item, value, is_right)
        measured = item.measure(situation)
        return Result(item, measured, measured is not None and item.is_reached(measured))

    def _situation(self) -> Situation:
        contacts = tuple(self._contacts.pairs)
        return Situation(self._start, self._live.state, contacts, self._finished_run(), self.world)

    def _finished_run(self) -> FinishedRun | None:
        """The last program; None unless it ran to its end."""
        state = self._program.state
        if state is None or state.record is None:
            return None
        if self._finished is None or self._finished[0] is not state.record:
            is_taught = state.file == self._taught.path
            exposures, clouds = (self._exposures, self._clouds) if self._number == self._program.started else ([], [])
            self._finished = state.record, FinishedRun.of(state.record, is_taught, exposures, clouds, self.world)
        return self._finished[1]

    def _receive(self, recording: Recording, cloud: Cloud | None) -> None:
        """Keep what the last program measured; called in the thread of the cell."""
        with self._lock:
            if self._number != self._program.started:
                self._number, self._exposures, self._clouds = self._program.started, [], []
            self._exposures.append(recording)
            if cloud is not None:
                self._clouds.append(cloud)


def sheet_file(folder: Path, name: str) -> Path:
    """Path of a sheet in a folder; the suffix is added where it is missing.

    Raises
    ------
    DescriptionError
        If `name` is no file name.
    """
    name = name.strip()
    name = name if name.lower().endswith(_SUFFIX) else name + _SUFFIX
    is_plain = name.isprintable() and not set(name) & set('/\\:*?"<>|') and not name.startswith(".")
    if not is_plain or len(name.encode()) > _LONGEST_NAME:
        expected = f"a file name without folders, of at most {_LONGEST_NAME} bytes, such as exercise_1{_SUFFIX}"
        raise DescriptionError(key="file", value=name, expected=expected)
    return folder / name


def write_sheet(file: Path, attempt: Attempt, student: str, picture: bytes | None = None) -> None:
    """Write the results of an attempt.

    Parameters
    ----------
    student
        Name, may be empty.
    picture
        Picture of the scene (PNG).

    Raises
    ------
    OutputError
        If the file cannot be written.
    """
    text = sheet_html(attempt, student, picture)
    with atomic_write(file) as temporary:
        temporary.write_text(text, encoding="utf-8")


def sheet_html(attempt: Attempt, student: str, picture: bytes | None = None) -> str:
    """The text of a sheet; parameters as of `write_sheet`."""
    exercise, world, results = attempt.exercise, attempt.world, attempt.results
    is_passed = all(result.is_reached for result in results)
    title = escape(f"Exercise {exercise.number}: {exercise.title}")
    facts = {
        "student": student,
        "date": datetime.now().astimezone().isoformat(" ", "seconds"),
        "result": "passed" if is_passed else "not passed",
        "seed": str(world.seed),
        "deviations of the cell": " ".join(world.as_built) or "none",
        "scancell": __version__,
        "command": " ".join(command_words(None)),
    }
    rows = "".join(f"<tr><th>{escape(name)}</th><td>{escape(value)}</td></tr>\n" for name, value in facts.items())
    shown = base64.b64encode(picture).decode() if picture else ""
    image = f'<p><img alt="the scene" src="data:image/png;base64,{shown}"></p>\n' if shown else ""
    return (
        f'<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"><title>{title}</title>\n'
        f"<style>{_STYLE}</style></head>\n<body><h1>{title}</h1>\n<p>{escape(exercise.task)}</p>\n"
        f"<table>\n{rows}</table>\n<h2>Items</h2>\n<table>\n"
        f"<tr><th>item</th><th>value</th><th>limit</th><th>result</th></tr>\n{''.join(map(_row, results))}</table>\n"
        f"{image}</body></html>\n"
    )


def _row(result: Result) -> str:
    reached = "passed" if result.is_reached else "not passed"
    cells = (result.item.text, result.value_text or "none", result.item.limit, reached)
    return f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in cells)}</tr>\n"


_ENDS = Check("The program runs to its end", commands_of_run, "commands", least=2)
_NO_CONTACT = Check("No bodies touch from the opening of the cell on", contacts, "contacts", most=0)
_DEVIATION = Check("The RMS deviation of the cloud from the part is small", rms_deviation, "mm", most=0.05)


def _time(most: float) -> Check:
    return Check("The program is fast enough, in simulated time", duration, "s", most=most)


EXERCISES = (
    Exercise(
        1,
        "kinematics",
        "Kinematics",
        "Compute the pose of the flange from robot.joints and the Denavit-Hartenberg parameters of the arm. "
        "robot.world_from_tool() is the pose of the sensor: show that the pose of the sensor relative to the "
        "flange is the same in every configuration. Bring the arm to a configuration of your choice, and enter the "
        "position of the flange there. The joints (0, -60, 185, 0, 55, 0)° are a good start.",
        (
            _ENDS,
            Check("All joints have moved away from the home position", least_joint_motion, "deg", least=4),
            Question("x of the flange in the world", flange_coordinate(0), "mm", 0.1),
            Question("y of the flange in the world", flange_coordinate(1), "mm", 0.1),
            Question("z of the flange in the world", flange_coordinate(2), "mm", 0.1),
            Question("distance of the sensor from the flange", flange_to_sensor, "mm", 0.1),
        ),
    ),
    Exercise(
        2,
        "grasping",
        "Grasping",
        "The part stands in the middle of the table at (450, 0, 100) mm. Pick it up and put it down 40 mm further "
        "along y, turned by 90°. The fingers are 45 mm long and open up to 70 mm; the part is 50 mm wide. "
        'robot.set_tool("gripper") makes poses those of the point between the upper ends of the pads, with z along '
        "the fingers.",
        (
            _ENDS,
            _NO_CONTACT,
            Check("The part is 40 mm further along y", part_displacement_error((0, 40e-3, 0)), "mm", most=1),
            Check("The part is turned by 90°", part_turn_error(math.pi / 2), "deg", most=1),
            _time(20),
        ),
        part="step_block.stl",
        cell="gripper.toml",
    ),
    Exercise(
        3,
        "sensors",
        "Presence and distance sensors",
        "A belt brings the part past a light barrier (presence sensor 1, 2 mm thick along the belt) and below a "
        "distance sensor. Measure the length of the part along the belt with robot.conveyor_travel(1), and its "
        "height below the distance sensor. The controller reads sensors every 16 ms.",
        (
            _ENDS,
            _NO_CONTACT,
            Question("length of the part along the belt", part_length, "mm", 0.5),
            Question("height of the part", part_height, "mm", 0.1),
        ),
        part="step_block.stl",
        cell="belt.toml",
    ),
    Exercise(
        4,
        "conveyor",
        "Conveyor",
        "In the cell of exercise 3, stop the belt so that the front of the part is 60 mm past the middle of the "
        "barrier. The belt brakes at 1 m/s².",
        (
            _ENDS,
            _NO_CONTACT,
            Check("The belt is at rest", belt_speed, "mm/s", most=0.01),
            Check("The front of the part is 60 mm past the barrier", front_past_barrier, "mm", 58, 62),
            _time(15),
        ),
        part="step_block.stl",
        cell="belt.toml",
    ),
    Exercise(
        5,
        "scanning",
        "Scanning",
        "Scan the sphere from above and find its radius. Its centre is above the middle of the table, its top 70 "
        "mm above the table. The sensor measures at distances of about 75 to 165 mm.",
        (
            _ENDS,
            _NO_CONTACT,
            Check("The cloud has enough points", points, "points", least=10_000),
            _DEVIATION,
            Question("radius of the sphere", sphere_radius, "mm", 0.05),
            _time(10),
        ),
        part="sphere_on_foot.stl",
    ),
    Exercise(
        6,
        "seam",
        "Seam following",
        "The part lies on the table at an unknown angle of up to 10°. Follow its right-hand edge (smaller y), "
        "where the surface drops to the table: each profile determines the position of the next one. Find the "
        "angle of the edge.",
        (
            _ENDS,
            _NO_CONTACT,
            Check("The edge is followed", length_of_edge, "mm", least=30),
            Check("The sensor is above the edge from the third profile on", distance_from_edge, "mm", most=1),
            Question("angle of the edge from the world's x axis", part_angle, "deg", 0.3),
        ),
        part="step_block.stl",
        unknown={"cell.part.rz_deg": (-10.0, 10.0)},
    ),
    Exercise(
        7,
        "taught",
        "Teach a program by hand",
        "Scan the sphere of exercise 5 again, without writing a program, in the tab Program, Teach. Bring the "
        "sensor above the part (tab Pose: 450, 0, 300 mm; 180, 0, 0°), and add a step of the kind joints. Bring it "
        "to 432, 0, 260 mm, and add a line; to 468, 0, 260 mm, and add a scan line. Copy the first step, and move "
        "the copy to the end. Run the program in the tab Run, first step by step.",
        (
            Check("The taught program runs to its end", commands_of_taught_run, "commands", least=4),
            _NO_CONTACT,
            Check("The scan begins at 432, 0, 260 mm", scan_end_error(0, (0.432, 0, 0.26)), "mm", most=0.5),
            Check("The scan ends at 468, 0, 260 mm", scan_end_error(-1, (0.468, 0, 0.26)), "mm", most=0.5),
            Check("The sensor is raised after the scan", rise_after_scan, "mm", least=30),
            _DEVIATION,
            _time(15),
        ),
        part="sphere_on_foot.stl",
    ),
)


def find_exercise(selected: str) -> Exercise:
    """The exercise with a number or name.

    Raises
    ------
    DescriptionError
        If there is none.
    """
    for exercise in EXERCISES:
        if selected in (str(exercise.number), exercise.name):
            return exercise
    names = ", ".join(exercise.name for exercise in EXERCISES)
    expected = f"a number from 1 to {len(EXERCISES)}, or {names}"
    raise DescriptionError(key="exercise", value=selected, expected=expected)
