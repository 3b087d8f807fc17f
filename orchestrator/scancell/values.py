"""Base classes of results and other data: equality that holds for arrays, and a representation on one line."""

from __future__ import annotations

from abc import ABC, abstractmethod
from base64 import b64encode
from collections.abc import Iterator, Mapping
from dataclasses import Field, fields, is_dataclass
from html import escape
from types import TracebackType
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np

_LONGEST = 40  # characters of a text
_MOST = 3  # items of a sequence that are shown


class Value:
    """Base of dataclasses that hold arrays; to be declared with ``@dataclass(frozen=True, eq=False, repr=False)``.

    Two are equal if they are of one class and all fields that are compared are equal; NaN equals NaN. The
    representation names the fields that are shown, arrays by their shapes.
    """

    __dataclass_fields__: ClassVar[dict[str, Field[Any]]]
    __hash__ = None  # type: ignore[assignment]  # arrays can be changed

    def __eq__(self, other: object) -> bool:
        return is_same(self, other) if type(other) is type(self) else NotImplemented

    def __repr__(self) -> str:
        shown = (f"{one.name}={_brief(getattr(self, one.name))}" for one in fields(self) if one.repr)
        return f"{type(self).__name__}({', '.join(shown)})"


def is_same(a: Any, b: Any) -> bool:
    """Whether two values are of one class and equal, arrays and dataclasses in them included."""
    if a is b:
        return True
    if type(a) is not type(b):
        same = False
    elif isinstance(a, np.ndarray | float):
        same = np.array_equal(a, b, equal_nan=np.asarray(a).dtype.kind == "f")
    elif is_dataclass(a):
        same = all(is_same(getattr(a, one.name), getattr(b, one.name)) for one in fields(a) if one.compare)
    elif isinstance(a, Mapping):
        same = a.keys() == b.keys() and all(is_same(value, b[key]) for key, value in a.items())
    elif isinstance(a, tuple | list):
        same = len(a) == len(b) and all(map(is_same, a, b))
    else:
        same = bool(a == b)
    return same


def _brief(value: Any) -> str:
    """A value in few characters."""
    match value:
        case np.ndarray():
            text = f"<{value.dtype} {value.shape}>"
        case str():
            text = repr(value if len(value) <= _LONGEST else f"…{value[-_LONGEST:]}")
        case tuple() | list() if len(value) <= _MOST:
            text = f"[{', '.join(map(_brief, value))}]"
        case tuple() | list() | Mapping():
            text = f"<{len(value)} items>"
        case float():
            text = f"{value:.6g}"
        case int() | np.generic() | None:
            text = str(value)
        case _:
            text = f"{type(value).__name__}(…)"
    return text


class Result(Value):
    """Base of what the public functions return: figures, their summary, and a table of them in a notebook.

    The representation holds the first line of the summary.
    """

    @classmethod
    def of(cls, data: Value) -> Self:
        """The result with the fields of `data`, which is of a base class."""
        return cls(**{one.name: getattr(data, one.name) for one in fields(data)})

    if TYPE_CHECKING:

        @property
        def figures(self) -> dict[str, Any]:
            """Plain data (numbers, text, lists and mappings), lengths and angles in the units that the names state."""
            raise NotImplementedError

    def summary(self) -> str:
        """The main figures, as lines of text."""
        raise NotImplementedError

    def picture(self) -> bytes | None:
        """Picture as PNG; None if there is nothing to draw."""
        return None

    def __str__(self) -> str:
        return self.summary()

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.summary().partition(chr(10))[0].strip()})"

    def _repr_png_(self) -> bytes | None:
        return self.picture()

    def _repr_html_(self) -> str:
        image = self.picture()
        drawn = f'<img width="800" src="data:image/png;base64,{b64encode(image).decode()}">' if image else ""
        rows = (f"<tr><th>{escape(name)}</th><td>{escape(value)}</td></tr>" for name, value in _rows(self.figures))
        return f"{drawn}<table>{''.join(rows)}</table>"


def _rows(figures: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, str]]:
    """Names and texts of all figures that are not lists."""
    for name, value in figures.items():
        if isinstance(value, Mapping):
            yield from _rows(value, f"{prefix}{name}.")
        elif isinstance(value, float):
            yield prefix + name, f"{value:.6g}"
        elif not isinstance(value, list | tuple):
            yield prefix + name, str(value)


class Closing(ABC):
    """A context manager whose end is `close`."""

    @abstractmethod
    def close(self) -> None:
        """Release what the object holds."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
