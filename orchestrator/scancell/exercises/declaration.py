"""What an exercise is made of: its task, and items that are checked in the live cell."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from math import inf
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scancell.cell.recording import Recording
from scancell.config.files import assets_dir
from scancell.evaluation.deviation import deviation_from_mesh
from scancell.geometry import pose
from scancell.geometry.mesh import Mesh
from scancell.live.state import LiveState
from scancell.programs.program import ProgramRun
from scancell.reconstruction.cloud import Cloud
from scancell.scanning.world import World

Array = NDArray[np.float64]


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
