"""URScript: complete programs of a stream of text, and the statements of a subset of the language.

The subset is calls of functions with literal arguments, one a line, within ``def NAME(): ... end`` or alone: see
`STATEMENTS`. Control flow, variables, threads and functions of a program are refused.
"""

from __future__ import annotations

import ast
import operator
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from scancell.errors import ProgramError

MAX_PROGRAM = 1_000_000  # characters
_MAX_LINE = 2_000

_OPENS = re.compile(r"^\s*(?:\$\s+)?(def|sec|thread|if|while|for)\b.*:\s*(?:#.*)?$")
_CLOSES = re.compile(r"^\s*end\s*(?:#.*)?$")
_DEFINES = re.compile(r"^\s*(?:def|sec)\s+(\w+)\s*\(\s*\)\s*:\s*(?:#.*)?$")

_OPERATORS = {ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul, ast.Div: operator.truediv}


@dataclass(frozen=True)
class PoseLiteral:
    """``p[x, y, z, rx, ry, rz]``: metres and the rotation vector, rad."""

    values: tuple[float, ...]


Argument = float | bool | str | tuple[float, ...] | PoseLiteral


@dataclass(frozen=True)
class Parameter:
    """What an argument of a statement is, and its default; None: it is required."""

    kinds: tuple[type, ...]
    default: Argument | None = None


_JOINTS_OR_POSE, _NUMBER, _ANY = Parameter((tuple, PoseLiteral)), Parameter((float,)), (float, bool, str, tuple)
_MOVE = {"t": Parameter((float,), 0.0), "r": Parameter((float,), 0.0)}

# Parameters of each statement by name, in their order.
STATEMENTS: dict[str, dict[str, Parameter]] = {
    "movej": {"q": _JOINTS_OR_POSE, "a": Parameter((float,), 1.4), "v": Parameter((float,), 1.05), **_MOVE},
    "movel": {"pose": _JOINTS_OR_POSE, "a": Parameter((float,), 1.2), "v": Parameter((float,), 0.25), **_MOVE},
    "stopj": {"a": _NUMBER},
    "stopl": {"a": _NUMBER},
    "sleep": {"t": _NUMBER},
    "sync": {},
    "textmsg": {"s1": Parameter(_ANY), "s2": Parameter(_ANY, "")},
    "set_tcp": {"pose": Parameter((PoseLiteral,))},
    "set_digital_out": {"n": _NUMBER, "b": Parameter((bool,))},
    "set_standard_digital_out": {"n": _NUMBER, "b": Parameter((bool,))},
    "set_configurable_digital_out": {"n": _NUMBER, "b": Parameter((bool,))},
    "write_output_integer_register": {"address": _NUMBER, "value": _NUMBER},
    "write_output_float_register": {"address": _NUMBER, "value": _NUMBER},
    "write_output_boolean_register": {"address": _NUMBER, "value": Parameter((bool,))},
    "rtde_set_watchdog": {
        "variable_name": Parameter((str,)),
        "min_frequency": _NUMBER,
        "action": Parameter((str,), "pause"),
    },
    "signal_async_progress": {"value": _NUMBER},
}


@dataclass(frozen=True)
class Statement:
    """A call: its line in the program, from 1, its function, and its arguments by name."""

    line: int
    name: str
    arguments: Mapping[str, Argument]

    def number(self, name: str) -> float:
        """A number among the arguments."""
        value = self.arguments[name]
        assert isinstance(value, float | bool)
        return float(value)


class ScriptBuffer:
    """Complete programs of the bytes that a client sends: a definition up to its ``end``, or a line alone."""

    def __init__(self) -> None:
        self._rest, self._depth, self._size = b"", 0, 0
        self._lines: list[str] = []

    def programs(self, received: bytes) -> Iterator[str]:
        """Programs that are complete with the bytes `received`.

        Raises
        ------
        ProgramError
            If a program is larger than a controller would take.
        """
        *lines, self._rest = (self._rest + received).split(b"\n")
        self._size += len(received)
        if self._size > MAX_PROGRAM:
            raise ProgramError(f"the program has more than {MAX_PROGRAM} characters")
        for raw in lines:
            line = raw.decode(errors="replace").rstrip("\r")
            if not self._lines and (not line.strip() or line.lstrip().startswith("#")):
                continue
            self._lines.append(line)
            self._depth += bool(_OPENS.match(line)) - bool(_CLOSES.match(line))
            if self._depth <= 0:
                program, self._lines, self._depth = "\n".join(self._lines), [], 0
                self._size = len(self._rest)
                yield program


def statements(program: str) -> list[Statement]:
    """Statements of a program.

    Raises
    ------
    ProgramError
        With the line that is not in the subset, and the reason.
    """
    lines = list(enumerate(program.split("\n"), 1))
    if _DEFINES.match(lines[0][1]):
        if not _CLOSES.match(lines[-1][1]):
            raise _refused(*lines[0], "expected a definition up to its end")
        lines = lines[1:-1]
    parsed = []
    for number, line in lines:
        text = line.strip()
        if text and not text.startswith("#"):
            parsed.append(_statement(number, text))
    return parsed


def is_secondary(program: str) -> bool:
    """Whether a program runs beside the one that runs (``sec NAME():``)."""
    return program.lstrip().startswith("sec ")


def _statement(number: int, text: str) -> Statement:
    if len(text) > _MAX_LINE:
        raise _refused(number, text, f"the line has more than {_MAX_LINE} characters")
    try:
        call = ast.parse(text, mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        raise _refused(number, text, "expected the call of a function with literal arguments") from None
    if not isinstance(call, ast.Call) or not isinstance(call.func, ast.Name):
        raise _refused(number, text, "expected the call of a function")
    name = call.func.id
    if name not in STATEMENTS:
        raise _refused(number, text, f"expected one of {', '.join(STATEMENTS)}")
    parameters = STATEMENTS[name]
    given: dict[str, ast.expr] = dict(zip(parameters, call.args, strict=False))
    for keyword in call.keywords:
        if keyword.arg is None or keyword.arg not in parameters or keyword.arg in given:
            raise _refused(number, text, f"expected {name}({', '.join(parameters)})")
        given[keyword.arg] = keyword.value
    missing = [key for key, parameter in parameters.items() if key not in given and parameter.default is None]
    if len(call.args) > len(parameters) or missing:
        raise _refused(number, text, f"expected {name}({', '.join(parameters)})")
    try:
        values = {key: _value(node) for key, node in given.items()}
    except (ValueError, TypeError, ZeroDivisionError, OverflowError, RecursionError):
        raise _refused(
            number, text, "expected literal numbers, lists of six numbers, p[...], True, False, text"
        ) from None
    for key, value in values.items():
        if not isinstance(value, parameters[key].kinds) or (
            isinstance(value, bool) and bool not in parameters[key].kinds
        ):
            raise _refused(number, text, f"{key} is of another kind than {name} expects")
    if name.startswith("move") and values.get("t"):
        raise _refused(number, text, "t is not emulated: expected v")
    defaults = {key: parameter.default for key, parameter in parameters.items() if parameter.default is not None}
    return Statement(number, name, defaults | values)


def _value(node: ast.expr) -> Argument:
    """Value of a literal; raises `ValueError` or `TypeError` for anything else."""
    if isinstance(node, ast.Constant) and isinstance(node.value, bool | str):
        return node.value
    if isinstance(node, ast.List):
        return _six(node.elts)
    if isinstance(node, ast.Subscript) and isinstance(node.value, ast.Name) and node.value.id == "p":
        return PoseLiteral(_six(node.slice.elts if isinstance(node.slice, ast.Tuple) else []))
    return _number(node)


def _number(node: ast.expr) -> float:
    if isinstance(node, ast.Constant) and isinstance(node.value, int | float) and not isinstance(node.value, bool):
        value = float(node.value)
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.UAdd):
        value = _number(node.operand) * (-1.0 if isinstance(node.op, ast.USub) else 1.0)
    elif isinstance(node, ast.BinOp) and type(node.op) in _OPERATORS:
        value = float(_OPERATORS[type(node.op)](_number(node.left), _number(node.right)))
    else:
        raise ValueError
    if not np.isfinite(value):
        raise ValueError
    return value


def _six(nodes: Sequence[ast.expr]) -> tuple[float, ...]:
    if len(nodes) != 6:
        raise ValueError
    return tuple(_number(node) for node in nodes)


def _refused(number: int, text: str, reason: str) -> ProgramError:
    return ProgramError(f"line {number}: {text[:80]!r}: {reason}")
