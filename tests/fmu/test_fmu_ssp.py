"""The package of cell and sequencer (SSP), run by FMPy and libcosim."""

from __future__ import annotations

import json
import os
import xml.etree.ElementTree as ET
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pyarrow
import pyarrow.csv
import pyssp_standard
import pytest
from cell_fixture import START, cell_description
from fmpy.ssp.simulation import simulate_ssp
from fmpy.ssp.ssd import Parameter, ParameterSet, find_components, read_ssd
from lxml import etree

from bench.peers.attributes import misspelt_attributes
from bench.peers.check import PeerMissingError
from bench.peers.importers import TOLERANCE, ImporterTools, run_tool
from scancell.cell.driver import TRIGGER_MODES, Mode, Operation, Until, example_sequence
from scancell.cell.fmu_file import cell_json, make_temporary_fmu
from scancell.cell.instance import CellInstance, RecordCollector
from scancell.cell.recording import read_recording
from scancell.cell.ssp import build_ssp
from scancell.config.loading import assets_dir, load_setup
from scancell.errors import CommandError, DescriptionError
from scancell.nominal.cell import nominal_cell
from scancell.nominal.parts import load_part

CYCLE_US = 16_000
CYCLE = CYCLE_US * 1e-6
TURN, INTERVAL = 1.0, 0.05  # rad
GOAL = START + np.radians([5.0, -4.0, 3.0, 6.0, -5.0, 8.0])
MOVE = {"mode": int(Mode.JOINT_MOVE), **{f"q[{i}]": float(q) for i, q in enumerate(GOAL, 1)}}
STEPS = [
    {"duration": 0.0, "until": Until.MOTION, **MOVE, "start": 1, "speed": 0.06},
    {"duration": 0.0, "until": Until.TIME, **MOVE, "start": 1,
     "trigger.mode": TRIGGER_MODES["table_angle"], "trigger.angle": INTERVAL, "exposure": 0.002, "segment": 4},
    {"duration": 0.0, "until": Until.MOTION, **MOVE, "start": 2, "speed": 0.1, "table": TURN,
     "trigger.mode": TRIGGER_MODES["table_angle"], "trigger.angle": INTERVAL, "exposure": 0.002, "segment": 4},
    {"duration": 0.2, "until": Until.TIME, "mode": int(Mode.JOINT_JOG), "operation": int(Operation.MANUAL),
     "start": 2, "jog[1]": 0.5},
    {"duration": 0.2, "until": Until.TIME, "operation": int(Operation.MANUAL), "start": 2},
]  # fmt: skip
STOP = 4.0  # s


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("ssp") / "cell.ssp"
    build_ssp(cell_description(), STEPS, path, stop_time=STOP)
    return path


def bound_parameters(package: Path, changes: Mapping[str, float] | None = None) -> ParameterSet:
    """Parameters that the package binds, which FMPy reads but does not set by itself."""
    values = {
        f"{component.name}.{parameter.name}": parameter.value
        for component in find_components(read_ssd(package).system)
        for binding in component.parameterBindings
        for values in binding.parameterValues
        for parameter in values.parameters
    }
    values |= {name: str(value) for name, value in (changes or {}).items()}
    return ParameterSet(parameters=[Parameter(name=name, value=value) for name, value in values.items()])


def run(package: Path, changes: Mapping[str, float] | None = None, stop: float = STOP) -> Any:
    """Values of all connectors after each step, in FMPy."""
    parameters = bound_parameters(package, changes)
    return simulate_ssp(str(package), stop_time=stop - CYCLE / 2, step_size=CYCLE, parameter_set=parameters)


@pytest.fixture(scope="module")
def ran(package: Path) -> Any:
    return run(package)


def end_of_step(rows: Any, number: int) -> int:
    """Row after which a step has ended."""
    return int(np.flatnonzero(rows["sequencer.number"] == number)[-1])


def outputs(rows: Any, package: Path) -> list[str]:
    """Real outputs of the cell among the connectors."""
    with zipfile.ZipFile(package) as archive, archive.open("resources/RobotCell.fmu") as file:
        model = fmpy.read_model_description(file, validate=False)
    reals = [v.name for v in model.modelVariables if v.causality == "output" and v.type == "Real"]
    return [name for name in reals if f"cell.{name}" in rows.dtype.names]


def test_description_and_parameters_follow_schemas(package: Path) -> None:
    """`read_ssd` validates against the schemas of SSP 1.0; connected variables exist and agree."""
    system = read_ssd(package, validate=True).system
    models = {}
    with zipfile.ZipFile(package) as archive:
        for component in find_components(system):
            with archive.open(component.source) as file:
                model = fmpy.read_model_description(file, validate=False)
            models[component.name] = {v.name: v for v in model.modelVariables}
            for connector in component.connectors:
                assert models[component.name][connector.name].causality == connector.kind
    connected = [(c.startElement, c.startConnector, c.endElement, c.endConnector) for c in system.connections]
    assert ("sequencer", "command.q[6]", "cell", "command.q[6]") in connected
    assert ("cell", "controller.at_destination", "sequencer", "controller.at_destination") in connected
    for start, source, end, target in connected:
        output, target_input = models[start][source], models[end][target]
        assert (output.causality, target_input.causality) == ("output", "input")
        assert (output.type, output.unit) == (target_input.type, target_input.unit)


def test_package_of_ssp_2_follows_its_schemas(tmp_path: Path) -> None:
    path = tmp_path / "cell.ssp"
    build_ssp(cell_description(), STEPS, path, stop_time=STOP, version="2.0")
    schemas = Path(pyssp_standard.__file__).parent / "resources" / "ssp2"
    files = {
        "Description": ["SystemStructure.ssd"],
        "ParameterValues": ["resources/cell.ssv", "resources/sequencer.ssv"],
    }
    with zipfile.ZipFile(path) as archive:
        for kind, names in files.items():
            schema = etree.XMLSchema(etree.parse(schemas / f"SystemStructure{kind}.xsd"))
            for name in names:
                document = etree.fromstring(archive.read(name))
                schema.assertValid(document)
                assert document.get("version") == "2.0"


def test_sequencer_fmu_has_no_findings(package: Path, tmp_path: Path) -> None:
    with zipfile.ZipFile(package) as archive:
        fmu = Path(archive.extract("resources/CellSequencer.fmu", tmp_path))
    fmpy.read_model_description(str(fmu), validate=True, validate_model_structure=True)
    with zipfile.ZipFile(fmu) as archive:
        assert misspelt_attributes(ET.fromstring(archive.read("modelDescription.xml")), 2) == []


def test_same_input_gives_same_bytes(package: Path, tmp_path: Path) -> None:
    build_ssp(cell_description(), STEPS, tmp_path / "again.ssp", stop_time=STOP)
    assert (tmp_path / "again.ssp").read_bytes() == package.read_bytes()
    assert [path.name for path in tmp_path.iterdir()] == ["again.ssp"]


def test_sequence_is_executed(ran: Any) -> None:
    assert ran["sequencer.finished"][-1]
    assert ran["sequencer.error"][-1] == 0
    moved = end_of_step(ran, 1)
    for i, goal in enumerate(GOAL, 1):
        assert ran[f"cell.measured.q[{i}]"][moved] == pytest.approx(goal, abs=1e-12)
    turned = end_of_step(ran, 3)
    assert ran["cell.measured.table"][turned] == pytest.approx(TURN, abs=1e-12)
    # One exposure where the trigger is armed, and one at every whole interval.
    assert ran["cell.trigger.count"][-1] in (round(TURN / INTERVAL), round(TURN / INTERVAL) + 1)
    jogged = [ran[f"cell.measured.q[{i}]"][-1] - goal for i, goal in enumerate(GOAL, 1)]
    assert 0.01 < jogged[0] < 0.5 * 0.1 * 5.0 * 0.2  # at most at the jog speed for 0.2 s
    np.testing.assert_allclose(jogged[1:], 0, atol=1e-12)


def test_agrees_with_stepping_in_python(ran: Any, package: Path, tmp_path: Path) -> None:
    """The commands of the sequencer given to the FMU by `CellInstance`: outputs and recorded exposures are the same."""
    names = outputs(ran, package)
    assert {"measured.q[1]", "truth.part[1].position[3]", "trigger.time", "trigger.measured.table"} <= set(names)
    with CellInstance(make_temporary_fmu(cell_description(), tmp_path / "fmu")) as cell:
        inputs = [n for n in cell.names if n.startswith("command.") and f"cell.{n}" in ran.dtype.names]
        reals = [n for n in inputs if ran[f"cell.{n}"].dtype.kind == "f"]
        integers = [n for n in inputs if ran[f"cell.{n}"].dtype.kind == "i"]
        seen, commands = cell.real_group(names), cell.real_group(reals)
        collector = RecordCollector(cell, CYCLE_US, exposure=0.0)
        collector.step_to(CYCLE_US)
        rows = []
        for row in range(1, len(ran)):  # inputs of a step are the connectors after the step before
            for name in integers:
                cell.set_integer(name, int(ran[f"cell.{name}"][row - 1]))
            cell.set(commands, np.array([ran[f"cell.{name}"][row - 1] for name in reals]))
            collector.step_to((row + 1) * CYCLE_US)
            rows.append(cell.get(seen).copy())
        own = collector.finish()
    expected = np.stack([ran[f"cell.{name}"][1:] for name in names], 1)
    assert np.ptp(expected, axis=0).max() > 0.5  # nonzero motion
    np.testing.assert_allclose(rows, expected, rtol=0, atol=TOLERANCE)
    table = {name.removeprefix("cell."): ran[name] for name in ran.dtype.names if name.startswith("cell.trigger.")}
    pyarrow.csv.write_csv(pyarrow.table(table), tmp_path / "recording.csv")
    recording = read_recording(tmp_path / "recording.csv")
    assert len(own) == len(recording) >= TURN / INTERVAL
    assert set(own.columns["trigger.segment"]) == {4}
    for name, values in own.columns.items():
        np.testing.assert_allclose(recording.columns[name], values, rtol=0, atol=TOLERANCE, err_msg=name)


def test_changed_parameters_take_effect(ran: Any, package: Path) -> None:
    """Half the speed takes longer, another target is reached, the true table is displaced as built."""
    changes = {"sequencer.step[1].speed": 0.03, "sequencer.step[1].q[2]": float(START[1])}
    changed = run(package, changes | {"cell.as_built.table.x": 0.003}, stop=2.0)
    slow, fast = end_of_step(changed, 1), end_of_step(ran, 1)
    assert slow > 1.3 * fast
    assert changed["cell.measured.q[2]"][slow] == pytest.approx(START[1], abs=1e-12)
    assert changed["cell.measured.q[1]"][slow] == pytest.approx(GOAL[0], abs=1e-12)
    displaced = changed["cell.truth.table.position[1]"][0] - ran["cell.truth.table.position[1]"][0]
    assert displaced == pytest.approx(0.003, abs=1e-9)


def test_libcosim_agrees_with_fmpy(ran: Any, package: Path, tmp_path: Path) -> None:
    """It sets the parameters of the package, and steps as the package's default experiment states."""
    names = outputs(ran, package)
    np.testing.assert_allclose(
        run_in_libcosim(package, names, len(ran), tmp_path),
        np.stack([ran[f"cell.{name}"] for name in names], 1),
        rtol=0,
        atol=TOLERANCE,
    )


def test_libcosim_uses_changed_parameter_file(ran: Any, package: Path, tmp_path: Path) -> None:
    changed = tmp_path / "changed.ssp"
    before = '<ssv:Parameter name="step[1].speed">\n      <ssv:Real value="0.06" />'
    with zipfile.ZipFile(package) as old, zipfile.ZipFile(changed, "w") as new:
        for name in old.namelist():
            content = old.read(name)
            if name == "resources/sequencer.ssv":
                assert before.encode() in content
                content = content.replace(before.encode(), before.replace("0.06", "0.03").encode())
            new.writestr(name, content)
    name = "measured.q[1]"
    rows = run_in_libcosim(changed, [name], len(ran), tmp_path)[:, 0]
    arrived = [int(np.flatnonzero(np.abs(q - GOAL[0]) < 1e-12)[0]) for q in (rows, ran[f"cell.{name}"])]
    assert arrived[0] > 1.3 * arrived[1]


def run_in_libcosim(package: Path, names: list[str], steps: int, folder: Path) -> np.ndarray:
    """Real outputs of the cell after each step; skips where libcosim cannot be installed."""
    tools = ImporterTools(Path(os.environ.get("SCANCELL_IMPORTERS", Path(__file__).parents[2] / "build/importers")))
    try:
        python = tools.python()
    except PeerMissingError as missing:
        if os.environ.get("CI"):
            raise
        pytest.skip(str(missing))
    request, answer = folder / "request.json", folder / "rows.json"
    request.write_text(json.dumps({"ssp": str(package), "component": "cell", "outputs": names, "steps": steps}))
    run_tool([python, Path(__file__).parents[1] / "bench/peers/importers_ssp.py", request, answer])
    return np.array(json.loads(answer.read_text()))


def test_rejected_command_ends_sequence(package: Path) -> None:
    """Joint 1 beyond its limit: the sequence stops with the error of the controller, and the axes rest."""
    rows = run(package, {"sequencer.step[1].q[1]": 3.1}, stop=0.5)
    assert rows["sequencer.error"][-1] == 5
    assert rows["sequencer.number"][-1] == 1
    assert not rows["sequencer.finished"][-1]
    assert rows["cell.command.mode"][-1] == Mode.HOLD
    assert rows["cell.measured.q[1]"][-1] == pytest.approx(START[0], abs=1e-12)


@pytest.fixture(scope="module")
def pick_package(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Example of the cell with belt and gripper, without outputs of collisions, which cost most of its steps."""
    setup = load_setup(assets_dir() / "cells/pick_and_place.toml", ideal=True)
    nominal = nominal_cell(setup.cell, load_part(assets_dir() / "parts/step_block.stl"))
    description = cell_json(setup.cell, nominal, 0, collision_outputs=False)
    path = tmp_path_factory.mktemp("pick") / "pick.ssp"
    build_ssp(description, example_sequence(setup, nominal), path, stop_time=30.0)
    return path


def test_example_picks_places_scans_and_jogs(pick_package: Path) -> None:
    rows = run(pick_package, stop=22.0)
    assert rows["sequencer.finished"][-1]
    assert rows["sequencer.error"][-1] == 0
    aloft = rows["cell.truth.part[1].position[3]"] > 0.11
    assert aloft.any()
    assert rows["cell.measured.gripper.gripped"][aloft].all()
    # Placed in the middle of the table, where the exposures of a whole turn are taken.
    table = (0.45, 0.0, 0.1)
    placed = [rows[f"cell.truth.part[1].position[{i}]"][-1] for i in (1, 2, 3)]
    np.testing.assert_allclose(placed, table, rtol=0, atol=1e-6)
    turned = rows["cell.trigger.count"][-1] - 1
    assert turned in (179, 180)
    exposures = np.flatnonzero(np.diff(rows["cell.trigger.index"]) > 0)
    assert not aloft[exposures].any()
    # Two jogs in manual operation, nothing else.
    manual = rows["cell.command.operation"] == Operation.MANUAL
    assert set(rows["cell.controller.mode"][manual]) >= {Mode.JOINT_JOG, Mode.CARTESIAN_JOG}
    assert rows["cell.controller.mode"][-1] == Mode.HOLD


def test_example_without_gripper_scans_and_jogs() -> None:
    for name in ("default", "seven_axis", "offset_wrist"):
        setup = load_setup(assets_dir() / f"cells/{name}.toml")
        steps = example_sequence(setup, nominal_cell(setup.cell, None))
        assert not any("gripper.mode" in step for step in steps)
        assert {step.get("mode", 0) for step in steps} == {
            Mode.HOLD, Mode.JOINT_MOVE, Mode.JOINT_JOG, Mode.CARTESIAN_JOG
        }  # fmt: skip


def test_wrong_input_is_rejected(tmp_path: Path) -> None:
    cell = cell_description()
    with pytest.raises(DescriptionError, match=r"cell\.zip.*\.ssp"):
        build_ssp(cell, STEPS, tmp_path / "cell.zip", stop_time=STOP)
    for stop in (0.0, -1.0, np.inf, np.nan):
        with pytest.raises(DescriptionError, match="stop_time"):
            build_ssp(cell, STEPS, tmp_path / "cell.ssp", stop_time=stop)
    for step, key in (({"spede": 0.5}, "step[1].spede"), ({"gripper.mode": 1}, "step[1].gripper.mode")):
        with pytest.raises(DescriptionError) as caught:
            build_ssp(cell, [step], tmp_path / "cell.ssp", stop_time=STOP)
        assert caught.value.key == key
    with pytest.raises(DescriptionError, match=r"step\[21\]"):
        build_ssp(cell, [STEPS[0]] * 21, tmp_path / "cell.ssp", stop_time=STOP)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("settings", "error", "text"),
    [
        (["cell.gripper.stroke_mm=55"], DescriptionError, "gripper.stroke_mm = 55.0: expected at least 60.0"),
        (["cell.conveyor[1].pose.x_mm=900"], CommandError, "cannot be brought to"),
    ],
)
def test_example_that_cannot_be_executed_is_rejected(settings: list[str], error: type[Exception], text: str) -> None:
    setup = load_setup(assets_dir() / "cells/pick_and_place.toml", settings=settings)
    nominal = nominal_cell(setup.cell, load_part(assets_dir() / "parts/step_block.stl"))
    with pytest.raises(error, match=text):
        example_sequence(setup, nominal)
