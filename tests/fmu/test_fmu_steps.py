"""Trajectories at different communication steps."""

from __future__ import annotations

import numpy as np
from cell_fixture import FREE, START, Array, Build, CellFmu

STEPS_US = (40, 1000, 16_000, 1_000_000)
PHASE_US = 2_000_000  # the shortest duration that is a multiple of all steps
# Only the sum that gives `time` depends on the communication step: states and records are bit-identical.
TOLERANCE = 0.0


def run_phases(cell: CellFmu, step_us: int) -> tuple[Array, Array, dict[int, Array]]:
    """Arm, table and a free part in motion, an exposure every 0.15 s; values at the end of two phases.

    The inputs change where all step sizes have a communication point. The records that wait at the end are shown
    one by one.
    """
    present = [n for n, v in cell.variables.items() if v.causality == "output" and not n.startswith("trigger.")]
    reals = [n for n in present if cell.variables[n].type in ("Real", "Float64")]
    record = [n for n, v in cell.variables.items() if n.startswith("trigger.") and v.type in ("Real", "Float64")]
    records: dict[int, Array] = {}

    def collect() -> None:
        index = cell.get_int("trigger.index")
        if index > len(records):
            records[index] = cell.get(*record)

    seen = []
    for phase in range(2):
        cell.command(START + np.radians([20, 5, -8, 15, -12, 30]) * (1 - 2 * phase), 1.2 - 2 * phase)
        cell.trigger(1, 0.15, exposure=0.004, segment=phase)
        for _ in range(PHASE_US // step_us):
            cell.step(step_us)
            collect()
        seen.append(cell.get(*reals))
    cell.trigger(0)
    while len(records) < cell.get_int("trigger.count"):
        cell.step(1000)
        collect()
    return seen[0], seen[1], records


def test_trajectory_is_independent_of_communication_step(build: Build) -> None:
    """From 40 us to 1 s, for servo motion, timed exposures and a part held by friction."""
    runs = [run_phases(build(3, FREE), step_us) for step_us in STEPS_US]
    first, second, records = runs[0]
    assert np.abs(second - first).max() > 0.1  # nonzero motion
    assert sorted(records) == list(range(1, len(records) + 1))
    assert len(records) >= 26
    for step_us, (one, two, other) in zip(STEPS_US[1:], runs[1:], strict=True):
        for expected, value in ((first, one), (second, two)):
            np.testing.assert_allclose(value, expected, rtol=0, atol=TOLERANCE, err_msg=f"steps of {step_us} us")
        assert sorted(other) == sorted(records)
        for index, expected in records.items():
            np.testing.assert_allclose(other[index], expected, rtol=0, atol=TOLERANCE, err_msg=f"exposure {index}")
