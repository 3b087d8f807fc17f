"""Ends of the ranges of all numbers of descriptions, and numbers of samples that follow from several of them."""

from __future__ import annotations

import math

import numpy as np
import pytest

from bench.schema_bounds import Case, bases, cases_of, limits_of, numeric_keys, outcome_of
from scancell.config.description import validate
from scancell.errors import DescriptionError, PlanningError
from scancell.planning.motion.trajectory import MAX_DURATION, cycle_times
from scancell.planning.views.paths import tile

BASES = {base.name: base for base in bases()}
# One of each kind that once ended in a traceback, reserved terabytes or never ended.
RUNS = (
    "scan.sweep.standoff_mm=0.001",
    "scan.sweep.height_step_mm=0.001",
    "scan.sweep.speed_deg_s=0.001",
    "sensor.camera[1].cy_px=-16384.0",
    "spiral.spiral.turns=100.0",
    "contour.contour.smoothing_mm=100000.0",
    "soft.further_part[1].soft.stiffness_n_mm=1e-06",
)


@pytest.mark.parametrize("name", BASES)
def test_values_at_the_ends_are_accepted_or_refused_by_key_and_those_beyond_are_refused(name: str) -> None:
    base = BASES[name]
    for case in cases_of(base):
        try:
            validate(base.model, case.changed, "ends")
        except DescriptionError as error:
            assert any(part in str(error) for part in case.path if isinstance(part, str))
    for path, schema in list(numeric_keys(base.model, base.data))[::5]:
        low, high = limits_of(schema)
        for value in (low - max(1.0, abs(low)), high + max(1.0, abs(high)), math.inf, math.nan):
            with pytest.raises(DescriptionError):
                validate(base.model, Case(base, path, value).changed, "beyond")


@pytest.mark.parametrize("name", RUNS)
def test_runs_at_the_ends_give_an_answer_or_a_refusal(name: str) -> None:
    case = next(case for base in bases() for case in cases_of(base) if case.name == name)
    outcome, text = outcome_of(case)
    assert outcome in ("answer", "refused"), text


def test_motion_of_too_many_samples_is_refused_before_memory_is_reserved() -> None:
    assert len(cycle_times(0.16, 0.016)) == 11
    for duration in (1.01 * MAX_DURATION, 1e30, math.inf, math.nan):
        with pytest.raises(PlanningError, match="raise the speed of the sweep"):
            cycle_times(duration, 0.016)


def test_too_many_laser_lines_are_refused_before_memory_is_reserved() -> None:
    np.testing.assert_allclose(tile(0.0, 0.1, 0.02, 0.03), [0.02, 0.05, 0.08])
    for step in (1e-5, 1e-15, 5e-324):
        with pytest.raises(PlanningError, match=r"scan\.sweep\.height_step_mm"):
            tile(0.0, 0.1, 0.02, step)


def test_a_turn_at_the_smallest_jerk_lasts_half_a_minute_at_most() -> None:
    base = BASES["cell"]
    found = [
        limits_of(schema)[0] for path, schema in numeric_keys(base.model, base.data) if path[-1] == "max_jerk_deg_s3"
    ]
    assert len(found) > 1
    assert max((32 * 360.0 / low) ** (1 / 3) for low in found) < 30.0  # from rest to rest, s; each is simulated


def test_exposure_times_and_angles_of_the_sensor_do_not_underflow() -> None:
    base = BASES["burst"]
    keys = {"further_ms", "exposure_ms", "row_readout_us", "fan_half_angle_deg", "tilt_deg", "far_mm", "period_ms"}
    for path, schema in numeric_keys(base.model, base.data):
        if keys & set(path):
            assert limits_of(schema)[0] >= 1e-6


def test_standard_deviations_of_factors_do_not_overflow_where_they_divide() -> None:
    base = BASES["study"]
    found = [limits_of(schema)[0] for path, schema in numeric_keys(base.model, base.data) if path[-1] == "std"]
    assert len(found) > 1
    assert min(found) >= 1e-15
