"""Importers and validators that come from PyPI, in an environment of their own; the others are in `make peers`."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from bench.peers.check import PeerMissingError
from bench.peers.importers import TOLERANCE, ImporterTools, run_fmpy, run_in_python, run_tool, servo_scenario
from cell_fixture import START_DEG, FmuFolders, cell_description


@pytest.fixture(scope="module")
def tools() -> ImporterTools:
    """What cannot be installed is skipped on a desk without network, never in continuous integration."""
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
def test_other_importers_see_what_fmpy_sees(
    tools: ImporterTools, folders: FmuFolders, importer: Literal["cosim", "ecos"], version: int
) -> None:
    scenario = servo_scenario(folders.packed(version, cell_description()), START_DEG)
    reference = run_fmpy(scenario)
    assert np.ptp(reference, axis=0).max() > 0.1  # things move
    assert reference[-1, scenario.outputs.index("trigger.time")] > 0  # exposures fired
    rows = run_in_python(tools.python(), importer, scenario)
    np.testing.assert_allclose(rows, reference, rtol=0, atol=TOLERANCE)


@pytest.mark.parametrize("version", [2, 3])
def test_fmutool_finds_nothing(tools: ImporterTools, folders: FmuFolders, version: int) -> None:
    said = run_tool([tools.fmutool(), "-input", folders.packed(version, cell_description()), "-check"])
    assert "seems to be compliant" in said
    assert "No semantic error" in said
    assert "ERROR" not in said
    assert "WARNING" not in said
