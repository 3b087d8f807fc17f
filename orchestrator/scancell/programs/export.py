"""Planned scans as programs of a controller: V+ and URScript (docs/programs.md)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Literal

import numpy as np

from scancell.arguments import checked_arguments
from scancell.arrays import Array
from scancell.cell.program import Segment
from scancell.config.description import si_value
from scancell.config.sensor import exposure_span
from scancell.errors import DescriptionError
from scancell.geometry import pose
from scancell.geometry.mesh import Mesh
from scancell.nominal.cell import flange_from_tool, tool_names
from scancell.planning.model import MOTION_SHARE
from scancell.planning.options import scan_options
from scancell.planning.plan import Plan
from scancell.planning.views.placement import LIMIT_FRACTION
from scancell.programs.robot import deg, mm
from scancell.programs.script import Output
from scancell.programs.urscript import INTERVAL, TABLE_ANGLE, TABLE_SPEED, pose_vector
from scancell.programs.vplus import euler_numbers
from scancell.progress import NullProgress
from scancell.proximity.motion_check import MotionCheck
from scancell.scanner import Scanner
from scancell.scanning.scan import Scan
from scancell.scanning.world import World

Language = Literal["urscript", "v2"]

_STRAIGHT = 1e-6  # rad, m: largest deviation of set-points from a straight motion
_MOST_STEPS = 64  # of arm and table in turn
_RADII = (0.05, 0.02, 0.01, 0.005)  # m, of zones in which corners may be rounded
_ZONE_PARTS = 16  # of a zone, for its proof
_LEG_POINTS = 200
_MOST_DISTANCE = 0.1  # m, up to which distances are stated


@dataclass(frozen=True)
class JointMove:
    """All axes together to `axes` (n,), rad, with a share of full speed; rounded within `radius`, m."""

    axes: Array
    share: float
    radius: float = 0.0


@dataclass(frozen=True)
class LineMove:
    """The tool straight to a pose (4, 4) in the frame of the robot's base, with a speed, m/s, to `axes` (n,), rad."""

    base_from_tool: Array
    speed: float
    axes: Array


@dataclass(frozen=True)
class Switch:
    """A digital output, see `Output`."""

    output: int
    on: bool


@dataclass(frozen=True)
class Interval:
    """Interval of exposures, m, or rad of the table."""

    value: float
    unit: Literal["m", "rad"]


@dataclass(frozen=True)
class Expose:
    """One exposure at rest, after `settle` s."""

    settle: float


@dataclass(frozen=True)
class Remark:
    """A comment."""

    text: str


Action = JointMove | LineMove | Switch | Interval | Expose | Remark


@checked_arguments
def export_program(
    plan: Plan | str | Path, scanner: Scanner, part: str | Path | Mesh, language: Language, *, unit: str = "mm"
) -> str:
    """A planned scan as the text of a program of a controller.

    The plan is checked again first. Every move ends at rest, except where URScript rounds a corner in a zone in which
    all motions are proved free.

    Parameters
    ----------
    plan
        A plan or its file.
    scanner
        With the cell of the plan.
    part
        The part of the plan, see `Scanner.scan`; `unit` is that of its file.
    language
        ``v2`` for V+, ``urscript``.

    Raises
    ------
    DescriptionError
        If the plan has motions that the language cannot state, with the segment.
    PlanningError
        If the plan is not feasible in this cell.

    Examples
    --------
    >>> with scancell.Scanner() as scanner:
    ...     text = scancell.export_program(scanner.plan("part.stl"), scanner, "part.stl", "v2")
    >>> ".PROGRAM scan()" in text
    True
    """
    saved = Plan.load(plan) if isinstance(plan, str | Path) else plan
    pipeline, file = scanner.pipeline, Path(part) if isinstance(part, str | Path) else None
    world = pipeline.load(scanner.setup, scanner.load_part(part, unit), part_file=file, unit=unit)
    checked = Scan(pipeline, world, "geometric").plan(NullProgress(), saved)
    exporter = _Exporter(world, checked, pipeline.motion_check(world))
    least = pipeline.clearance(world, checked, _MOST_DISTANCE)
    return exporter.vplus(least) if language == "v2" else exporter.urscript(least)


class _Exporter:
    """Turns the segments of a plan into the actions of a program, and these into text."""

    def __init__(self, world: World, plan: Plan, motions: MotionCheck) -> None:
        self._world, self._plan, self._motions = world, plan, motions
        self._nominal = nominal = world.nominal
        self._joints = len(nominal.home)
        self._limits = nominal.axis_max_speed[: self._joints + 1]
        self._accelerations = nominal.axis_max_acceleration[: self._joints + 1]
        self._tool = flange_from_tool(nominal, tool_names(nominal)[0])

    # Actions

    def _actions(self) -> Iterator[Action]:
        program = self._plan.program
        yield JointMove(program.start, LIMIT_FRACTION)
        for segment in program.segments:
            yield Remark(f"{segment.id}: {segment.name}")
            if segment.further.size and np.ptp(segment.further, axis=0).any():
                raise self._error(segment, "moves axes beside joints and table", "a plan without [[axis]]")
            match segment.trigger.kind:
                case "off" | "request":
                    self._require_straight(segment, segment.axes)
                    yield JointMove(segment.axes[-1], LIMIT_FRACTION)
                    if segment.trigger.kind == "request":
                        yield Expose(program.settle)
                case "table_angle":
                    yield from self._sweep(segment)
                case "path_distance":
                    yield from self._pass(segment)
                case kind:
                    raise self._error(segment, f"triggers by {kind}", "table_angle, path_distance or exposures at rest")

    def _sweep(self, segment: Segment) -> Iterator[Action]:
        self._require_straight(segment, segment.axes)
        if np.ptp(segment.axes[:, :-1], axis=0).any():
            raise self._along_curve(segment)
        speed = float(np.abs(np.diff(segment.axes[:, -1]) / np.diff(segment.times)).max())
        share = min(speed / float(self._limits[-1]), 1.0)
        first, last = self._trigger_window(segment)
        yield JointMove(first, share)
        yield Interval(segment.trigger.interval, "rad")
        yield Switch(Output.BY_TABLE, True)
        yield JointMove(last, share)
        yield Switch(Output.BY_TABLE, False)
        yield JointMove(segment.axes[-1], share)

    def _pass(self, segment: Segment) -> Iterator[Action]:
        poses = self._base_from_tool(segment.all_axes)
        if np.ptp(segment.axes[:, -1]) or not self._nominal.carries_sensor or not _is_straight(poses):
            raise self._along_curve(segment)
        speed = float((np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1) / np.diff(segment.times)).max())
        rest = segment.all_axes[0, self._joints + 1 :]
        points = [*self._trigger_window(segment), segment.axes[-1]]
        first, last, end = (LineMove(self._base_from_tool(np.append(one, rest)), speed, one) for one in points)
        yield first
        yield Interval(segment.trigger.interval, "m")
        yield Switch(Output.BY_PATH, True)
        yield last
        yield Switch(Output.BY_PATH, False)
        yield end

    def _trigger_window(self, segment: Segment) -> list[Array]:
        """Axes (joints + 1,) where triggers are enabled and disabled."""
        times = [segment.trigger_from, segment.trigger_to]
        return list(np.transpose([np.interp(times, segment.times, column) for column in segment.axes.T]))

    def _base_from_tool(self, axes: Array) -> Array:
        """Poses (..., 4, 4) of the tool in the frame of the robot's base at positions (..., axes)."""
        base, flange = (self._nominal.world_from(frame, axes) for frame in ("base", self._nominal.arm.flange))
        return np.asarray(pose.inverse(base) @ flange @ self._tool)

    def _require_straight(self, segment: Segment, axes: Array) -> None:
        way = axes[-1] - axes[0]
        share = (axes - axes[0]) @ way / max(float(way @ way), 1e-12)
        if np.abs(axes - axes[0] - share[:, None] * way).max() > _STRAIGHT:
            raise self._along_curve(segment)

    def _along_curve(self, segment: Segment) -> DescriptionError:
        expected = 'exposures at rest (plan with --set scan.mode="stop-and-look")'
        return self._error(
            segment, "exposures along a motion that is no straight line of the sensor or table", expected
        )

    def _error(self, segment: Segment, what: str, expected: str) -> DescriptionError:
        where = f"segment {segment.id} ({segment.name}): {what}"
        return DescriptionError(where, file=self._plan.source or None, expected=expected)

    # Proofs of what a controller does otherwise than the plan

    def _arm_and_table_in_turn(self, actions: Sequence[Action]) -> Iterator[Action]:
        """Joint moves in which either the arm or the table moves, proved free, in place of those of both."""
        at = self._plan.program.start
        for action in actions:
            if isinstance(action, JointMove):
                yield from (replace(action, axes=axes) for axes in self._in_turn(at, action.axes))
            else:
                yield action
            at = action.axes if isinstance(action, JointMove | LineMove) else at

    def _in_turn(self, start: Array, end: Array) -> list[Array]:
        moves = np.abs(end - start) > 0
        if not (moves[:-1].any() and moves[-1]):
            return [end]
        steps = 1
        while steps <= _MOST_STEPS:
            shares = np.linspace(0.0, 1.0, steps + 1)[:, None]
            on_way = start + shares * (end - start)
            for table_leads in (True, False):
                arm, table = (on_way[:-1], on_way[1:]) if table_leads else (on_way[1:], on_way[:-1])
                between = np.column_stack([arm[:, :-1], table[:, -1]])
                points = np.vstack([start, np.stack([between, on_way[1:]], 1).reshape(-1, len(start))])
                if all(clash is None for clash in self._motions.first_clashes(points[:-1], points[1:])):
                    return list(points[1:])
            steps *= 2
        raise DescriptionError("arm and table cannot be moved in turn with the clearances of the plan")

    def _rounded(self, actions: Sequence[Action]) -> Iterator[Action]:
        """Moves of the arm that follow each other, with the largest zone in which all rounded corners are proved."""
        listed = [action for action in actions if not isinstance(action, Remark)]
        at, radii = self._plan.program.start, dict[int, float]()
        for action, following in pairwise([*listed, Remark("")]):
            if isinstance(action, JointMove) and isinstance(following, JointMove):
                radii[id(action)] = self._radius(at, action.axes, following.axes)
            at = action.axes if isinstance(action, JointMove | LineMove) else at
        for action in actions:
            radius = radii.get(id(action), 0.0)
            yield replace(action, radius=radius) if isinstance(action, JointMove) else action

    def _radius(self, before: Array, corner: Array, after: Array) -> float:
        """Largest zone, m, about a corner where every motion within the triangle of both legs is proved free; or 0.

        The triangle of joint space is covered by chords, each with the deviation that reaches its neighbours.
        """
        if before[-1] != corner[-1] or after[-1] != corner[-1]:
            return 0.0
        shares = (np.arange(_ZONE_PARTS) + 0.5)[:, None] / _ZONE_PARTS
        for radius in _RADII:
            ends = [self._at_radius(corner, leg, radius) for leg in (before, after)]
            if any(end is None for end in ends):
                continue
            sides = np.array(ends) - corner
            slack = np.abs(sides).max(0) / (2 * _ZONE_PARTS)
            found = self._motions.first_clashes(corner + shares * sides[0], corner + shares * sides[1], slack)
            if all(clash is None for clash in found):
                return radius
        return 0.0

    def _at_radius(self, corner: Array, end: Array, radius: float) -> Array | None:
        """Point of a leg from the corner where the tool is `radius` away, in its first half; None without one."""
        points = corner + np.linspace(0.0, 0.5, _LEG_POINTS)[:, None] * (end - corner)
        tool = self._base_from_tool(np.column_stack([points, np.tile(self._plan.program.further, (_LEG_POINTS, 1))]))
        far = np.flatnonzero(np.linalg.norm(tool[:, :3, 3] - tool[0, :3, 3], axis=1) >= radius)
        return points[far[0]] if len(far) else None

    # Text

    def _header(self, least: float, units: str, signals: Sequence[str]) -> list[str]:
        import scancell  # noqa: PLC0415  (the version alone)

        world, setup = self._world, self._world.setup
        clearance = scan_options(setup.scan, setup.sensor).clearance / mm
        distance = f"{least / mm:.1f} mm" if least < _MOST_DISTANCE else f"more than {_MOST_DISTANCE / mm:.0f} mm"
        return [
            f"Scan of {world.part} by {setup.cell.robot.name} in the cell {setup.cell.name}: {len(self._plan.axes)}"
            " exposures.",
            f"Written by scancell {scancell.__version__}. It was NOT run on a controller of the maker: run it first",
            "step by step at the lowest speed, in manual operation.",
            "Proved in the described cell: joint limits; every motion, straight in joint space or of the tool, keeps",
            f"{100 * MOTION_SHARE:.0f} % of the clearances between all bodies (scan.clearance_mm = {clearance:g}; 2 mm"
            " between links of the arm);",
            f"least distance at the set-points: {distance}. Not proved: the way to the first point, the home position;",
            "corners that are rounded without a stated zone; a cell, tool or part unlike its description.",
            f"Frame: base of the robot as described. Tool: the sensor, Z along the laser. {units}",
            "Joints are counted and signed as in the description of the arm.",
            *signals,
        ]

    def vplus(self, least: float) -> str:
        """The program in V+."""
        signals = [
            f"The axis after joint {self._joints} is the table. Signals: {Output.EXPOSE} one exposure;"
            f" {Output.BY_PATH} exposures every trigger.interval mm of the",
            f"tool's path, {Output.BY_TABLE} every trigger.interval degrees of the table, both by encoders.",
        ]
        head = self._header(least, "Units: mm, degrees; yaw, pitch, roll.", signals)
        lines = [*(f"; {line}" for line in head), ".PROGRAM scan()"]
        if self._nominal.carries_sensor:
            lines.append(f"  TOOL TRANS({_numbers(euler_numbers(self._tool), 4)})")
        lines.append(f"  SIGNAL -{Output.EXPOSE}, -{Output.BY_PATH}, -{Output.BY_TABLE}")
        speed = ""
        for action in self._actions():
            wanted = speed
            match action:
                case JointMove(axes, share):
                    wanted = f"  SPEED {_number(100 * share, 3)} ALWAYS"
                    text = [f"  MOVE #PPOINT({_numbers(axes / deg, 4)})", "  BREAK"]
                case LineMove(at, of_tool, _):
                    wanted = f"  SPEED {_number(of_tool / mm, 3)} MMPS ALWAYS"
                    text = [f"  MOVES TRANS({_numbers(euler_numbers(at), 4)})", "  BREAK"]
                case Switch(output, on):
                    text = [f"  SIGNAL {output if on else -output}"]
                case Interval(value, unit):
                    text = [f"  trigger.interval = {_number(value / (mm if unit == 'm' else deg), 6)}"]
                case Expose(settle):
                    text = [f"  WAIT.EVENT , {_number(settle, 3)}"] if settle else []
                    text.append("  CALL expose()")
                case Remark(remark):
                    text = [f"  ; {remark}"]
            lines += [*([wanted] if wanted != speed else []), *text]
            speed = wanted
        pulse = f"  WAIT.EVENT , {_number(self._pulse, 3)}"
        expose = [".PROGRAM expose()", f"  SIGNAL {Output.EXPOSE}", pulse, f"  SIGNAL -{Output.EXPOSE}", ".END"]
        return "\n".join([*lines, ".END", *expose]) + "\n"

    @property
    def _pulse(self) -> float:
        """Duration of the signal of an exposure, s."""
        return max(exposure_span(self._world.setup.sensor), self._world.setup.cell.world.controller_cycle)

    def urscript(self, least: float) -> str:
        """The program in URScript."""
        if self._joints != 6:
            raise DescriptionError(f"the arm has {self._joints} joints", expected="6 for URScript")
        signals = [
            f"Digital outputs: {Output.EXPOSE - 1} one exposure; {Output.BY_PATH - 1} exposures by the tool's path,"
            f" {Output.BY_TABLE - 1} by the table, both by encoders, every",
            f"float register {INTERVAL} (m or rad). The table is another controller's axis: float registers"
            f" {TABLE_ANGLE} (angle, rad) and",
            f"{TABLE_SPEED} (rad/s), start by output {Output.TURN_TABLE - 1}, arrival by input 0.",
            "r: zone in which every path within the triangle of both legs in joint space is proved free.",
        ]
        head = self._header(least, "Units: m, rad; rotation vectors.", signals)
        lines = [*(f"# {line}" for line in head), *_UR_HEAD.format(pulse=_number(self._pulse, 3)).splitlines()]
        if self._nominal.carries_sensor:
            lines.append(f"  set_tcp(p[{_numbers(pose_vector(self._tool), 6)}])")
        start: Array | None = None
        acceleration = _number(
            LIMIT_FRACTION * si_value(self._world.setup.cell.robot.motion, "line_acceleration_mm_s2"), 4
        )
        for action in self._rounded(list(self._arm_and_table_in_turn(list(self._actions())))):
            match action:
                case JointMove(axes):
                    lines += self._ur_move(start, action)
                    start = axes
                case LineMove(at, speed, axes):
                    lines.append(f"  movel(p[{_numbers(pose_vector(at), 6)}], a={acceleration}, v={_number(speed, 6)})")
                    start = axes
                case Switch(output, on):
                    lines.append(f"  set_standard_digital_out({output - 1}, {on})")
                case Interval(value):
                    lines.append(f"  write_output_float_register({INTERVAL}, {_number(value, 9)})")
                case Expose(settle):
                    lines += [f"  sleep({_number(settle, 3)})"] if settle else []
                    lines.append("  expose()")
                case Remark(remark):
                    lines.append(f"  # {remark}")
        return "\n".join([*lines, "end"]) + "\n"

    def _ur_move(self, start: Array | None, move: JointMove) -> list[str]:
        """Lines of a move from `start` (axes,), or from anywhere: of the table, then of the arm."""
        travel, share, lines = np.ones(len(move.axes)) if start is None else np.abs(move.axes - start), move.share, []
        if travel[-1] > 0:
            lines.append(f"  table_to({_number(move.axes[-1], 6)}, {_number(share * self._limits[-1], 6)})")
        if travel[:-1].any():
            arm = travel[:-1]
            speed, acceleration = (
                share * arm.max() / float((arm / limits[:-1]).max()) for limits in (self._limits, self._accelerations)
            )
            zone = f", r={_number(move.radius, 3)}" if move.radius else ""
            joints = _numbers(move.axes[:-1], 6)
            lines.append(f"  movej([{joints}], a={_number(acceleration, 4)}, v={_number(speed, 6)}{zone})")
        return lines


_UR_HEAD = f"""\
def scan():
  def table_to(angle, speed):
    write_output_float_register({TABLE_ANGLE}, angle)
    write_output_float_register({TABLE_SPEED}, speed)
    set_standard_digital_out({Output.TURN_TABLE - 1}, True)
    while not get_standard_digital_in(0):
      sync()
    end
    set_standard_digital_out({Output.TURN_TABLE - 1}, False)
    while get_standard_digital_in(0):
      sync()
    end
  end
  def expose():
    set_standard_digital_out({Output.EXPOSE - 1}, True)
    sleep({{pulse}})
    set_standard_digital_out({Output.EXPOSE - 1}, False)
  end
  set_standard_digital_out({Output.EXPOSE - 1}, False)
  set_standard_digital_out({Output.BY_PATH - 1}, False)
  set_standard_digital_out({Output.BY_TABLE - 1}, False)
  set_standard_digital_out({Output.TURN_TABLE - 1}, False)"""


def _is_straight(poses: Array) -> bool:
    """Whether poses (n, 4, 4) lie on a straight line on which the tool turns evenly with its way."""
    way = poses[-1, :3, 3] - poses[0, :3, 3]
    share = (poses[:, :3, 3] - poses[0, :3, 3]) @ way / max(float(way @ way), 1e-12)
    straight = pose.interpolate_straight(poses[0], poses[-1], share)
    return bool(np.abs(poses - straight).max() < _STRAIGHT)


def _number(value: float, digits: int) -> str:
    text = f"{value:.{digits}f}".rstrip("0").rstrip(".")
    return "0" if text in ("-0", "") else text


def _numbers(values: Array, digits: int) -> str:
    return ", ".join(_number(float(value), digits) for value in values)
