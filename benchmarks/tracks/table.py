"""Track `table`: pose of a profile sensor on a flange, and axis of a table, from profiles of a sphere on the table."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from benchmarks.sphere_cell import CENTRE, RADIUS, REALISTIC, SphereCase, default_kinematics, misaligned, sphere_views
from benchmarks.track import Array, Case, Outcome, Table, Track, coverage, median_error, named_values
from scancell.calibration.cell.kinematics import TABLE, TOOL, AxisReadings, written_unit
from scancell.geometry import pose

POSES = 24
KEYS = (*TOOL, *TABLE)
NAMES = tuple(f"{name}_{written_unit(name)[0]}" for name in KEYS)
_FACTORS = np.array([written_unit(name)[1] for name in KEYS])
_PLACED_OFF = 0.5e-3  # m, of each coordinate of the sphere from where it is said to be


def cases(seed: int, number: int) -> list[Case]:
    """Random deviations and views in each case."""
    cell, found = default_kinematics(), []
    for index in range(number):
        rng = np.random.default_rng([seed, index])
        sphere = SphereCase(misaligned(rng, *KEYS), REALISTIC)
        readings = AxisReadings.at_rest(sphere_views(rng, POSES))
        observed = sphere.observe(readings, rng)
        flange = pose.inverse(cell.arm.world_from_base) @ cell.arm.fk(readings.q)
        rotations = {f"r{i + 1}{k + 1}": flange[:, i, k] for i in range(3) for k in range(3)}
        positions = {f"{axis}_mm": 1e3 * flange[:, i, 3] for i, axis in enumerate("xyz")}
        _, y, z = 1e3 * observed.points_in_sensor.T
        inputs = {
            "exposures": {**rotations, **positions, "table_deg": np.degrees(readings.table)},
            "points": {"exposure": observed.frame.astype(float), "y_mm": y, "z_mm": z},
            "flange_from_sensor": cell.carrier_from_sensor.tolist(),
            "base_from_table": (pose.inverse(cell.arm.world_from_base) @ cell.world_from_table).tolist(),
            "radius_mm": 1e3 * RADIUS,
            "sphere_on_table_mm": (1e3 * (np.array(CENTRE) + rng.uniform(-_PLACED_OFF, _PLACED_OFF, 3))).tolist(),
            "noise_mm": 1e3 * sphere.noise,
        }
        values = np.array([sphere.deviations[name] for name in KEYS]) / _FACTORS
        found.append(Case(f"{index:04d}", inputs, {"values": values}))
    return found


def check(case: Case, table: Table) -> None:
    """All values are there."""
    named_values(table, NAMES, "value")


def summary(outcomes: Sequence[Outcome]) -> dict[str, float]:
    """Medians of the lengths of errors; a failed case counts as infinite. Coverage of the intervals, per cent."""
    groups = {"tool µm": slice(0, 3), "tool deg": slice(3, 6), "table µm": slice(6, 8), "table deg": slice(8, 10)}
    errors: dict[str, list[float]] = {name: [] for name in groups}
    inside: list[Array] = []
    for case, table in outcomes:
        error = np.full(len(NAMES), np.inf)
        if table is not None:
            error = named_values(table, NAMES, "value") - case.truth["values"]
            if "half_width" in table:
                inside.append(np.abs(error) <= named_values(table, NAMES, "half_width"))
        for name, rows in groups.items():
            errors[name].append((1e3 if "µm" in name else 1.0) * float(np.linalg.norm(error[rows])))
    return {
        **{name: median_error(lengths) for name, lengths in errors.items()},
        "in 95 % intervals, %": coverage(inside),
    }


TRACK = Track("table", ("name", "value"), ("half_width",), cases, check, summary, default_cases=20)
