"""Importers and validators from PyPI, in an environment of their own; others run in `make peers`."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from cell_fixture import START_DEG, FmuFolders, cell_description, pack, write_fmu

from bench.peers.check import PeerMissingError
from bench.peers.importers import TOLERANCE, ImporterTools, run_fmpy, run_in_python, run_tool, servo_scenario


@pytest.fixture(scope="module")
def tools() -> ImporterTools:
    """Skips tools that cannot be installed on a machine without network, never in continuous integration."""
    folder = Path(__file__).parents[2] / "build/importers"
    tools = ImporterTools(Path(os.environ.get("SCANCELL_IMPORTERS", folder)))
    try:
        tools.python()
    except PeerMissingError as missing:
        if os.environ.get("CI"):
            raise
        pytest.skip(str(missing))
    return tools


@pytest.mark.parametrize(("importer", "version"), [("cosim", 2), ("ecos", 2), ("ecos", 3)])
def test_importers_agree_with_fmpy(
    tools: ImporterTools, tmp_path: Path, importer: Literal["cosim", "ecos"], version: int
) -> None:
    """They do not know enumerations: the FMU describes integers."""
    fmu = pack(write_fmu(cell_description(), version, tmp_path / "RobotCell", "--integers"), tmp_path / "RobotCell.fmu")
    scenario = servo_scenario(fmu, START_DEG)
    reference = run_fmpy(scenario)
    assert np.ptp(reference, axis=0).max() > 0.1  # nonzero motion
    assert reference[-1, scenario.outputs.index("trigger.time")] > 0  # exposures fired
    rows = run_in_python(tools.python(), importer, scenario)
    np.testing.assert_allclose(rows, reference, rtol=0, atol=TOLERANCE)


@pytest.mark.parametrize("version", [2, 3])
def test_fmutool_reports_no_problems(tools: ImporterTools, folders: FmuFolders, version: int) -> None:
    output = run_tool([tools.fmutool(), "-input", folders.packed(version, cell_description()), "-check"])
    assert "seems to be compliant" in output
    assert "No semantic error" in output
    assert "ERROR" not in output
    assert "WARNING" not in output
