"""Soft parts: conversion of the description for the FMU, invalid values."""

from __future__ import annotations

import pytest

from scancell.cell.fmu_file import cell_json
from scancell.config.loading import load_setup
from scancell.errors import DescriptionError
from scancell.geometry.mesh import box_mesh
from scancell.nominal.cell import nominal_cell

BLOCK = box_mesh((0.04, 0.03, 0.02), "block")


def test_springs_json_is_in_si_units() -> None:
    setup = load_setup(settings=['cell.part.fixture="free"', "cell.part.soft={stiffness_n_mm=0.5, longest_edge_mm=8}"])
    part = cell_json(setup.cell, nominal_cell(setup.cell, BLOCK), 0)["parts"][0]
    assert part["soft"] == pytest.approx({"stiffness": 500.0, "damping_ratio": 1.0, "longest_edge": 0.008})


def test_part_is_rigid_by_default() -> None:
    setup = load_setup()
    assert cell_json(setup.cell, nominal_cell(setup.cell, BLOCK), 0)["parts"][0]["soft"] is None


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["cell.part.soft.stiffness_n_mm=1"], "a soft part cannot be clamped"),
        (['cell.part.fixture="free"', "cell.part.soft.damping_ratio=1"], "stiffness_n_mm"),
        (['cell.part.fixture="free"', "cell.part.soft.stiffness_n_mm=0"], "stiffness_n_mm"),
        (['cell.part.fixture="free"', "cell.part.soft={stiffness_n_mm=1, longest_edge_mm=-1}"], "longest_edge_mm"),
    ],
)
def test_invalid_springs_are_rejected(words: list[str], said: str) -> None:
    with pytest.raises(DescriptionError, match=said):
        load_setup(settings=words)
