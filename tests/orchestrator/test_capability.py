"""Gauge repeatability and reproducibility of simulated measurements: planted variances and the closed forms."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from inspection_parts import cad_part, cloud_of
from scancell.arrays import Array
from scancell.config.inspection import InspectionDescription
from scancell.config.loading import Setup, load_setup
from scancell.geometry import pose
from scancell.geometry.shapes import Box, PlacedShape
from scancell.progress import NullProgress
from scancell.studies.capability import Capability, CapabilityRow, Gauge, run_capability, variance_components

_HEIGHT = 0.02
_PART = cad_part([PlacedShape("block", Box(0.03, 0.02, _HEIGHT), pose.translation([0.0, 0.0, _HEIGHT / 2]))])
_CALIBRATE, _CLAMP, _REPEAT = 5e-6, 3e-6, 2e-6
_FACTORS = f"""
name = "gauge"
part = "none"
design = {{ kind = "latin_hypercube", trials = 2 }}
[[factor]]
path = "as_built.tool.z_mm"
distribution = {{ kind = "normal", std = {1e3 * _CALIBRATE} }}
[[factor]]
path = "cell.part.x_mm"
distribution = {{ kind = "normal", std = {1e3 * _CLAMP} }}
"""


class _Cell:
    """A cell that measures the height of the block with errors by calibration, clamping and seed."""

    def __init__(self) -> None:
        self.setup = load_setup()
        self.pipeline = SimpleNamespace(threads=1)
        self.errors: list[tuple[float, float, float]] = []
        self.plans: list[Any] = []

    def scan(self, part: Any, *, as_built: Any, seed: int, setup: Setup | None, plan: Any, **_: Any) -> Any:
        named = dict(word.split("=") for word in as_built)
        calibrated = 1e-3 * float(named.get("tool.z_mm", 0.0))
        clamped = 1e-3 * (setup or self.setup).cell.part.x_mm
        repeated = _REPEAT * float(np.random.default_rng(seed).standard_normal())
        self.errors.append((calibrated, clamped, repeated))
        self.plans.append(plan)
        higher = calibrated + clamped + repeated
        points = cloud_of(part, 600, 0, changes={4: lambda local, _: local + np.array([0.0, 0.0, higher])})
        cloud = SimpleNamespace(points_in_part=points, profile=None, time=np.array([1.0]))
        return SimpleNamespace(plan=object() if plan is None else plan, cloud=cloud)


def _description() -> InspectionDescription:
    height = {"name": "height", "kind": "distance", "faces": [4], "to": [5], "upper_mm": 0.05, "lower_mm": -0.05}
    return InspectionDescription.model_validate({"characteristic": [height], "filter_mm": 0.0})


def _capability(cell: _Cell, folder: Path, **counts: int) -> Capability:
    (folder / "factors.toml").write_text(_FACTORS)
    options: dict[str, Any] = {"engine": "geometric", "as_built": (), "progress": NullProgress(), "seed": 3}
    return run_capability(cell, _PART, _description(), factors=folder / "factors.toml", **counts, **options)  # type: ignore[arg-type]


def test_planted_variances_are_those_of_the_table(tmp_path: Path) -> None:
    cell = _Cell()
    found = _capability(cell, tmp_path, draws=8, clampings=5, repeats=3)
    errors = np.array(cell.errors).reshape(8, 5, 3, 3)
    # A calibration keeps its errors while the part is clamped again, and both while it is measured again.
    assert (np.ptp(errors[..., 0], axis=(1, 2)) == 0).all() and (np.ptp(errors[..., 1], axis=2) == 0).all()
    assert len(np.unique(errors[..., 0])) == 8 and len(np.unique(errors[..., 1])) == 40
    gauge = found.rows[0].gauge
    assert gauge is not None
    planted = [errors[:, 0, 0, 0].std(ddof=1), errors[:, :, 0, 1].std(), errors[..., 2].std()]
    assert [gauge.calibrate, gauge.clamp, gauge.repeat] == pytest.approx(planted, rel=0.25)
    assert planted == pytest.approx([_CALIBRATE, _CLAMP, _REPEAT], rel=0.35)
    row = found.figures["characteristics"][0]
    assert row["gauge_total_um"] == pytest.approx(1e6 * gauge.total)
    assert row["gauge_share"] == pytest.approx(6 * gauge.total / 100e-6)
    assert "repeating, clamping and calibrating" in found.summary()
    # A plan is made anew where the nominal cell differs, and kept while the part stays clamped.
    assert [plan is None for plan in cell.plans] == [number % 3 == 0 for number in range(120)]


def test_measurements_without_repeats_have_no_gauge(tmp_path: Path) -> None:
    cell = _Cell()
    found = _capability(cell, tmp_path, draws=3)
    assert found.rows[0].gauge is None and "gauge_share" not in found.figures["characteristics"][0]
    assert len(np.unique(np.array(cell.errors)[:, :2])) == 6
    assert "calibrating" not in found.summary()


def _nested(shape: tuple[int, int, int], calibrate: float, clamp: float, repeat: float) -> Array:
    random = np.random.default_rng(1)
    r, c, n = shape
    return np.asarray(
        calibrate * random.standard_normal((r, 1, 1))
        + clamp * random.standard_normal((r, c, 1))
        + repeat * random.standard_normal((r, c, n))
    )


@pytest.mark.parametrize("planted", [(5.0, 3.0, 2.0), (0.0, 4.0, 1.0), (2.0, 0.0, 1.0), (0.0, 0.0, 1.0)])
def test_components_of_many_measurements_are_those_planted(planted: tuple[float, float, float]) -> None:
    repeat, clamp, calibrate = variance_components(_nested((3000, 4, 3), *planted))
    assert (calibrate, clamp, repeat) == pytest.approx(planted, rel=0.05, abs=0.25)


def test_levels_that_are_not_repeated_are_unknown() -> None:
    repeat, clamp, calibrate = variance_components(_nested((1, 1, 4000), 5.0, 3.0, 2.0))
    assert repeat == pytest.approx(2.0, rel=0.05) and np.isnan([clamp, calibrate]).all()
    repeat, clamp, calibrate = variance_components(_nested((4000, 1, 2), 4.0, 3.0, 2.0))
    assert np.isnan(clamp) and calibrate == pytest.approx(5.0, rel=0.05)  # with that of the clampings


def test_share_and_categories_of_a_gauge() -> None:
    gauge = Gauge(3e-6, 4e-6, float("nan"), 60e-6)
    assert gauge.total == pytest.approx(5e-6) and gauge.share == pytest.approx(0.5) and gauge.categories == 2
    assert Gauge(0.0, 0.0, 0.0, 1e-3).categories == np.inf


def test_a_characteristic_that_one_measurement_lacks_has_no_gauge() -> None:
    errors = np.array([1e-6, np.nan, 2e-6, 3e-6])
    row = CapabilityRow("bore", "diameter", errors, np.full(4, 1e-6), 20e-6, "few points", (1, 2, 2))
    assert row.gauge is None and row.as_row()["gauge_share"] is None
