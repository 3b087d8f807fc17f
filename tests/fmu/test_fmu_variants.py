"""Variables on request: the path ahead, arrays of records; attributes of the model descriptions."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest
from cell_fixture import (
    CYCLE_US,
    FREE,
    Array,
    Build,
    CellFmu,
    FmuFolders,
    cell_description,
    conveyor,
    pack,
    write_fmu,
)
from fmpy.validation import validate_fmu

from bench.peers.attributes import misspelt_attributes

BELT = {**FREE, "conveyors": [conveyor()]}
RECORD = r"trigger\.(index|segment|time|exposure|measured\..*|truth\..*)"


def co_simulation(folder: Path) -> ET.Element:
    element = ET.parse(folder / "modelDescription.xml").getroot().find("CoSimulation")
    assert element is not None
    return element


def test_descriptions_state_what_the_library_needs_and_provides(folders: FmuFolders) -> None:
    second, third = (co_simulation(folders.unpacked(version, cell_description())).attrib for version in (2, 3))
    assert second["canNotUseMemoryManagementFunctions"] == "true"
    assert float(third["fixedInternalStepSize"]) == 1e-3
    assert third["providesIntermediateUpdate"] == "true"


@pytest.mark.parametrize("version", [2, 3])
def test_texts_say_which_inputs_are_clamped(build: Build, version: int) -> None:
    cell = build(version, loggingOn=True)
    for variable in cell.variables.values():
        if variable.causality not in ("input", "parameter"):
            continue
        real = variable.type in ("Real", "Float64")
        bounded = variable.min is not None or variable.max is not None
        clamped = variable.causality == "input" and real and bounded
        assert ("clamped, with a warning" in variable.description) == clamped, variable.name
        if clamped:
            known = len(cell.messages)
            cell.set(variable.name, 1e10 if variable.max is not None else -1.0)
            assert cell.messages[known].endswith(": clamped")


@pytest.mark.parametrize("version", [2, 3])
def test_path_ahead_is_described_on_request(folders: FmuFolders, build: Build, version: int) -> None:
    plain, ahead = build(version, FREE), build(version, FREE, variants=["--ahead"])
    added = [name for name in ahead.variables if name not in plain.variables]
    assert len(added) == (448 if version == 2 else 1)
    assert all(name.startswith("controller.ahead") for name in added)
    for name, variable in plain.variables.items():
        assert ahead.variables[name].valueReference == variable.valueReference
    assert ahead.path_ahead().shape == (64, 7)
    for cell in (plain, ahead):
        cell.start_move(np.zeros(6), 1.0)
        cell.step(CYCLE_US, 10)
    later = []
    points = ahead.path_ahead()
    assert np.ptp(points[:, 6]) > 0.1
    for _ in range(5):
        ahead.step(CYCLE_US)
        later.append([*ahead.vector("measured.q", 6), *ahead.get("measured.table")])
    np.testing.assert_allclose(later, points[1:6], atol=1e-10)


@pytest.mark.parametrize("variants", [["--records"], ["--records", "--ahead", "--clock"], ["--records", "--arrays"]])
def test_variants_are_valid(tmp_path: Path, variants: list[str]) -> None:
    """But for one finding: FMPy expects output clocks in InitialUnknown, where the standard has no clocks."""
    folder = write_fmu(BELT, 3, tmp_path / "RobotCell", *variants)
    assert misspelt_attributes(ET.parse(folder / "modelDescription.xml").getroot(), 3) == []
    for finding in validate_fmu(str(pack(folder, tmp_path / "RobotCell.fmu"))):
        sets = re.search(r"InitialUnknowns .* Expected \{(.*)\} but was \{(.*)\}", finding)
        assert sets is not None, finding
        expected, found = (set(group.split(", ")) for group in sets.groups())
        assert "--clock" in variants
        assert expected ^ found == {"trigger.clock"}


def columns(cell: CellFmu) -> dict[str, Array]:
    """The arrays of records, of all numbers of a record."""
    found = {}
    for name, variable in cell.variables.items():
        if re.match(r"trigger\.records\.(?!count)", name):
            getter = cell.slave.getFloat64 if variable.type == "Float64" else cell.slave.getInt32
            found[name.replace("records.", "")] = np.array(getter([variable.valueReference], nValues=256))
    return found


@pytest.mark.parametrize("step_us", [1000, CYCLE_US, 100_000])
def test_all_records_of_a_step_can_be_read_at_its_end(build: Build, step_us: int) -> None:
    """Equal to the records that an importer reads one by one at shorter steps."""
    commands = {"command.mode": 1, "command.table": 1.0}
    plain, cell = (
        build(3, BELT, {"as_built.trigger.jitter": 1e-4}),
        build(3, BELT, {"as_built.trigger.jitter": 1e-4}, variants=["--records"]),
    )
    for one in (plain, cell):
        for name, value in commands.items():
            one.set(name, value)
        one.trigger(1, 0.0007, exposure=0.0002)
    names = [name for name in plain.variables if re.fullmatch(RECORD, name)]
    assert set(columns(cell)) == set(names)
    expected: list[list[float]] = []
    while plain.time_us < 400_000:
        plain.step(200)
        if plain.get_int("trigger.index") == len(expected) + 1:
            expected.append([
                plain.get_int(n) if plain.variables[n].type == "Int32" else float(plain.get(n)[0]) for n in names
            ])  # fmt: skip
    rows: list[Array] = []
    while cell.time_us < 400_000:
        cell.step(step_us)
        count, values = cell.get_int("trigger.records.count"), columns(cell)
        assert count <= 256
        assert cell.get_int("trigger.queued") == 0
        new = np.array([values[name][:count] for name in names]).T
        rows += list(new)
        if count:
            assert cell.get_int("trigger.index") == values["trigger.index"][count - 1]
            assert not np.array([values[name][count:] for name in names]).any()
    assert len(expected) > 500
    np.testing.assert_array_equal(rows, expected[: len(rows)])
    assert len(rows) >= len(expected) - 1


def test_records_beyond_the_arrays_are_queued(build: Build) -> None:
    cell = build(3, FREE, variants=["--records"])
    cell.trigger(1, 1e-4)
    cell.step(50_000)
    assert cell.get_int("trigger.records.count") == 256
    queued = cell.get_int("trigger.queued")
    assert queued > 200
    cell.trigger(0)
    cell.step(1000)
    assert cell.get_int("trigger.records.count") == min(256, queued)


def test_records_are_part_of_the_state(build: Build) -> None:
    cell, other = (build(3, FREE, variants=["--records"]) for _ in range(2))
    cell.trigger(1, 0.001)
    cell.step(50_000)
    expected = columns(cell)
    other.restore(other.deserialize(cell.serialize(cell.save())), cell.time_us)
    assert other.get_int("trigger.records.count") == cell.get_int("trigger.records.count") > 40
    for name, values in columns(other).items():
        np.testing.assert_array_equal(values, expected[name])


def test_variants_exchange_states(build: Build) -> None:
    cell, other = build(3, FREE), build(3, FREE, variants=["--ahead", "--records", "--arrays"])
    cell.command(table=1.0)
    cell.step(200_000)
    other.restore(other.deserialize(cell.serialize(cell.save())), cell.time_us)
    for one in (cell, other):
        one.step(10_330)
    reference = cell.variables["truth.table"].valueReference
    assert other.slave.getFloat64([reference]) == cell.slave.getFloat64([reference])
