"""Reuse of a cell instance: same results as a new instance; a new one only when the variables differ."""

from __future__ import annotations

import numpy as np
import pytest
from cells import ball, block
from fmu_cells import CYCLE_US, EXPOSURE, turn_of_table

from scancell.cell.driver import Driver
from scancell.cell.fmu_file import ReusableCell, cell_json
from scancell.cell.instance import CellInstance
from scancell.cell.recording import Recording
from scancell.config.loading import load_setup
from scancell.errors import CellError, DescriptionError
from scancell.nominal.cell import nominal_cell


def description(mesh=None, *overrides: str, **options):
    setup = load_setup(settings=list(overrides))
    return cell_json(setup.cell, nominal_cell(setup.cell, mesh or ball()), 0, **options)


def run(cell: CellInstance) -> Recording:
    home = cell.get(cell.real_group([f"truth.q[{i}]" for i in range(1, 7)])).copy()
    program = turn_of_table(home, "table_angle", np.radians(1.0))
    return Driver(cell, CYCLE_US, EXPOSURE).run(program)


def same(first: Recording, second: Recording) -> bool:
    return all(np.array_equal(values, second.columns[name]) for name, values in first.columns.items())


def test_restarted_cell_gives_same_recording_as_new_one(tmp_path) -> None:
    home = "cell.robot.home_deg=[30, -20, 190, -60, 70, 0]"
    cells = [
        (description(), []),
        (description(None, home), ["tool.z_mm=0.2"]),
        (description(block(0.04, 0.03, 0.02)), []),
    ]
    recordings = []
    with ReusableCell(tmp_path) as reusable:
        instances = []
        for cell, as_built in cells:
            instances.append(reusable.start(cell, as_built))
            recordings.append(run(instances[-1]))
        assert instances[0] is instances[1] is instances[2]
    for (cell, as_built), recording in zip(cells, recordings, strict=True):
        with ReusableCell(tmp_path) as fresh:
            assert same(run(fresh.start(cell, as_built)), recording)
    assert not same(recordings[0], recordings[1])
    assert not list(tmp_path.iterdir())


def test_listeners_end_with_their_run(tmp_path) -> None:
    steps: list[int] = []
    with ReusableCell(tmp_path) as reusable:
        first = reusable.start(description())
        first.on_step(lambda: steps.append(first.time_us))
        first.step_to(CYCLE_US)
        second = reusable.start(description())
        assert second is first
        second.step_to(CYCLE_US)
    assert steps == [CYCLE_US]


def test_different_variables_create_new_instance(tmp_path) -> None:
    with ReusableCell(tmp_path) as reusable:
        first = reusable.start(description(collision_outputs=False))
        assert "truth.collision.pairs" not in first.names
        second = reusable.start(description())
        assert second is not first
        assert "truth.collision.pairs" in second.names
        assert len(run(second)) == 20


def test_deviation_that_only_the_new_cell_has_is_accepted(tmp_path) -> None:
    """Hayati's parameter belongs to a joint whose axis is parallel to the next one."""
    skew = description()
    skew["robot"]["joints"][1]["alpha"] = 1e-3
    with ReusableCell(tmp_path) as reusable:
        assert "as_built.dh[2].beta" not in reusable.start(skew).names
        assert "as_built.dh[2].beta" in reusable.start(description(), ["dh[2].beta_deg=0.1"]).names


def test_valid_cell_starts_after_rejected_one(tmp_path) -> None:
    with ReusableCell(tmp_path) as reusable:
        reusable.start(description())
        with pytest.raises(DescriptionError, match="warp"):
            reusable.start(description(), ["warp_mm=1"])
        assert len(run(reusable.start(description()))) == 20
        broken = description()
        broken["table"]["radius"] = -1.0
        with pytest.raises(CellError, match=r"table\.radius"):
            reusable.start(broken)
        assert len(run(reusable.start(description()))) == 20
