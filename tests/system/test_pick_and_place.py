"""The example of docs/examples: from the belt to the table to the cloud, by commands alone."""

from __future__ import annotations

import importlib.util
import json
import sys
from pathlib import Path

import numpy as np
import pytest

from scancell.config.loading import assets_dir, load_setup

SCRIPT = Path(__file__).parents[2] / "docs/examples/pick_and_place.py"
SPARSE = ["scan.max_profiles=60", "scan.raster.enabled=false"]


@pytest.fixture(scope="module")
def example():
    """The script as a module."""
    spec = importlib.util.spec_from_file_location("pick_and_place", SCRIPT)
    module = importlib.util.module_from_spec(spec)
    sys.modules["pick_and_place"] = module
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def ran(example, tmp_path_factory):
    """What became of it: the task with its signals, and the folder of results."""
    setup = load_setup(assets_dir() / "cells/pick_and_place.toml", settings=SPARSE, ideal=True)
    out = tmp_path_factory.mktemp("pick") / "out"
    _, task = example.run(assets_dir() / "parts/step_block.stl", out, setup, "geometric")
    return task, out


def between(task, name: str) -> slice:
    """Rows of the log that belong to a stage."""
    begins = [begin for begin, _ in task.stages]
    stage = [label for _, label in task.stages].index(name)
    ends = [*begins[1:], np.inf]
    rows = np.flatnonzero((task.log.time >= begins[stage]) & (task.log.time < ends[stage]))
    return slice(int(rows[0]), int(rows[-1]) + 1)


def test_belt_stops_at_gate(ran, example) -> None:
    task, _ = ran
    seen = task.log["presence[1].detected"]
    first = int(np.flatnonzero(seen)[0])
    assert between(task, "belt").start < first < between(task, "belt").stop
    # The gate begins at -291 mm, the part's front at -560 mm; the belt has run as far, and a cycle's way more at most.
    travel = task.log["conveyor[1].travel"]
    assert 0.269 <= travel[first] < 0.269 + 2 * 0.016 * example.BELT_SPEED
    rest = between(task, "pick")
    assert np.ptp(travel[rest]) == 0
    # Braking evenly from full speed, a cycle after it was told to.
    assert travel[-1] - travel[first] == pytest.approx(
        example.BELT_SPEED**2 / (2 * 1.0), abs=2 * 0.016 * example.BELT_SPEED
    )


def test_gripper_holds_part_by_friction(ran, example) -> None:
    task, _ = ran
    height, force, width = (
        task.log[name] for name in ("truth.part[1].position[3]", "measured.gripper.force", "measured.gripper.width")
    )
    aloft = height > 0.11
    assert height.max() > 0.17
    np.testing.assert_allclose(force[aloft], example.GRIP_FORCE, atol=1e-6)
    np.testing.assert_allclose(width[aloft], 0.050, atol=5e-5)
    assert task.log["measured.gripper.gripped"][aloft].all()
    assert not aloft[between(task, "belt")].any()
    assert not aloft[between(task, "home")].any()


def test_part_is_at_scan_pose(ran, example) -> None:
    task, _ = ran
    away, turn = example.placing_error(task)
    assert away < 1e-6
    assert turn < np.radians(0.0001)
    # It turns with the table, and stays on it.
    scan = between(task, "scan")
    np.testing.assert_allclose(task.log["truth.part[1].position[3]"][scan], 0.1, atol=1e-6)
    assert np.ptp(task.log["measured.table"][scan]) > 2 * np.pi


def test_cell_is_collision_free(ran) -> None:
    task, _ = ran
    assert task.log["truth.clearance.distance"][1:].min() > 1e-3


def test_cloud_matches_placed_part(ran, example) -> None:
    task, out = ran
    deviation = json.loads((out / "deviation.json").read_text())
    assert deviation["all"]["count"] > 10_000
    away, _ = example.placing_error(task)
    assert deviation["all"]["rms_um"] < away * 1e6 + 5
    assert (out / "devices.png").stat().st_size > 20_000
    assert (out / "deviation.png").is_file()
