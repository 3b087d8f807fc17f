"""FMU instances accessed by variable names: values, parameters, error messages, removal of temporary files."""

from __future__ import annotations

import os
import tempfile
import zipfile
from pathlib import Path

import numpy as np
import pytest
from fmu_cells import build

from scancell.cell.fmu_file import parse_as_built
from scancell.cell.fmu_info import describe_fmu
from scancell.cell.instance import CellInstance
from scancell.errors import CellError, DescriptionError


@pytest.fixture(scope="module", params=[2, 3], ids=["FMI 2", "FMI 3"])
def fmu(request, tmp_path_factory):
    """An FMU file."""
    folder = build(tmp_path_factory.mktemp("fmu"), request.param)
    file = folder.with_suffix(".fmu")
    with zipfile.ZipFile(file, "w") as archive:
        for path, _, names in os.walk(folder, followlinks=True):
            for name in names:
                archive.write(Path(path) / name, (Path(path) / name).relative_to(folder))
    return file


@pytest.fixture
def scratch(tmp_path, monkeypatch):
    """Folder into which instances unpack their FMU."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return tmp_path


def test_values_keep_order_of_names(fmu) -> None:
    names = [f"command.q[{i}]" for i in (3, 1, 2)]
    with CellInstance(fmu) as cell:
        group = cell.real_group(names)
        cell.set(group, np.array([0.3, 0.1, 0.2]))
        assert cell.get(cell.real_group(sorted(names))).tolist() == [0.1, 0.2, 0.3]
        cell.set_integer("command.segment", 42)
        assert cell.get_integer("command.segment") == 42


def test_time_is_integer_microseconds(fmu) -> None:
    with CellInstance(fmu) as cell:
        for k in range(1, 301):
            cell.step_to(k * 3333)
        assert cell.time_us == 999_900


def test_cell_is_stationary_without_command(fmu) -> None:
    with CellInstance(fmu) as cell:
        group = cell.real_group([f"measured.q[{i}]" for i in range(1, 7)])
        before = cell.get(group).copy()
        cell.step_to(500_000)
        assert cell.get(group) == pytest.approx(before, abs=1e-12)
        assert cell.get_integer("trigger.count") == 0


def test_perturbation_changes_truth_only(fmu) -> None:
    names = [f"truth.sensor.position[{i}]" for i in (1, 2, 3)]
    positions, joints = [], []
    for words in ((), ("tool.z_mm=1.0",)):
        with CellInstance(fmu, parameters=lambda units, words=words: parse_as_built(words, units)) as cell:
            cell.step_to(16_000)
            positions.append(cell.get(cell.real_group(names)).copy())
            joints.append(cell.get(cell.real_group([f"measured.q[{i}]" for i in range(1, 7)])).copy())
    assert np.linalg.norm(positions[1] - positions[0]) == pytest.approx(1e-3, abs=1e-12)
    assert np.array_equal(joints[0], joints[1])


def test_perturbations_have_units(fmu) -> None:
    with CellInstance(fmu) as cell:
        units = cell.units()
    assert units["as_built.tool.x"] == "m"
    assert units["as_built.dh[3].theta"] == "rad"
    assert units["as_built.trigger.latency"] == "s"


def test_unknown_variable_error(fmu) -> None:
    with CellInstance(fmu) as cell, pytest.raises(CellError, match=r"no variable 'command\.warp'"):
        cell.set_integer("command.warp", 9)
    with pytest.raises(CellError, match=r"no variable 'as_built\.warp'"):
        CellInstance(fmu, parameters=lambda _: {"as_built.warp": 1.0})


def test_fmu_error_includes_message(fmu) -> None:
    with CellInstance(fmu) as cell, pytest.raises(CellError, match=r"command\.mode"):
        cell.set_integer("command.mode", 99)
        cell.step_to(16_000)


def test_close_removes_files(fmu, scratch) -> None:
    with CellInstance(fmu) as cell:
        assert list(scratch.iterdir())
        cell.step_to(16_000)
    assert not list(scratch.iterdir())


def test_closed_instance_refuses_calls(fmu) -> None:
    with CellInstance(fmu) as cell:
        table = cell.real_group(["measured.table"])
    for call in (lambda: cell.get(table), lambda: cell.step_to(16_000), cell.reset):
        with pytest.raises(CellError, match="is closed"):
            call()
    cell.close()


def interrupted(_units):
    raise KeyboardInterrupt


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"parameters": lambda units: parse_as_built(["warp_mm=1"], units)}, DescriptionError, "warp"),
        ({"parameters": interrupted}, KeyboardInterrupt, None),
        ({"cell_file": Path("/gone.json")}, CellError, r"gone\.json"),
    ],
    ids=["unknown perturbation", "interrupt", "missing file"],
)
def test_failed_start_removes_files(fmu, scratch, options, error, message) -> None:
    with pytest.raises(error, match=message):
        CellInstance(fmu, **options)
    assert not list(scratch.iterdir())


def test_invalid_fmu_error(tmp_path) -> None:
    (tmp_path / "thing.fmu").write_text("no")
    with pytest.raises(CellError, match=r"thing\.fmu"):
        CellInstance(tmp_path / "thing.fmu")
    with pytest.raises(CellError, match=r"thing\.fmu: not a readable FMU"):
        describe_fmu(tmp_path / "thing.fmu")


def test_info_shows_every_variable_with_unit_start_and_description(fmu) -> None:
    info = describe_fmu(fmu)
    assert (info.name, info.fmi_version[0], info.platforms) == ("RobotCell", fmu.stem[-1], ["linux64"])
    lines = info.lines()
    assert any(info.token in line for line in lines)
    for variable in info.variables:
        assert variable.description
        shown = variable.name + (f"[{variable.size}]" if variable.size > 1 else "")
        line = next(line for line in lines if line.split()[:1] == [shown])
        assert line.endswith(variable.description)
        assert (f"= {variable.start} " in line) == (variable.causality in {"parameter", "input"})
    latency = next(v for v in info.variables if v.name == "as_built.trigger.latency")
    assert (latency.causality, latency.unit, float(latency.start)) == ("parameter", "s", 0.0)


def test_info_filters_variables_by_prefix(fmu) -> None:
    info = describe_fmu(fmu)
    figures = info.figures("command.trigger.")
    names = [variable["name"] for variable in figures["variables"]]
    inputs = ("mode", "period", "angle", "distance", "conveyor", "travel", "request", "from", "to")
    assert names == [f"command.trigger.{name}" for name in inputs]
    assert figures["causalities"] == info.causalities
    shown = {line.split()[0] for line in info.lines("command.trigger.") if line.startswith("  command")}
    assert shown == set(names)
    with pytest.raises(CellError, match=r"no variable starts with 'warp'; groups of variables: .*command"):
        info.lines("warp")
