"""Ticks of axes and scales of colours."""

from __future__ import annotations

import numpy as np
import pytest

from scancell.output.sheet import interpolated_colours, ticks


@pytest.mark.parametrize(
    ("low", "high", "most", "texts"),
    [
        (0.0, 10.0, 5, ["0", "2", "4", "6", "8", "10"]),
        (0.0, 10.0, 4, ["0.0", "2.5", "5.0", "7.5", "10.0"]),
        (0.0, 0.3, 3, ["0.0", "0.1", "0.2", "0.3"]),
        (-100.0, 100.0, 4, ["\N{MINUS SIGN}100", "\N{MINUS SIGN}50", "0", "50", "100"]),
    ],
)
def test_limits_that_are_round_have_ticks(low: float, high: float, most: int, texts: list[str]) -> None:
    found = ticks(low, high, most)
    assert [text for _, text in found] == texts
    np.testing.assert_allclose([value for value, _ in found], np.linspace(low, high, len(texts)), atol=1e-12)


def test_ticks_are_as_many_as_fit() -> None:
    """Multiples of a round step between the limits; the next smaller step would give more than the most."""
    rng = np.random.default_rng(4)
    for _ in range(200):
        low = rng.normal()
        high, most = low + 10 ** rng.uniform(-3, 3), int(rng.integers(2, 9))
        values = np.array([value for value, _ in ticks(low, high, most)])
        assert len(values) <= most + 1
        if len(values) < 2:
            continue
        step = np.diff(values).mean()
        mantissa = step / 10 ** np.floor(np.log10(step * (1 + 1e-9)))
        assert np.abs(mantissa - [1, 2, 2.5, 5]).min() < 1e-6
        np.testing.assert_allclose(values / step, np.round(values / step), atol=1e-6)
        assert low - 1e-6 * step <= values[0] < low + step * (1 + 1e-6)
        assert high - step * (1 + 1e-6) < values[-1] <= high + 1e-6 * step
        assert step / 2.5 < (high - low) / most * (1 + 1e-6)


def test_colours_between_evenly_spaced_ones() -> None:
    colours = interpolated_colours(np.array([[0.0, 10.0, 255.0], [100.0, 10.0, 0.0], [0.0, 10.0, 255.0]]))
    assert colours.shape == (256, 3)
    np.testing.assert_allclose(colours[[0, -1]], [[0, 10, 255]] * 2)
    np.testing.assert_allclose(colours, colours[::-1], atol=1e-9)
    np.testing.assert_allclose(np.diff(colours[:128, 0]), 200 / 255)
