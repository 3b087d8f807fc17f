"""Checks of arguments at the public functions: NumPy scalars become plain numbers, wrong types a clear message.

The annotations of a function define what it accepts; `checked_arguments` holds callers to them. Pydantic's
``validate_call`` also evaluates return types, which only type checkers may know, and either accepts text for numbers or
refuses integers of NumPy.
"""

from __future__ import annotations

import functools
import inspect
import sys
import types
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import EnumType
from numbers import Integral, Real
from os import PathLike
from pathlib import Path
from typing import Annotated, Any, Literal, ParamSpec, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray

from scancell.errors import DescriptionError

P = ParamSpec("P")
R = TypeVar("R")
C = TypeVar("C", bound=type)

_ORTHOGONAL = 1e-6  # largest error of the products of the columns of a rotation
_LONGEST_NAME = 255  # bytes in the name of a file


@dataclass(frozen=True)
class Within:
    """Bounds of a number, for ``Annotated``; a float is finite in any case."""

    low: float = -np.inf
    high: float = np.inf
    above: bool = False  # whether `low` itself is excluded

    def __contains__(self, value: float) -> bool:
        return (self.low < value if self.above else self.low <= value) and value <= self.high

    def __str__(self) -> str:
        low = "" if self.low == -np.inf else f" {'above' if self.above else 'from'} {self.low:g}"
        return low + ("" if self.high == np.inf else f" to {self.high:.12g}")


@dataclass(frozen=True)
class Shape:
    """Shape of an array of numbers, for ``Annotated``; None: any length."""

    lengths: tuple[int | None, ...]
    dtype: type = float
    finite: bool = True
    within: Within = Within()

    def __str__(self) -> str:
        lengths = ", ".join("n" if length is None else str(length) for length in self.lengths)
        kinds = {int: "integers", bool: "booleans"}
        kind = kinds.get(self.dtype, "finite numbers" if self.finite else "numbers")
        return f"{kind} of shape ({lengths}{',' if len(self.lengths) == 1 else ''}){self.within}"

    def converted(self, value: Any) -> NDArray[Any]:
        """Convert a value to such an array, without a copy if it is one."""
        try:
            array = np.asarray(value)
        except (TypeError, ValueError):  # rows of several lengths
            raise _RefusedError from None
        if array.dtype.kind not in {int: "iu", bool: "b"}.get(self.dtype, "iuf") and array.size:
            raise _RefusedError
        if array.ndim != len(self.lengths) or any(
            wanted not in (None, length) for wanted, length in zip(self.lengths, array.shape, strict=True)
        ):
            raise _RefusedError(str(self), problem=f"the shape is {array.shape}")
        if self.finite and array.dtype.kind == "f" and not np.isfinite(array).all():
            wrong = np.argwhere(~np.isfinite(array))
            raise _RefusedError(str(self), problem=f"{len(wrong)} are not finite, the first at {wrong[0].tolist()}")
        if self.within != Within() and array.size and not (array.min() in self.within and array.max() in self.within):
            raise _RefusedError(str(self))
        return array


@dataclass(frozen=True)
class Rigid(Shape):
    """A pose (4, 4), for ``Annotated``: a rotation and a position, m."""

    lengths: tuple[int | None, ...] = (4, 4)

    def converted(self, value: Any) -> NDArray[Any]:
        """Convert a value to a pose; a (4, 4) array that is not rigid, such as one with a scale, is rejected."""
        found = super().converted(value)
        rotation = found[:3, :3]
        is_rotation = np.abs(rotation @ rotation.T - np.eye(3)).max() < _ORTHOGONAL and np.linalg.det(rotation) > 0
        if not is_rotation or not np.array_equal(found[3], (0, 0, 0, 1)):
            raise _RefusedError("a pose (4, 4): a rotation, a position in metres, and (0, 0, 0, 1) below")
        return found


Seed = Annotated[int, Within(0, 2**31 - 1)]
Threads = Annotated[int, Within(0, 1024)]
Count = Annotated[int, Within(1)]
Repeats = Annotated[int, Within(1, 10_000)]
QuarterTurns = Annotated[int, Within(0, 3)]
LatencyMs = Annotated[float, Within(-100.0, 100.0)]
Length = Annotated[float, Within(0.0, 1e6, above=True)]
Duration = Annotated[float, Within(0.0, 1e6)]
Share = Annotated[float, Within(0.0, 1.0, above=True)]
Pose = Annotated[NDArray[np.float64], Rigid()]
Points = Annotated[NDArray[np.float64], Shape((None, 3))]

_NUMBERS = (bool, int, float)


class _RefusedError(Exception):
    """A value is not as `expected`; empty: it does not match the type."""

    def __init__(self, expected: str = "", problem: str = "") -> None:
        super().__init__(expected)
        self.expected, self.problem = expected, problem


def checked_arguments(function: Callable[P, R], owner: type | None = None) -> Callable[P, R]:
    """Decorator: check arguments against the annotations of a function, or of the dataclass `owner` that it makes.

    Numbers of NumPy become plain ones. An argument of another type raises a `DescriptionError` that names the argument,
    its value and what was expected. Arguments that do not fit the signature raise a TypeError, as without the check;
    options of an ``Unpack[TypedDict]`` belong to it.
    """
    signature = inspect.signature(function)
    names = {one.kind: one.name for one in signature.parameters.values()}
    variadic = names.get(inspect.Parameter.VAR_KEYWORD, "")
    is_spelled_out = "Unpack[" in str(function.__annotations__.get(variadic))

    @functools.cache
    def hints() -> dict[str, Any]:
        if owner is not None:
            return get_type_hints(owner, include_extras=True)
        # A return type may be known to type checkers alone.
        unchecked = ("return", names.get(inspect.Parameter.VAR_POSITIONAL))
        given = {name: hint for name, hint in function.__annotations__.items() if name not in unchecked}
        parameters = types.SimpleNamespace(__annotations__=given)
        found = get_type_hints(parameters, vars(sys.modules[function.__module__]), include_extras=True)
        options = found.pop(variadic, None)
        return found | (get_type_hints(get_args(options)[0], include_extras=True) if is_spelled_out else {})

    @functools.wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> R:
        bound = signature.bind(*args, **kwargs)
        options = bound.arguments.get(variadic, {})
        if is_spelled_out and (unknown := options.keys() - hints().keys()):
            raise TypeError(f"{function.__name__}() got an unexpected keyword argument '{min(unknown)}'")
        for given in (bound.arguments, options):
            for name in given.keys() & hints().keys():
                given[name] = checked_value(name, given[name], hints()[name])
        return function(*bound.args, **bound.kwargs)

    return call


def checked_fields(cls: C) -> C:
    """Class decorator: check the arguments of a dataclass by the types of its fields, as `checked_arguments` does."""
    cls.__init__ = checked_arguments(cls.__init__, cls)  # type: ignore[misc]
    return cls


def checked_value(name: str, value: Any, hint: Any) -> Any:
    """Convert a value to the type `hint`.

    Raises `DescriptionError` naming the argument or its item, such as ``scans['a']``, its value and what was expected.
    """
    try:
        return _converted(name, value, hint)
    except _RefusedError as error:
        raise DescriptionError(error.problem, key=name, value=value, expected=error.expected or _text(hint)) from None


def _converted(name: str, value: Any, hint: Any) -> Any:  # noqa: PLR0911
    origin, arguments = _origin(hint), get_args(hint)
    if hint in (Any, object):
        return value
    if origin is Annotated:
        return _bounded(name, value, arguments[0], hint.__metadata__)
    if origin in (Union, types.UnionType):
        return _first(name, value, arguments)
    if origin is Literal:
        return _choice(value, arguments)
    if hint in _NUMBERS:
        return _number(value, hint)
    if hint is str:
        return _string(value)
    if hint is Path:
        return Path(_file_name(value.__fspath__() if isinstance(value, PathLike) else None))
    if origin is not None:
        return _collection(name, value, origin, arguments)
    return _required(value, isinstance(value, types.NoneType if hint is None else hint))


def _origin(hint: Any) -> Any:
    """The class or form of a generic type; None: it is not generic.

    `numpy.typing.NDArray` is an alias of its own kind from NumPy 2.5 on.
    """
    origin = get_origin(hint)
    return get_origin(origin.__value__) if hasattr(origin, "__value__") else origin


def _required(value: Any, condition: bool) -> Any:
    if not condition:
        raise _RefusedError
    return value


def _bounded(name: str, value: Any, hint: Any, bounds: Sequence[Any]) -> Any:
    for bound in bounds:
        if isinstance(bound, Shape):
            value = bound.converted(value)
        elif isinstance(bound, Within):
            value = _converted(name, value, hint)
            if value not in bound:
                raise _RefusedError(f"{_text(hint)}{bound}")
    return value


def _first(name: str, value: Any, hints: Sequence[Any]) -> Any:
    """Convert a value to the first of several types that accepts it."""
    if isinstance(value, str) and Path in hints:
        return _file_name(value)
    inner = None
    for hint in hints:
        try:
            return _converted(name, value, hint)
        except (_RefusedError, DescriptionError) as error:
            if error.expected:  # of the right type, with a wrong content
                inner = inner or error
    raise inner or _RefusedError


def _choice(value: Any, choices: tuple[Any, ...]) -> Any:
    for choice in choices:
        if isinstance(value, type(choice)) and value == choice:
            return choice
    raise _RefusedError


def _number(value: Any, kind: type) -> Any:
    if isinstance(value, np.ndarray) and value.ndim == 0:
        value = value[()]
    is_flag = isinstance(value, bool | np.bool_)
    if kind is bool:
        return bool(_required(value, is_flag))
    if kind is int:
        return int(_required(value, isinstance(value, Integral) and not is_flag))
    try:
        number = float(_required(value, isinstance(value, Real) and not is_flag))
    except OverflowError:  # an integer too large
        raise _RefusedError from None
    return _required(number, bool(np.isfinite(number)))


def _string(value: Any) -> str:
    if "\0" in _required(value, isinstance(value, str)):
        raise _RefusedError("text without NUL characters")
    return str(value)


def _file_name(value: Any) -> str:
    path = _string(value)
    if any(len(name.encode(errors="replace")) > _LONGEST_NAME for name in path.split("/")):
        raise _RefusedError(f"a path whose names have at most {_LONGEST_NAME} bytes")
    return path


def _collection(name: str, value: Any, origin: Any, arguments: tuple[Any, ...]) -> Any:
    if not issubclass(origin, Mapping | Sequence):
        return _required(value, isinstance(value, origin))
    if issubclass(origin, Mapping):
        _required(value, isinstance(value, Mapping))
        mapping = {
            checked_value(f"{name}[{key!r}]", key, arguments[0]): checked_value(f"{name}[{key!r}]", item, arguments[1])
            for key, item in value.items()
        }
        return value if origin is dict else mapping  # a dict may be shared
    is_array = isinstance(value, np.ndarray) and value.ndim > 0
    _required(value, is_array or (isinstance(value, Sequence) and not isinstance(value, str | bytes | bytearray)))
    hints = [arguments[0]] * len(value)
    if origin is tuple and arguments[-1] is not Ellipsis:
        hints = list(_required(arguments, len(arguments) == len(value)))
    items = [checked_value(f"{name}[{i}]", *one) for i, one in enumerate(zip(value, hints, strict=True))]
    return tuple(items) if origin is tuple else items


def _text(hint: Any) -> str:  # noqa: PLR0911
    """Describe the values that a type accepts."""
    origin, arguments = _origin(hint), get_args(hint)
    if origin is Annotated:
        return "".join(
            str(one) if isinstance(one, Shape) else f"{_text(arguments[0])}{one}" for one in hint.__metadata__
        )
    if origin in (Union, types.UnionType):
        return " or ".join(dict.fromkeys(_text(one) for one in arguments))
    if origin is Literal:
        return ", ".join(f"'{one}'" for one in arguments)
    if origin is Callable:
        return "a function"
    if origin is not None and issubclass(origin, Mapping):
        return "a mapping"
    if origin is not None and issubclass(origin, Sequence):
        return (
            f"a sequence of ({_text(arguments[0])})"
            if get_args(arguments[0])
            else f"a sequence of {_text(arguments[0])}"
        )
    if origin is np.ndarray:
        return "an array"
    if isinstance(hint, EnumType):
        return " or ".join(f"{hint.__name__}.{name}" for name in hint.__members__)
    names = {float: "a finite number", int: "an integer", bool: "True or False", str: "text", Path: "a path"}
    if hint in (None, types.NoneType):
        return "None"
    return names.get(hint) or f"a {getattr(hint, '__name__', hint)}"
