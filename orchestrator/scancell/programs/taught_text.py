"""Taught programs as files of `scancell run`, in the commands of docs/programs.md.

They are read as data: nothing of a file is executed.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterable
from typing import Any, Literal, cast

from scancell.cell.controller import Tool
from scancell.config.devices import NAME_PATTERN
from scancell.errors import DescriptionError, ScancellError
from scancell.programs.robot import deg, mm
from scancell.programs.taught import COMMANDS, WORDS, JointPoint, Point, PosePoint, TaughtProgram, TaughtStep

MAX_BYTES = 1_000_000

_UNITS = {"mm": mm, "deg": deg}
_DIGITS = {"mm": 3, "deg": 4}  # 1 um, and 1 um at a distance of 0.5 m
_HEAD = '''"""Robot program taught in the workspace of scancell, which reads such literal commands again."""

from scancell import Robot, deg, location, mm
'''
_MAIN = "def main(robot: Robot) -> None:"
_EXPECTED = "a command as the workspace writes it, with literal numbers"


def program_text(program: TaughtProgram) -> str:
    """The file of a robot program; numbers are rounded to 0.001 mm, 0.0001 deg and 0.001 in other units."""
    points = [f"{name} = {_point_text(point)}" for name, point in program.points.items()]
    lines = [_HEAD, *points, *(["", ""] if points else [""]), _MAIN, *(f"    {line}" for line in _body(program))]
    return "\n".join(lines) + "\n"


def _body(program: TaughtProgram) -> Iterable[str]:
    speed, tool = 1.0, "sensor"
    for step in program.steps:
        words = WORDS[step.command]
        if words.moves and step.speed != speed:
            speed = step.speed
            yield f"robot.set_speed({_number(speed, '')})"
        if step.command == "move_line" and step.tool != tool:
            tool = step.tool
            yield f'robot.set_tool("{tool}")'
        yield f"robot.{step.command}({', '.join(_arguments(step))})"
    if not program.steps:
        yield "pass"


def _arguments(step: TaughtStep) -> Iterable[str]:
    words = WORDS[step.command]
    if words.point is not None:
        yield step.point
    if step.value is not None:
        text = _number(step.value, words.unit)
        yield f"{words.value}={text}" if words.point is not None else text


def _point_text(point: Point) -> str:
    if isinstance(point, JointPoint):
        angles = [_number(angle, "deg") for angle in point.joints]
        return f"({', '.join(angles)}{',' if len(angles) == 1 else ''})"
    position = [_number(value, "mm") for value in point.position]
    turns = [f"r{axis}={_number(value, 'deg')}" for axis, value in zip("xyz", point.angles, strict=True)]
    return f"location({', '.join(position + turns)})"


def _number(value: float, unit: str) -> str:
    text = f"{value / _UNITS.get(unit, 1.0):.{_DIGITS.get(unit, 3)}f}".rstrip("0").rstrip(".")
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

    def _step(self, command: Any, call: ast.Call) -> TaughtStep:
        words, arguments = WORDS[cast(Literal["wait"], command)], list(call.args)
        point, value = "", None
        if words.point is not None:
            match arguments:
                case [ast.Name(id=point), *arguments]:
                    pass
                case _:
                    raise self._error(call)
        match arguments, call.keywords:
            case ([number], []) | ([], [ast.keyword(arg=words.value, value=number)]) if words.value:
                value = self._quantity(number)
            case [], [] if not words.value:
                pass
            case _:
                raise self._error(call)
        speed = self._speed if words.moves else 1.0
        return TaughtStep(command, point, value, speed, self._tool if command == "move_line" else "sensor")

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
