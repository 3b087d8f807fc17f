"""One instance of the FMU by names: values, integers, parameters, errors in words, nothing left behind."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import pytest
from fmu_cells import build

from orchestrator.cell.as_built import parse_as_built
from orchestrator.cell.fmu_info import describe_fmu
from orchestrator.cell.instance import CellInstance
from orchestrator.errors import CellError, DescriptionError


@pytest.fixture(scope="module", params=[2, 3], ids=["FMI 2", "FMI 3"])
def fmu(request, tmp_path_factory):
    return build(tmp_path_factory.mktemp("fmu"), request.param)


@pytest.fixture
def scratch(tmp_path, monkeypatch):
    """Where instances unpack their FMU."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return tmp_path


def test_values_are_set_and_got_in_the_order_of_their_names(fmu) -> None:
    names = [f"command.q[{i}]" for i in (3, 1, 2)]
    with CellInstance(fmu) as cell:
        group = cell.real_group(names)
        cell.set(group, np.array([0.3, 0.1, 0.2]))
        assert cell.get(cell.real_group(sorted(names))).tolist() == [0.1, 0.2, 0.3]
        cell.set_integer("command.segment", 42)
        assert cell.get_integer("command.segment") == 42


def test_time_is_counted_in_whole_microseconds(fmu) -> None:
    with CellInstance(fmu) as cell:
        for k in range(1, 301):
            cell.step_to(k * 3333)
        assert cell.time_us == 999_900


def test_cell_holds_still_without_a_command(fmu) -> None:
    with CellInstance(fmu) as cell:
        group = cell.real_group([f"measured.q[{i}]" for i in range(1, 7)])
        before = cell.get(group).copy()
        cell.step_to(500_000)
        assert cell.get(group) == pytest.approx(before, abs=1e-12)
        assert cell.get_integer("trigger.count") == 0


def test_perturbation_moves_the_truth_and_not_the_measured(fmu) -> None:
    names = [f"truth.sensor.position[{i}]" for i in (1, 2, 3)]
    places, joints = [], []
    for words in ((), ("tool.z_mm=1.0",)):
        with CellInstance(fmu, parameters=lambda units, words=words: parse_as_built(words, units)) as cell:
            cell.step_to(16_000)
            places.append(cell.get(cell.real_group(names)).copy())
            joints.append(cell.get(cell.real_group([f"measured.q[{i}]" for i in range(1, 7)])).copy())
    assert np.linalg.norm(places[1] - places[0]) == pytest.approx(1e-3, abs=1e-12)
    assert np.array_equal(joints[0], joints[1])


def test_units_of_perturbations_are_known(fmu) -> None:
    with CellInstance(fmu) as cell:
        units = cell.units()
    assert units["as_built.tool.x"] == "m"
    assert units["as_built.dh[3].theta"] == "rad"
    assert units["as_built.trigger.latency"] == "s"


def test_unknown_variable_is_named(fmu) -> None:
    with CellInstance(fmu) as cell, pytest.raises(CellError, match=r"no variable 'command\.warp'"):
        cell.set_integer("command.warp", 9)


def test_error_of_the_fmu_comes_with_its_message(fmu) -> None:
    with CellInstance(fmu) as cell, pytest.raises(CellError, match=r"command\.mode"):
        cell.set_integer("command.mode", 99)
        cell.step_to(16_000)


def test_nothing_is_left_behind(fmu, scratch) -> None:
    with CellInstance(fmu) as cell:
        assert list(scratch.iterdir())
        cell.step_to(16_000)
    assert not list(scratch.iterdir())


def test_unknown_perturbation_leaves_nothing_behind(fmu, scratch) -> None:
    with pytest.raises(DescriptionError, match="warp"):
        CellInstance(fmu, parameters=lambda units: parse_as_built(["warp_mm=1"], units))
    assert not list(scratch.iterdir())


def test_interrupt_at_the_start_leaves_nothing_behind(fmu, scratch) -> None:
    def interrupted(_units):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        CellInstance(fmu, parameters=interrupted)
    assert not list(scratch.iterdir())


def test_cell_file_that_does_not_exist_is_named(fmu, scratch) -> None:
    with pytest.raises(CellError, match=r"gone\.json"):
        CellInstance(fmu, cell_file=Path("/gone.json"))
    assert not list(scratch.iterdir())


def test_file_that_is_no_fmu(tmp_path) -> None:
    (tmp_path / "thing.fmu").write_text("no")
    with pytest.raises(CellError, match=r"thing\.fmu"):
        CellInstance(tmp_path / "thing.fmu")
    with pytest.raises(CellError, match=r"thing\.fmu: not a readable FMU"):
        describe_fmu(tmp_path / "thing.fmu")


def test_info_tells_what_the_fmu_is(fmu) -> None:
    info = describe_fmu(fmu)
    assert info.name == "RobotCell"
    assert info.fmi_version[0] == fmu.stem[-1]
    assert info.platforms == ["linux64"]
    assert info.causalities["input"] >= 38
    assert any(info.token in line for line in info.lines())
