"""FMU states: saved and restored to the last bit, here and in another process; foreign bytes refused."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from cell_fixture import (
    CYCLE_US,
    START_DEG,
    Array,
    Build,
    CellFmu,
    all_reals,
    cell_description,
    continue_motion,
    conveyor,
    pose,
)
from continue_from_state import continued_in_new_process
from grasp_fixture import grasp_cell

FREE = cell_description(fixture="free", support_from_part=pose([0.06, 0.02, 0]))


def bring_into_motion(cell: CellFmu) -> None:
    """The part rides on the turning table, records wait, an exposure is under way, a dynamics step is half done."""
    for k in range(60):
        cell.command(np.radians(START_DEG) + 0.1 * np.sin(0.1 * k), 0.05 * k)
        cell.step(CYCLE_US)
    cell.trigger(2, 0.02, exposure=0.003)
    cell.step(60_250)


@pytest.mark.parametrize("version", [2, 3])
def test_restoring_repeats_the_future_exactly(build: Build, version: int) -> None:
    cell = build(version, FREE, {"seed": 3, "as_built.tool.x": 1e-4})
    bring_into_motion(cell)
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
def test_a_new_process_goes_on_from_the_bytes(build: Build, version: int, tmp_path: Path) -> None:
    cell = build(version, FREE)
    bring_into_motion(cell)
    state, time_us = cell.save(), cell.time_us
    continue_motion(cell)
    elsewhere = continued_in_new_process(cell, state, time_us, continue_motion, tmp_path)
    np.testing.assert_array_equal(elsewhere, all_reals(cell))
    cell.free_state(state)


@pytest.mark.parametrize("damage", ["cut", "altered", "foreign", "empty", "longer"])
def test_damaged_bytes_are_refused_and_the_instance_recovers(build: Build, damage: str) -> None:
    cell = build(3, FREE)
    bring_into_motion(cell)
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


def test_a_state_of_another_cell_is_refused(build: Build) -> None:
    here, there = build(3, FREE), build(3)
    there.step(1000)
    foreign = there.serialize(there.save())
    with pytest.raises(Exception, match="fmi3SetFMUState"):
        here.restore(here.deserialize(foreign), 1000)
    assert "another description" in here.messages[-1]


@pytest.mark.parametrize("value", [1e12, -1e300])
def test_a_state_is_read_back_whatever_an_importer_has_set(build: Build, value: float) -> None:
    """Huge numbers mean "never" and "no limit" to some."""
    description = {**grasp_cell(), "conveyors": [conveyor()]}
    variables = build(3, description).description.modelVariables
    inputs = [v.name for v in variables if v.causality == "input" and v.type == "Float64"]
    assert {"command.max_age", "command.gripper.force", "command.trigger.period"} <= set(inputs)
    for name in inputs:
        cell = build(3, description)
        with suppress(Exception):  # the cell may refuse the value, and is then to be restored
            cell.set(name, value)
            cell.step(8000)
        cell.restore(cell.deserialize(cell.serialize(cell.save())), cell.time_us)
