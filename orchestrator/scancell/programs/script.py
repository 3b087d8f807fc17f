"""Robot programs in languages of controllers: what V+ and URScript have in common, run with the robot of a cell.

A grammar (``*.lark``) makes the syntax tree; its rules are the methods ``do_...`` of statements and ``get_...`` of
values. Instructions and functions of a language are methods ``call_...``: whatever has none is refused before anything
moves, with its line.
"""

from __future__ import annotations

import inspect
import math
import operator
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from lark import Lark, Token, Tree
from lark.exceptions import LarkError, UnexpectedInput

from scancell.arrays import Array
from scancell.errors import ProgramError, ScancellError
from scancell.files import read_text
from scancell.geometry import pose
from scancell.live.state import JobStopped
from scancell.programs.robot import Robot, mm

Value = float | str | Array
Frame = dict[str, Value | None]  # values of variables; None: declared, without a value
Node = Any  # Tree, Token, or None for what is left out

MAX_BYTES = 2_000_000
_MOST_TEXT = 1000  # characters of a value
_MOST_IDLE = 100_000  # statements during which no simulated time passes
_DEEPEST = 30  # calls of routines
_SAME_TOOL = 1e-5  # m and rad
_UNMOVED = 1e-4  # rad

_COMPARISONS: dict[str, Callable[[Any, Any], bool]] = {
    "==": operator.eq,
    "<>": operator.ne,
    "!=": operator.ne,
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
}
_OPERATIONS: dict[str, Callable[[Any, Any], Any]] = {
    "+": operator.add,
    "-": operator.sub,
    "*": operator.mul,
    "/": operator.truediv,
    "%": math.fmod,
    "MOD": math.fmod,
}


@dataclass(frozen=True)
class Output:
    """Numbers of the digital outputs that act on the cell, from 1.

    Attributes
    ----------
    EXPOSE
        One exposure at the rising edge.
    BY_PATH, BY_TABLE
        While on, exposures by the travel of the tool in straight moves, or by the turn of the table.
    TURN_TABLE
        The table turns at the rising edge, where the language has no axis for it.
    """

    EXPOSE: ClassVar[int] = 1
    BY_PATH: ClassVar[int] = 2
    BY_TABLE: ClassVar[int] = 3
    TURN_TABLE: ClassVar[int] = 4


class Finish(Exception):  # noqa: N818  (the end of a routine is no error)
    """A routine ends."""

    def __init__(self, value: Value | None = None) -> None:
        super().__init__()
        self.value = value


class Halt(Finish):
    """The program ends."""


class Fault(Exception):  # noqa: N818  (becomes a `ProgramError` with file and line)
    """A statement cannot be carried out."""


@dataclass(frozen=True)
class Routine:
    """A subroutine: the names of its parameters, and its statements."""

    parameters: tuple[str, ...]
    block: Tree[Token]


class Script:
    """A parsed program of a controller.

    Parameters
    ----------
    file
        Its file, also for messages.
    text
        Its text, in place of the content of the file.

    Attributes
    ----------
    line
        Line of the statement that runs, or of the last error.

    Raises
    ------
    ProgramError
        With file, line and text of what is not in the subset.
    """

    grammar: ClassVar[str]
    ignores_case: ClassVar[bool] = False

    def __init__(self, file: Path, text: str | None = None) -> None:
        self.file, self.line = file, 0
        text = read_text(file, ProgramError) if text is None else text
        if len(text) > MAX_BYTES:
            raise ProgramError(f"{len(text)} characters", file=file, expected=f"at most {MAX_BYTES}")
        self._lines = text.split("\n")
        self._routines: dict[str, Routine] = {}
        self._globals: Frame = {}
        self._frames: list[Frame] = []
        self._outputs: dict[int, bool] = {}
        self._idle, self._time = 0, -1.0
        self._robot: Robot
        self._say: Callable[[str], None] = print
        try:
            self.tree = _parser(self.grammar).parse(text + "\n")
        except UnexpectedInput as error:
            self.line = error.line if error.line > 0 else len(self._lines)
            raise self.error("is not understood here") from None
        except (LarkError, RecursionError) as error:
            raise ProgramError(f"cannot be parsed: {type(error).__name__}", file=file) from None
        self._check()

    def run(self, robot: Robot, say: Callable[[str], None]) -> None:
        """Run the program from its start; `say` receives the text that it prints.

        Raises
        ------
        ProgramError
            With file, line and text of the statement that fails.
        JobStopped
            With file and line, where it was ended.
        """
        self._robot, self._say = robot, say
        self._globals, self._frames, self._outputs = {}, [], {}
        self._idle, self._time = 0, -1.0
        try:
            self.start()
        except Finish:
            pass
        except JobStopped as stop:
            raise JobStopped(f"{self.file}:{self.line}: {stop}") from stop
        except (Fault, ScancellError) as error:
            raise self.error(str(error)) from error
        except (ArithmeticError, ValueError, TypeError) as error:
            raise self.error(f"{error or type(error).__name__}") from error
        except RecursionError:
            raise self.error("is nested too deeply") from None

    def error(self, what: str) -> ProgramError:
        """An error of the present line."""
        text = self._lines[self.line - 1].strip() if 0 < self.line <= len(self._lines) else "end of the file"
        return ProgramError(f"{self.file}:{self.line}: {text[:100]}: {what}")

    def start(self) -> None:
        """Run the first routine, or what the language has in its place."""
        raise NotImplementedError

    # Checks before the run

    def _check(self) -> None:
        nodes: list[Tree[Token]] = list(self.tree.iter_subtrees_topdown())  # type: ignore[no-untyped-call]
        for node in nodes:
            self.line = getattr(node.meta, "line", self.line)
            match node.data:
                case "routine":
                    self._declare(node)
                case "print":
                    self.check_formats(node)
        for node in nodes:
            self.line = getattr(node.meta, "line", self.line)
            if node.data in ("command", "function", "call"):
                self._check_call(node)
        self.line = 0

    def check_formats(self, node: Tree[Token]) -> None:
        """Refuse formats of printed values that are not known."""

    def _declare(self, node: Tree[Token]) -> None:
        name, names, block = node.children
        key, parameters = self.key(name), () if names is None else tuple(map(self.key, _tree(names).children))
        if key in self._routines or len(set(parameters)) < len(parameters):
            raise self.error(f"{name} is defined twice")
        self._routines[key] = Routine(parameters, _tree(block))

    def _check_call(self, node: Tree[Token]) -> None:
        key, (arguments, words) = self.key(node.children[0]), _given(node)
        routine = None if node.data == "command" else self._routines.get(key)
        if routine is not None:
            if words or len(arguments) != len(routine.parameters):
                raise self.error(f"{node.children[0]} has {len(routine.parameters)} arguments")
            return
        method = None if node.data == "call" else self._method(node)
        if method is None:
            kind = {"command": "instruction", "function": "function", "call": "program"}[str(node.data)]
            raise self.error(f"{node.children[0]}: no {kind} that is known")
        try:
            inspect.signature(method).bind(*arguments, **words)
        except TypeError as error:
            raise self.error(f"{node.children[0]}: {error}") from None

    def _method(self, node: Tree[Token]) -> Callable[..., Any] | None:
        """The method of an instruction or a function."""
        name = self.key(node.children[0]).replace("#", "precision_").replace(".", "_").replace("$", "")
        kind = "instruct" if node.data == "command" else "call"
        return getattr(self, f"{kind}_{name}", None)

    def key(self, name: Node) -> str:
        """Name by which a variable or routine is found."""
        return str(name).lower() if self.ignores_case else str(name)

    # Statements

    def run_block(self, block: Tree[Token]) -> None:
        """Carry out statements."""
        for node in block.children:
            self._statement(_tree(node))

    def _statement(self, node: Tree[Token]) -> None:
        self.line = node.meta.line
        self._idle += 1
        now = self._robot.time
        if now != self._time:
            self._idle, self._time = 0, now
        if self._idle > _MOST_IDLE:
            raise Fault(f"{_MOST_IDLE} statements without a motion or wait: an endless loop")
        getattr(self, f"do_{node.data}")(*node.children)

    def do_assign(self, target: Node, value: Node) -> None:
        """Give a variable a value."""
        self.assign(self.frame_of(self.slot(target)), target, self.value(value))

    def assign(self, frame: Frame, target: Node, value: Value) -> None:
        """Give a variable of a frame a value."""
        if isinstance(value, str) and len(value) > _MOST_TEXT:
            raise Fault(f"a text of {len(value)} characters, at most {_MOST_TEXT}")
        frame[self.slot(target)] = value

    def slot(self, variable: Node) -> str:
        """Key under which a variable, or an element of an array, is kept."""
        name, *index = _tree(variable).children
        return self.key(name) + "".join(f"[{self.integer(one)}]" for one in index)

    def frame_of(self, slot: str) -> Frame:
        """Variables among which the one of a slot is."""
        local = self._frames[-1] if self._frames else {}
        return local if slot in local or slot.partition("[")[0] in local else self._globals

    def do_if_(self, *parts: Node) -> None:
        """Carry out the block of the first condition that holds, or the last block, of ELSE."""
        pairs, rest = parts[: len(parts) // 2 * 2], parts[len(parts) // 2 * 2 :]
        for condition, block in zip(pairs[::2], pairs[1::2], strict=True):
            if self.is_true(condition):
                return self.run_block(block)
        return self.run_block(rest[0]) if rest else None

    def do_while_(self, condition: Node, block: Node) -> None:
        """Repeat while a condition holds."""
        while self.is_true(condition):
            self.run_block(block)
            self._idle += 1
            self._require_time()

    def do_finish(self, value: Node = None) -> None:
        """End a routine."""
        raise Finish(None if value is None else self.value(value))

    def _require_time(self) -> None:
        if self._idle > _MOST_IDLE:
            raise Fault(f"{_MOST_IDLE} statements without a motion or wait: an endless loop")

    def enter(self, routine: Routine, frame: Frame) -> Value | None:
        """Run a routine with the values of its parameters."""
        if len(self._frames) >= _DEEPEST:
            raise Fault(f"{_DEEPEST} calls within each other")
        at = self.line
        self._frames.append(frame)
        try:
            self.run_block(routine.block)
        except Halt:
            raise
        except Finish as end:
            return end.value
        finally:
            self._frames.pop()
        self.line = at
        return None

    # Values

    def value(self, node: Node) -> Value:
        """Value of an expression."""
        found: Value = getattr(self, f"get_{_tree(node).data}")(*_tree(node).children)
        if isinstance(found, float) and not math.isfinite(found):
            raise Fault("the value is not finite")
        return found

    def number(self, node: Node) -> float:
        """Value that has to be a number."""
        found = self.value(node)
        if not isinstance(found, int | float):
            raise Fault(f"{_kind(found)}, expected a number")
        return float(found)

    def integer(self, node: Node) -> int:
        """Value that has to be a whole number, at most a million."""
        found = self.number(node)
        if found != round(found) or abs(found) > 1e6:
            raise Fault(f"{found:g}, expected a whole number")
        return round(found)

    def location(self, node: Node) -> Array:
        """Value (4, 4) that has to be a pose."""
        found = self.value(node)
        if not isinstance(found, np.ndarray) or found.ndim != 2:
            raise Fault(f"{_kind(found)}, expected a location")
        return found

    def is_true(self, node: Node) -> bool:
        """Whether a number is not 0."""
        return self.number(node) != 0

    def truth(self, value: bool) -> Value:
        """Value of a condition in the language."""
        return value

    def get_number(self, token: Node) -> Value:
        """A literal number."""
        return float(token)

    def get_text(self, token: Node) -> Value:
        """A literal text."""
        return str(token)[1:-1]

    def get_variable(self, name: Node, index: Node = None) -> Value:
        """Value of a variable, or of an element of an array."""
        slot = self.key(name) if index is None else f"{self.key(name)}[{self.integer(index)}]"
        found = self.frame_of(slot).get(slot)
        if found is None:
            raise Fault(f"{slot} has no value")
        return found

    def get_minus(self, sign: Node, value: Node) -> Value:
        """A number with its sign."""
        number = self.number(value)
        return -number if sign == "-" else number

    def get_binary(self, left: Node, sign: Node, right: Node) -> Value:
        """Sum, difference, product, quotient or remainder of numbers; texts are joined."""
        first = self.value(left)
        if isinstance(first, str):
            second = self.value(right)
            if sign == "+" and isinstance(second, str):
                return first + second
            raise Fault("a text, expected a number")
        return float(_OPERATIONS[str(sign).upper()](self.number(left), self.number(right)))

    def get_compare(self, left: Node, sign: Node, right: Node) -> Value:
        """Whether two numbers, or two texts, compare so."""
        values = self.value(left), self.value(right)
        if not (all(isinstance(v, int | float) for v in values) or all(isinstance(v, str) for v in values)):
            raise Fault(f"{_kind(values[0])} and {_kind(values[1])} cannot be compared")
        return self.truth(_COMPARISONS[str(sign)](*values))

    def get_either(self, left: Node, right: Node) -> Value:
        """Whether one of two holds."""
        return self.truth(self.is_true(left) or self.is_true(right))

    def get_both(self, left: Node, right: Node) -> Value:
        """Whether both hold."""
        return self.truth(self.is_true(left) and self.is_true(right))

    def get_negate(self, value: Node) -> Value:
        """Whether it does not hold."""
        return self.truth(not self.is_true(value))

    def get_function(self, name: Node, arguments: Node) -> Any:
        """Value of a function."""
        node = Tree("function", [name, arguments])
        positions, words = _given(node)
        method = self._method(node)
        assert method is not None  # checked before the run
        return method(*positions, **words)

    # The robot

    @property
    def _world_from_base(self) -> Array:
        return self._robot.world_from_frame("base")

    def here(self) -> Array:
        """Measured pose (4, 4) of the tool in the frame of the robot."""
        return np.asarray(pose.inverse(self._world_from_base) @ self._robot.world_from_tool())

    def move_axes(self, axes: Array) -> None:
        """Move all joints, and the table if `axes` (n,), rad, has one more."""
        robot, joints = self._robot, len(self._robot.joints)
        if axes.shape not in ((joints,), (joints + 1,)):
            raise Fault(f"{len(axes)} axes, expected {joints} joints, or {joints + 1} with the table")
        table_angle = float(axes[joints]) if len(axes) > joints else None
        if self.output(Output.BY_PATH) or self.output(Output.BY_TABLE):
            if table_angle is None or np.abs(axes[:joints] - robot.joints).max() > _UNMOVED:
                raise Fault("joints move while exposures are triggered: expected a straight move, or the table alone")
            self.turn_table(table_angle)
        else:
            robot.move_joints(axes[:joints], table_angle)

    def turn_table(self, table_angle: float) -> None:
        """Turn the table to an angle, rad, with exposures if they are triggered by it."""
        if self.output(Output.BY_TABLE):
            self._robot.scan_table(table_angle, self.interval(math.radians(1.0)))
        else:
            self._robot.turn_table(table_angle)

    def move_straight(self, base_from_tool: Array) -> None:
        """Move the tool straight to a pose (4, 4) in the frame of the robot, with exposures if they are triggered."""
        world_from_tool = self._world_from_base @ base_from_tool
        if not self.output(Output.BY_PATH):
            return self._robot.move_line(world_from_tool)
        away = np.abs(self._robot.world_from_tool("sensor") - self._robot.world_from_tool()).max()
        if away > _SAME_TOOL:
            raise Fault("exposures along the path are those of the tool sensor")
        self._robot.scan_line(world_from_tool, self.interval(1e-3))
        return None

    def interval(self, unit: float) -> float:
        """Interval of exposures, m or rad; `unit` is the SI value of a mm or degree."""
        raise NotImplementedError

    def choose_tool(self, flange_from_tool: Array) -> None:
        """Take the tool of the cell that has this pose (4, 4) on the flange."""
        tools = self._robot.flange_from_tools()
        for name, own in tools.items():
            if np.abs(own - flange_from_tool).max() < _SAME_TOOL:
                return self._robot.set_tool(name)
        known = ", ".join(
            f"{name} at ({', '.join(f'{x:.3f}' for x in own[:3, 3] / mm)}) mm" for name, own in tools.items()
        )
        raise Fault(f"no tool of the cell has this pose on the flange; expected {known}")

    def set_output(self, number: int, on: bool) -> None:
        """Switch a digital output, from 1, and do what its rising edge does in the cell."""
        if not 1 <= number <= 999:
            raise Fault(f"output {number}, expected 1 to 999")
        rises = on and not self._outputs.get(number, False)
        self._outputs[number] = on
        if rises and number == Output.EXPOSE:
            self._robot.profile()

    def output(self, number: int) -> bool:
        """Whether a digital output is on."""
        return self._outputs.get(number, False)


def _tree(node: Node) -> Tree[Token]:
    assert isinstance(node, Tree)
    return node


def _given(node: Tree[Token]) -> tuple[list[Node], dict[str, Node]]:
    """Arguments of a call by position, and by keyword."""
    listed = node.children[1]
    nodes: list[Node] = [] if listed is None else list(_tree(listed).children)
    words = {str(one.children[0]): one.children[1] for one in nodes if _is_keyword(one)}
    return [one for one in nodes if not _is_keyword(one)], words


def _is_keyword(node: Node) -> bool:
    return isinstance(node, Tree) and node.data == "keyword"


def _kind(value: Value) -> str:
    if isinstance(value, np.ndarray):
        return "a location" if value.ndim == 2 else f"{len(value)} numbers"
    return "a text" if isinstance(value, str) else "a number"


@lru_cache
def _parser(grammar: str) -> Lark:
    text = (Path(__file__).parent / grammar).read_text(encoding="utf-8")
    return Lark(text, parser="lalr", propagate_positions=True, maybe_placeholders=True)
