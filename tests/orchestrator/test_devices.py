"""Further parts, soft parts and conveyors: conversion for the FMU, recorded poses, bodies of the scene."""

from __future__ import annotations

import numpy as np
import pytest
from cells import cell_file, export_mm
from fmu_cells import drive

from mesh_json import read_mesh_json
from scancell.cell.fmu_file import cell_json
from scancell.cell.program import TriggerRule
from scancell.cell.recording import read_recording, write_recording
from scancell.config.loading import load_setup
from scancell.errors import DescriptionError
from scancell.geometry.mesh import box_mesh
from scancell.nominal.cell import nominal_cell
from scancell.scanning.world import exposures_from_truth, visible_bodies

BLOCK = box_mesh((0.04, 0.03, 0.02), "block")
DEVICES = """
[[conveyor]]
name = "belt"
pose = { x_mm = 0.0, y_mm = -500.0, z_mm = 200.0, rz_deg = 90.0 }
length_mm = 600.0
width_mm = 150.0

[[further_part]]
name = "rider"
mesh = "block.stl"
stands_on = "conveyor[1]"
pose = { x_mm = 100.0, z_mm = 10.0 }

[[further_part]]
name = "bracket"
mesh = "block.stl"
fixture = "clamped"
pose = { y_mm = 60.0, z_mm = 10.0, rz_deg = 30.0 }
"""


@pytest.fixture
def described(tmp_path):
    """The default cell with a conveyor and two further parts, in the folder of their mesh."""
    export_mm(BLOCK, tmp_path / "block.stl")
    return cell_file(tmp_path, DEVICES)


def test_devices_json_is_in_si_units(described) -> None:
    setup = load_setup(described)
    data = cell_json(setup.cell, nominal_cell(setup.cell, BLOCK), 0)
    assert [part["name"] for part in data["parts"]] == ["part", "rider", "bracket"]
    assert [part["stands_on"] for part in data["parts"]] == ["table", "conveyor[1]", "table"]
    assert data["parts"][1]["support_from_part"]["position"] == [0.1, 0.0, 0.01]
    assert data["parts"][1]["inertial"]["mass"] == pytest.approx(2700 * 0.04 * 0.03 * 0.02)
    assert data["parts"][0]["inertial"] is None  # clamped
    assert all(len(read_mesh_json(part["hull"])[0]) == 8 for part in data["parts"])  # the free one can touch all
    belt = data["conveyors"][0]
    assert (belt["length"], belt["max_speed"], belt["max_acceleration"]) == (0.6, 0.5, 1.0)


def test_springs_of_a_soft_part_are_in_si_units() -> None:
    soft = "cell.part.soft={stiffness_n_mm=0.5, longest_edge_mm=8}"
    for words, expected in (
        (['cell.part.fixture="free"', soft], {"stiffness": 500.0, "damping_ratio": 1.0, "longest_edge": 0.008}),
        ([], None),
    ):
        setup = load_setup(settings=words)
        assert cell_json(setup.cell, nominal_cell(setup.cell, BLOCK), 0)["parts"][0]["soft"] == pytest.approx(expected)


def test_recorded_part_poses_move_bodies(described, tmp_path) -> None:
    """The clamped part rotates with the table, the other one moves with the belt."""
    setup = load_setup(described, ideal=True)
    nominal = nominal_cell(setup.cell, BLOCK)
    table = 0.3 * (1 - np.cos(np.linspace(0, np.pi, 60)))
    recording = drive(tmp_path, setup.cell, nominal, table, TriggerRule("time", 0.1), belt_speed=0.1)
    write_recording(recording, tmp_path / "records.parquet")
    read = read_recording(tmp_path / "records.parquet")
    truth = read.truth.world_from_frame
    assert set(truth) >= {"part[1]", "part[2]", "part[3]"}
    table, bracket, rider = (truth[name].mean(1)[:, :3, 3] for name in ("table", "part[3]", "part[2]"))
    assert np.ptp(bracket[:, :2], axis=0).max() > 0.01
    assert np.ptp(np.linalg.norm(bracket - table, axis=1)) < 1e-9
    travelled = np.ptp(rider, axis=0)
    assert travelled[1] > 0.04
    assert travelled[[0, 2]].max() < 1e-6
    # At the start all parts are at their nominal poses.
    first = nominal.frame_poses(nominal.home)
    assert np.abs(rider[0, [0, 2]] - first["part[2]"][[0, 2], 3]).max() < 1e-6
    bodies = visible_bodies(nominal)
    names = [body.name for body in bodies]
    assert {"belt", "rider", "bracket"} <= set(names)
    exposures = exposures_from_truth(read.truth, read.measured.index, bodies)
    assert exposures is not None
    np.testing.assert_array_equal(read.without_truth().columns["trigger.index"], read.columns["trigger.index"])
    assert np.isnan(read.without_truth().columns["trigger.truth.part[3].position[1]"]).all()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["cell.further_part[1].stands_on='conveyor[2]'"], "there are 1 conveyors"),
        (["cell.further_part[1].fixture='clamped'"], "cannot be clamped"),
        (["cell.further_part[2].name='rider'"], "the name 'rider' is taken"),
        (["cell.conveyor[1].name='table'"], "the name 'table' is taken"),
        (["cell.conveyor[1].length_mm=0"], "length_mm"),
    ],
)
def test_invalid_devices_are_rejected(described, words, said) -> None:
    with pytest.raises(DescriptionError, match=said):
        load_setup(described, settings=words)


ARRIVAL = """
[part]
fixture = "free"

[part.arrival]
stands_on = "conveyor[1]"
pose = { x_mm = -100.0, z_mm = 10.0 }
"""


def test_scanned_part_starts_on_conveyor(described) -> None:
    """The FMU starts with the part on the conveyor; planning and reconstruction use its pose on the table."""
    described.write_text(described.read_text() + ARRIVAL)
    setup = load_setup(described)
    nominal = nominal_cell(setup.cell, BLOCK)
    part = cell_json(setup.cell, nominal, 0)["parts"][0]
    assert (part["name"], part["stands_on"], part["fixture"]) == ("part", "conveyor[1]", "free")
    assert part["support_from_part"]["position"] == pytest.approx([-0.1, 0.0, 0.01])
    np.testing.assert_allclose(nominal.world_from("part")[:3, 3], [0.45, 0.0, 0.11], atol=1e-12)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"free"', '"clamped"', 'must be "free"'),
        ('[part.arrival]\nstands_on = "conveyor[1]"', '[part.arrival]\nstands_on = "conveyor[2]"', "part.arrival"),
        ('[part.arrival]\nstands_on = "conveyor[1]"', '[part.arrival]\nstands_on = "table"', "stands_on"),
    ],
)
def test_invalid_arrival_is_rejected(described, old, new, message) -> None:
    described.write_text(described.read_text() + ARRIVAL.replace(old, new))
    with pytest.raises(DescriptionError, match=message):
        load_setup(described)
