"""Assembly of placed views into one scan program: connecting motions, triggered runs and exposures at rest."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scancell.cell.program import BeltRun, Program, Segment, TriggerRule
from scancell.errors import PlanningError
from scancell.planning.model import PlanningCell
from scancell.planning.motion import trajectory
from scancell.planning.motion.connection import Connector
from scancell.planning.options import ScanOptions
from scancell.planning.path_map.path_planner import PlacedPath
from scancell.planning.views.placement import Placed, PlacedPass, PlacedPose, PlacedSweep, sweep_run
from scancell.planning.work import WorkLimitError

Array = NDArray[np.float64]
Parts = tuple[Program, NDArray[np.int64], Array, Array]


def approach(cell: PlanningCell, clearance: float, start: Array, goal: Array, purpose: str) -> Program | None:
    """Collision-free motions from `start` to `goal` (axes,), rad, which `purpose` names; None where both are the same.

    Raises `PlanningError` if none is found, naming the bodies that collide on the direct way.
    """
    motions = Connector(cell, clearance).connect(start, goal, purpose)
    segments = (
        Segment(number, _times(points, cell), points[:, :-1], points[:, -1], name=f"to {purpose}")
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
        self._at = np.append(cell.nominal.home, cell.table_start)
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
                self.add_pass(placed)
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
        points = np.column_stack([np.tile(placed.q, (count, 1)), angles])
        if not self._options.dynamic:
            self._expose_at_rest(points, placed.view.name, are_free=True)
            return
        assert self._options.sweep is not None
        run = sweep_run(self._cell, count, self._options.sweep.speed)
        table = first + run.at(trajectory.cycle_times(run.duration, self._cell.cycle))
        setpoints = np.column_stack([np.tile(placed.q, (len(table), 1)), table])
        self._run(setpoints, run, TriggerRule("table_angle", step), points, placed.view.name)

    def add_pass(self, placed: PlacedPass) -> None:
        """Append a straight pass: at constant speed in dynamic mode, exposure by exposure otherwise."""
        table = self._reachable_table(placed.table)
        points = np.column_stack([placed.exposures, np.full(len(placed.exposures), table)])
        if not self._options.dynamic:
            self._expose_at_rest(points, placed.view.name)
            return
        setpoints = np.column_stack([placed.q, np.full(len(placed.q), table)])
        interval = placed.view.length / (len(points) - 1)
        self._run(setpoints, placed.run, TriggerRule("path_distance", interval), points, placed.view.name)

    def add_path(self, placed: PlacedPath) -> None:
        """Append a sensor path, along which arm and table move together."""
        turns = 2 * np.pi * np.round((self._at[-1] - placed.table[0]) / (2 * np.pi))
        points = placed.exposures + np.append(np.zeros(placed.q.shape[1]), turns)
        if not self._options.dynamic:
            self._expose_at_rest(points, placed.path.name)
            return
        setpoints = np.column_stack([placed.q, placed.table + turns])
        interval = placed.path.length / (len(points) - 1)
        self._run(setpoints, placed.run, TriggerRule("path_distance", interval), points, placed.path.name)

    def add_pose(self, placed: PlacedPose) -> None:
        """Append one exposure at rest."""
        point = np.append(placed.q, self._reachable_table(placed.table))
        self._expose_at_rest(point[None], placed.name)

    def add_belt(self, placed: PlacedPose, run: BeltRun, pitch: float, count: int) -> None:
        """Append the motion to the pose of the sensor, where it rests while the belt runs, with `count` exposures."""
        point = np.append(placed.q, placed.table)
        *before, last = self._connector.connect(self._at, point, placed.name) or [self._connector.move(self._at, point)]
        for setpoints in before:
            self._append(setpoints, TriggerRule(), 0.0, 0.0, f"to {placed.name}")
        number = self._append(last, TriggerRule("belt_travel", pitch), 0.0, 0.0, placed.name, run)
        self._exposures += count * [(number, point[None])]

    def finish(self) -> Parts:
        """Append the motion home, unless it was appended, and return the result.

        Raises `PlanningError` if no collision-free path home is found.

        Returns
        -------
        program
            All segments.
        segment
            (m,) segment id of each exposure.
        q, table
            (m, joints), (m,) joints and table angle of each exposure, rad.
        """
        self._go(np.append(self._cell.nominal.home, self._at[-1]), "home")
        program = Program(tuple(self._segments), 0.0 if self._all_moving() else self._options.settle)
        ids = np.array([number for number, _ in self._exposures], np.int64)
        points = np.concatenate([points for _, points in self._exposures])
        return program, ids, points[:, :-1], points[:, -1]

    def time_to(self, start: Array) -> float:
        """Time (s) of the direct motion from the present set-point to joints and a table angle (axes,), rad."""
        goal = np.append(start[:-1], self._nearest_table(float(start[-1])))
        return len(self._connector.move(self._at, goal)) * self._cell.cycle

    def _all_moving(self) -> bool:
        return all(segment.trigger.kind != "request" for segment in self._segments)

    def _nearest_table(self, angle: float) -> float:
        turn = 2 * np.pi
        return float(angle + turn * np.round((self._at[-1] - angle) / turn))

    def _reachable_table(self, angle: float) -> float:
        """The angle, modulo a full turn, to which the table gets whatever the arm does: the nearest one, if several."""
        nearest = self._nearest_table(angle)
        other = nearest - np.copysign(2 * np.pi, nearest - self._at[-1])
        return next((table for table in (nearest, other) if self._connector.is_table_free(self._at, table)), nearest)

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
        self._segments.append(Segment(number, times, setpoints[:, :-1], setpoints[:, -1], rule, start, end, name, belt))
        self._at = setpoints[-1]
        return number
