"""Illegal calls and values, unusual environments, many instances."""

from __future__ import annotations

import ctypes
import itertools
import json
import locale
import os
import re
import shutil
import struct
import subprocess
import sys
import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cell_fixture import (
    AXES,
    CYCLE_US,
    FREE,
    START,
    Array,
    Build,
    CellFmu,
    FmuFolders,
    all_reals,
    cell_description,
    continue_motion,
    conveyor,
    pose,
    read_description,
)
from grasp_fixture import grasp_cell
from test_fmu_dynamic_arm import dynamic_cell
from test_fmu_sensing import full_sensing_cell
from test_fmu_soft_part import soft_cell

from json_changes import changed

# Weak motors, backlash and friction, with sensors and collision outputs.
DYNAMIC = full_sensing_cell()
DYNAMIC["robot"] = dynamic_cell(backlash=3e-4, coulomb_friction=1.0, max_torque=60.0)["robot"]


BOUNDED = "expected a number from -1000 to 1000, got"
FREE_WITHOUT_HULL = {**cell_description()["parts"][0], "fixture": "free", "hull": None}


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        ("robot.joints.2.max_speed", ..., "robot.joints[2].max_speed"),
        ("table.colour", "red", "table.colour"),
        ("parts.0.inertial.mass", -1, "parts[0].inertial.mass"),
        ("tool.flange_from_sensor.quaternion", [1, 1, 0, 0], "tool.flange_from_sensor.quaternion"),
        ("robot.joints.0.start", 10, "robot.joints[0].start"),
        ("controller_cycle_us", 1500, "controller_cycle_us"),
        ("robot.joints", cell_description()["robot"]["joints"][:3], "robot.joints"),
        ("table.radius", "big", "table.radius"),
        ("table.world_from_table.position.0", 1e12, f"table.world_from_table.position[0]: {BOUNDED}"),
        ("robot.joints.1.a", 1e300, f"robot.joints[1].a: {BOUNDED}"),
        ("gravity.2", -1e30, f"gravity[2]: {BOUNDED}"),
        ("parts.0", FREE_WITHOUT_HULL, "parts[0].hull: expected an object for a free part, got null"),
        ("parts.0.inertial.mass", 1e-300, "parts[0].inertial.mass: expected a number from 1e-06 to 1e+09, got"),
    ],
)
def test_invalid_description_is_rejected_by_key(
    build: Build, tmp_path: Path, path: str, value: Any, message: str
) -> None:
    file = tmp_path / "invalid.json"
    file.write_text(json.dumps(changed(cell_description(), path, value)))
    with pytest.raises(RuntimeError) as caught:
        build(3, parameters={"cell.file": str(file)})
    assert str(file) in str(caught.value)
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("name", "range_"),
    [
        ("table.x", "-1000 to 1000 m"),
        ("platter.y", "-1000 to 1000 m"),
        ("dh[2].a", "-1000 to 1000 m"),
        ("dh[2].theta", "-629 to 629 rad"),
        ("tool.rx", "-629 to 629 rad"),
        ("table.wobble_phase", "-629 to 629 rad"),
        ("vibration.base.frequency", "0 to 1e+06 Hz"),
        ("vibration.table.random_rms", "0 to 1000 m"),
    ],
)
def test_deviations_out_of_range_are_rejected_by_name(build: Build, name: str, range_: str) -> None:
    with pytest.raises(RuntimeError, match=re.escape(f"as_built.{name} must be from {range_}, not")):
        build(3, FREE, {f"as_built.{name}": 1e9})


@pytest.mark.parametrize("end", ["min", "max"])
def test_a_cell_with_all_deviations_at_the_ends_of_their_ranges_has_finite_outputs(build: Build, end: str) -> None:
    variables = build(3).variables.values()
    numbers = [v for v in variables if v.causality == "parameter" and v.type == "Float64"]
    assert len(numbers) > 40
    values = {v.name: float(getattr(v, end)) for v in numbers}  # each has both bounds
    values |= {name: 1.0 for name in values if name.endswith("random_width")}  # above 0 where random_rms is
    cell = build(3, parameters=values)
    cell.step(CYCLE_US, 2)
    assert np.isfinite(all_reals(cell)).all()


@pytest.mark.parametrize("text", ["", "{", "[]", '{"format": 2}', "null"])
def test_file_without_description_is_rejected(build: Build, tmp_path: Path, text: str) -> None:
    file = tmp_path / "cell.json"
    file.write_text(text)
    with pytest.raises(RuntimeError, match=str(file)):
        build(2, parameters={"cell.file": str(file)})


@pytest.mark.parametrize("version", [2, 3])
def test_cell_file_must_be_a_regular_file(build: Build, tmp_path: Path, version: int) -> None:
    os.mkfifo(tmp_path / "pipe")
    for file in (tmp_path / "pipe", Path("/dev/zero")):
        with pytest.raises(Exception, match="expected a regular file"):
            build(version, parameters={"cell.file": str(file)})


def test_cell_file_selects_another_description(build: Build, tmp_path: Path) -> None:
    cell = cell_description(support_from_part=pose([0.07, 0, 0]))
    file = tmp_path / "other cell ä.json"
    file.write_text(json.dumps(cell))
    named = build(3, parameters={"cell.file": str(file)})
    assert named.vector("truth.part[1].position", 3)[0] == pytest.approx(0.45 + 0.07, abs=1e-15)
    assert named.get_string("cell.file") == str(file)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"parts": 2 * cell_description()["parts"]}, "2 parts instead of 1"),
        (
            {"parts": [{**cell_description()["parts"][0], "stands_on": "world"}]},
            r"part\[1\] on another support",
        ),
    ],
)
def test_description_with_other_devices_is_rejected(
    build: Build, tmp_path: Path, change: dict[str, Any], expected: str
) -> None:
    file = tmp_path / "other.json"
    file.write_text(json.dumps({**cell_description(), **change}))
    with pytest.raises(RuntimeError, match=rf"{file}.*{expected}"):
        build(3, parameters={"cell.file": str(file)})


@pytest.mark.parametrize("version", [2, 3])
def test_non_finite_values_are_rejected_until_reset(build: Build, version: int) -> None:
    for value in (np.nan, np.inf, -np.inf):
        cell = build(version)
        with pytest.raises(Exception, match="Set"):
            cell.set("command.q[3]", value)
        assert "command.q[3]" in cell.messages[-1]
        with pytest.raises(Exception, match="DoStep"):
            cell.step(1000)
        cell.slave.reset()
        cell.initialize()
        cell.step(1000)


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize(
    ("provoke", "expected"),
    [
        (lambda c: c.set("as_built.tool.x", 1.0), "as_built.tool.x is not allowed while stepping"),
        (lambda c: c.set("truth.table", 1.0), "truth.table is neither an input nor a parameter"),
        (lambda c: c.set("command.mode", 7), "command.mode must be from 0 to 6"),
        (lambda c: c.slave.doStep(0.5, 0.001), "differs from the end of the last step"),
        (lambda c: c.slave.doStep(0.0, 0.0), "must be positive"),
        (lambda c: c.slave.doStep(0.0, -0.001), "must be positive"),
        (lambda c: c.slave.doStep(0.0, np.nan), "must be positive"),
        (lambda c: c.slave.doStep(0.0, 1e300), "must be positive and finite"),
        (lambda c: c.slave.exitInitializationMode(), "leaving initialization mode is not allowed"),
    ],
)
def test_illegal_calls_are_errors_with_message(
    build: Build, version: int, provoke: Callable[[CellFmu], Any], expected: str
) -> None:
    cell = build(version)
    with pytest.raises(Exception, match="fmi"):
        provoke(cell)
    assert expected in cell.messages[-1]
    cell.slave.reset()
    cell.initialize()
    cell.step(1000)


INVALID_ORIENTATION, TRIGGER_INTERVAL, TRIGGER_QUEUE = 12, 13, 14


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize(("mode", "name", "value"), [(1, "period", 0.01), (2, "angle", 1e-3), (3, "distance", 1e-3)])
def test_trigger_without_interval_is_rejected_until_it_has_one(
    build: Build, version: int, mode: int, name: str, value: float
) -> None:
    cell = build(version, loggingOn=True)
    cell.command(table=1.0)
    cell.set("command.trigger.mode", mode)
    cell.set("command.trigger.request", 1)
    cell.step(CYCLE_US, 5)
    assert cell.get_int("controller.error") == TRIGGER_INTERVAL
    assert cell.get_int("trigger.count") == 0
    assert sum("controller: trigger mode without interval" in text for text in cell.messages) == 1
    assert cell.get("measured.table")[0] > 0
    cell.set(f"command.trigger.{name}", value)
    cell.step(CYCLE_US, 5)
    assert cell.get_int("controller.error") == 0
    assert cell.get_int("trigger.count") > 2


@pytest.mark.parametrize("version", [2, 3])
def test_target_orientation_is_normalised_or_rejected(build: Build, version: int) -> None:
    cell = build(version, loggingOn=True)
    position, orientation = cell.vector("truth.sensor.position", 3), cell.vector("truth.sensor.orientation", 4)
    cell.set("command.mode", 3)
    for start, scale in enumerate((0.0, 0.98, 1.02, 1.000002), start=1):
        for name, values in (("position", position + np.array([0, 0, 0.02])), ("orientation", scale * orientation)):
            for i, value in enumerate(values, start=1):
                cell.set(f"command.target.{name}[{i}]", float(value))
        cell.set("command.start", start)
        cell.step(CYCLE_US, 60)
        reached = start == 4
        assert cell.get_int("controller.error") == (0 if reached else INVALID_ORIENTATION)
        assert bool(cell.get_int("controller.at_destination"))
        expected = position + np.array([0, 0, 0.02 * reached])
        np.testing.assert_allclose(cell.vector("truth.sensor.position", 3), expected, atol=1e-9)
    assert any("command.target.orientation is no unit quaternion" in text for text in cell.messages)


def test_exposures_do_not_fire_while_the_queue_of_records_is_full(build: Build) -> None:
    cell = build(3, loggingOn=True)
    cell.command(table=1.0)
    cell.trigger(1, 1e-6)
    cell.step(70_000)
    assert cell.get_int("trigger.count") == 65536
    assert cell.get_int("controller.error") == TRIGGER_QUEUE
    assert any("65536 trigger records are queued" in text for text in cell.messages)
    cell.trigger(2, 1e-300)
    cell.step(1000, 3)
    assert cell.get_int("trigger.index") == 4
    assert cell.get_int("trigger.count") < 65536 + 5
    cell.trigger(0)
    cell.step(1000, 2)
    assert cell.get_int("controller.error") == 0
    assert cell.get("measured.table")[0] > 0


# Values at the ends of the ranges, and where a command is incomplete.
EDGES = (0.0, 1.0, -1.0, 1e-300, -1e-12, 1e-6, 0.5, 1e3, 1e9, -1e9, 1e300, -1e300)


def random_value(random: np.random.Generator, variable: Any) -> float | int | str:
    """A value that an importer may set: any one within the declared bounds."""
    if variable.type == "String":
        return str(random.choice(["", "no such file", "cell.json"]))
    if variable.type == "Boolean":
        return int(random.random() < 0.2)
    low, high = (float(b) if b is not None else d for b, d in ((variable.min, -np.inf), (variable.max, np.inf)))
    if variable.type in ("Real", "Float64"):
        value = random.choice(EDGES) if random.random() < 0.3 else random.normal()
        return float(np.clip(value, low, high))
    if variable.type == "Enumeration":
        return int(random.choice([item.value for item in variable.declaredType.items]))
    return int(random.choice([*range(6), -(2**31), 2**31 - 1]))


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize("name", ["dynamic", "gripper"])
def test_random_inputs_in_random_order_are_executed_or_rejected(build: Build, version: int, name: str) -> None:
    """Every call returns OK, all outputs stay finite, and each refusal is in the log."""
    description = DYNAMIC if name == "dynamic" else {**grasp_cell(), "conveyors": [conveyor()]}
    random, errors = np.random.default_rng(version), set()
    for _ in range(6):  # counters that reached their greatest values let no robot start again
        cell = build(version, description, loggingOn=True)
        inputs = [v for v in cell.variables.values() if v.causality == "input"]
        for _ in range(50):
            for variable in random.choice(inputs, random.integers(0, len(inputs) // 2)):
                cell.set(variable.name, random_value(random, variable))
            if random.random() < 0.3:  # what lets the robot move, for a while
                cell.set("command.emergency_stop", 0)
                cell.set("command.max_age", 0.0)
                cell.set("command.guard.max_age", 0.0)
            known = len(cell.messages)
            cell.step(int(random.choice([1, 250, 1000, 7300, CYCLE_US, 50_000])))
            assert np.isfinite(all_reals(cell)).all()
            error = cell.get_int("controller.error")
            if error not in (0, *errors):
                assert any(text.startswith("controller: ") for text in cell.messages[known:]), error
            errors.add(error)
        assert all(status < 3 for status, _ in cell.log)  # no error
    assert len(errors) > 5


def test_unknown_references_and_types_are_errors(build: Build) -> None:
    for get, reference in (("getFloat64", 99999), ("getInt32", 0), ("getFloat32", 1), ("getUInt64", 1)):
        cell = build(3)
        with pytest.raises(Exception, match="fmi3Get"):
            getattr(cell.slave, get)([reference])
        assert cell.messages


def test_step_beyond_stop_time_is_an_error(folders: FmuFolders, open_fmu: Build) -> None:
    cell = open_fmu(folders.unpacked(3, cell_description()), stop_time=0.01)
    cell.step(10_000)
    with pytest.raises(Exception, match="fmi3DoStep"):
        cell.step(1000)


def resource_forms(resources: Path) -> dict[str, str]:
    path = str(resources)
    encoded = path.replace(" ", "%20").replace("ä", "%C3%A4")
    return {
        "file:///": "file://" + encoded, "file:///…/": "file://" + encoded + "/", "file:////": "file:///" + encoded,
        "file:/": "file:" + encoded, "file:/…/": "file:" + encoded + "/", "localhost": "file://localhost" + encoded,
        "unencoded": "file://" + path, "FILE:": "FILE://" + encoded, "path": path, "path/": path + "/",
    }  # fmt: skip


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize("form", list(resource_forms(Path("/x"))))
def test_all_forms_of_resource_location_are_accepted(
    folders: FmuFolders, tmp_path: Path, version: int, form: str
) -> None:
    """Directly through the C interface, without callbacks and Terminate."""
    folder = folders.unpacked(version, cell_description())
    resources = tmp_path / "an ä folder" / "resources"
    shutil.copytree(folder / "resources", resources)
    location = resource_forms(resources)[form].encode()
    description = read_description(folder)
    library = ctypes.CDLL(str(next((folder / "binaries").iterdir()) / "RobotCell.so"))
    prefix = f"fmi{version}"
    instantiate = getattr(library, "fmi2Instantiate" if version == 2 else "fmi3InstantiateCoSimulation")
    instantiate.restype = ctypes.c_void_p
    name, token = str(folder).encode(), description.guid.encode()
    if version == 2:
        instance = ctypes.c_void_p(instantiate(name, 1, token, location, None, 0, 0))
        library.fmi2EnterInitializationMode(instance)
    else:
        instance = ctypes.c_void_p(
            instantiate(name, token, location, *[False] * 4, None, ctypes.c_size_t(0), *[None] * 3)
        )
        start = ctypes.c_double(0)
        library.fmi3EnterInitializationMode(instance, False, start, start, False, start)
    assert instance
    assert getattr(library, f"{prefix}ExitInitializationMode")(instance) == 0
    getattr(library, f"{prefix}FreeInstance")(instance)


def test_invalid_resource_location_is_rejected(folders: FmuFolders) -> None:
    folder = folders.unpacked(2, cell_description())
    library = ctypes.CDLL(str(folder / "binaries/linux64/RobotCell.so"))
    library.fmi2Instantiate.restype = ctypes.c_void_p
    token = read_description(folder).guid.encode()
    for location in (
        b"http://example.org/resources",
        b"file://elsewhere/resources",
        b"file:///bad%2",
        b"/nowhere",
        None,
    ):
        assert library.fmi2Instantiate(b"cell", 1, token, location, None, 0, 0) is None
    resources = str(folder / "resources").encode()
    for name, kind, guid in ((None, 1, token), (b"", 1, token), (b"cell", 0, token), (b"cell", 1, b"{other}")):
        assert library.fmi2Instantiate(name, kind, guid, resources, None, 0, 0) is None


# Run in a separate process: memory left by other tests would count as growth.
LIFE_CYCLES = """
import os, sys
from pathlib import Path
from cell_fixture import CYCLE_US, CellFmu

def resident_mb():
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGESIZE") / 1e6

folder = Path(sys.argv[1])
first, sizes = CellFmu(folder), []
for k in range(200):
    other = CellFmu(folder)
    other.step(2 * CYCLE_US)
    other.close()
    if k in (49, 199):
        sizes.append(resident_mb())
first.step(1000)
maps = Path("/proc/self/maps").read_text().splitlines()
print(sizes[1] - sizes[0], sum("libdart-" in line and str(folder) in line for line in maps))
"""


def test_150_instances_leak_less_than_5_mb(folders: FmuFolders) -> None:
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}
    command = [sys.executable, "-c", LIFE_CYCLES, str(folders.unpacked(3, FREE))]
    done = subprocess.run(command, check=True, env=environment, capture_output=True, text=True)
    growth_mb, mapped_regions = map(float, done.stdout.split()[-2:])
    # One instance holds 6 MB; a leak of 1 % of it, 150 times over, would show.
    assert growth_mb < 5.0
    assert 0 < mapped_regions < 20  # the regions of one copy


def test_an_instance_may_change_threads(build: Build) -> None:
    here, wandering = build(3, FREE), build(3, FREE)
    for k in range(20):
        for cell in (here, wandering):
            cell.command(table=0.05 * k)
        here.step(CYCLE_US)
        thread = threading.Thread(target=wandering.step, args=(CYCLE_US,))
        thread.start()
        thread.join()
    np.testing.assert_array_equal(all_reals(here), all_reals(wandering))


def test_results_are_independent_of_working_directory_and_locale(
    build: Build, folders: FmuFolders, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folders.packed(3, cell_description())
    monkeypatch.chdir(tmp_path)
    before = locale.setlocale(locale.LC_ALL)
    try:
        for name in ("de_DE.UTF-8", "fr_FR.UTF-8", "C.UTF-8", "C"):
            try:
                locale.setlocale(locale.LC_ALL, name)
            except locale.Error:
                continue
            cell = build(3)
            assert cell.vector("truth.part[1].position", 3)[0] == pytest.approx(0.47, abs=1e-15)
            assert locale.setlocale(locale.LC_ALL) == locale.setlocale(locale.LC_ALL, None)
            assert Path.cwd() == tmp_path
    finally:
        locale.setlocale(locale.LC_ALL, before)


def test_other_engine_copies_in_the_process_do_not_interfere(folders: FmuFolders, tmp_path: Path) -> None:
    """DART's Python binding (another version) and the FMU of the other FMI version are in use in the same process."""
    reference = CellFmu(folders.unpacked(3, FREE))
    continue_motion(reference)
    np.save(tmp_path / "reals.npy", all_reals(reference))
    reference.close()
    program = """
import sys
from pathlib import Path
import dartpy
import numpy as np
world = dartpy.simulation.World()
world.step()
from cell_fixture import CellFmu, all_reals, continue_motion
second, third = (CellFmu(Path(folder)) for folder in sys.argv[1:3])
for cell in (second, third):
    continue_motion(cell)
    world.step()
np.testing.assert_array_equal(all_reals(second), np.load(sys.argv[3]))
np.testing.assert_array_equal(all_reals(third), np.load(sys.argv[3]))
second.close()
third.close()
"""
    arguments = [str(folders.unpacked(version, FREE)) for version in (2, 3)]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}
    command = [sys.executable, "-c", program, *arguments, str(tmp_path / "reals.npy")]
    subprocess.run(command, check=True, env=environment, cwd=Path(__file__).parent)


def assert_same_values(actual: Any, expected: Any, path: str = "cell") -> None:
    """Assert equal structure and values; floats within 1e-12, because the last digit depends on the processor."""
    if isinstance(expected, float):
        assert actual == pytest.approx(expected, rel=1e-12, abs=1e-15), path
    elif isinstance(expected, dict):
        assert actual.keys() == expected.keys(), path
        for key, value in expected.items():
            assert_same_values(actual[key], value, f"{path}.{key}")
    elif isinstance(expected, list | tuple):
        assert len(actual) == len(expected), path
        for i, value in enumerate(expected):
            assert_same_values(actual[i], value, f"{path}[{i}]")
    else:
        assert actual == expected, path


def test_stored_cells_of_the_call_fuzzer_match_the_fixtures() -> None:
    soft = soft_cell(longest_edge=0.1)
    cells = {"clamped": cell_description(), "free": FREE, "soft": soft, "dynamic": DYNAMIC, "axes": AXES}
    for name, cell in cells.items():
        stored = json.loads((Path(__file__).parent / "cells" / name / "cell.json").read_text())
        assert_same_values(stored, json.loads(json.dumps(cell)), name)


def with_checksum(body: bytes) -> bytes:
    """A serialized state with a valid checksum (FNV-1a, 64 bits)."""
    checksum = 0xCBF29CE484222325
    for byte in body:
        checksum = (checksum ^ byte) * 0x100000001B3 % 2**64
    return body + struct.pack("<Q", checksum)


def test_out_of_range_positions_in_a_state_are_errors(build: Build) -> None:
    """Without the check the collision engine would end the process."""
    at = 0.0625  # m
    cell = build(3, cell_description(fixture="free", support_from_part=pose([at, 0.02, 0])))
    cell.step(8000, 6)
    good, until, there = cell.save(), cell.time_us, cell.body("part[1]")
    body = cell.serialize(good)[:-8]
    positions = [i for i in range(len(body) - 7) if abs(struct.unpack_from("<d", body, i)[0] - at) < 1e-6]
    assert len(positions) > 1
    for i in positions:
        far = body[:i] + struct.pack("<d", -9e8) + body[i + 8 :]
        with suppress(Exception):
            cell.restore(cell.deserialize(with_checksum(far)), until)
            cell.step(8000, 2)
        cell.restore(good, until)
    assert any("is out of range" in message for message in cell.messages)
    cell.step(8000)
    np.testing.assert_allclose(cell.body("part[1]"), there, atol=1e-6)


def run_at(cell: CellFmu, times: Sequence[float]) -> Array:
    """Turn the table and fire exposures over communication points; all readings and true values at the end."""
    cell.command(table=1.0)
    cell.trigger(1, 0.01)
    for now, following in itertools.pairwise(times):
        cell.slave.doStep(now, following - now)
    names = [n for n in cell.variables if re.match(r"measured\.(q|table)|truth\..*(position|orientation)", n)]
    return cell.get(*names)


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize("start", [1.7e9, -1.7e9, 4e9])
def test_start_times_as_large_as_unix_times_change_nothing_else(build: Build, version: int, start: float) -> None:
    cell, shifted = build(version, FREE), build(version, FREE)
    shifted.slave.reset()
    shifted.initialize(start_time=start)
    elapsed = np.arange(101) * 0.016
    np.testing.assert_array_equal(run_at(cell, list(elapsed)), run_at(shifted, list(start + elapsed)))
    assert shifted.get("time")[0] == pytest.approx(start + elapsed[-1], abs=1e-6)
    assert shifted.get("trigger.time")[0] == pytest.approx(start + cell.get("trigger.time")[0], abs=1e-6)


@pytest.mark.parametrize("version", [2, 3])
def test_times_beyond_the_clock_are_rejected(build: Build, version: int) -> None:
    cell = build(version)
    cell.slave.reset()
    with pytest.raises(Exception, match="fmi"):
        cell.initialize(start_time=4.3e9)
    assert "within 4294967296 s, not 4.3e+09 s" in cell.messages[-1]


@pytest.mark.parametrize("version", [2, 3])
def test_communication_points_in_single_precision_are_accepted(build: Build, version: int) -> None:
    """As absolute times they cannot drift: after 100 s, the cell is where it is with times in double precision."""
    exact = 0.016 * np.arange(6251)
    single = np.float32(0.016) * np.arange(6251, dtype=np.float32)
    assert np.abs(exact - single).max() > 3e-6
    cells = [build(version), build(version)]
    expected, found = (
        run_at(cell, [float(t) for t in times]) for cell, times in zip(cells, (exact, single), strict=True)
    )
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-6)


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize(("time", "step"), [(0.0319996, 0.016), (0.0321, 1e-3), (0.03, 1.0), (0.0320011, 1e-9)])
def test_other_communication_points_are_rejected_with_difference_and_tolerance(
    build: Build, version: int, time: float, step: float
) -> None:
    cell = build(version)
    cell.slave.doStep(0.0, 0.0160004)
    cell.slave.doStep(0.0160004, 0.016)
    with pytest.raises(Exception, match="DoStep"):
        cell.slave.doStep(time, step)
    text = cell.messages[-1]
    point, end, gap, tolerance = map(float, re.findall(r"(-?[0-9.e-]+) s", text))
    assert point == time
    assert end == pytest.approx(0.0320004)
    assert gap == pytest.approx(time - end, rel=1e-6)
    assert 0 < tolerance < abs(gap)


def reentrant_calls(cell: CellFmu, state: Any, data: Any) -> list[Callable[[], Any]]:
    """Calls that an importer may not make from its log callback."""
    slave = cell.slave
    calls = [
        slave.reset, slave.terminate, slave.exitInitializationMode, lambda: slave.doStep(cell.time_us * 1e-6, 0.001),
        lambda: cell.set("command.table", 0.3), lambda: cell.get("truth.table"), lambda: cell.set("cell.file", "none"),
        cell.save, lambda: cell.restore(state, 0), lambda: cell.serialize(state), lambda: cell.deserialize(data),
        lambda: slave.setDebugLogging(False, []),
    ]  # fmt: skip
    if cell.version == 3:
        calls += [slave.enterEventMode, slave.enterStepMode, slave.updateDiscreteStates]
    return calls


@pytest.mark.parametrize("version", [2, 3])
def test_calls_from_the_log_callback_are_refused_and_change_nothing(build: Build, version: int) -> None:
    """Messages of steps, setters, errors and the loading of a cell; freeing the instance has no effect there."""
    untouched, cell = build(version, FREE, loggingOn=True), build(version, FREE, loggingOn=True)
    state = cell.save()
    data, refused, accepted = cell.serialize(state), 0, []

    def call_back(*_message: Any) -> None:
        nonlocal refused
        for call in reentrant_calls(cell, state, data):
            try:
                accepted.append((call, call()))
            except Exception:
                refused += 1
        # FMPy would unload the library as well.
        getattr(cell.slave, f"fmi{version}FreeInstance")(cell.slave.component)

    results = []
    for one in (untouched, cell):
        if one is cell:
            one._on_message = call_back
        one.set("command.speed", 7.0)  # clamped
        one.command(START + np.array([0, 0, 0, 0, 0, 50.0]), table=1.0)
        one.trigger(1, 0.05)
        one.step(CYCLE_US, 30)
        results.append(all_reals(one))
        for provoke in (lambda: one.slave.doStep(-5.0, 0.001), lambda: one.set("command.mode", 99)):  # noqa: B023
            with pytest.raises(Exception, match="fmi"):
                provoke()
        one.slave.reset()
        one.initialize()
        one.step(CYCLE_US, 5)
        results[-1] = np.concatenate([results[-1], all_reals(one)])
    np.testing.assert_array_equal(*results)
    assert refused > 50
    assert accepted == []


@pytest.mark.parametrize("number", range(15))
def test_calls_from_an_intermediate_update_end_at_worst_the_step(build: Build, number: int) -> None:
    """Also after a getter failed there: the cell that the step uses stays."""

    def update(*_arguments: Any) -> None:
        with suppress(Exception):
            cell.slave.getFloat64([99999])
        with suppress(Exception):
            reentrant_calls(cell, state, data)[number]()
        cell.slave.fmi3FreeInstance(cell.slave.component)

    cell = build(3, FREE, intermediateUpdate=update)
    state = cell.save()
    data = cell.serialize(state)
    with pytest.raises(Exception, match="fmi3DoStep"):
        cell.slave.doStep(0.0, 0.1)
    cell.slave.reset()
    cell.initialize()
    untouched = build(3, FREE)
    np.testing.assert_array_equal(all_reals(cell), all_reals(untouched))
