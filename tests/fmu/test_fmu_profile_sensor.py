"""The FMU of a profile sensor (FMI 3): the points of a scan from its trigger records, states, illegal values."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from fmpy.fmi1 import FMICallException
from fmpy.fmi3 import FMU3Slave
from fmpy.validation import validate_fmu
from scipy.spatial import KDTree

import scancell.sensor
from scancell import Scanner, assets_dir, load_part, load_setup
from scancell.cell.fmu_file import build_sensor_fmu, description_text
from scancell.cell.fmu_package import sensor_contents
from scancell.cell.recording import Recording
from scancell.errors import CellError, DescriptionError
from scancell.geometry.mesh import Mesh
from scancell.scanning.world import World

STEP = 0.016
SAME = 1e-9  # m
GETTERS = {"Float64": "getFloat64", "Int32": "getInt32", "Boolean": "getBoolean"}
SETTERS = {"Float64": "setFloat64", "Int32": "setInt32", "Boolean": "setBoolean"}


@dataclass(frozen=True)
class Scanned:
    """A world and a recording of a scan in it."""

    world: World
    recording: Recording


class SensorFmu:
    """An initialised instance with access to variables by name."""

    def __init__(self, folder: Path) -> None:
        description = fmpy.read_model_description(str(folder), validate=False)
        self.variables = {v.name: v for v in description.modelVariables}
        self.slave = FMU3Slave(
            guid=description.guid,
            unzipDirectory=str(folder),
            modelIdentifier="ProfileSensor",
            instanceName="sensor",
        )
        self.log: list[str] = []
        self.slave.instantiate(logMessage=lambda _env, _status, _category, text: self.log.append(text.decode()))
        self.slave.enterInitializationMode()
        self.slave.exitInitializationMode()
        self.time = 0.0

    def set(self, name: str, value: float | int | bool) -> None:
        variable = self.variables[name]
        getattr(self.slave, SETTERS[variable.type])([variable.valueReference], [value])

    def get(self, name: str) -> Any:
        variable = self.variables[name]
        size = int(variable.dimensions[0].start) if variable.dimensions else 1
        values = getattr(self.slave, GETTERS[variable.type])([variable.valueReference], size)
        return np.array(values) if variable.dimensions else values[0]

    def step(self) -> None:
        self.slave.doStep(self.time, STEP)
        self.time += STEP

    def record(self, columns: dict[str, Any], row: int) -> None:
        """Set all inputs to a row of a recording, and make a step."""
        for name, variable in self.variables.items():
            if variable.causality == "input" and name in columns:
                kind = int if variable.type == "Int32" else float
                self.set(name, kind(columns[name][row]))
        self.step()

    def points(self) -> np.ndarray[Any, Any]:
        return np.column_stack([self.get(f"profile.{axis}") for axis in "xyz"])[: self.get("profile.count")]


Open = Callable[[World], SensorFmu]


def unpacked(world: World, folder: Path) -> Path:
    """The folder of an unpacked FMU, whose libraries are a link."""
    runtime = next(path / "runtime" for path in map(Path, scancell.sensor.__path__) if (path / "runtime").is_dir())
    for name, content in sensor_contents(runtime, description_text(world.for_sensor_fmu())).items():
        if not name.startswith("binaries"):
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_bytes(content)
    (folder / "binaries").mkdir()
    (folder / "binaries/x86_64-linux").symlink_to(runtime)
    return folder


@pytest.fixture
def open_fmu(tmp_path: Path) -> Iterator[Open]:
    opened: list[SensorFmu] = []

    def of(world: World) -> SensorFmu:
        opened.append(SensorFmu(unpacked(world, tmp_path / f"sensor{len(opened)}")))
        return opened[-1]

    yield of
    for one in opened:
        one.slave.freeInstance()


def scanned(part: Mesh, cell: str = "default", *settings: str, as_built: tuple[str, ...] = ()) -> Scanned:
    """A geometric scan of a few profiles."""
    few = ["scan.max_profiles=24", *settings]
    setup = load_setup(assets_dir() / f"cells/{cell}.toml", settings=few)
    with Scanner(setup=setup) as scanner:
        recording = scanner.scan(part, engine="geometric", as_built=as_built, seed=3).recording
        return Scanned(scanner.pipeline.load(setup, part, as_built=as_built, seed=3), recording)


def free_form() -> Mesh:
    return load_part(assets_dir() / "parts/free_form.stl")


CASES: dict[str, Callable[[], Scanned]] = {
    "with noise and an axis that turns": lambda: scanned(free_form()),
    "sensor as built": lambda: scanned(free_form(), as_built=("sensor.camera[1].tilt_deg=29.35", "tool.x_mm=0.4")),
    "without noise": lambda: scanned(free_form(), "default", "sensor.render.noise=false"),
    "two sensors": lambda: scanned(free_form(), "two_sensors"),
    "held part": lambda: scanned(free_form(), "held_part"),
}


def check_points(world: World, recording: Recording, fmu: SensorFmu) -> None:
    """Points of all profiles are those of the geometric engine.

    One at the edge of a surface, or of a run that is just long enough, may be found by one of both alone, since their
    poses differ by rounding.
    """
    own = world.exposed_at(recording.measured.index)
    expected = world.expose(recording[own], "geometric").points
    assert len(expected.frame) > 1000
    differing = 0
    for row in range(len(recording)):
        fmu.record(dict(recording.columns), row)
        assert fmu.get("laser.on") == (row in own)
        if row not in own:
            continue
        here, count = expected[expected.frame == np.searchsorted(own, row)], fmu.get("profile.count")
        values = {name: fmu.get(f"profile.{name}") for name in (*"xyz", "intensity", "flags", "camera", "column")}
        assert not any(array[count:].any() for array in values.values())
        # A camera of its own coordinate: points of both are at one place.
        of_fmu = np.column_stack([values[name][:count] for name in (*"xyz", "camera")])
        distance, found = KDTree(np.column_stack([here.points_in_sensor, here.camera])).query(of_fmu)
        same = distance < SAME
        differing += count + len(here.frame) - 2 * len(np.unique(found[same]))
        for name, rtol in (("intensity", 1e-3), ("flags", 0), ("column", 0)):
            np.testing.assert_allclose(values[name][:count][same], getattr(here, name)[found[same]], rtol=rtol)
    assert differing < 0.005 * len(expected.frame)


@pytest.mark.parametrize("case", CASES)
def test_points_are_those_of_the_scan(case: str, open_fmu: Open) -> None:
    found = CASES[case]()
    for world in found.world.sensors:
        check_points(world, found.recording, open_fmu(world))


@pytest.mark.parametrize(
    "file", ["artefacts/cone.toml", "artefacts/ring.toml", "artefacts/v_groove.toml", "parts/turned_part.step"]
)
def test_exact_surfaces_are_those_of_the_scan(file: str, open_fmu: Open) -> None:
    if file.endswith(".step"):
        pytest.importorskip("OCP")
    found = scanned(load_part(assets_dir() / file), "default", "sensor.render.noise=false")
    check_points(found.world, found.recording, open_fmu(found.world))


@pytest.fixture(scope="module")
def example() -> Scanned:
    return scanned(free_form())


def test_packed_fmu_has_no_findings(example: Scanned, tmp_path: Path) -> None:
    build_sensor_fmu(example.world.for_sensor_fmu(), tmp_path / "sensor.fmu")
    assert validate_fmu(str(tmp_path / "sensor.fmu")) == []


def test_a_step_without_a_new_trigger_keeps_the_profile(example: Scanned, open_fmu: Open) -> None:
    fmu = open_fmu(example.world)
    fmu.step()
    assert (fmu.get("profile.index"), fmu.get("profile.count"), fmu.get("laser.on")) == (0, 0, False)
    fmu.record(example.recording.columns, 4)
    before = fmu.points()
    assert (fmu.get("profile.index"), fmu.get("laser.on")) == (example.recording.measured.index[4], True)
    assert fmu.get("profile.time") == example.recording.columns["trigger.time"][4]
    fmu.step()
    assert not fmu.get("laser.on")
    np.testing.assert_array_equal(fmu.points(), before)


def test_without_the_laser_nothing_is_seen(example: Scanned, open_fmu: Open) -> None:
    fmu = open_fmu(example.world)
    fmu.set("laser.enabled", False)
    fmu.record(example.recording.columns, 4)
    assert (fmu.get("profile.index"), fmu.get("profile.count")) == (example.recording.measured.index[4], 0)
    assert not fmu.get("laser.on")


def test_a_state_continues_as_the_run_did(example: Scanned, open_fmu: Open) -> None:
    fmu, columns = open_fmu(example.world), example.recording.columns
    fmu.record(columns, 2)
    data = fmu.slave.serializeFMUState(fmu.slave.getFMUState())
    kept = fmu.points()
    fmu.record(columns, 3)
    after, time = fmu.points(), fmu.time
    state = fmu.slave.deserializeFMUState(data)
    fmu.slave.setFMUState(state)
    fmu.time = time - STEP
    np.testing.assert_array_equal(fmu.points(), kept)
    fmu.record(columns, 3)
    np.testing.assert_array_equal(fmu.points(), after)
    with pytest.raises(FMICallException):
        fmu.slave.deserializeFMUState(data[:-9])


@pytest.mark.parametrize(
    ("name", "value", "text"),
    [
        ("trigger.truth.sensor.orientation[1]", 0.5, "trigger.truth.sensor.orientation has the norm"),
        ("trigger.exposure", 0.0, "trigger.exposure is 0"),
        ("trigger.truth.sensor.position[2]", float("nan"), "must be a finite number"),
    ],
)
def test_values_that_are_none_are_refused(example: Scanned, open_fmu: Open, name: str, value: float, text: str) -> None:
    fmu = open_fmu(example.world)
    columns = {**example.recording.columns, name: np.full(len(example.recording), value)}
    with pytest.raises(FMICallException):
        fmu.record(columns, 1)
    assert any(text in line for line in fmu.log)


def test_exposures_that_images_choose_are_refused() -> None:
    words = ("sensor.exposure.mode=automatic", "sensor.exposure.shortest_ms=0.1", "sensor.exposure.longest_ms=1")
    setup = load_setup(settings=list(words))
    with Scanner(setup=setup) as scanner, pytest.raises(DescriptionError, match=r"sensor\.exposure\.mode"):
        scanner.pipeline.load(setup, free_form()).for_sensor_fmu()


@pytest.mark.parametrize(
    ("key", "value", "text"),
    [
        ("format", 2, "format: expected an integer from 1 to 1, got 2"),
        ("every", 0, "every: expected an integer .*, got 0"),
        ("exposure", -1.0, "exposure: expected a number above 0, got -1"),
        ("bodies", [], "bodies: expected"),
        ("shapes", [{"shape": "egg", "name": "part"}], "mesh, light, sphere"),
    ],
)
def test_a_wrong_description_is_refused(example: Scanned, tmp_path: Path, key: str, value: Any, text: str) -> None:
    with pytest.raises(CellError, match=text):
        build_sensor_fmu({**example.world.for_sensor_fmu(), key: value}, tmp_path / "sensor.fmu")
    assert not (tmp_path / "sensor.fmu").exists()
