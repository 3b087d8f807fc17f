"""One instance of the robot cell FMU, by variable name, for FMI 2 and FMI 3."""

from __future__ import annotations

import atexit
import math
import shutil
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from ctypes import POINTER, c_double, c_size_t, c_uint32
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
from fmpy import fmi2
from fmpy.fmi1 import FMICallException
from fmpy.fmi2 import FMU2Slave, fmi2CallbackFunctions, fmi2CallbackLoggerTYPE
from fmpy.fmi3 import FMU3Slave
from numpy.typing import NDArray

from scancell.arguments import checked_arguments
from scancell.closing import Closing
from scancell.errors import CellError, DescriptionError

_STATUS_WARNING = 1
_DOUBLES = POINTER(c_double)


# Chooses values (SI) of fixed parameters, knowing the names and units of those that the FMU has.
Parameters = Callable[[Mapping[str, str | None]], Mapping[str, float]]


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
            self._initialise(cell_file, parameters(self.units()) if parameters else {})
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

    def axis_names(self, prefix: str) -> list[str]:
        """Names of the variables of all axes after a `prefix` such as ``measured.``: joints, then table."""
        joints = sum(name.startswith("measured.q[") for name in self._variables)
        return [*(f"{prefix}q[{i}]" for i in range(1, joints + 1)), f"{prefix}table"]

    def _initialise(self, cell_file: Path | None, parameters: Mapping[str, float]) -> None:
        self._fmu.instantiate(**self._callbacks())
        self._enter(cell_file, parameters)

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
        self._set_parameters(parameters)
        if self._is_fmi2:
            self._fmu.setupExperiment(startTime=0.0)
            self._fmu.enterInitializationMode()
        else:
            self._fmu.enterInitializationMode(startTime=0.0)
        self._fmu.exitInitializationMode()

    def _callbacks(self) -> dict[str, Any]:
        if self._is_fmi2:
            callbacks = fmi2CallbackFunctions()
            callbacks.logger = fmi2CallbackLoggerTYPE(self._log_fmi2)
            callbacks.allocateMemory = fmi2.defaultCallbacks.allocateMemory
            callbacks.freeMemory = fmi2.defaultCallbacks.freeMemory
            return {"callbacks": callbacks}
        return {"logMessage": self._log_fmi3}

    def _log_fmi2(self, _environment: Any, _name: Any, status: int, _category: Any, message: bytes) -> None:
        if status > _STATUS_WARNING:
            self._messages.append(message.decode(errors="replace"))

    def _log_fmi3(self, _environment: Any, status: int, _category: Any, message: bytes) -> None:
        if status > _STATUS_WARNING:
            self._messages.append(message.decode(errors="replace"))

    def _explain(self, what: str, error: Exception) -> str:
        # The keys of the FMU's own description are named, but not its file, which is temporary.
        own = self.folder / "resources" / "cell.json"
        reason = ("; ".join(self._messages) or str(error)).replace(f"{own}: ", "")
        self._messages.clear()
        return f"{what}: {reason}"

    def _set_parameters(self, parameters: Mapping[str, float]) -> None:
        for name, value in parameters.items():
            reference, variable = self._reference(name), self._variables[name]
            setter = self._fmu.setReal if self._is_fmi2 else self._fmu.setFloat64
            if variable.type.startswith("Int"):
                setter = self._fmu.setInteger if self._is_fmi2 else self._fmu.setInt32
            setter([reference], [value])

    def units(self) -> dict[str, str | None]:
        """Unit of every ``as_built.*`` parameter by name; None where it has none."""
        return {
            name: v.declaredType.unit if v.declaredType is not None else v.unit
            for name, v in self._variables.items()
            if name.startswith("as_built.")
        }

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
        self._call(self._get_reals, group)
        return group.values

    def set(self, group: RealGroup, values: NDArray[np.float64]) -> None:
        """Set the inputs of a `group` of `real_group` to `values` (n,), SI.

        Raises
        ------
        CellError
            If one of them is no input, or a value is not finite.
        """
        group.values[:] = values
        self._call(self._set_reals, group)

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

    def _get_reals(self, group: RealGroup) -> None:
        if self._is_fmi2:
            self._fmu.fmi2GetReal(self._fmu.component, group.references, c_size_t(group.count), group.pointer)
        else:
            count, size = c_size_t(group.count), c_size_t(group.values.size)
            self._fmu.fmi3GetFloat64(self._fmu.component, group.references, count, group.pointer, size)

    def _set_reals(self, group: RealGroup) -> None:
        if self._is_fmi2:
            self._fmu.fmi2SetReal(self._fmu.component, group.references, c_size_t(group.count), group.pointer)
        else:
            count, size = c_size_t(group.count), c_size_t(group.values.size)
            self._fmu.fmi3SetFloat64(self._fmu.component, group.references, count, group.pointer, size)

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
