"""The plan of the scan in a live cell, made in a thread, and moves to its poses."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass
from time import monotonic
from typing import Annotated, Literal

import numpy as np

from scancell.arguments import Shape, Within, checked_arguments
from scancell.arrays import Array
from scancell.errors import CommandError, DescriptionError
from scancell.live.cell import LiveCell
from scancell.live.state import process_goes_on, ready_to_move, while_stepping
from scancell.planning.path_map.configuration_map import ConfigurationMap
from scancell.planning.path_map.ray_shooting import why_forbidden
from scancell.planning.plan import Plan
from scancell.progress import CallbackProgress
from scancell.scanning.session import ScanSession

Index = Annotated[int, Within(0)]
Axes = Annotated[Array, Shape((None,))]
Stage = Literal["none", "planning", "evaluating", "ready", "failed"]

_PIECES = 24  # in which a map is evaluated
_NO_PLAN = "there is no plan: make one first"


@dataclass(frozen=True)
class LivePlanState:
    """Progress of a plan: its stage, the time in it (s), the share of the map that is evaluated, and the error."""

    stage: Stage
    seconds: float
    share: float
    error: str


@dataclass(frozen=True, eq=False)
class MapPose:
    """A cell of a configuration map.

    Attributes
    ----------
    share
        Share of the time along the path, 0 to 1.
    angle
        Angle of the table, rad, from 0 to 2 pi.
    quality
        0 to 1; 0 where the pose is forbidden.
    reason
        Why it is forbidden; empty where it is not.
    axes
        Joints and table angle (joints + 1,), rad; None out of reach.
    """

    share: float
    angle: float
    quality: float
    reason: str
    axes: Array | None


class LivePlan:
    """Plans the scan of a session's descriptions while the cell runs, and moves the robot to poses of the plan.

    A scan that is started later finds the plan in the pipeline. All methods are thread-safe.

    Parameters
    ----------
    live, session
        The running cell; only nominal geometry of the session is used, because `live` steps it.
    has_part
        Whether something stands on the table.

    Examples
    --------
    >>> settings = {"scan.raster.enabled": False, "scan.sweep.angle_step_deg": 20}
    >>> with scancell.Scanner(settings=settings) as scanner, scanner.session("part.stl") as session:
    ...     live = scancell.LiveCell(session)
    ...     plan = scancell.LivePlan(live, session)
    ...     plan.start()
    ...     live.run(lambda: plan.state.stage in ("ready", "failed"), realtime=False)
    ...     moved = plan.go_to(plan.plan.program.start, "the start")
    ...     live.run(moved.done, realtime=False)
    ...     bool(np.allclose(session.joints, plan.plan.program.start[:-1], atol=1e-3))
    True
    """

    @checked_arguments
    def __init__(self, live: LiveCell, session: ScanSession, has_part: bool = True) -> None:
        self._live, self._session, self._has_part = live, session, has_part
        self._lock, self._progress = threading.Lock(), CallbackProgress(process_goes_on)
        self._stage: Stage = "none"
        self._since, self._share, self._error = monotonic(), 0.0, ""
        self._plan: Plan | None = None
        self._maps: dict[tuple[int, int], ConfigurationMap] = {}

    @property
    def state(self) -> LivePlanState:
        """Its ``stage``, for how long (``seconds``), the ``share`` of the map that is evaluated, and the ``error``."""
        return LivePlanState(self._stage, monotonic() - self._since, self._share, self._error)

    @property
    def plan(self) -> Plan | None:
        """The last plan; None before the first."""
        return self._plan

    def start(self) -> None:
        """Plan, and evaluate the maps of the sensor paths in the branches that were chosen.

        Raises
        ------
        CommandError
            If the table is empty, or a plan is being made.
        """
        if not self._has_part:
            raise CommandError("the table is empty: open a part first")
        self._begin("planning", self._make)

    @checked_arguments
    def map_of(self, path: Index, branch: Index) -> ConfigurationMap | None:
        """The map of the sensor path number `path` (from 0) in `branch` of the arm, where it is evaluated."""
        return self._maps.get((path, branch))

    @checked_arguments
    def evaluate(self, path: Index, branch: Index) -> None:
        """Evaluate the map of the sensor path number `path` (from 0) in `branch` of the arm, where it is not.

        Raises
        ------
        CommandError
            If there is no plan, or one is being made, or another axis than the table moves along the path.
        DescriptionError
            If the plan has no such path, or the arm no such branch.
        """
        if (plan := self._plan) is None:
            raise CommandError(_NO_PLAN)
        branches = len(self._session.nominal.arm.branch_names)
        for name, number, count in (("path", path, len(plan.paths)), ("branch", branch, branches)):
            if number >= count:
                raise DescriptionError(key=name, value=number, expected=f"a number below {count}")
        moving = plan.paths[path].lattice.map.drive.name
        if moving != "table":
            raise CommandError(f"rows of this map are positions of {moving}: scancell plan --picture draws it")
        if (path, branch) not in self._maps:

            def work() -> None:
                self._maps[path, branch] = self._evaluated(plan, path, branch)

            self._begin("evaluating", work)

    @checked_arguments
    def judge(self, path: Index, branch: Index, share: float, angle: float) -> MapPose:
        """The cell of the map of `path` and `branch` nearest to a `share` of it, 0 to 1, and a table `angle`, rad.

        It has the ``quality`` of the pose, or the ``reason`` why it is forbidden, and its ``axes``.

        Raises
        ------
        CommandError
            If the map is not evaluated.
        """
        map_ = self._maps.get((path, branch))
        if map_ is None:
            raise CommandError("the map is not evaluated yet")
        column = int(np.clip(np.rint(share * (map_.columns - 1)), 0, map_.columns - 1))
        row = int(np.rint(angle / (2 * np.pi) * map_.rows)) % map_.rows
        at = float(map_.angle(row))
        q = map_.joints([column], [at])[0]
        axes = np.append(q, at) if np.isfinite(q).all() else None
        quality = float(map_.quality[column, row])
        return MapPose(column / (map_.columns - 1), at, quality, why_forbidden(map_, column, row), axes)

    @checked_arguments
    def go_to(self, axes: Axes, purpose: str) -> Future[None]:
        """Move the robot to `axes`, joints and table angle (joints + 1,), rad, on a planned path free of collision.

        Axes beyond the table stay where they are. `purpose` is for messages: ``the start``.

        The table turns in the shorter direction. Where there is no path the job fails with a `PlanningError`, which
        names the bodies that collide, and the robot does not move.
        """
        return self._live.perform(lambda session: self._go(session, axes, purpose), f"the motion to {purpose}")

    # In the thread of the cell

    def _go(self, session: ScanSession, axes: Array, purpose: str) -> None:
        start = ready_to_move(session)
        table = len(session.home)
        goal = nearest_turn(axes[: table + 1], float(start[table]))
        program = while_stepping(session, lambda _: session.pipeline.approach(session.world, start, goal, purpose))
        if program is not None:
            session.run_program(program, session.exposure)

    # In a thread of its own

    def _begin(self, stage: Stage, work: Callable[[], None]) -> None:
        with self._lock:
            if self._stage in ("planning", "evaluating"):
                raise CommandError("a plan is being made: wait for it")
            self._enter(stage)
            self._error = ""

        def do() -> None:
            try:
                work()
            except Exception as error:
                self._error = str(error)
            self._enter("failed" if self._error else "ready")

        threading.Thread(target=do, name="plan").start()  # no daemon, as in `while_stepping`

    def _enter(self, stage: Stage) -> None:
        self._stage, self._since, self._share = stage, monotonic(), 0.0

    def _make(self) -> None:
        world = self._session.world
        plan = self._session.pipeline.plan(world, progress=self._progress)
        self._enter("evaluating")
        branches = [placed.lattice.map.branch for placed in plan.paths]
        of_table = [path for path, placed in enumerate(plan.paths) if placed.lattice.map.drive.name == "table"]
        maps = {(path, branches[path]): self._evaluated(plan, path, branches[path]) for path in of_table}
        self._maps, self._plan = maps, plan

    def _evaluated(self, plan: Plan, path: int, branch: int) -> ConfigurationMap:
        planned = plan.paths[path].lattice.map
        map_ = planned if branch == planned.branch else planned.of_branch(branch)
        rows = np.arange(map_.rows)
        for number, columns in enumerate(np.array_split(np.arange(map_.columns), _PIECES)):
            self._share = number / _PIECES
            self._progress.advance(0.0)
            map_.require(*(cells.ravel() for cells in np.meshgrid(columns, rows)))
        return map_


def nearest_turn(axes: Array, table: float) -> Array:
    """Positions (axes,), rad, with the same pose of the table by as many turns more as bring it nearest to `table`."""
    turns = np.round((table - axes[-1]) / (2 * np.pi))
    return np.append(axes[:-1], axes[-1] + 2 * np.pi * turns)
