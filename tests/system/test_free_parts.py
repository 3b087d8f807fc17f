"""Parts that stand freely on the table: they do not slip on planned motions."""

from __future__ import annotations

import numpy as np
import pytest

import scancell
from scancell.config.loading import assets_dir, load_setup
from scancell.nominal import cell as nominal_module
from scancell.nominal.cell import table_limits

PART = assets_dir() / "parts" / "step_block.stl"
SLIPPERY = {
    "scan.max_profiles": 60,
    "scan.raster.enabled": False,
    "cell.part.fixture": "free",
    "cell.part.friction": 0.01,
    "cell.part.x_mm": 40.0,
}


def slip() -> float:
    """How far the part moved over the table between the first exposure and the last, m."""
    with scancell.Scanner(settings=SLIPPERY, ideal=True) as scanner:
        recording = scanner.scan(PART, engine="geometric").recording
    table_from_part = np.linalg.inv(recording.truth_at_middle("table")) @ recording.truth_at_middle("part[1]")
    return float(np.linalg.norm(table_from_part[-1, :3, 3] - table_from_part[0, :3, 3]))


def test_a_part_of_little_friction_stays_where_it_is() -> None:
    assert slip() < 1e-6


def test_it_would_slip_at_the_limits_of_the_table(monkeypatch: pytest.MonkeyPatch) -> None:
    table = load_setup().cell.table
    own = tuple(np.radians([table.max_speed_deg_s, table.max_acceleration_deg_s2]))
    monkeypatch.setattr(nominal_module, "table_limits", lambda *_: own)
    assert slip() > 1e-4


def test_limits_follow_from_the_distance_to_the_axis() -> None:
    from scancell.geometry.mesh import box_mesh  # noqa: PLC0415

    setup = load_setup(settings=['cell.part.fixture="free"', "cell.part.friction=0.01"])
    at = np.eye(4)
    at[0, 3] = 0.07
    speed, acceleration = table_limits(setup.cell, box_mesh((0.02, 0.0002, 0.02), "bar"), at)
    held = 0.01 * setup.cell.world.gravity_m_s2
    assert np.hypot(speed**2 * 0.08, acceleration * 0.08) == pytest.approx(held / 2, rel=1e-4)
    clamped = load_setup().cell
    assert table_limits(clamped, box_mesh((0.02, 0.02, 0.02), "bar"), at)[0] == pytest.approx(np.pi)
