"""States that earlier versions serialized continue in an FMU of the same cell, or are refused with what to do."""

from __future__ import annotations

import gzip
import json
from pathlib import Path

import numpy as np
import pytest
from cell_fixture import CYCLE_US, Build
from grasp_fixture import grasp_cell

from compatibility import SETS


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize("files", SETS, ids=lambda path: path.name)
def test_state_of_an_earlier_version_continues_or_is_refused(build: Build, files: Path, version: int) -> None:
    description = json.loads(gzip.decompress((files / "fmu" / "cell.json.gz").read_bytes()))
    stored = json.loads((files / "fmu" / f"fmi{version}.json").read_text())
    cell = build(version, description)
    try:
        state = cell.deserialize((files / "fmu" / f"fmi{version}.state").read_bytes())
        cell.restore(state, stored["time_us"])
    except Exception:
        assert "the FMU that saved it" in cell.messages[-1]
        other_token = cell.description.guid != stored["token"]
        assert ("token" in cell.messages[-1]) == other_token
        if other_token:
            assert stored["token"] in cell.messages[-1]
        return
    for values, cycles in ((stored["before"], 0), (stored["after_10_cycles"], 10)):
        if cycles:
            cell.step(CYCLE_US, cycles)
        known = [name for name in values if name in cell.variables]
        assert len(known) > 100
        assert cell.get(*known) == pytest.approx(np.array([values[name] for name in known]), rel=1e-9, abs=1e-9)
    cell.free_state(state)


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize("files", SETS, ids=lambda path: path.name)
def test_state_of_an_fmu_with_other_variables_is_refused(build: Build, files: Path, version: int) -> None:
    cell = build(version, grasp_cell())
    with pytest.raises(Exception, match=r"[dD]e[sS]erializeFMU[sS]tate"):
        cell.deserialize((files / "fmu" / f"fmi{version}.state").read_bytes())
    stored = json.loads((files / "fmu" / f"fmi{version}.json").read_text())
    assert stored["token"] in cell.messages[-1]
    assert "restore it in the FMU that saved it" in cell.messages[-1]
