"""A planned scan."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scancell.cell.program import Program
from scancell.planning.coverage import CoverageReport
from scancell.planning.path_planner import PlacedPath

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Plan:
    """A program and its exposures.

    Attributes
    ----------
    program
        From home to home, checked for reach, joint limits and collisions.
    segment
        (m,) segment id of each exposure, in order of time.
    q, table
        (m, joints), (m,) planned joints and table angle of each exposure, rad.
    coverage
        Fraction of the part's surface that the views see, self-occlusion ignored; None for given poses.
    warnings
        Views that were omitted or replaced, and why.
    paths
        Sensor paths with the motions of the table that were found for them.
    report
        What coverage-driven views see; None for others.
    reduced
        Bodies whose meshes were reduced for the distance queries, and by how much: added to their clearances.
    source
        File that a saved plan was read from.
    """

    program: Program
    segment: NDArray[np.int64]
    q: Array
    table: Array
    coverage: float | None
    warnings: tuple[str, ...]
    paths: tuple[PlacedPath, ...] = ()
    report: CoverageReport | None = None
    reduced: tuple[str, ...] = ()
    source: str = ""
