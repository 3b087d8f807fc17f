"""Assembly of placed views into one scan program: connecting motions, triggered runs and exposures at rest."""

from __future__ import annotations

from itertools import pairwise, product

import numpy as np
from numpy.typing import NDArray

from scancell.arrays import Array
from scancell.cell.program import BeltRun, Program, Segment, TriggerRule
from scancell.config.description import si_value
from scancell.errors import PlanningError
from scancell.nominal.cell import OCCUPIED, NominalCell
from scancell.planning.model import CONFIGURATION, PlanningCell, WorkLimitError, describe
from scancell.planning.motion import trajectory
from scancell.planning.motion.connection import Connector, Stand, Stands
from scancell.planning.motion.trajectory import axis_name, slowdown
from scancell.planning.options import ScanOptions
from scancell.planning.path_map.path_planner import PlacedPath
from scancell.planning.plan import Plan
from scancell.planning.views.placement import Placed, PlacedPass, PlacedPose, PlacedSweep, sweep_run, turned
from scancell.proximity.judge import Judge
from scancell.proximity.scene import Clash, arm_chain

Parts = tuple[Program, NDArray[np.int64], Array]
_Before = tuple[Array, Stand, int, int]  # set-point, stand, numbers of segments and exposures

_SAME_PLACE = 1e-6  # rad
_BLOCK = 1024  # poses that python-fcl checks between two looks at the work


def approach(cell: PlanningCell, clearance: float, start: Array, goal: Array, purpose: str) -> Program | None:
    """Collision-free motions from `start` to `goal` (axes,), rad, which `purpose` names; None where both are the same.

    Raises `PlanningError` if none is found, naming the bodies that collide on the direct way.
    """
    motions = Connector(cell, clearance).connect(start, goal, purpose)
    segments = (
        Segment(
            number,
            _times(points, cell),
            points,
            name=f"to {purpose}",
            further=np.tile(cell.nominal.held_at, (len(points), 1)),
        )
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
        Nominal cell; the program starts and ends at its home position, with axes beside joints and table where they
        start.
    options
        Scan mode, speeds and clearance.
    stands
        Where these axes may rest; None: at the start alone.
    """

    def __init__(self, cell: PlanningCell, options: ScanOptions, stands: Stands | None = None) -> None:
        self._stands = stands or Stands(cell, options)
        self._scan, self._is_dynamic = options.scan, options.scan.mode == "dynamic"
        self._stand = self._stands.start
        self._at = self._cell.start
        self._segments: list[Segment] = []
        self._exposures: list[tuple[int, Array]] = []
        self._views: list[tuple[Placed, _Before]] = []  # with what there was before each

    @property
    def _cell(self) -> PlanningCell:
        return self._stand.cell

    @property
    def _connector(self) -> Connector:
        return self._stand.connector

    def add_view(self, placed: Placed, count: int) -> None:
        """Append a sweep with `count` exposures, or a pass.

        Raises `PlanningError` if no collision-free path to it is found; then nothing is appended.
        """
        before = (self._at, self._stand, len(self._segments), len(self._exposures))
        try:
            self._move_to(placed.further, placed.view.name)
            if isinstance(placed, PlacedSweep):
                self.add_sweep(placed, count)
            else:
                self.add_motion(placed)
        except PlanningError:
            self._return_to(before)
            raise
        self._views.append((placed, before))

    def go_home(self) -> list[tuple[Placed, str]]:
        """Append the motion home of all axes but the table; returns views without one, taken out, with the reason.

        Raises `PlanningError` if no view is left from which there is one.
        """
        lost: list[tuple[Placed, str]] = []
        while True:
            try:
                self._go_home()
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

    def _return_to(self, before: _Before) -> None:
        self._at, self._stand, segments, exposures = before
        del self._segments[segments:], self._exposures[exposures:]

    def _go_home(self) -> None:
        self._go(np.append(self._cell.nominal.home, self._at[-1]), "home")
        self._move_to(self._stands.start.positions, "home")

    def _move_to(self, positions: tuple[float, ...], purpose: str) -> None:
        """Append the motions to another stand: home, then the axes, with the table as it is or where it starts.

        Raises `PlanningError` if there is no free motion, naming the bodies that collide on the direct one.
        """
        if not positions or positions == self._stand.positions:
            return
        home, motions = self._cell.nominal.home, self._stands.motions
        started = self._cell.table_start
        started += 2 * np.pi * np.round((self._at[-1] - started) / (2 * np.pi))
        clash: Clash | None = None
        for table in (self._at[-1], started):
            self._go(np.append(home, table), purpose)
            at = self._stands.along(self._at, self._stand.positions)
            way = motions.path(at, self._stands.along(at, positions))
            if not isinstance(way, Clash):
                for start, end in pairwise(way):
                    self._append(motions.move(start, end), TriggerRule(), 0.0, 0.0, f"to {purpose}")
                return
            clash = clash or way
        assert clash is not None
        where = self._stands.in_words(positions)
        raise PlanningError(f"no collision-free motion of the axes to {purpose} ({where}): {describe(clash)}")

    def add_sweep(self, placed: PlacedSweep, count: int) -> None:
        """Append a full turn of the part with `count` exposures, the first at table angle 0 (modulo 2 pi).

        Raises `PlanningError` if a joint that turns the part leaves its limits where it starts or stops.
        """
        step, first = 2 * np.pi / count, placed.start + self._nearest_turns(placed.start)
        points = turned(first, placed.axis, step * np.arange(count, dtype=np.float64))
        if not self._is_dynamic:
            self._expose_at_rest(points, placed.view.name, are_free=True)
            return
        run = sweep_run(self._cell, count, si_value(self._scan.sweep, "speed_deg_s"))
        # Relative to a part that the last joint turns, the sensor draws a circle about the axis of the flange.
        rule = TriggerRule("table_angle", step)
        if not placed.is_of_table:
            rule = TriggerRule("path_distance", step * placed.view.lever)
            run = self._of_joint(run, first, placed)
        travel = run.at(trajectory.cycle_times(run.duration, self._cell.cycle))
        self._run(turned(first, placed.axis, travel), run, rule, points, placed.view.name)

    def _of_joint(self, run: trajectory.Run, start: Array, placed: PlacedSweep) -> trajectory.Run:
        """The run of a joint that turns the part from `start` (axes,), as slow as the limits require."""
        cell, axis, name = self._stand.cell, placed.axis, placed.view.name
        ends = start[axis] + run.at(np.array([0.0, run.duration]))
        lower, upper = (limit[axis] for limit in cell.nominal.arm.limits)
        if ends.min() < lower or ends.max() > upper:
            raise PlanningError(
                f"{name}: {axis_name(cell, axis)} leaves its limits where its full turn starts or stops"
            )
        needed = slowdown(cell, lambda time: turned(start, axis, run.at(time)), run.duration)
        if isinstance(needed, str):
            raise PlanningError(f"{name}: {needed}")
        return run.slowed(needed.factor)

    def add_motion(self, placed: PlacedPass | PlacedPath) -> None:
        """Append a motion of the sensor: at constant speed in dynamic mode, exposure by exposure otherwise."""
        moved, width = len(self._at), placed.axes.shape[1]
        first = placed.axes[0] if self._is_dynamic else placed.exposures[0]
        self._move_to(tuple(first[moved:].tolist()) or placed.further, placed.view.name)
        turns = np.append(self._turns(placed.axes[0, :moved]), np.zeros(width - moved))
        points, view = placed.exposures + turns, placed.view
        if not self._is_dynamic:
            if width > moved:
                self._expose_along(points, view.name)
            else:
                self._expose_at_rest(points, view.name)
            return
        rule = TriggerRule("path_distance", view.length / (len(points) - 1))
        self._run(placed.axes + turns, placed.run, rule, points, view.name)

    def add_pose(self, placed: PlacedPose) -> None:
        """Append one exposure at rest."""
        self._move_to(placed.further, placed.name)
        self._expose_at_rest((placed.axes + self._turns(placed.axes))[None], placed.name)

    def add_belt(self, placed: PlacedPose, run: BeltRun, pitch: float, count: int) -> None:
        """Append the motion to the pose of the sensor, where it rests while the belt runs, with `count` exposures."""
        goal, name = placed.axes, placed.name
        self._move_to(placed.further, name)
        *before, last = self._connector.connect(self._at, goal, name) or [self._connector.move(self._at, goal)]
        for setpoints in before:
            self._append(setpoints, TriggerRule(), 0.0, 0.0, f"to {name}")
        number = self._append(last, TriggerRule("belt_travel", pitch), 0.0, 0.0, name, run)
        self._expose(number, np.tile(goal, (count, 1)))

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
            (m, axes) joints, table angle and further axes of each exposure, rad or m.
        """
        self._go_home()
        is_moving = all(segment.trigger.kind != "request" for segment in self._segments)
        program = Program(tuple(self._segments), 0.0 if is_moving else si_value(self._scan, "settle_ms"))
        ids = np.array([number for number, _ in self._exposures], np.int64)
        return program, ids, np.concatenate([points for _, points in self._exposures])

    def time_to(self, start: Array, further: tuple[float, ...] = ()) -> float:
        """Time (s) of the direct motion from the present set-point to joints and a table angle (axes,), rad.

        Where `further` axes rest at others, by way of home.
        """
        goal = start + self._nearest_turns(start)
        if not further or further == self._stand.positions:
            return len(self._connector.move(self._at, goal)) * self._cell.cycle
        home = np.append(self._cell.nominal.home, self._at[-1])
        at = self._stands.along(home, self._stand.positions)
        moves = len(self._connector.move(self._at, home)) + len(self._connector.move(home, goal))
        return moves * self._cell.cycle + self._stands.motions.time(at, self._stands.along(at, further))

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
        self._go(setpoints[0, : len(self._at)], name)
        number = self._append(setpoints, rule, run.trigger_from, run.trigger_to, name)
        self._expose(number, points)

    def _expose_along(self, points: Array, name: str) -> None:
        """Append exposures at rest at points (m, axes) between which axes beside joints and table move, too."""
        self._go(points[0, : len(self._at)], name)
        self._stands.motions.require_free(points, name)
        for start, end in pairwise([points[0], *points]):
            number = self._append(self._stands.motions.move(start, end), TriggerRule("request"), 0.0, 0.0, name)
            self._expose(number, end[None])

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
            self._expose(number, point[None])

    def _approaching(self, name: str) -> None:
        self._cell.work.doing = f"finding the motion to {name}; {len(self._segments)} segments were made"

    def _append(
        self, setpoints: Array, rule: TriggerRule, start: float, end: float, name: str, belt: BeltRun | None = None
    ) -> int:
        number, moved = len(self._segments) + 1, len(self._at)
        axes, further = setpoints[:, :moved], setpoints[:, moved:]
        times = _times(setpoints, self._cell)
        if further.size:
            self._stand = self._stands.at(tuple(further[-1].tolist()))
        else:
            further = np.tile(self._stand.positions, (len(axes), 1))
        self._segments.append(Segment(number, times, axes, rule, start, end, name, belt, further))
        self._at = axes[-1]
        return number

    def _expose(self, number: int, points: Array) -> None:
        """Note exposures of a segment at points (m, axes), of which the further axes may be left out."""
        rest = self._stand.positions[points.shape[1] - len(self._at) :]
        self._exposures += [(number, np.append(point, rest)[None]) for point in points]


def check_part(cell: PlanningCell) -> None:
    """Check that the part lies on the table (if it is to be there) and that nothing collides at the home position.

    Raises
    ------
    PlanningError
        Otherwise, with the distance by which the part protrudes or the bodies that collide.
    """
    if cell.nominal.support == "table":
        _check_on_table(cell)
    hit = cell.contacts(cell.start[None])
    if hit:
        raise PlanningError(f"at the home position: {describe(hit[0])}")


def _check_on_table(cell: PlanningCell) -> None:
    nominal = cell.nominal
    used = nominal.part.vertices[np.unique(nominal.part.faces)]
    on_table = used @ nominal.table_from_part[:3, :3].T + nominal.table_from_part[:3, 3]
    radius = float(np.hypot(on_table[:, 0], on_table[:, 1]).max())
    if radius > nominal.table_radius + 1e-9:
        raise PlanningError(
            f"too large for the table: it extends to {1e3 * radius:.1f} mm from the axis,"
            f" {1e3 * (radius - nominal.table_radius):.1f} mm beyond cell.table.radius_mm ="
            f" {1e3 * nominal.table_radius:g}; move or turn it with cell.part.x_mm, y_mm, rx_deg, ry_deg, rz_deg",
            file=nominal.part.source,
        )
    if on_table[:, 2].min() < -1e-6:
        raise PlanningError(
            f"its lowest point is {-1e3 * on_table[:, 2].min():.3f} mm below the table's top; raise cell.part.z_mm",
            file=nominal.part.source,
        )


def recheck(cell: PlanningCell, saved: Plan, options: ScanOptions) -> Plan:
    """A saved plan, after it was checked in this cell as a new one is: limits, clearances, python-fcl.

    Raises `PlanningError` if the plan is for another arm or controller, does not start at the home position, does not
    continue, exceeds a limit, or comes too close to something; with the segment.
    """
    check_part(cell)
    nominal, at, stands = cell.nominal, cell.start, Stands(cell, options)
    whole = cell.motion_check(options.clearance)
    table = len(nominal.home)
    lower, upper = _limits(nominal)
    for segment in saved.program.segments:
        where = f"{saved.source}: segment {segment.id} ({segment.name})"
        points = segment.all_axes
        if segment.axes.shape[1] != table + 1:
            raise PlanningError(f"{where}: {segment.axes.shape[1] - 1} joints, the arm has {table}")
        if points.shape[1] != len(at):
            further = f"{points.shape[1] - table - 1} axes beside joints and table, the cell has"
            raise PlanningError(f"{where}: {further} {len(nominal.further_axes)}")
        if np.abs(np.diff(segment.times, prepend=-cell.cycle) - cell.cycle).max() > 1e-9:
            raise PlanningError(
                f"{where}", expected=f"a set-point every {1e3 * cell.cycle:g} ms from 0, the controller's cycle"
            )
        gap = float(np.abs(points[0] - at).max())
        if gap > _SAME_PLACE:
            number = int(np.abs(points[0] - at).argmax())
            slides = number > table and nominal.further_axes[number - table - 1].joint.kind == "prismatic"
            off = f"{1e3 * gap:.3f} mm" if slides else f"{np.degrees(gap):.3f} deg"
            of_axis = f" ({axis_name(cell, number)})" if number > table else ""
            raise PlanningError(f"{where}: starts {off} from where the motion before it ends{of_axis}")
        outside = ((points < lower - _SAME_PLACE) | (points > upper + _SAME_PLACE)).any(0)
        if outside.any():
            number = int(outside.argmax())
            limits = f"limits of {axis_name(cell, number)}" if number > table else "joint limits"
            raise PlanningError(f"{where}: leaves the {limits}")
        resting = np.concatenate([*3 * [points[:1]], points, *3 * [points[-1:]]])
        used = trajectory.limit_fractions(resting, cell.axis_limits, cell.cycle)
        if used.max() > 1 + 1e-6:
            axis = axis_name(cell, int(np.argmax(used.max(0))))
            raise PlanningError(f"{where}: {axis} exceeds a limit by {100 * (used.max() - 1):.1f} %")
        rests = bool(segment.further.size) and not np.ptp(segment.further, axis=0).any()
        if rests:
            held = stands.at(tuple(segment.further[0].tolist())).cell.motion_check(options.clearance)
            clash = held.clash_along(segment.axes)
        else:
            clash = whole.clash_along(points)
        if clash is not None:
            raise PlanningError(f"{where}: {describe(clash)}")
        at = points[-1]
    return verified(cell, options, saved)


def _limits(nominal: NominalCell) -> tuple[Array, Array]:
    """Lower and upper limits (axes,) of all axes, rad or m; those of the table are infinite."""
    further = np.array([(axis.min, axis.max) for axis in nominal.further_axes]).reshape(-1, 2)
    joints = np.transpose(nominal.arm.limits)
    limits = np.concatenate([joints, [[-np.inf, np.inf]], further])
    return limits[:, 0], limits[:, 1]


def verified(cell: PlanningCell, options: ScanOptions, made: Plan) -> Plan:
    """The plan, after python-fcl found no collision at every second set-point.

    Raises
    ------
    PlanningError
        Otherwise: a defect of scancell, whose own distances proved the motion free.
    """
    if not options.scan.verify:
        return made
    segments = made.program.segments
    poses = cell.nominal.body_poses(np.concatenate([segment.all_axes[::2] for segment in segments]))
    cell.work.doing = "checking the finished plan by python-fcl"
    names = [body.name for body in cell.nominal.bodies]
    # Voxels of a body that is known are not an obstacle to this body: occupied space is compared with the arm alone.
    measured, others = [name for name in names if name.startswith(OCCUPIED)], set(names) - set(arm_chain(cell.nominal))
    around = [frozenset(pair) for pair in product(measured, others)]
    start = cell.nominal.body_poses(cell.start)
    judge = Judge(cell.judged_meshes, names, start, around)
    for first in range(0, len(poses), _BLOCK):
        block = poses[first : first + _BLOCK]
        cell.work.spend(CONFIGURATION * len(block))
        clash = judge.first_collision(block)
        if clash is not None:
            break
    else:
        return made
    starts = np.cumsum([0, *(len(segment.times[::2]) for segment in segments)])
    number = int(np.searchsorted(starts, first + clash.index, side="right")) - 1
    segment, at = segments[number], 2 * int(first + clash.index - starts[number])
    place = f"segment {segment.id} ({segment.name}), {segment.times[at]:.3f} s after its start"
    raise PlanningError(f"python-fcl finds that {clash.body_a} hits {clash.body_b} in {place}")
