"""Package: model descriptions, binary, library closure."""

from __future__ import annotations

import json
import re
import subprocess
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest
from cell_fixture import (
    Array,
    Build,
    FmuFolders,
    box_part,
    cell_description,
    conveyor,
    pose,
    runtime_folder,
    write_fmu,
)
from fmpy.validation import validate_fmu
from grasp_fixture import gripper

from bench.peers.attributes import ATTRIBUTES, misspelt_attributes

SYSTEM = ("linux-vdso", "ld-linux", "libc.so", "libm.so", "libpthread.so", "libdl.so", "libstdc++.so", "libgcc_s.so")


def run(*command: str | Path) -> str:
    return subprocess.run([str(c) for c in command], check=True, capture_output=True, text=True).stdout


def description_of(folder: Path) -> ET.Element:
    return ET.parse(folder / "modelDescription.xml").getroot()


@pytest.mark.parametrize("version", [2, 3])
def test_fmpy_validates_model_description(folders: FmuFolders, version: int) -> None:
    file = folders.packed(version, {**cell_description(), "gripper": gripper()})
    assert validate_fmu(str(file)) == []


@pytest.mark.parametrize(
    ("version", "variant"),
    [
        (2, []),
        (3, []),
        (3, ["--clock"]),
        (3, ["--arrays"]),
        (3, ["--arrays", "--clock"]),
        (2, ["--integers"]),
        (3, ["--integers"]),
    ],
)
def test_attributes_are_those_of_the_fmi_version(tmp_path: Path, version: int, variant: list[str]) -> None:
    file = tmp_path / "cell.json"
    file.write_text(json.dumps(cell_description()))
    words = ["--fmi", str(version), "--needs", 'a "machine" & more', *variant]
    root = ET.fromstring(run(runtime_folder() / "robotcell-describe", file, *words))
    assert root.attrib["description"].endswith('(needs a "machine" & more)')
    assert misspelt_attributes(root, version) == []
    co_simulation = root.find("CoSimulation")
    assert co_simulation is not None
    assert set(co_simulation.attrib) == ATTRIBUTES[version]["CoSimulation"]
    assert ("guid" in root.attrib) == (version == 2)
    assert ("instantiationToken" in root.attrib) == (version == 3)


def test_both_fmi_versions_describe_same_variables(build: Build) -> None:
    tables = [
        [(v.name, v.valueReference, v.causality, v.variability, v.description, v.start, v.declaredType and (
            v.declaredType.name, v.declaredType.quantity, v.declaredType.unit, v.declaredType.displayUnit))
         for v in build(version).description.modelVariables if v.type != "Clock"]
        for version in (2, 3)
    ]  # fmt: skip
    assert tables[0] == tables[1]
    assert len({name for name, *_ in tables[0]}) == len(tables[0])
    assert all(len(row[4]) > 10 for row in tables[0])
    units = {row[0]: row[-1][2] for row in tables[0] if row[-1]}
    assert units["truth.sensor.position[1]"] == "m"
    assert units["command.q[3]"] == units["as_built.tool.rx"] == "rad"
    assert units["trigger.time"] == "s"


@pytest.mark.parametrize("version", [2, 3])
def test_enumerations_name_their_members(build: Build, version: int) -> None:
    """Every choice is an enumeration with named items from 0 on, and its text lists them."""
    cell = build(version, {**cell_description(), "gripper": gripper()})
    names = {n: v.declaredType for n, v in cell.variables.items() if v.type == "Enumeration"}
    assert set(names) == {
        "command.mode", "command.jog_frame", "command.operation", "command.trigger.mode", "command.gripper.mode",
        "controller.mode", "controller.state", "controller.error",
    }  # fmt: skip
    for name, kind in names.items():
        assert [int(item.value) for item in kind.items] == list(range(len(kind.items)))
        for item in kind.items:
            assert f"{item.value} {item.name} ({item.description})" in cell.variables[name].description
    assert names["command.mode"].name == names["controller.mode"].name == "ControllerMode"
    assert [item.name for item in names["command.operation"].items] == ["manual", "automatic"]
    cell.set("command.trigger.mode", len(names["command.trigger.mode"].items) - 1)
    assert cell.get_int("command.trigger.mode") == 5
    with pytest.raises(Exception, match="fmi"):
        cell.set("command.trigger.mode", 6)
    assert "command.trigger.mode must be from 0 to 5" in cell.messages[-1]


@pytest.mark.parametrize("value", [-1, 7, 2**32 + 1])
def test_values_beyond_an_enumeration_are_errors(build: Build, value: int) -> None:
    cell = build(3)
    with pytest.raises(Exception, match="fmi3SetInt64"):
        cell.set("command.mode", value)


@pytest.mark.parametrize("version", [2, 3])
def test_variant_with_integers_has_same_token_and_values(
    build: Build, open_fmu: Build, tmp_path: Path, version: int
) -> None:
    cell = open_fmu(write_fmu(cell_description(), version, tmp_path / "RobotCell", "--integers"))
    usual = build(version)
    assert cell.description.guid == usual.description.guid
    assert not [v for v in cell.variables.values() if v.type == "Enumeration"]
    assert (cell.variables["command.mode"].min, cell.variables["command.mode"].max) == ("0", "6")
    for each in (cell, usual):
        each.set("command.mode", 2)
        each.step(1000)
    assert cell.get_int("controller.mode") == usual.get_int("controller.mode") == 2


@pytest.mark.parametrize("version", [2, 3])
def test_model_structure_is_sorted(folders: FmuFolders, version: int) -> None:
    root = description_of(folders.unpacked(version, cell_description()))
    paths = {
        2: ("Outputs/Unknown", "InitialUnknowns/Unknown", "index"),
        3: ("Output", "InitialUnknown", "valueReference"),
    }
    outputs, initial, key = paths[version]
    for path in (outputs, initial):
        references = [int(e.attrib[key]) for e in root.findall(f"ModelStructure/{path}")]
        assert references == sorted(set(references))
        for element in root.findall(f"ModelStructure/{path}"):
            dependencies = [int(d) for d in element.attrib["dependencies"].split()]
            assert dependencies == sorted(set(dependencies))


@pytest.mark.parametrize("devices", ["one part", "several"])
def test_initial_dependencies_are_complete_and_minimal(build: Build, devices: str) -> None:
    """Changing one parameter of a cell without symmetry changes exactly the outputs that declare it."""
    description = cell_description()
    if devices == "several":
        description["conveyors"] = [conveyor()]
        description["gripper"] = gripper()
        beside = box_part(0.1, 0.1, 0.1, stands_on="world", support_from_part=pose([0.5, 0.5, 0.1]))
        description["parts"] += [beside, box_part(0.02, 0.02, 0.02, support_from_part=pose([-0.05, 0.01, 0]))]
    for axis in [*description["robot"]["joints"], description["table"]]:
        axis["encoder_noise"] = 1e-4
    cell = build(3, description)
    parameters = [n for n, v in cell.variables.items() if v.causality == "parameter" and n not in ("cell.file", "seed")]
    rng = np.random.default_rng(1)
    values: dict[str, float | int] = {name: float(rng.uniform(0.005, 0.02)) for name in parameters}
    outputs = [n for n, v in cell.variables.items() if v.type == "Float64" and v.causality == "output"]

    def initial_values(parameter: str) -> Array:
        change = {parameter: 7 if parameter == "seed" else values.get(parameter, 0) + 0.01} if parameter else {}
        cell.slave.reset()
        cell.initialize({**values, **change})
        return cell.get(*outputs)

    before = initial_values("")
    for parameter in [*parameters, "seed"]:
        moved = initial_values(parameter) != before
        named = {
            u.variable.name for u in cell.description.initialUnknowns if parameter in {d.name for d in u.dependencies}
        }
        # A change along x may leave y unchanged: dependencies are declared for whole vectors.
        moved_vectors = {name.rsplit("[", 1)[0] for name, m in zip(outputs, moved, strict=True) if m}
        assert moved_vectors == {name.rsplit("[", 1)[0] for name in named}, parameter


def test_library_exports_only_fmi_functions() -> None:
    symbols = run("nm", "-D", "--defined-only", runtime_folder() / "RobotCell.so").split("\n")
    names = [line.split()[-1] for line in symbols if line]
    assert len(names) > 80
    assert all(re.match(r"fmi[23][A-Z]", name) for name in names)


@pytest.mark.parametrize("version", [2, 3])
def test_fmu_contains_library_closure(folders: FmuFolders, version: int) -> None:
    folder = folders.unpacked(version, cell_description())
    binaries = next((folder / "binaries").iterdir())
    for library in binaries.iterdir():
        for line in run("ldd", library).splitlines():
            name, _, place = line.strip().partition(" => ")
            if name != "statically linked" and not Path(name).name.startswith(SYSTEM):
                assert Path(place.split(" (")[0]).resolve().parent == binaries.resolve(), line
        symbols = run("readelf", "--dyn-syms", "--wide", library)
        assert " UNIQUE " not in symbols  # would be merged with other copies in the process
    sonames = [library.name for library in binaries.iterdir() if library.name != "RobotCell.so"]
    assert all(re.match(r".*-[0-9a-f]{8}\.so", name) for name in sonames)


def test_every_bundled_library_has_a_licence() -> None:
    texts = {file.stem: file.read_text(errors="replace") for file in (runtime_folder() / "licenses").iterdir()}
    assert "fmi" in texts
    assert all("copyright" in text.lower() for text in texts.values())
    for library in runtime_folder().glob("lib*.so*"):
        stem = re.sub(r"-[0-9a-f]{8}\.so.*", "", library.name).removeprefix("lib").replace("_", "-")
        origins = {"octomath": "octomap", "z": "zlib", "robotcell-locks": "scancell"}
        assert any(origins.get(stem, stem) in name for name in texts), library.name


def test_package_size(folders: FmuFolders) -> None:
    file = folders.packed(3, cell_description())
    assert file.stat().st_size < 12e6


def test_display_units_have_exact_factors(build: Build) -> None:
    cell = build(2)
    units = {u.name: {d.name: d.factor for d in u.displayUnits} for u in cell.description.unitDefinitions}
    assert float(units["rad"]["deg"]) == np.degrees(1)
    assert float(units["m"]["mm"]) == 1000
