"""Limit of the work of planning, in units that do not depend on the machine or its load."""

from __future__ import annotations

import math

from scancell.errors import PlanningError
from scancell.progress import NullProgress, Progress

# Units of work, about seconds of one core of 2020.
POSE = 5e-6  # inverse kinematics of a pose in closed form
NUMERICAL_POSE = 1.5e-3  # and by continuation
NUMERICAL_STEP, NUMERICAL_ROW = 5e-4, 5e-5  # of a step along paths, and of each solution in it
CONFIGURATION = 3e-5  # distances of all bodies
CELL = 2e-4  # of a configuration map
QUERY = 2e-3  # of cells of one, with the ranking of the ways over them
PATH_POSE = 1e-5  # pose on a sensor path
SIGHT = 1e-6  # judgement of a sample from a pose


class WorkLimitError(PlanningError):
    """The limit of the work of planning is reached; the message states the current step and result."""


class Work:
    """Counts work and passes the time for cancelling; a `Progress` of parts, whose stages are not displayed.

    Parameters
    ----------
    limit
        Largest work; ``scan.max_planning_work``.
    progress
        Told of every piece of work, so that it may cancel.
    """

    def __init__(self, limit: float = math.inf, progress: Progress | None = None) -> None:
        self.limit, self.spent, self.doing = limit, 0.0, "preparing the cell"
        self._progress = progress or NullProgress()

    def spend(self, amount: float) -> None:
        """Count work that is about to be done.

        Raises `WorkLimitError` naming what was being done, when the limit is exceeded; `CancelledError` when the
        progress cancels.
        """
        self.spent += amount
        self._progress.advance(0.0)
        if self.spent > self.limit:
            raise WorkLimitError(
                f"planning reached its limit of work while {self.doing}",
                key="scan.max_planning_work",
                value=self.limit,
                expected="a larger limit, or a scan with fewer views",
            )

    def stage(self, name: str, total: float, unit: str) -> None:
        """Begin a part."""
        self.spend(0.0)

    def advance(self, steps: float) -> None:
        """Count steps of a part, which are no work by themselves."""
        self.spend(0.0)
