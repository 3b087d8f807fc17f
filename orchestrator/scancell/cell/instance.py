"""One instance of the robot cell FMU, by variable name, for FMI 2 and FMI 3; records and logs of its run."""

from __future__ import annotations

import atexit
import math
import shutil
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from ctypes import POINTER, c_double, c_size_t, c_uint32
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
from fmpy import fmi2
from fmpy.fmi1 import FMICallException
from fmpy.fmi2 import FMU2Slave, fmi2CallbackFunctions, fmi2CallbackLoggerTYPE
from fmpy.fmi3 import FMU3Slave
from numpy.typing import ArrayLike, NDArray

from scancell.arguments import checked_arguments
from scancell.arrays import Array
from scancell.cell.recording import INTEGER_COLUMNS, Recording, RecordLayout
from scancell.errors import CellError, DescriptionError
from scancell.values import Closing

_STATUS_WARNING = 1
_DOUBLES = POINTER(c_double)


# Chooses values (SI) of fixed parameters, knowing the names and units of those that the FMU has.
Parameters = Callable[[Mapping[str, str | None]], Mapping[str, float]]

_OF_EXPOSURE = ("trigger.time", "trigger.exposure")
_RECORD = "trigger."
# Beyond every trigger index, which are 32 bits wide: the index seeds the noise of an image.
_FIRST_INDEX = 1 << 31

_RECORD_NUMBERS = (*INTEGER_COLUMNS, "trigger.queued")
# A record must arrive within this time of its exposure, or the cell is not working.
PATIENCE_US = 5_000_000


class RealGroup:
    """Value references of some real variables, with a buffer for their values: `sizes` of them each, 1 by default."""

    def __init__(self, references: Sequence[int], sizes: Sequence[int] | None = None) -> None:
        self.count = len(references)
        self.references = (c_uint32 * self.count)(*references)
        self.values: NDArray[np.float64] = np.zeros(self.count if sizes is None else sum(sizes))
        self.pointer = self.values.ctypes.data_as(_DOUBLES)


class CellInstance(Closing):
    """An initialised robot cell. Use it as a context manager; times are whole microseconds.

    Parameters
    ----------
    fmu
        An FMU file, or the folder of an unpacked one (`make_temporary_fmu`).
    cell_file
        Description of the cell (JSON) to use in place of the FMU's own, with as many devices of each kind.
    parameters
        Function that gets the units of the ``as_built.*`` parameters by name (see `units`) and returns the values, SI,
        of those fixed parameters that are to be set.
    folder
        Where an FMU file is unpacked; the system's folder for temporary files if not given.

    Attributes
    ----------
    token
        Identifies the FMU's table of variables.
    folder
        Where the FMU is unpacked.

    Raises
    ------
    CellError
        If the FMU cannot be loaded or refuses a call, with the message that it logged. After an error of the FMU the
        instance takes no more calls but `reset` and `close`.

    Examples
    --------
    >>> setup = scancell.load_setup()
    >>> nominal = scancell.nominal_cell(setup.cell, None)
    >>> fmu = scancell.make_temporary_fmu(scancell.cell_json(setup.cell, nominal, seed=0), "fmu")
    >>> with scancell.CellInstance(fmu) as cell:
    ...     table = cell.real_group(["command.table", "measured.table"])
    ...     cell.set(cell.real_group(["command.table"]), np.array([0.01]))
    ...     cell.set_integer("command.mode", scancell.Mode.SERVO)
    ...     cell.step_to(500_000)
    ...     cell.get(table).round(3)
    array([0.01, 0.01])
    """

    @checked_arguments
    def __init__(
        self,
        fmu: str | Path,
        cell_file: Path | None = None,
        parameters: Parameters | None = None,
        folder: Path | None = None,
    ) -> None:
        self._messages: list[str] = []
        self._listeners: list[Callable[[], object]] = []
        # FMPy's function and value references by names; None where the types differ.
        self._integer_getters: dict[tuple[str, ...], tuple[Any, list[int]] | None] = {}
        self._unpacked: Path | None = None
        self.folder = Path(fmu).absolute()
        self._time_us = 0
        self._is_closed = False
        try:
            if not self.folder.is_dir():
                self.folder = self._unpack(self.folder, folder)
            self._load(self.folder)
            values = parameters(self.units()) if parameters else {}
            self._instantiate()
            self._enter(cell_file, values)
        except BaseException as error:  # an interrupt, too, must leave no unpacked files
            self._remove_unpacked()
            if isinstance(error, DescriptionError) or not isinstance(error, Exception):
                raise
            raise CellError(self._explain(f"the cell cannot be started from {Path(fmu).name}", error)) from error

    def _unpack(self, fmu: Path, folder: Path | None) -> Path:
        self._unpacked = Path(tempfile.mkdtemp(prefix="scancell-fmu-", dir=folder))
        # An interrupt may hit the removal itself; the end of the process tries once more.
        atexit.register(self._remove_unpacked)
        fmpy.extract(str(fmu), str(self._unpacked))
        return self._unpacked

    def _remove_unpacked(self) -> None:
        if self._unpacked is None:
            return
        shutil.rmtree(self._unpacked, ignore_errors=True)
        atexit.unregister(self._remove_unpacked)

    def _load(self, unpacked: Path) -> None:
        description = fmpy.read_model_description(str(unpacked), validate=False)
        self.token = str(description.guid)
        self._variables = {variable.name: variable for variable in description.modelVariables}
        self._is_fmi2 = description.fmiVersion.startswith("2")
        slave = FMU2Slave if self._is_fmi2 else FMU3Slave
        self._fmu: Any = slave(
            guid=description.guid,
            unzipDirectory=str(unpacked),
            modelIdentifier=description.coSimulation.modelIdentifier,
            instanceName="cell",
        )

    def _instantiate(self) -> None:
        if self._is_fmi2:
            callbacks = fmi2CallbackFunctions()
            callbacks.logger = fmi2CallbackLoggerTYPE(self._log)
            callbacks.allocateMemory = fmi2.defaultCallbacks.allocateMemory
            callbacks.freeMemory = fmi2.defaultCallbacks.freeMemory
            self._fmu.instantiate(callbacks=callbacks)
        else:
            self._fmu.instantiate(logMessage=self._log)

    def axis_names(self, prefix: str) -> list[str]:
        """Names of the variables of all axes after a `prefix` such as ``measured.``: joints, table, further axes."""
        joints = sum(name.startswith("measured.q[") for name in self._variables)
        first = "measured.axis."
        further = [name.removeprefix(first) for name in self._variables if name.startswith(first)]
        return [
            *(f"{prefix}q[{i}]" for i in range(1, joints + 1)),
            f"{prefix}table",
            *(f"{prefix}axis.{name}" for name in further),
        ]

    def prismatic_axes(self) -> list[bool]:
        """Whether each of the axes of `axis_names` is prismatic: its positions are in m."""
        return [self._unit(name) == "m" for name in self.axis_names("measured.")]

    def reset(self, cell_file: Path | None = None, parameters: Mapping[str, float] | None = None) -> None:
        """Reset to time 0 without loading the FMU again.

        Nothing listens to the steps of the new run.

        Parameters
        ----------
        cell_file
            Description of another cell (JSON); None: the last one.
        parameters
            Values of fixed parameters by name, SI.

        Raises
        ------
        CellError
            If the FMU refuses; the instance is of no further use then.
        """
        self._call(self._fmu.reset)
        self._listeners.clear()
        self._time_us = 0
        self._call(self._enter, cell_file, parameters or {})

    def _enter(self, cell_file: Path | None, parameters: Mapping[str, float]) -> None:
        if cell_file is not None:
            reference = [self._variables["cell.file"].valueReference]
            self._fmu.setString(reference, [str(cell_file)])
        for name, value in parameters.items():
            number, variable = self._reference(name), self._variables[name]
            setter = self._fmu.setReal if self._is_fmi2 else self._fmu.setFloat64
            if variable.type.startswith("Int"):
                setter = self._fmu.setInteger if self._is_fmi2 else self._fmu.setInt32
            setter([number], [value])
        if self._is_fmi2:
            self._fmu.setupExperiment(startTime=0.0)
            self._fmu.enterInitializationMode()
        else:
            self._fmu.enterInitializationMode(startTime=0.0)
        self._fmu.exitInitializationMode()

    def _log(self, *values: Any) -> None:
        """Keep an error that the FMU logs; status, category and message follow what FMI 2 and 3 state differently."""
        status, _category, message = values[-3:]
        if status > _STATUS_WARNING:
            self._messages.append(message.decode(errors="replace"))

    def _explain(self, what: str, error: Exception) -> str:
        # The keys of the FMU's own description are named, but not its file, which is temporary.
        own = self.folder / "resources" / "cell.json"
        reason = ("; ".join(self._messages) or str(error)).replace(f"{own}: ", "")
        self._messages.clear()
        return f"{what}: {reason}"

    def units(self) -> dict[str, str | None]:
        """Unit of every ``as_built.*`` parameter by name; None where it has none."""
        return {name: self._unit(name) for name in self._variables if name.startswith("as_built.")}

    def _unit(self, name: str) -> str | None:
        variable = self._variables[name]
        unit = variable.unit if variable.declaredType is None else variable.declaredType.unit
        return None if unit is None else str(unit)

    @property
    def names(self) -> list[str]:
        """Names of all variables."""
        return list(self._variables)

    def real_group(self, names: Iterable[str]) -> RealGroup:
        """A group of real variables for `get` and `set`, in the order of `names`.

        Raises
        ------
        CellError
            If the FMU has no such variable.
        """
        names = list(names)
        references = [self._reference(name) for name in names]
        sizes = [math.prod(int(d.start) for d in self._variables[name].dimensions) for name in names]
        return RealGroup(references, sizes)

    def path_ahead(self, points: int) -> RealGroup:
        """The group of the first `points` points of the controller's path ahead, each with all axes.

        Raises
        ------
        CellError
            If the FMU was built without the path ahead, or has fewer points.
        """
        if "controller.ahead" in self._variables:  # one array, FMI 3
            return self.real_group(["controller.ahead"])
        if "controller.ahead[1].table" not in self._variables:
            raise CellError("the FMU does not describe the path ahead of the controller: build it with `ahead`")
        axes = self.axis_names("")
        return self.real_group([f"controller.ahead[{k}].{name}" for k in range(1, points + 1) for name in axes])

    def _reference(self, name: str) -> int:
        if name not in self._variables:
            raise CellError(f"the FMU has no variable '{name}'")
        return int(self._variables[name].valueReference)

    def get(self, group: RealGroup) -> NDArray[np.float64]:
        """Values (n,) of a `group` of `real_group`, SI; the array is overwritten by the next call.

        Raises
        ------
        CellError
            If one of the variables is not real.
        """
        self._call(self._transfer, "Get", group)
        return group.values

    def set(self, group: RealGroup, values: NDArray[np.float64]) -> None:
        """Set the inputs of a `group` of `real_group` to `values` (n,), SI.

        Raises
        ------
        CellError
            If one of them is no input, or a value is not finite.
        """
        group.values[:] = values
        self._call(self._transfer, "Set", group)

    def get_integer(self, name: str) -> int:
        """Value of the integer or enumeration variable `name`; `CellError` if there is none."""
        return self.get_integers([name])[0]

    def get_integers(self, names: Iterable[str]) -> list[int]:
        """Values of the integer and enumeration variables `names`; `CellError` if one does not exist."""
        names = tuple(names)
        if names not in self._integer_getters:
            access = {self._integer_access("get", name) for name in names}
            references = [self._reference(name) for name in names]
            self._integer_getters[names] = (getattr(self._fmu, access.pop()), references) if len(access) == 1 else None
        getter = self._integer_getters[names]
        return list(self._call(*getter)) if getter else [self.get_integer(name) for name in names]

    def get_boolean(self, name: str) -> bool:
        """Value of the Boolean variable `name`; `CellError` if there is none."""
        return bool(self._call(self._fmu.getBoolean, [self._reference(name)])[0])

    def set_integer(self, name: str, value: int) -> None:
        """Set the integer or enumeration input `name` to `value`; `CellError` if there is no such input."""
        self._call(getattr(self._fmu, self._integer_access("set", name)), [self._reference(name)], [value])

    def _integer_access(self, verb: str, name: str) -> str:
        """FMPy's function: in FMI 3, enumerations have 64 bits."""
        self._reference(name)
        enumeration = self._variables[name].type == "Enumeration"
        return verb + ("Integer" if self._is_fmi2 else "Int64" if enumeration else "Int32")

    def set_boolean(self, name: str, value: bool) -> None:
        """Set the Boolean input `name` to `value`; `CellError` if there is no such input."""
        self._call(self._fmu.setBoolean, [self._reference(name)], [value])

    def set_string(self, name: str, value: str) -> None:
        """Set the string input `name` to `value`; `CellError` if there is no such input."""
        self._call(self._fmu.setString, [self._reference(name)], [value])

    def get_string(self, name: str) -> str:
        """Value of the string variable `name`; `CellError` if there is none."""
        value = self._call(self._fmu.getString, [self._reference(name)])[0]
        return value.decode() if isinstance(value, bytes) else str(value)

    def on_step(self, listener: Callable[[], object]) -> Callable[[], None]:
        """Call `listener`, without arguments, after every communication step, until the returned function is called."""
        self._listeners.append(listener)

        def end() -> None:
            self._listeners = [one for one in self._listeners if one is not listener]

        return end

    def on_cycle(self, cycle_us: int, listener: Callable[[], object]) -> None:
        """Call `listener` after every communication step that reaches or passes the end of a cycle of `cycle_us` µs."""
        done = self._time_us // cycle_us

        def look() -> None:
            nonlocal done
            before, done = done, self._time_us // cycle_us
            if done > before:
                listener()

        self.on_step(look)

    @property
    def time_us(self) -> int:
        """Simulated time, µs."""
        return self._time_us

    def step_to(self, time_us: int) -> None:
        """Advance to `time_us`, later than now, in one communication step.

        Raises
        ------
        CellError
            If the FMU reports an error.
        """
        start, size = self._time_us * 1e-6, (time_us - self._time_us) * 1e-6
        self._call(self._fmu.doStep, start, size)
        self._time_us = time_us
        for listener in self._listeners:
            listener()

    def _transfer(self, verb: str, group: RealGroup) -> None:
        """Get or set all values of a group by one call of the FMU."""
        fmu, values = self._fmu, (group.references, c_size_t(group.count), group.pointer)
        if self._is_fmi2:
            getattr(fmu, f"fmi2{verb}Real")(fmu.component, *values)
        else:
            getattr(fmu, f"fmi3{verb}Float64")(fmu.component, *values, c_size_t(group.values.size))

    def _call(self, function: Any, *arguments: Any) -> Any:
        if self._is_closed:  # the FMU would read memory that is free
            raise CellError(
                "the robot cell is closed: use it, its session or robot inside the `with` statement that opened it"
            )
        try:
            return function(*arguments)
        except Exception as error:
            raise CellError(self._explain("the robot cell FMU reported an error", error)) from error

    def close(self) -> None:
        """Free the instance and its unpacked files; every later call but this one raises `CellError`."""
        if self._is_closed:
            return
        self._is_closed = True
        try:
            # After an error an FMU may refuse to terminate; what is left is to free it, and the first error counts.
            with suppress(FMICallException):
                self._fmu.terminate()
            self._fmu.freeInstance()
        finally:
            self._remove_unpacked()


def snapshot(cell: CellInstance, exposure: float, number: int = 0) -> Recording:
    """One row: axes, poses and twists at the present instant, as of an exposure whose middle is now.

    The cell is not stepped, and its trigger records are not touched; as-built latency and jitter of the trigger do not
    apply.

    Parameters
    ----------
    exposure
        Duration of the exposure, s.
    number
        Number of the snapshot, from 0; another number gives other image noise.
    """
    present = _present_columns(cell)
    values = cell.get(cell.real_group([name.removeprefix(_RECORD) for name in present]))
    row = [cell.time_us * 1e-6, exposure, *values]
    return _recording([(_FIRST_INDEX + number, 0)], [*_OF_EXPOSURE, *present], [row])


def _present_columns(cell: CellInstance) -> list[str]:
    """Columns of a recording that the cell also states for the present instant, without ``trigger.``."""
    layout = RecordLayout.of(cell.names)
    return [name for name in (*layout.measured, *layout.truth) if name not in _OF_EXPOSURE]


def _recording(numbers: Sequence[tuple[int, int]], names: Sequence[str], rows: ArrayLike) -> Recording:
    """Recording of rows of numbers (`INTEGER_COLUMNS`) and of values of the columns `names`."""
    integers = np.array(numbers, np.int64).reshape(-1, len(INTEGER_COLUMNS))
    reals = np.array(rows, float).reshape(-1, len(names))
    return Recording(dict(zip(INTEGER_COLUMNS, integers.T, strict=True)) | dict(zip(names, reals.T, strict=True)))


class MotionLog:
    """Axes, poses and twists of a cell from now on until `end`, at least `interval_us` µs apart; the last ones always.

    Attributes
    ----------
    end
        Ends the log.
    """

    def __init__(self, cell: CellInstance, interval_us: int) -> None:
        self._cell, self._interval_us = cell, interval_us
        self._columns = _present_columns(cell)
        self._group = cell.real_group([name.removeprefix(_RECORD) for name in self._columns])
        self._times_us: list[int] = []
        self._rows: list[NDArray[np.float64]] = []
        self._look()
        self.end = cell.on_step(self._look)

    def _look(self) -> None:
        if len(self._rows) > 1 and self._times_us[-1] - self._times_us[-2] < self._interval_us:
            self._times_us.pop()
            self._rows.pop()
        self._times_us.append(self._cell.time_us)
        self._rows.append(self._cell.get(self._group).copy())

    @property
    def recording(self) -> Recording:
        """All poses as a recording whose rows are no exposures: these are 0 s long."""
        numbers = [(number, 0) for number in range(1, len(self._rows) + 1)]
        rows = np.column_stack([1e-6 * np.array(self._times_us), np.zeros(len(numbers)), self._rows])
        return _recording(numbers, [*_OF_EXPOSURE, *self._columns], rows)


@dataclass(frozen=True)
class RecordBatches:
    """Passes records on as they arrive: `size` at a time, fewer at the end."""

    size: int
    receive: Callable[[Recording], object]


class RecordCollector:
    """Steps a cell and keeps every trigger record from now on.

    The FMU shows one record per communication step: while records wait, a step is divided into as many.

    Parameters
    ----------
    cycle_us
        The controller's cycle.
    exposure
        Duration of the exposures, s.
    batches
        Receives the records in addition.
    """

    def __init__(
        self, cell: CellInstance, cycle_us: int, exposure: float, batches: RecordBatches | None = None
    ) -> None:
        self._cell, self._cycle_us, self._batches = cell, cycle_us, batches
        self._passed_on = 0
        layout = RecordLayout.of(cell.names)
        self._columns = (*layout.measured, *layout.truth)
        self._group = cell.real_group(self._columns)
        self._records: list[NDArray[np.float64]] = []
        self._numbers: list[tuple[int, int]] = []
        # The cell may have run before, and still show or queue records of that run.
        self._last, self._queued = cell.get_integers(["trigger.count", "trigger.queued"])
        cell.set(cell.real_group(["command.exposure"]), np.array([exposure]))

    def __len__(self) -> int:
        return len(self._records)

    def step_to(self, time_us: int) -> None:
        """Step to `time_us`, in one communication step and one more for each record that waits."""
        start_us = self._cell.time_us
        steps = min(1 + self._queued, time_us - start_us)
        for k in range(1, steps + 1):
            self._cell.step_to(start_us + (time_us - start_us) * k // steps)
            index, segment, self._queued = self._cell.get_integers(_RECORD_NUMBERS)
            if index > self._last:
                self._last = index
                self._numbers.append((index, segment))
                self._records.append(self._cell.get(self._group).copy())
        if self._batches is not None and len(self) - self._passed_on >= self._batches.size:
            self.pass_on()

    def pass_on(self) -> None:
        """Pass on the records of an incomplete batch, such as those before a stop."""
        if self._batches is not None and len(self) > self._passed_on:
            first, self._passed_on = self._passed_on, len(self)
            self._batches.receive(_recording(self._numbers[first:], self._columns, self._records[first:]))

    def finish(self) -> Recording:
        """Step until no record is queued or pending; returns all records.

        Raises
        ------
        CellError
            If a record never comes.
        """
        limit = self._cell.time_us + PATIENCE_US
        while self._cell.get_integer("trigger.count") > self._last:
            if self._cell.time_us > limit:
                raise CellError("trigger records are missing at the end of the program")
            self.step_to(self._cell.time_us + self._cycle_us)
        self.pass_on()
        return _recording(self._numbers, self._columns, self._records)


class SignalLog:
    """Values of variables from now on, at every communication step.

    Parameters
    ----------
    cell
        Running instance (`CellSession.cell`).
    reals
        Names of real variables.
    booleans
        Names of Boolean variables, which count 0 and 1.

    Raises
    ------
    CellError
        If the cell has no such variable.

    Examples
    --------
    >>> with scancell.Scanner() as scanner, scanner.session("part.stl") as session:
    ...     log = scancell.SignalLog(session.cell, ["measured.table"], ["controller.moving"])
    ...     session.turn_table(0.5)
    >>> log["measured.table"][[0, -1]].round(3)
    array([0. , 0.5])
    >>> bool(np.all(np.diff(log["measured.table"]) >= 0)), int(log["controller.moving"].max())
    (True, 1)
    """

    @checked_arguments
    def __init__(self, cell: CellInstance, reals: Sequence[str], booleans: Sequence[str] = ()) -> None:
        self._cell = cell
        self._reals, self._booleans = tuple(reals), tuple(booleans)
        self._group = cell.real_group(self._reals)
        self._rows: list[Array] = []
        self._listen()
        cell.on_step(self._listen)

    def _listen(self) -> None:
        seen = [float(self._cell.get_boolean(name)) for name in self._booleans]
        self._rows.append(np.concatenate([[self._cell.time_us * 1e-6], self._cell.get(self._group), seen]))

    @property
    def time(self) -> Array:
        """Instants (n,) in s, the present one at the beginning first."""
        return np.array([row[0] for row in self._rows])

    def __getitem__(self, name: str) -> Array:
        """Values (n,) of the variable `name` at the instants of `time`, SI; `KeyError` where it is not logged."""
        names = (*self._reals, *self._booleans)
        if name not in names:
            raise KeyError(name)
        column = 1 + names.index(name)
        return np.array([row[column] for row in self._rows])
