"""Comparison of the FMU with a twin of the cell on DART's Python binding."""

from __future__ import annotations

import numpy as np
import pytest
from cell_fixture import CYCLE_US, START, Array, Build, box_part, cell_description, pose
from dart_twin import DartTwin

from mesh_json import read_mesh_json
from scancell.cell.fmu_file import mesh_json

CYCLES = 625  # 10 s
CYCLE = CYCLE_US * 1e-6


def set_points(cycle: int) -> Array:
    """All joints oscillate with different periods, the table accelerates to 0.5 rad/s from rest."""
    t = cycle * CYCLE
    rise = min(t / 2, 1.0) ** 2 * (3 - 2 * min(t / 2, 1.0))
    q = START + 0.2 * rise * np.sin(np.arange(1, 7) * t)
    return np.append(q, 0.5 * (t - 1 + np.exp(-t)))


def test_twin_agrees_over_ten_seconds_of_motion(build: Build) -> None:
    """Compares angles at every dynamics step and link poses at every cycle."""
    description = cell_description()
    cell, twin = build(3, description), DartTwin(description)
    for k in range(CYCLES):
        target = set_points(k)
        cell.command(target[:6], target[6])
        expected = []
        for _ in range(CYCLE_US // 1000):
            cell.step(1000)
            expected.append(np.append(cell.vector("truth.q", 6), cell.get("truth.table")))
        np.testing.assert_allclose(twin.cycle(target), expected, atol=1e-6)
        assert twin.time_us == cell.time_us
        for link in (1, 3, 6):
            np.testing.assert_allclose(twin.link_pose(link), cell.body(f"link[{link}]"), atol=1e-6)
        np.testing.assert_allclose(twin.table_pose, cell.body("table"), atol=1e-6)
    # The difference is rounding only.
    assert np.abs(twin.positions - expected[-1]).max() < 1e-11


@pytest.mark.parametrize("radius", [0.03, 0.07])
def test_part_on_rotating_table_differs_by_engine_creep(build: Build, radius: float) -> None:
    """Without stick constraints the engine lets a resting part creep outwards by r w^2 dt / 2 per second.

    That is all that the two differ by: 0.1 mm in 10 s at 0.5 rad/s and 70 mm.
    """
    place = pose([radius, 0, 0])
    description = cell_description(fixture="free", support_from_part=place)
    cell, twin = build(3, description), DartTwin(description)
    on_platter = [np.linalg.inv(twin.table_pose) @ twin.part_pose(1)]
    speeds = []
    for k in range(CYCLES):
        target = set_points(k)
        cell.command(target[:6], target[6])
        cell.step(CYCLE_US)
        angles = twin.cycle(target)[:, 6]
        speeds.append((angles[-1] - angles[0]) / (len(angles) - 1) / 1e-3)
        on_platter.append(np.linalg.inv(twin.table_pose) @ twin.part_pose(1))
    creep = radius * 1e-3 / 2 * np.sum(np.square(speeds)) * CYCLE
    shift = on_platter[-1] - np.linalg.inv(cell.body("table")) @ cell.body("part[1]")
    assert shift[0, 3] == pytest.approx(creep, rel=0.1)
    assert np.abs(shift[1:3, 3]).max() < 0.1 * creep
    assert np.abs(shift[:3, :3]).max() < 1e-5
    assert creep < 1e-4


def test_twin_rejects_unsupported_parts() -> None:
    description = cell_description(fixture="free")
    description["parts"] = [box_part(0.06, 0.04, 0.05, fixture="free")]
    vertices, faces = read_mesh_json(description["parts"][0]["hull"])
    description["parts"][0]["hull"] = mesh_json(vertices + np.eye(8, 3) * 0.001, faces)
    with pytest.raises(ValueError, match=r"parts\[0\]\.hull"):
        DartTwin(description)
