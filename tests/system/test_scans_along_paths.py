"""A scan along a sensor path, on which arm and table move together."""

from __future__ import annotations

import numpy as np
import pytest

import scancell
from scancell.config.loading import assets_dir, load_setup, with_path
from scancell.config.scan import PathDescription, SpiralDescription
from scancell.errors import PlanningError

PART = assets_dir() / "parts" / "free_form.stl"


@pytest.mark.parametrize("mode", ["dynamic", "stop-and-look"])
def test_points_along_a_path_lie_on_the_mesh(mode: str) -> None:
    spiral = PathDescription(pitch_mm=4.0, spiral=SpiralDescription(turns=0.5, elevation_deg=(45.0, 50.0)))
    setup = with_path(load_setup(settings=[f'scan.mode="{mode}"'], ideal=True), spiral)
    with scancell.Scanner(setup=setup) as scanner:
        result = scanner.scan(PART, engine="geometric")
    measured = result.recording.measured
    assert len(measured.index) == len(result.plan.q)
    assert np.ptp(measured.table) > 1.0
    assert np.ptp(measured.q, axis=0).max() > 0.1
    # Exposures fire where the plan has them, by the distance that the sensor travels over the table.
    np.testing.assert_allclose(measured.q, result.plan.q, atol=2e-3)
    np.testing.assert_allclose(measured.table, result.plan.table, atol=2e-3)
    assert result.deviation.figures.rms < 1e-7


def test_a_constraint_of_ones_own_keeps_the_table_out_of_a_range() -> None:
    spiral = PathDescription(pitch_mm=4.0, spiral=SpiralDescription(turns=0.3, elevation_deg=(45.0, 50.0)))
    setup = with_path(load_setup(), spiral)
    middles = []
    with scancell.Scanner(setup=setup) as scanner:
        free = scanner.plan(PART)
        middles.append(np.median(free.table))

        def elsewhere(q: np.ndarray, table: np.ndarray) -> np.ndarray:
            return (np.cos(table - middles[0]) < 0.5).astype(float)

        made = scanner.plan(PART, quality_factors=[elsewhere])
        result = scanner.scan(PART, engine="geometric", plan=made)
    assert (np.cos(free.table - middles[0]) > 0.5).any()
    assert (np.cos(made.table - middles[0]) < 0.5 + 0.02).all()
    np.testing.assert_allclose(result.recording.measured.table, made.table, atol=2e-3)


def test_a_path_with_more_exposures_than_allowed_is_refused() -> None:
    setup = with_path(
        load_setup(settings=["scan.max_profiles=50"]), PathDescription(pitch_mm=1.0, spiral=SpiralDescription())
    )
    with (
        scancell.Scanner(setup=setup) as scanner,
        pytest.raises(PlanningError, match=r"max_profiles = 50: the paths need \d+ exposures"),
    ):
        scanner.plan(PART)
