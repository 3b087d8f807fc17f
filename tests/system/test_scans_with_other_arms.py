"""Scans with an arm without spherical wrist and with one of seven joints, made from a URDF file."""

from __future__ import annotations

import numpy as np
import pytest

import scancell
from scancell.config.loading import assets_dir


@pytest.mark.parametrize(("cell", "joints"), [("offset_wrist", 6), ("seven_axis", 7)])
def test_a_scan_without_noise_lies_on_the_mesh(cell: str, joints: int) -> None:
    part, cells = assets_dir() / "parts" / "free_form.stl", assets_dir() / "cells"
    with scancell.Scanner(cells / f"{cell}.toml", settings={"scan.max_profiles": 80}, ideal=True) as scanner:
        result = scanner.scan(part, engine="geometric")
    q = result.recording.measured.q
    assert q.shape == (len(result.recording), joints)
    assert np.ptp(q, axis=0).max() > 0.5  # the arm moved
    # Without noise the points lie on the facets, if the FMU moves the arm as the description says.
    assert len(result.cloud.points_in_part) > 50_000
    assert result.deviation.figures.rms < 1e-7
