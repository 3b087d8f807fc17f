"""Assembly of placed views into one scan program: connecting motions, triggered runs and exposures at rest."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scancell.cell.program import BeltRun, Program, Segment, TriggerRule
from scancell.errors import PlanningError
from scancell.planning.model import PlanningCell, WorkLimitError, with_table
from scancell.planning.motion import trajectory
from scancell.planning.motion.connection import Connector
from scancell.planning.options import ScanOptions
from scancell.planning.path_map.path_planner import PlacedPath
from scancell.planning.views.placement import Placed, PlacedPass, PlacedPose, PlacedSweep, sweep_run

Array = NDArray[np.float64]
Parts = tuple[Program, NDArray[np.int64], Array]


def approach(cell: PlanningCell, clearance: float, start: Array, goal: Array, purpose: str) -> Program | None:
    """Collision-free motions from `start` to `goal` (axes,), rad, which `purpose` names; None where both are the same.

    Raises `PlanningError` if none is found, naming the bodies that collide on the direct way.
    """
    motions = Connector(cell, clearance).connect(start, goal, purpose)
    segments = (
        Segment(number, _times(points, cell), points, name=f"to {purpose}")
        for number, points in enumerate(motions, start=1)
    )
    return Program(tuple(segments)) if motions else None


def _times(setpoints: Array, cell: PlanningCell) -> Array:
    return np.arange(len(setpoints), dtype=np.float64) * cell.cycle


class Assembly:
    """Builds a program segment by segment; each segment starts at the set-point where the previous one ended.

    Parameters
    ----------
    cell
        Nominal cell; the program starts at its home position.
    options
        Scan mode, speeds and clearance.
    """

    def __init__(self, cell: PlanningCell, options: ScanOptions) -> None:
        self._cell = cell
        self._options = options
        self._connector = Connector(cell, options.clearance)
        self._at = cell.start
        self._segments: list[Segment] = []
        self._exposures: list[tuple[int, Array]] = []
        self._views: list[tuple[Placed, tuple[Array, int, int]]] = []  # with what there was before each

    def add_view(self, placed: Placed, count: int) -> None:
        """Append a sweep with `count` exposures, or a pass.

        Raises `PlanningError` if no collision-free path to it is found; then nothing is appended.
        """
        before = (self._at, len(self._segments), len(self._exposures))
        try:
            if isinstance(placed, PlacedSweep):
                self.add_sweep(placed, count)
            else:
                self.add_motion(placed)
        except PlanningError:
            self._return_to(before)
            raise
        self._views.append((placed, before))

    def go_home(self) -> list[tuple[Placed, str]]:
        """Append the motion home; returns views from which there is none, which are taken out, with the reason.

        Raises `PlanningError` if no view is left from which there is one.
        """
        lost: list[tuple[Placed, str]] = []
        while True:
            try:
                self._go(np.append(self._cell.nominal.home, self._at[-1]), "home")
            except WorkLimitError:
                raise
            except PlanningError as error:
                if not self._views:
                    raise
                placed, before = self._views.pop()
                self._return_to(before)
                lost.append((placed, str(error)))
            else:
                return lost

    def _return_to(self, before: tuple[Array, int, int]) -> None:
        self._at, segments, exposures = before
        del self._segments[segments:], self._exposures[exposures:]

    def add_sweep(self, placed: PlacedSweep, count: int) -> None:
        """Append a full table turn with `count` exposures, the first at table angle 0 (modulo 2 pi)."""
        step = 2 * np.pi / count
        first = 2 * np.pi * np.round(self._at[-1] / (2 * np.pi))
        angles = first + step * np.arange(count)
        points = with_table(placed.q, angles)
        if not self._options.dynamic:
            self._expose_at_rest(points, placed.view.name, are_free=True)
            return
        assert self._options.sweep is not None
        run = sweep_run(self._cell, count, self._options.sweep.speed)
        table = first + run.at(trajectory.cycle_times(run.duration, self._cell.cycle))
        self._run(with_table(placed.q, table), run, TriggerRule("table_angle", step), points, placed.view.name)

    def add_motion(self, placed: PlacedPass | PlacedPath) -> None:
        """Append a motion of the sensor: at constant speed in dynamic mode, exposure by exposure otherwise."""
        turns = self._turns(placed.axes[0])
        points, view = placed.exposures + turns, placed.view
        if not self._options.dynamic:
            self._expose_at_rest(points, view.name)
            return
        rule = TriggerRule("path_distance", view.length / (len(points) - 1))
        self._run(placed.axes + turns, placed.run, rule, points, view.name)

    def add_pose(self, placed: PlacedPose) -> None:
        """Append one exposure at rest."""
        self._expose_at_rest((placed.axes + self._turns(placed.axes))[None], placed.name)

    def add_belt(self, placed: PlacedPose, run: BeltRun, pitch: float, count: int) -> None:
        """Append the motion to the pose of the sensor, where it rests while the belt runs, with `count` exposures."""
        goal, name = placed.axes, placed.name
        *before, last = self._connector.connect(self._at, goal, name) or [self._connector.move(self._at, goal)]
        for setpoints in before:
            self._append(setpoints, TriggerRule(), 0.0, 0.0, f"to {name}")
        number = self._append(last, TriggerRule("belt_travel", pitch), 0.0, 0.0, name, run)
        self._exposures += count * [(number, goal[None])]

    def finish(self) -> Parts:
        """Append the motion home, unless it was appended, and return the result.

        Raises `PlanningError` if no collision-free path home is found.

        Returns
        -------
        program
            All segments.
        segment
            (m,) segment id of each exposure.
        axes
            (m, axes) joints and table angle of each exposure, rad.
        """
        self._go(np.append(self._cell.nominal.home, self._at[-1]), "home")
        program = Program(tuple(self._segments), 0.0 if self._all_moving() else self._options.settle)
        ids = np.array([number for number, _ in self._exposures], np.int64)
        return program, ids, np.concatenate([points for _, points in self._exposures])

    def time_to(self, start: Array) -> float:
        """Time (s) of the direct motion from the present set-point to joints and a table angle (axes,), rad."""
        return len(self._connector.move(self._at, start + self._nearest_turns(start))) * self._cell.cycle

    def _all_moving(self) -> bool:
        return all(segment.trigger.kind != "request" for segment in self._segments)

    def _nearest_turns(self, goal: Array) -> Array:
        """Full turns (axes,), rad, of the table alone that bring `goal` (axes,) nearest."""
        turn = np.append(np.zeros(len(goal) - 1), 2 * np.pi)
        return np.asarray(turn * np.round((self._at[-1] - goal[-1]) / (2 * np.pi)))

    def _turns(self, goal: Array) -> Array:
        """Full turns (axes,), rad, by which the table gets to `goal` whatever the arm does: the nearest, if several."""
        nearest = self._nearest_turns(goal)
        back = np.append(np.zeros(len(goal) - 1), np.copysign(2 * np.pi, goal[-1] + nearest[-1] - self._at[-1]))
        ways = (nearest, nearest - back)
        return next((way for way in ways if self._connector.is_table_free(self._at, (goal + way)[-1])), nearest)

    def _go(self, goal: Array, purpose: str) -> None:
        self._approaching(purpose)
        for setpoints in self._connector.connect(self._at, goal, purpose):
            self._append(setpoints, TriggerRule(), 0.0, 0.0, f"to {purpose}")

    def _run(self, setpoints: Array, run: trajectory.Run, rule: TriggerRule, points: Array, name: str) -> None:
        self._go(setpoints[0], name)
        number = self._append(setpoints, rule, run.trigger_from, run.trigger_to, name)
        self._exposures += [(number, point[None]) for point in points]

    def _expose_at_rest(self, points: Array, name: str, are_free: bool = False) -> None:
        """Append exposures at rest at points (m, axes) in order, by collision-free paths.

        `are_free`: the straight motions between them are known to be free.
        """
        straight = self._connector.are_free(points[:-1], points[1:]) if not are_free else [True] * (len(points) - 1)
        for point, is_free in zip(points, [False, *straight], strict=True):
            self._approaching(name)
            motions = [] if is_free else self._connector.connect(self._at, point, name)
            for setpoints in motions[:-1]:
                self._append(setpoints, TriggerRule(), 0.0, 0.0, f"to {name}")
            last = motions[-1] if motions else self._connector.move(self._at, point)
            number = self._append(last, TriggerRule("request"), 0.0, 0.0, name)
            self._exposures.append((number, point[None]))

    def _approaching(self, name: str) -> None:
        self._cell.work.doing = f"finding the motion to {name}; {len(self._segments)} segments were made"

    def _append(
        self, setpoints: Array, rule: TriggerRule, start: float, end: float, name: str, belt: BeltRun | None = None
    ) -> int:
        number = len(self._segments) + 1
        times = _times(setpoints, self._cell)
        self._segments.append(Segment(number, times, setpoints, rule, start, end, name, belt))
        self._at = setpoints[-1]
        return number
