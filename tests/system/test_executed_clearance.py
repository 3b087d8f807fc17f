"""Clearances of executed motions: the FMU's arm, table and interpolation against what was planned."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

import scancell
from bench.true_clearances import CASES, Case, judged, run
from scancell.cell.instance import CellInstance
from scancell.config.loading import assets_dir, load_setup, with_path
from scancell.config.scan import PathDescription, SpiralDescription
from scancell.geometry import pose
from scancell.planning.model import PlanningCell, SensorRange

PART = assets_dir() / "parts" / "free_form.stl"
STEP_US = 2000  # an eighth of the controller's cycle
BOUND = 0.06  # m: distances above it do not matter


@pytest.fixture
def visited(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[np.ndarray]]:
    """True joints and table angle every 2 ms of all cells that are driven."""
    found: list[np.ndarray] = []
    step_to = CellInstance.step_to

    def in_small_steps(cell: CellInstance, time_us: int) -> None:
        truth = cell.real_group([*(f"truth.q[{i}]" for i in range(1, 7)), "truth.table"])
        while cell.time_us < time_us:
            step_to(cell, min(cell.time_us + STEP_US, time_us))
            found.append(cell.get(truth).copy())

    monkeypatch.setattr(CellInstance, "step_to", in_small_steps)
    yield found


@pytest.mark.parametrize("kind", ["path", "default"])
def test_executed_clearances_are_those_planned_within_a_fifth_of_a_millimetre(
    kind: str, visited: list[np.ndarray]
) -> None:
    setup = load_setup(settings=["scan.max_profiles=200"], ideal=True)
    if kind == "path":
        spiral = SpiralDescription(turns=-1.0, elevation_deg=(35.0, 55.0))
        setup = with_path(setup, PathDescription(pitch_mm=4.0, speed_mm_s=100.0, spiral=spiral))
    with scancell.Scanner(setup=setup) as scanner:
        result = scanner.scan(PART, engine="geometric")
    assert result.plan is not None
    cell = PlanningCell(result.nominal, SensorRange.of(result.world.sensor), 0.016)
    planned = np.concatenate([s.axes for s in result.plan.program.segments])
    executed = np.array(visited)
    assert len(executed) > 6 * len(planned)

    def clearances(at: np.ndarray) -> np.ndarray:
        poses = cell.nominal.body_poses(at)
        return np.asarray(cell.proximity.distances(poses, BOUND).min(0))

    smallest, met = clearances(planned), clearances(executed)
    assert (smallest < BOUND).any()
    assert (smallest - met).max() < 2e-4
    assert (met >= 0.8 * cell.clearances(5e-3)).all()


@pytest.mark.parametrize("case", CASES, ids=[f"{case.cell}{number}" for number, case in enumerate(CASES)])
def test_true_bodies_of_a_whole_scan_keep_apart_by_python_fcl(case: Case) -> None:
    """Of the cell with deviations; the same poses with the sensor moved into the part are found."""
    found, nominal, poses = run(replace(case, settings=(*case.settings, "scan.max_profiles=60")), step_us=16_000)
    assert found.contacts == ()
    names = [body.name for body in nominal.bodies]
    sensor, part = names.index("sensor"), names.index("part")
    relative = pose.inverse(poses[:, part]) @ poses[:, sensor]
    assert np.ptp(relative[:, :3, 3], axis=0).max() > 0.02  # they move past each other
    nearest = int(np.argmin(np.linalg.norm(relative[:, :3, 3], axis=1)))
    pushed = poses[nearest - 1 : nearest + 1].copy()
    centre = pose.transform_points(pushed[1, part], nominal.bodies[part].mesh.bounds.mean(0)[None])[0]
    pushed[1, sensor, :3, 3] = centre
    assert {"sensor", "part"} in [set(pair.split(" - ")) for pair in judged(nominal, pushed).contacts]
    assert 5e-3 < found.distance < 0.2
