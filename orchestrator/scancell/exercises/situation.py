"""State of an attempt at an exercise, from which its items are measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from scancell.cell.recording import Recording
from scancell.evaluation.deviation import deviation_from_mesh
from scancell.geometry import pose
from scancell.geometry.mesh import Mesh
from scancell.live.state import LiveState
from scancell.programs.program import ProgramRun
from scancell.reconstruction.cloud import Cloud
from scancell.scanning.world import World

Array = NDArray[np.float64]


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
