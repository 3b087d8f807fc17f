"""Assembly of placed views into one scan program: connecting motions, triggered runs and exposures at rest."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scancell.cell.program import BeltRun, Program, Segment, TriggerRule
from scancell.planning.model import PlanningCell
from scancell.planning.motion import trajectory
from scancell.planning.motion.connection import Connector
from scancell.planning.options import ScanOptions
from scancell.planning.path_map.path_planner import PlacedPath
from scancell.planning.views.placement import PlacedPass, PlacedPose, PlacedSweep, sweep_run

Array = NDArray[np.float64]
Parts = tuple[Program, NDArray[np.int64], Array, Array]

_SMALL_MOVE = np.radians(0.5)  # joint moves up to this need no collision check: they stay within the clearance


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

    def add_sweep(self, placed: PlacedSweep, count: int) -> None:
        """Append a full table turn with `count` exposures, the first at table angle 0 (modulo 2 pi)."""
        step = 2 * np.pi / count
        first = 2 * np.pi * np.round(self._at[-1] / (2 * np.pi))
        angles = first + step * np.arange(count)
        points = np.column_stack([np.tile(placed.q, (count, 1)), angles])
        if not self._options.dynamic:
            self._expose_at_rest(points, placed.view.name)
            return
        assert self._options.sweep is not None
        run = sweep_run(self._cell, count, self._options.sweep.speed)
        table = first + run.at(trajectory.cycle_times(run.duration, self._cell.cycle))
        setpoints = np.column_stack([np.tile(placed.q, (len(table), 1)), table])
        self._run(setpoints, run, TriggerRule("table_angle", step), points, placed.view.name)

    def add_pass(self, placed: PlacedPass) -> None:
        """Append a straight pass: at constant speed in dynamic mode, exposure by exposure otherwise."""
        table = self._nearest_table(placed.table)
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
            self._expose_at_rest(points, placed.path.name, table_is_free=False)
            return
        setpoints = np.column_stack([placed.q, placed.table + turns])
        interval = placed.path.length / (len(points) - 1)
        self._run(setpoints, placed.run, TriggerRule("path_distance", interval), points, placed.path.name)

    def add_pose(self, placed: PlacedPose) -> None:
        """Append one exposure at rest."""
        point = np.append(placed.q, self._nearest_table(placed.table))
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
        """Append the motion home and return the result.

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

    def _go(self, goal: Array, purpose: str) -> None:
        self._approaching(purpose)
        for setpoints in self._connector.connect(self._at, goal, purpose):
            self._append(setpoints, TriggerRule(), 0.0, 0.0, f"to {purpose}")

    def _run(self, setpoints: Array, run: trajectory.Run, rule: TriggerRule, points: Array, name: str) -> None:
        self._go(setpoints[0], name)
        number = self._append(setpoints, rule, run.trigger_from, run.trigger_to, name)
        self._exposures += [(number, point[None]) for point in points]

    def _expose_at_rest(self, points: Array, name: str, table_is_free: bool = True) -> None:
        """Append exposures at rest at points (m, axes) in order; larger moves go by collision-free paths.

        Moves of the table alone need no check where it is free to turn: the full turn was checked when the view was
        placed.
        """
        checked = slice(None, -1 if table_is_free else None)
        for point in points:
            self._approaching(name)
            far = np.abs(point - self._at)[checked].max() > _SMALL_MOVE
            motions = self._connector.connect(self._at, point, name) if far else []
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
