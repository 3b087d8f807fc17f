"""Parsing of perturbations given as ``key=value``."""

from __future__ import annotations

import math

import pytest

from scancell.cell.fmu_file import expected_keys, parse_as_built
from scancell.errors import DescriptionError

UNITS = {"as_built.dh[3].theta": "rad", "as_built.tool.x": "m", "as_built.trigger.latency": "s", "as_built.gain": None}


def test_values_are_converted_to_si() -> None:
    parsed = parse_as_built(["dh[3].theta_deg=0.05", "tool.x_mm=0.1", "trigger.latency_ms=1", "gain=2"], UNITS)
    assert parsed["as_built.dh[3].theta"] == pytest.approx(math.radians(0.05))
    assert parsed["as_built.tool.x"] == pytest.approx(1e-4)
    assert parsed["as_built.trigger.latency"] == pytest.approx(1e-3)
    assert parsed["as_built.gain"] == 2.0


@pytest.mark.parametrize(
    ("word", "fragment"),
    [
        ("tool.x=0.1", "unit"),
        ("tool.x_deg=0.1", "tool.x_mm"),
        ("tool.y_mm=0.1", "unknown perturbation"),
        ("tool.x_mm=high", "finite number"),
        ("tool.x_mm=inf", "finite number"),
        ("tool.x_mm=true", "finite number"),
    ],
)
def test_invalid_words_are_rejected(word: str, fragment: str) -> None:
    with pytest.raises(DescriptionError, match=fragment):
        parse_as_built([word], UNITS)


def test_expected_keys_round_trip() -> None:
    words = [f"{key}=1" for key in expected_keys(UNITS)]
    assert set(parse_as_built(words, UNITS)) == set(UNITS)
