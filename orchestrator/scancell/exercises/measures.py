"""Measurements of exercises, from true poses and from records of programs; None before there is a value."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from math import inf
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from scancell.arrays import Array
from scancell.cell.recording import Recording
from scancell.config.files import assets_dir
from scancell.evaluation.deviation import deviation_from_mesh
from scancell.geometry import pose
from scancell.geometry.fits import fit_sphere
from scancell.geometry.mesh import Mesh
from scancell.live.state import LiveState
from scancell.nominal.parts import pose_matrix
from scancell.programs.program import ProgramRun
from scancell.reconstruction.cloud import Cloud
from scancell.scanning.world import World

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
