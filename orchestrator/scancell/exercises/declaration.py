"""What an exercise is made of: its task, and items that are checked in the live cell."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from scancell.config.files import assets_dir

if TYPE_CHECKING:
    from scancell.exercises.situation import Situation

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
