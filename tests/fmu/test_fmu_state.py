"""FMU states: saved and restored bit-exactly, in the same and in another process; invalid bytes rejected."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from cell_fixture import CYCLE_US, FREE, START, Array, Build, CellFmu, all_reals, continue_motion, conveyor
from continue_from_state import assert_continues_exactly
from grasp_fixture import grasp_cell


def start_motion(cell: CellFmu) -> None:
    """A free part on the rotating table, queued records, an exposure in progress, within a dynamics step."""
    for k in range(60):
        cell.command(START + 0.1 * np.sin(0.1 * k), 0.05 * k)
        cell.step(CYCLE_US)
    cell.trigger(2, 0.02, exposure=0.003)
    cell.step(60_250)


@pytest.mark.parametrize("version", [2, 3])
def test_restored_state_repeats_trajectory_exactly(build: Build, version: int) -> None:
    cell = build(version, FREE, {"seed": 3, "as_built.tool.x": 1e-4})
    start_motion(cell)
    time_us, state = cell.time_us, cell.save()
    futures: list[Array] = []
    for _ in range(2):
        continue_motion(cell)
        futures.append(all_reals(cell))
        cell.restore(state, time_us)
    np.testing.assert_array_equal(futures[0], futures[1])
    # Also after Reset, and in an instance that was something else before.
    cell.slave.reset()
    cell.initialize()
    other = build(version, FREE, {"as_built.table.x": 0.01})
    other.step(CYCLE_US)
    for instance in (cell, other):
        instance.restore(instance.deserialize(cell.serialize(state)), time_us)
        continue_motion(instance)
        np.testing.assert_array_equal(all_reals(instance), futures[0])
    cell.free_state(state)


@pytest.mark.parametrize("version", [2, 3])
def test_serialized_state_continues_in_a_new_process(build: Build, version: int, tmp_path: Path) -> None:
    cell = build(version, FREE)
    start_motion(cell)
    assert_continues_exactly(cell, continue_motion, tmp_path)


@pytest.mark.parametrize("damage", ["cut", "altered", "foreign", "empty", "longer"])
def test_damaged_bytes_are_rejected_and_instance_recovers(build: Build, damage: str) -> None:
    cell = build(3, FREE)
    start_motion(cell)
    state, time_us = cell.save(), cell.time_us
    whole = cell.serialize(state)
    altered = bytearray(whole)
    altered[len(altered) // 2] ^= 1
    damaged = {
        "cut": whole[:-9],
        "altered": bytes(altered),
        "foreign": bytes(range(256)) * 8,
        "empty": b"",
        "longer": whole + b"\0" * 8,
    }[damage]
    with pytest.raises(Exception, match="DeserializeFMUState"):
        cell.deserialize(damaged)
    assert "serialized state" in cell.messages[-1]
    with pytest.raises(Exception, match="fmi3DoStep"):
        cell.step(1000)
    cell.restore(state, time_us)
    cell.step(1000)


def test_state_of_another_cell_is_rejected(build: Build) -> None:
    here, there = build(3, FREE), build(3)
    there.step(1000)
    foreign = there.serialize(there.save())
    with pytest.raises(Exception, match="fmi3SetFMUState"):
        here.restore(here.deserialize(foreign), 1000)
    assert "another cell description" in here.messages[-1]


@pytest.mark.parametrize("value", [1e12, -1e300])
def test_state_with_extreme_inputs_is_restored(build: Build, value: float) -> None:
    """Some importers use huge numbers for "never" and "no limit"."""
    description = {**grasp_cell(), "conveyors": [conveyor()]}
    variables = build(3, description).description.modelVariables
    inputs = [v.name for v in variables if v.causality == "input" and v.type == "Float64"]
    assert {"command.max_age", "command.gripper.force", "command.trigger.period"} <= set(inputs)
    for name in inputs:
        cell = build(3, description)
        with suppress(Exception):  # the cell may reject the value; the state must restore it
            cell.set(name, value)
            cell.step(8000)
        cell.restore(cell.deserialize(cell.serialize(cell.save())), cell.time_us)
