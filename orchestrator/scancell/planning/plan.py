"""A planned scan."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scancell.arguments import checked_arguments
from scancell.cell.program import Program
from scancell.planning.path_map.path_planner import PlacedPath
from scancell.planning.views.coverage import CoverageReport
from scancell.values import Value

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False, repr=False)
class Plan(Value):
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

    Examples
    --------
    >>> plan = scancell.plan("part.stl")
    >>> f"{len(plan.q)} exposures, {plan.coverage:.0%} of the surface"
    '1299 exposures, 71% of the surface'
    >>> file = plan.save("plan.json")
    >>> bool(np.array_equal(scancell.Plan.load("plan.json").q, plan.q))
    True
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
    source: str = field(default="", compare=False)

    @checked_arguments
    def save(self, path: str | Path) -> Path:
        """Write program and exposures to the file `path` (JSON), for `load` and `Scanner.scan`.

        What else the plan holds is not kept.

        Raises
        ------
        OutputError
            If the file cannot be written.
        """
        from scancell.planning.plan_file import write_plan  # noqa: PLC0415  (imports this module)

        write_plan(Path(path), self)
        return Path(path)

    @staticmethod
    @checked_arguments
    def load(path: str | Path) -> Plan:
        """The plan of the file `path`; `Scanner.scan` checks it again.

        Raises
        ------
        DescriptionError
            If the file cannot be read or holds no plan, naming key, value and what was expected.
        """
        from scancell.planning.plan_file import read_plan  # noqa: PLC0415  (imports this module)

        return read_plan(Path(path))
