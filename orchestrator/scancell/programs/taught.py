"""Robot programs as data: named points, and steps that an operator adds, edits and reorders."""

from __future__ import annotations

import ast
import keyword
import math
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from itertools import count
from pathlib import Path
from threading import RLock
from typing import Literal

from scancell.arguments import Within
from scancell.arrays import Array
from scancell.cell.driver import Tool
from scancell.config.devices import NAME_PATTERN
from scancell.errors import DescriptionError, OutputError, ScancellError
from scancell.files import atomic_write, first_free, read_text
from scancell.geometry import pose
from scancell.programs.robot import deg, mm

CommandName = Literal[
    "move_joints", "move_line", "scan_line", "turn_table", "move_axis", "open_gripper", "close_gripper", "wait"
]

MAX_STEPS = 1000
RESERVED = frozenset({"Robot", "deg", "location", "mm", "main", "robot"})  # names in the text of a program
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,39}")
_SPEED = Within(0.001, 1.0)  # the text has three digits
_COORDINATES = Within(-100.0, 100.0)  # m and rad
_SAME_ANGLE = math.radians(0.01)  # of the table; beyond the noise of its encoder
_SAME_POSITION = 1e-4  # rad and m, of an axis beyond the table
_AXIS_NAME = re.compile(r"[a-z][a-z0-9_]*")

MAX_BYTES = 1_000_000

_UNITS = {"mm": mm, "deg": deg}
_DIGITS = {"mm": 3, "deg": 4}  # 1 um, and 1 um at a distance of 0.5 m
_HEAD = '''"""Robot program taught in the workspace of scancell, which reads such literal commands again."""

from scancell import Robot, deg, location, mm
'''
_MAIN = "def main(robot: Robot) -> None:"
_EXPECTED = "a command as the workspace writes it, with literal numbers"


@dataclass(frozen=True)
class JointPoint:
    """Joint angles (joints,), rad."""

    joints: tuple[float, ...]


@dataclass(frozen=True)
class PosePoint:
    """Pose of a tool in the world: position (3,), m, and XYZ' Euler angles (3,), rad."""

    position: tuple[float, ...]
    angles: tuple[float, ...]

    @classmethod
    def of(cls, world_from_tool: Array) -> PosePoint:
        """The point of a pose (4, 4)."""
        angles = pose.euler_xyz_from_rotation(world_from_tool[:3, :3])
        return cls(tuple(world_from_tool[:3, 3].tolist()), tuple(angles.tolist()))

    @property
    def world_from_tool(self) -> Array:
        """The pose (4, 4)."""
        return pose.from_euler_xyz(self.position, self.angles)


Point = JointPoint | PosePoint


@dataclass(frozen=True)
class Arguments:
    """Arguments of a command of `Robot` in a taught program.

    Attributes
    ----------
    label
        Name of the command in the workspace.
    point
        Type of the point to which it moves; None: it moves to none.
    value
        Name of its number; empty if it has none.
    bounds
        Smallest and largest value of the number, SI.
    unit
        Unit of the number in texts.
    first_value
        Value in this unit that the workspace offers first; None: the number is measured, not typed.
    moves
        Whether it has a speed.
    of_axis
        Whether it moves an axis that the step names; the unit of its number is that of the step.
    """

    label: str
    point: type[JointPoint] | type[PosePoint] | None = None
    value: str = ""
    bounds: Within = field(default_factory=Within)
    unit: str = ""
    first_value: float | None = None
    moves: bool = False
    of_axis: bool = False

    @property
    def si_per_unit(self) -> float:
        """SI value of one unit of the number."""
        return _UNITS.get(self.unit, 1.0)


COMMANDS: dict[CommandName, Arguments] = {
    "move_joints": Arguments("joints", JointPoint, "table_angle", Within(-1e4, 1e4), "deg", moves=True),
    "move_line": Arguments("line", PosePoint, moves=True),
    "scan_line": Arguments("scan line", PosePoint, "spacing", Within(1e-5, 1.0), "mm", 0.5, moves=True),
    "turn_table": Arguments("table", None, "table_angle", Within(-1e4, 1e4), "deg", moves=True),
    "move_axis": Arguments("axis", None, "position", Within(-1e4, 1e4), moves=True, of_axis=True),
    "open_gripper": Arguments("open gripper", None, "width", Within(0.0, 10.0), "mm", 60.0),
    "close_gripper": Arguments("close gripper", None, "force", Within(0.0, 1e4), "N", 20.0),
    "wait": Arguments("wait", None, "duration", Within(0.0, 3600.0), "s", 1.0),
}


@dataclass(frozen=True)
class TaughtStep:
    """One command of `Robot`.

    Parameters
    ----------
    command
        Its name.
    point
        Name of the point that it moves to.
    value
        Its number, see `COMMANDS`; SI.
    speed
        Share of the full speed, 0.001 to 1; 1 for a command that moves nothing.
    tool
        Tool that a line moves; ``sensor`` for every other command.
    axis, unit
        Name of the axis beyond the table that it moves, and the unit of its position in texts, ``mm`` or ``deg``;
        empty for every other command, and a unit for SI.

    Raises
    ------
    DescriptionError
        If the value or the speed is out of its range, or the command has none, or no axis is named.
    """

    command: CommandName
    point: str = ""
    value: float | None = None
    speed: float = 1.0
    tool: Tool = "sensor"
    axis: str = ""
    unit: str = ""

    @property
    def value_text(self) -> str:
        """Its number with its unit, as programs state it; empty without one."""
        if self.value is None:
            return ""
        arguments = COMMANDS[self.command]
        unit = self.unit if arguments.of_axis else arguments.unit
        return _number(self.value, unit, _DIGITS.get(unit, 6 if arguments.of_axis else 3))

    def __post_init__(self) -> None:
        arguments = COMMANDS[self.command]
        if self.value is not None and not arguments.value:
            raise DescriptionError(f"{self.command} has no number")
        if arguments.value and (self.value is None or not _is_within(self.value, arguments.bounds)):
            expected = f"a finite number{arguments.bounds} (SI unit)"
            raise DescriptionError(key=f"{self.command}: {arguments.value}", value=self.value, expected=expected)
        if arguments.of_axis != bool(_AXIS_NAME.fullmatch(self.axis)) or self.unit not in ("", *_UNITS):
            raise DescriptionError(key=f"{self.command}: axis", value=self.axis, expected="the name of an axis")
        if not arguments.moves and self.speed != 1.0:
            raise DescriptionError(f"{self.command} has no speed")
        if not _is_within(self.speed, _SPEED):
            raise DescriptionError(key="speed", value=self.speed, expected=f"a finite number{_SPEED}")


@dataclass(frozen=True)
class TaughtProgram:
    """Named points, and the steps that use them; every edit returns another program.

    Points that no step uses are dropped. Indices of steps count from 0.

    Raises
    ------
    DescriptionError
        If a name or a number is not valid, a step has no point of its type, or there are more than `MAX_STEPS`.
    """

    points: Mapping[str, Point] = field(default_factory=dict)
    steps: tuple[TaughtStep, ...] = ()

    def __post_init__(self) -> None:
        if len(self.steps) > MAX_STEPS:
            raise DescriptionError(f"{len(self.steps)} steps", expected=f"at most {MAX_STEPS}")
        used = {step.point for step in self.steps if step.point}
        for step in self.steps:
            self._check_point(step)
        object.__setattr__(self, "points", {name: point for name, point in self.points.items() if name in used})

    def _check_point(self, step: TaughtStep) -> None:
        kind, name = COMMANDS[step.command].point, step.point
        if kind is None:
            return
        if not _NAME.fullmatch(name) or keyword.iskeyword(name) or name in RESERVED:
            expected = "a Python name: a letter, then letters, digits and _, at most 40"
            raise DescriptionError(key="name", value=name[:60], expected=expected)
        point = self.points.get(name)
        if not isinstance(point, kind):
            expected = "joint angles" if kind is JointPoint else "a location"
            raise DescriptionError(f"{step.command}: the point {name} is not there or no {expected}")
        numbers = point.joints if isinstance(point, JointPoint) else point.position + point.angles
        if point == JointPoint(()) or not all(_is_within(number, _COORDINATES) for number in numbers):
            raise DescriptionError(key=name, value=point, expected=f"finite numbers{_COORDINATES}, m and rad")

    def step(self, index: int) -> TaughtStep:
        """Step number `index`.

        Raises
        ------
        DescriptionError
            If there is none.
        """
        if not 0 <= index < len(self.steps):
            raise DescriptionError(f"there is no step {index + 1}", expected=f"1 to {len(self.steps)}")
        return self.steps[index]

    def free_name(self) -> str:
        """The first of p1, p2, ... that no point has."""
        return next(name for number in count(1) if (name := f"p{number}") not in self.points)

    def table_angle_before(self, index: int) -> float | None:
        """Angle to which the steps before step `index` turn the table, rad; None: none of them does."""
        angles = [step.value for step in self.steps[:index] if COMMANDS[step.command].value == "table_angle"]
        return angles[-1] if angles else None

    def with_step(self, index: int, step: TaughtStep, point: Point | None = None) -> TaughtProgram:
        """Insert `step` before step `index`, and define its `point`.

        Raises
        ------
        DescriptionError
            If there is a point of this name.
        """
        if point is None:
            return self._changed((*self.steps[:index], step, *self.steps[index:]))
        if step.point in self.points:
            raise DescriptionError(key="name", value=step.point, expected="a name that no other point has")
        return self._changed((*self.steps[:index], step, *self.steps[index:]), {step.point: point})

    def with_line(self, index: int, step: TaughtStep, point: Point, table_angle: float) -> TaughtProgram:
        """Insert a line as of `with_step`, and before it a turn of the table unless it is at `table_angle`, rad."""
        before = self.table_angle_before(index)
        if before is not None and abs(before - table_angle) < _SAME_ANGLE:
            return self.with_step(index, step, point)
        turn = TaughtStep("turn_table", value=table_angle, speed=step.speed)
        return self.with_step(index, turn).with_step(index + 1, step, point)

    def axis_position_before(self, index: int, axis: str) -> float | None:
        """Position to which the steps before step `index` move an axis, rad or m; None: none of them does."""
        positions = [step.value for step in self.steps[:index] if step.axis == axis]
        return positions[-1] if positions else None

    def with_axes(self, index: int, moves: Iterable[TaughtStep]) -> TaughtProgram:
        """Insert those moves of axes before step `index` that end elsewhere than the steps before it."""
        program = self
        for move in moves:
            before = self.axis_position_before(index, move.axis)
            if move.value is not None and (before is None or abs(before - move.value) >= _SAME_POSITION):
                program = program.with_step(index + len(program.steps) - len(self.steps), move)
        return program

    def with_copy(self, index: int) -> TaughtProgram:
        """Insert a copy of step `index`, with the same point, after it."""
        return self.with_step(index + 1, self.step(index))

    def without(self, index: int) -> TaughtProgram:
        """Delete step `index`."""
        self.step(index)
        return self._changed(self.steps[:index] + self.steps[index + 1 :])

    def moved(self, index: int, by: int) -> TaughtProgram:
        """Move step `index` by a number of positions, or as far as the list goes."""
        step, steps = self.step(index), list(self.steps)
        del steps[index]
        steps.insert(max(index + by, 0), step)
        return self._changed(tuple(steps))

    def renamed(self, old: str, new: str) -> TaughtProgram:
        """Rename the point `old`, in all steps.

        Raises
        ------
        DescriptionError
            If `new` is not valid, or the name of another point.
        """
        if new != old and new in self.points:
            raise DescriptionError(key="name", value=new, expected="a name that no other point has")
        points = {new if name == old else name: point for name, point in self.points.items()}
        steps = (replace(step, point=new) if step.point == old else step for step in self.steps)
        return TaughtProgram(points, tuple(steps))

    def with_speed(self, index: int, speed: float) -> TaughtProgram:
        """Change the speed of step `index`."""
        return self._replaced(index, replace(self.step(index), speed=speed))

    def with_value(self, index: int, value: float) -> TaughtProgram:
        """Change the number of step `index`; SI."""
        return self._replaced(index, replace(self.step(index), value=value))

    def with_point(self, name: str, point: Point) -> TaughtProgram:
        """Change the point `name`, for all steps."""
        return self._changed(self.steps, {name: point})

    def _replaced(self, index: int, step: TaughtStep) -> TaughtProgram:
        return self._changed((*self.steps[:index], step, *self.steps[index + 1 :]))

    def _changed(self, steps: tuple[TaughtStep, ...], points: Mapping[str, Point] | None = None) -> TaughtProgram:
        return TaughtProgram({**self.points, **(points or {})}, steps)


def _is_within(value: float, bounds: Within) -> bool:
    return math.isfinite(value) and value in bounds


def program_text(program: TaughtProgram) -> str:
    """The file of a robot program; numbers are rounded to 0.001 mm, 0.0001 deg and 0.001 in other units."""
    points = [f"{name} = {_point_text(point)}" for name, point in program.points.items()]
    lines = [_HEAD, *points, *(["", ""] if points else [""]), _MAIN, *(f"    {line}" for line in _body(program))]
    return "\n".join(lines) + "\n"


def _body(program: TaughtProgram) -> Iterable[str]:
    speed, tool = 1.0, "sensor"
    for step in program.steps:
        arguments = COMMANDS[step.command]
        if arguments.moves and step.speed != speed:
            speed = step.speed
            yield f"robot.set_speed({_number(speed, '')})"
        if step.command == "move_line" and step.tool != tool:
            tool = step.tool
            yield f'robot.set_tool("{tool}")'
        yield f"robot.{step.command}({', '.join(_arguments(step))})"
    if not program.steps:
        yield "pass"


def _arguments(step: TaughtStep) -> Iterable[str]:
    arguments = COMMANDS[step.command]
    if arguments.point is not None:
        yield step.point
    if arguments.of_axis:
        yield f'"{step.axis}"'
    if step.value is not None:
        yield f"{arguments.value}={step.value_text}" if arguments.point is not None else step.value_text


def _point_text(point: Point) -> str:
    if isinstance(point, JointPoint):
        angles = [_number(angle, "deg") for angle in point.joints]
        return f"({', '.join(angles)}{',' if len(angles) == 1 else ''})"
    position = [_number(value, "mm") for value in point.position]
    turns = [f"r{axis}={_number(value, 'deg')}" for axis, value in zip("xyz", point.angles, strict=True)]
    return f"location({', '.join(position + turns)})"


def _number(value: float, unit: str, digits: int | None = None) -> str:
    digits = _DIGITS.get(unit, 3) if digits is None else digits
    text = f"{value / _UNITS.get(unit, 1.0):.{digits}f}".rstrip("0").rstrip(".")
    text = "0" if text == "-0" else text
    return f"{text} * {unit}" if unit in _UNITS else text


def read_program(text: str, source: str) -> TaughtProgram:
    """Read a taught program from the text of a file `source`; layout, comments and values may have been edited.

    Raises
    ------
    DescriptionError
        With the line, if the text holds something else than the points and commands that the workspace writes.
    """
    if len(text) > MAX_BYTES:
        raise DescriptionError(f"{len(text)} characters", file=source, expected=f"at most {MAX_BYTES}")
    reader = _Reader(source)
    try:
        for node in ast.parse(text).body:
            reader.read(node)
    except SyntaxError as error:
        raise DescriptionError(f"{error.msg}", file=f"{source}:{error.lineno}") from None
    except (ValueError, RecursionError, MemoryError, OverflowError) as error:
        if isinstance(error, ScancellError):
            raise
        raise DescriptionError(f"cannot be parsed: {type(error).__name__}", file=source, expected=_EXPECTED) from None
    return reader.program()


class _Reader:
    """Collects the points and steps of a syntax tree."""

    def __init__(self, source: str) -> None:
        self._source, self._has_main = source, False
        self._points: dict[str, Point] = {}
        self._steps: list[TaughtStep] = []
        self._speed = 1.0
        self._tool: Tool = "sensor"

    def program(self) -> TaughtProgram:
        if not self._has_main:
            raise DescriptionError("has no function main", file=self._source, expected=_MAIN)
        try:
            return TaughtProgram(self._points, tuple(self._steps))
        except DescriptionError as error:
            raise error.within(self._source) from None

    def read(self, node: ast.stmt) -> None:
        match node:
            case ast.Expr(value=ast.Constant(value=str())):
                pass
            case ast.ImportFrom(module="scancell", level=0, names=names) if not any(name.asname for name in names):
                pass
            case ast.Assign(targets=[ast.Name(id=name)], value=value):
                self._points[name] = self._point(value)
            case ast.FunctionDef(name="main", decorator_list=[], args=ast.arguments(args=[ast.arg(arg="robot")])) if (
                not self._has_main
            ):
                self._has_main = True
                for statement in node.body:
                    self._read_command(statement)
            case _:
                raise self._error(node)

    def _read_command(self, node: ast.stmt) -> None:
        match node:
            case ast.Pass() | ast.Expr(value=ast.Constant(value=str())):
                pass
            case ast.Expr(value=ast.Call(func=ast.Attribute(value=ast.Name(id="robot"), attr=command)) as call):
                try:
                    self._add(command, call)
                except DescriptionError as error:
                    raise error if error.file else error.within(f"{self._source}:{node.lineno}") from None
            case _:
                raise self._error(node)

    def _add(self, command: str, call: ast.Call) -> None:
        match command, call.args, call.keywords:
            case "set_speed", [value], []:
                self._speed = self._quantity(value)
            case "set_tool", [ast.Constant(value=str() as tool)], [] if re.fullmatch(NAME_PATTERN, tool):
                self._tool = tool
            case _ if command in COMMANDS:
                self._steps.append(self._step(command, call))
            case _:
                raise self._error(call)

    def _step(self, command: CommandName, call: ast.Call) -> TaughtStep:
        arguments, numbers = COMMANDS[command], list(call.args)
        point, value, axis, unit = "", None, "", ""
        if arguments.of_axis:
            match numbers:
                case [ast.Constant(value=str(axis)), *numbers]:
                    pass
                case _:
                    raise self._error(call)
        if arguments.point is not None:
            match numbers:
                case [ast.Name(id=point), *numbers]:
                    pass
                case _:
                    raise self._error(call)
        match numbers, call.keywords:
            case ([number], []) | ([], [ast.keyword(arg=arguments.value, value=number)]) if arguments.value:
                value = self._quantity(number)
                if arguments.of_axis and isinstance(number, ast.BinOp) and isinstance(number.right, ast.Name):
                    unit = number.right.id
            case [], [] if not arguments.value:
                pass
            case _:
                raise self._error(call)
        speed = self._speed if arguments.moves else 1.0
        tool = self._tool if command == "move_line" else "sensor"
        return TaughtStep(command, point, value, speed, tool, axis, unit)

    def _point(self, node: ast.expr) -> Point:
        match node:
            case ast.Tuple(elts=numbers):
                return JointPoint(tuple(map(self._quantity, numbers)))
            case ast.Call(func=ast.Name(id="location"), args=[_, _, _] as position, keywords=turns) if all(
                turn.arg in ("rx", "ry", "rz") for turn in turns
            ):
                angles = {str(turn.arg): self._quantity(turn.value) for turn in turns}
                turned = tuple(angles.get(name, 0.0) for name in ("rx", "ry", "rz"))
                return PosePoint(tuple(map(self._quantity, position)), turned)
        raise self._error(node)

    def _quantity(self, node: ast.expr) -> float:
        """A number, with its sign and unit; SI."""
        match node:
            case ast.Constant(value=int() | float() as number) if not isinstance(number, bool):
                return float(number)
            case ast.UnaryOp(op=ast.USub(), operand=operand):
                return -self._quantity(operand)
            case ast.BinOp(op=ast.Mult(), left=left, right=ast.Name(id="mm" | "deg" as unit)):
                return self._quantity(left) * _UNITS[unit]
        raise self._error(node)

    def _error(self, node: ast.stmt | ast.expr) -> DescriptionError:
        shown = " ".join(ast.unparse(node).split())
        shown = shown if len(shown) <= 80 else f"{shown[:77]}..."
        return DescriptionError(shown, file=f"{self._source}:{node.lineno}", expected=_EXPECTED)


class TaughtFile:
    """A taught program in a file, which may also be edited by hand. All methods are thread-safe.

    Attributes
    ----------
    path
        Path of the file; without it the program is empty.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._lock = RLock()
        self._text = ""
        self._program = TaughtProgram()

    @property
    def text(self) -> str:
        """Content of the file; that of an empty program without it.

        Raises
        ------
        OutputError
            If it cannot be read.
        """
        if not self.path.exists():
            return program_text(TaughtProgram())
        return read_text(self.path, OutputError)

    @property
    def program(self) -> TaughtProgram:
        """The program of the file.

        Raises
        ------
        DescriptionError
            With the line, if the file was edited to something that is no list of steps.
        OutputError
            If it cannot be read.
        """
        with self._lock:
            text = self.text
            if text != self._text:
                self._program, self._text = read_program(text, str(self.path)), text
            return self._program

    @property
    def count(self) -> int:
        """Number of steps; 0 if the file cannot be read."""
        try:
            return len(self.program.steps)
        except ScancellError:
            return 0

    def edit(self, change: Callable[[TaughtProgram], TaughtProgram]) -> None:
        """Replace the program by `change` of it, and write the file.

        Raises
        ------
        ScancellError
            If the program cannot be read or changed, or the file cannot be written.
        """
        with self._lock:
            self.write(change(self.program))

    def write(self, program: TaughtProgram) -> None:
        """Write the file with a program.

        Raises
        ------
        OutputError
            If it cannot be written.
        """
        with self._lock, atomic_write(self.path) as temporary:
            temporary.write_text(program_text(program), encoding="utf-8")

    def set_aside(self) -> Path | None:
        """Begin an empty program: rename the file to the first of ``taught_1.py``, ``taught_2.py``, ... that is free.

        Returns
        -------
        Path or None
            The new name; None if there is no file.

        Raises
        ------
        OutputError
            If it cannot be renamed.
        """
        with self._lock:
            kept = first_free(self.path.parent, f"{self.path.stem}_{{}}{self.path.suffix}")
            try:
                return self.path.rename(kept)
            except FileNotFoundError:
                return None
            except OSError as error:
                raise OutputError(f"cannot be renamed: {error.strerror}", file=self.path) from error
