"""The exception tree: every error that a user can cause or correct derives from `ScancellError`.

Errors about values derive from `ValueError` as well.
"""

from __future__ import annotations

import pickle
from collections.abc import Mapping, Sequence
from copy import copy
from importlib import import_module
from os import PathLike
from typing import Any, Self

_ABSENT: Any = object()
_LONGEST = 80  # characters of a value in a message


class ScancellError(Exception):
    """An error for users: ``FILE: KEY = VALUE: PROBLEM; expected EXPECTED``, without the parts that do not apply.

    Parameters
    ----------
    problem
        What is wrong, where key, value and what was expected do not say it. Arguments of functions stand in
        backticks. A message that names none of the other parts is given as `problem` alone.
    file, key, value, expected
        See the attributes; None, or left out, where they do not apply.

    Attributes
    ----------
    file : str or None
        File, or other source, that holds the key.
    key : str or None
        Key of a file, or argument of a function.
    value : object
        Its value.
    expected : str or None
        What was expected in place of the value.
    problem : str
        What is wrong.

    Examples
    --------
    >>> try:
    ...     scancell.scan("part.stl", settings={"scan.max_profiles": 0})
    ... except scancell.ScancellError as error:
    ...     error.key, error.value, error.expected
    ('max_profiles', 0, 'greater than or equal to 1')
    """

    def __init__(
        self,
        problem: str = "",
        *,
        file: str | PathLike[str] | None = None,
        key: str | None = None,
        value: object = _ABSENT,
        expected: str | None = None,
    ) -> None:
        self.problem, self.key, self.expected = problem, key, expected
        self.file = None if file is None else str(file)
        self.value = None if value is _ABSENT else value
        self._subject = [] if key is None else [key] if value is _ABSENT else [key, shown(value)]
        self._joined: tuple[Self, ...] = ()
        super().__init__(self._message(" = ".join(self._subject)))

    @classmethod
    def of_all(cls, errors: Sequence[Self]) -> Self:
        """One error of several, each on a line of its own; its attributes are those of the first."""
        if len(errors) == 1:
            return errors[0]
        made = cls("\n".join(map(str, errors)))
        made.__dict__.update(errors[0].__dict__)
        made._joined = tuple(errors)
        return made

    def within(self, source: str) -> Self:
        """The error as of something inside `source`, which its message begins with."""
        if self._joined:
            return self.of_all([error.within(source) for error in self._joined])
        made = copy(self)
        made.file = source if self.file is None else f"{source}: {self.file}"
        made.args = (made._message(" = ".join(self._subject)),)
        return made

    @property
    def problems(self) -> tuple[Self, ...]:
        """The errors that this one joins; itself where it joins none."""
        return self._joined or (self,)

    def in_options(self, options: Mapping[str, str]) -> str:
        """The message for users of a command, where `options` gives the option of each argument."""
        if self._joined:
            return "\n".join(error.in_options(options) for error in self._joined)
        text = str(self)
        option = None if self.file is not None or self.key is None else options.get(self.key)
        if option is not None:
            value = self.value if isinstance(self.value, str) else "".join(self._subject[1:])
            text = self._message(f"{option} {value}".strip())
        return named_by(text, options)

    def _message(self, subject: str) -> str:
        states_it = self.expected is None or self.problem.endswith(self.expected)
        parts = [self.problem] if states_it else [self.problem, f"expected {self.expected}"]
        return ": ".join(filter(None, (self.file, subject, "; ".join(filter(None, parts)))))

    def __reduce__(self) -> tuple[Any, ...]:
        state = dict(self.__dict__)
        try:
            pickle.dumps(self.value)
        except Exception:  # of a foreign object
            state["value"] = shown(self.value)
        return type(self), self.args, state


class DescriptionError(ScancellError, ValueError):
    """A cell, sensor or scan description is wrong (unknown key, missing key, value out of bounds).

    Examples
    --------
    >>> scancell.ScanDescription(max_profiles=0)
    Traceback (most recent call last):
        ...
    scancell.errors.DescriptionError: ScanDescription: max_profiles = 0: must be greater than or equal to 1
    """


class MeshError(ScancellError, ValueError):
    """A mesh file is missing, unreadable, empty or broken.

    Examples
    --------
    >>> scancell.load_part("missing.stl")
    Traceback (most recent call last):
        ...
    scancell.errors.MeshError: missing.stl: no such file
    """


class PlanningError(ScancellError):
    """A scan cannot be carried out: unreachable, outside limits, or colliding poses.

    Examples
    --------
    >>> scancell.plan("part.stl", settings={"cell.part.x_mm": 1000})
    Traceback (most recent call last):
        ...
    scancell.errors.PlanningError: part.stl: too large for the table: ...
    """


class CellError(ScancellError):
    """The FMU rejected a call or reported an error.

    Examples
    --------
    >>> scancell.CellInstance("missing.fmu")
    Traceback (most recent call last):
        ...
    scancell.errors.CellError: the cell cannot be started from missing.fmu: ...
    """


class CommandError(CellError):
    """The cell's controller rejected a command, stopped it, or did not finish it in time.

    Examples
    --------
    >>> with scancell.Scanner() as scanner, scanner.session() as session:
    ...     session.move_joints(np.full(6, 9.0))
    Traceback (most recent call last):
        ...
    scancell.errors.CommandError: move_joints: the target of joint 1 is outside its limits
    """


class ProgramError(ScancellError):
    """A robot program failed; the message states its file and line.

    Examples
    --------
    >>> issubclass(scancell.ProgramError, scancell.ScancellError)
    True
    """


class SensorError(ScancellError, ValueError):
    """The sensor library rejected its input.

    Examples
    --------
    >>> issubclass(scancell.SensorError, ValueError)
    True
    """


class CalibrationError(ScancellError):
    """Measured data do not determine what is to be calibrated; the message states what is missing.

    Examples
    --------
    >>> scancell.calibrate_sensor(scancell.SensorCalibrationRequest(also=("sensor.lens",)))
    Traceback (most recent call last):
        ...
    scancell.errors.CalibrationError: also = 'sensor.lens': expected one of the keys baseline_mm, ...
    """


class ImageError(ScancellError, ValueError):
    """An image file is missing, unreadable, or inconsistent with the sensor's description.

    Examples
    --------
    >>> scancell.extract(["part.stl"], "profiles")
    Traceback (most recent call last):
        ...
    scancell.errors.ImageError: part.stl: names no camera; ...
    """


class OutputError(ScancellError):
    """A result cannot be written.

    Examples
    --------
    >>> result = scancell.scan("part.stl", engine="geometric", settings={"scan.max_profiles": 20})
    >>> result.save("part.stl")
    Traceback (most recent call last):
        ...
    scancell.errors.OutputError: part.stl: is a file; expected a folder
    """


class WorkersError(ScancellError):
    """Work cannot be distributed, its scheduler is gone, or all of it failed.

    Examples
    --------
    >>> issubclass(scancell.WorkersError, scancell.ScancellError)
    True
    """


class MessageError(ScancellError, ValueError):
    """A message between cell and guard is malformed, or holds a value outside its bounds.

    Examples
    --------
    >>> issubclass(scancell.MessageError, ValueError)
    True
    """


class LinkError(ScancellError):
    """No socket can be opened: between cell and guard, or for browsers.

    Examples
    --------
    >>> scancell.TcpTransport("127.0.0.1", 1)
    Traceback (most recent call last):
        ...
    scancell.errors.LinkError: 127.0.0.1:1: ...; expected a guard that listens there
    """


class FitError(ScancellError, ValueError):
    """Points do not determine a geometric element; the message states what is missing.

    Examples
    --------
    >>> scancell.evaluate(np.zeros((3, 3)), mesh="part.stl", align="best-fit")
    Traceback (most recent call last):
        ...
    scancell.errors.FitError: best fit: 3 points; at least 6 are needed
    """


class EmptyScanError(ScancellError):
    """A scan gave no point of the part; the message states the cause and the key to change.

    Examples
    --------
    >>> scancell.scan(scancell.box_mesh((1e-4, 1e-4, 1e-4)), engine="geometric")
    Traceback (most recent call last):
        ...
    scancell.errors.EmptyScanError: box: the scan gave no point: ... lower scan.table_margin_mm
    """


class CancelledError(ScancellError):
    """The progress callback asked to stop.

    Examples
    --------
    >>> scancell.scan("part.stl", progress=lambda stage, done, total: False)
    Traceback (most recent call last):
        ...
    scancell.errors.CancelledError: cancelled while loading (0 of 1)
    """


class MissingExtraError(ScancellError):
    """A package of an optional extra is not installed; the message states the command that installs it.

    Examples
    --------
    >>> try:
    ...     scancell.acceptance(quick=True, repeats=1, seed=-1, out="report")
    ... except scancell.MissingExtraError as error:
    ...     print(error)
    ... except scancell.DescriptionError:
    ...     print("the extra is there")
    the extra is there
    """


def named_by(text: str, options: Mapping[str, str]) -> str:
    """A message for users of a command, with `options` in place of the arguments that stand in backticks."""
    for argument, option in options.items():
        text = text.replace(f"`{argument}`", option)
    return text


def shown(value: Any) -> str:
    """A value in a message, on one line and not too long; a scalar of NumPy as the plain number."""
    try:
        text = " ".join(repr(value.item() if getattr(value, "shape", None) == () else value).split())
    except Exception:  # of a foreign object
        text = type(value).__name__
    return text if len(text) <= _LONGEST else f"{text[:_LONGEST]}… ({type(value).__name__})"


def require(module: str, extra: str) -> Any:
    """Import `module`, which ``pip install "scancell[extra]"`` provides.

    Raises `MissingExtraError` if the package is not installed, with the command that installs it.
    """
    try:
        return import_module(module)
    except ModuleNotFoundError as error:
        package = module.partition(".")[0]
        if (error.name or "").partition(".")[0] != package:
            raise  # the package is there; one of its own dependencies is missing
        raise MissingExtraError(
            f'{package} is not installed; install it with: pip install "scancell[{extra}]"'
        ) from None
