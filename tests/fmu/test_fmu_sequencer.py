"""The FMU of the sequencer in FMI 2 and FMI 3: trajectories, states, log, illegal calls."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import fmpy
import pytest
from cell_fixture import cell_description, conveyor
from fmpy import fmi2
from fmpy.fmi2 import FMU2Slave, fmi2CallbackFunctions, fmi2CallbackLoggerTYPE
from fmpy.fmi3 import FMU3Slave
from fmpy.validation import validate_fmu

from scancell.cell.fmu_file import build_sequencer_fmu
from scancell.cell.fmu_package import FmiVersion

STEP = 0.016
CELL = {**cell_description(), "conveyors": [conveyor()]}
SEQUENCE: dict[str, float | int] = {
    "steps": 3,
    "step[1].duration": 0.1, "step[1].q[2]": -0.3, "step[1].mode": 1,
    "step[2].duration": 0.05, "step[2].until": 1, "step[2].conveyor[1].speed": 0.2,
    "step[3].duration": 0.1, "step[3].speed": 0.5,
}  # fmt: skip


@pytest.fixture(scope="module", params=[2, 3])
def package(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A packed FMU."""
    version: FmiVersion = request.param
    file = tmp_path_factory.mktemp("sequencer") / f"CellSequencer{version}.fmu"
    build_sequencer_fmu(CELL, file, version)
    return file


class SequencerFmu:
    """An initialised instance with access to variables by name."""

    def __init__(self, folder: Path, parameters: dict[str, float | int], start: float = 0.0, **options: Any) -> None:
        description = fmpy.read_model_description(str(folder))
        self.version = int(description.fmiVersion[0])
        self.variables = {v.name: v for v in description.modelVariables}
        self.log: list[tuple[int, str, str]] = []
        slave = FMU2Slave if self.version == 2 else FMU3Slave
        self.slave = slave(
            guid=description.guid, unzipDirectory=str(folder), modelIdentifier="CellSequencer", instanceName="s"
        )
        self.slave.instantiate(**self._callbacks(), **options)
        self.enter(parameters, start)

    def _callbacks(self) -> dict[str, Any]:
        if self.version == 3:
            return {"logMessage": lambda _env, status, category, text: self._add(status, category, text)}
        callbacks = fmi2CallbackFunctions()
        self.logger = fmi2CallbackLoggerTYPE(lambda _env, _name, *message: self._add(*message))
        callbacks.logger = self.logger
        callbacks.allocateMemory = fmi2.defaultCallbacks.allocateMemory
        callbacks.freeMemory = fmi2.defaultCallbacks.freeMemory
        return {"callbacks": callbacks}

    def _add(self, status: int, category: bytes, text: bytes) -> None:
        self.log.append((status, category.decode(), text.decode()))

    def enter(self, parameters: dict[str, float | int], start: float = 0.0) -> None:
        self.time = start
        if self.version == 2:
            self.slave.setupExperiment(startTime=start)
            self.slave.enterInitializationMode()
        else:
            self.slave.enterInitializationMode(startTime=start)
        for name, value in parameters.items():
            self.set(name, value)
        self.slave.exitInitializationMode()

    def set(self, name: str, value: float | int) -> None:
        setter = {"Real": "setReal", "Float64": "setFloat64", "Integer": "setInteger", "Int32": "setInt32"}
        getattr(self.slave, setter.get(self.variables[name].type, "setBoolean"))(
            [self.variables[name].valueReference], [value]
        )

    def step(self, count: int = 1) -> list[tuple[Any, ...]]:
        """Values of all outputs and of the time after each step."""
        rows = []
        for _ in range(count):
            self.slave.doStep(self.time, STEP)
            self.time += STEP
            rows.append(self.outputs())
        return rows

    def outputs(self) -> tuple[Any, ...]:
        getter = {"Real": "getReal", "Float64": "getFloat64", "Integer": "getInteger", "Int32": "getInt32",
                  "Boolean": "getBoolean", "String": "getString"}  # fmt: skip
        values = []
        for variable in self.variables.values():
            if variable.causality in ("output", "independent"):
                value = getattr(self.slave, getter[variable.type])([variable.valueReference])[0]
                values.append(value.decode() if isinstance(value, bytes) else value)
        return tuple(values)

    def save(self) -> Any:
        return self.slave.getFMUstate() if self.version == 2 else self.slave.getFMUState()

    def restore(self, state: Any, time: float) -> None:
        (self.slave.setFMUstate if self.version == 2 else self.slave.setFMUState)(state)
        self.time = time

    def serialize(self, state: Any) -> bytes:
        return bytes((self.slave.serializeFMUstate if self.version == 2 else self.slave.serializeFMUState)(state))

    def deserialize(self, data: bytes) -> Any:
        return (self.slave.deSerializeFMUstate if self.version == 2 else self.slave.deserializeFMUState)(data)


@pytest.fixture
def folder(package: Path, tmp_path: Path) -> Path:
    return Path(fmpy.extract(str(package), str(tmp_path / "unpacked")))


def test_description_has_no_findings(package: Path) -> None:
    assert validate_fmu(str(package)) == []


def test_versions_give_the_same_outputs(tmp_path: Path) -> None:
    rows = []
    for version in (2, 3):
        file = tmp_path / f"{version}.fmu"
        build_sequencer_fmu(CELL, file, 2 if version == 2 else 3)
        run = SequencerFmu(Path(fmpy.extract(str(file), str(tmp_path / str(version)))), SEQUENCE)
        rows.append(run.step(30))
    assert rows[0] == rows[1]
    assert rows[0][0] != rows[0][10]


def test_state_continues_exactly_also_in_another_instance(folder: Path) -> None:
    run, other = SequencerFmu(folder, SEQUENCE), SequencerFmu(folder, {})
    run.step(12)
    state, time = run.save(), run.time
    data, expected = run.serialize(state), run.step(20)
    run.restore(state, time)
    assert run.step(20) == expected
    other.restore(other.deserialize(data), time)
    assert other.step(20) == expected
    other.slave.reset()
    other.enter(SEQUENCE)
    other.step(12)
    assert other.step(20) == expected


def test_damaged_states_are_rejected(folder: Path) -> None:
    run = SequencerFmu(folder, SEQUENCE)
    data = run.serialize(run.save())
    for damaged in (data[:-1], data[:40], b"", bytes([*data[:60], data[60] ^ 1, *data[61:]])):
        with pytest.raises(Exception, match="fmi"):
            run.restore(run.deserialize(damaged), 0.0)
        assert "state" in run.log[-1][2]
        run.slave.reset()
        run.enter(SEQUENCE)
    run.step()


def test_log_is_filtered_by_category(folder: Path) -> None:
    run = SequencerFmu(folder, SEQUENCE)
    run.step(3)
    assert run.log == []
    run.slave.setDebugLogging(True, ["logEvents"])
    run.step(27)
    assert [text.split(" begins")[0] for _, _, text in run.log] == ["step 2", "step 3"]
    assert {category for _, category, _ in run.log} == {"logEvents"}
    run.slave.setDebugLogging(False, [])
    run.slave.terminate()
    assert len(run.log) == 2


def test_rejected_command_is_a_warning(folder: Path) -> None:
    run = SequencerFmu(folder, SEQUENCE, loggingOn=True)
    run.step(2)
    run.set("controller.error", 5)
    run.step(2)
    warnings = [text for status, category, text in run.log if category == "logStatusWarning" and status == 1]
    assert len(warnings) == 1
    assert "step 1" in warnings[0]
    assert "controller.error is 5" in warnings[0]


def test_illegal_calls_are_errors_until_reset(folder: Path) -> None:
    run = SequencerFmu(folder, SEQUENCE)
    for provoke in (
        lambda: run.slave.doStep(0.5, STEP),
        lambda: run.set("steps", 2),
        run.slave.exitInitializationMode,
        lambda: run.slave.fmi2GetReal(run.slave.component, None, 1, None) if run.version == 2 else run.set("number", 1),
    ):
        with pytest.raises(Exception, match="fmi"):
            provoke()
        assert run.log[-1][:2] == (3, "logStatusError")
        with pytest.raises(Exception, match="DoStep"):
            run.step()
        run.slave.reset()
        run.enter(SEQUENCE)
        run.step()


def test_calls_from_the_log_callback_are_refused(folder: Path) -> None:
    run, untouched = (SequencerFmu(folder, SEQUENCE, loggingOn=True) for _ in range(2))
    refused = 0

    def call_back(*_message: Any) -> None:
        nonlocal refused
        for call in (run.slave.reset, run.slave.terminate, run.step, run.save, lambda: run.set("controller.error", 1)):
            time = run.time
            try:
                call()
            except Exception:
                refused += 1
            run.time = time
        getattr(run.slave, f"fmi{run.version}FreeInstance")(run.slave.component)

    run._add = call_back
    assert run.step(30) == untouched.step(30)
    assert refused == 5 * len(untouched.log) > 0


def test_event_mode_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "CellSequencer3.fmu"
    build_sequencer_fmu(CELL, file, 3)
    folder = Path(fmpy.extract(str(file), str(tmp_path / "unpacked")))
    with pytest.raises(Exception, match="instantiate"):
        SequencerFmu(folder, {}, eventModeUsed=True)
