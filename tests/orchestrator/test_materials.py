"""Materials of a cell: presets, overrides, conversion for the ray tracer, invalid values."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from cells import ball
from pydantic import ValidationError

from scancell import scan
from scancell import sensor as sensor_rt
from scancell.config.loading import load_setup
from scancell.config.material import PRESETS, MaterialDescription
from scancell.nominal.cell import nominal_cell
from scancell.scanning.world import build_scene, native_material


@pytest.mark.parametrize("name", PRESETS)
def test_ray_tracer_accepts_presets(name: str) -> None:
    preset = MaterialDescription.model_validate({"preset": name}).resolved()
    assert 0.0 < native_material(preset).albedo([0.7])[0] < 1.0


def test_ray_tracer_gets_scattering_per_metre() -> None:
    assert native_material(PRESETS["marble"]).scattering == pytest.approx(2190.0)
    assert native_material(PRESETS["painted_plastic"]).scattering_albedo is None


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ({"preset": "matt_white", "scattering_per_mm": 2.0}, "belongs to rough_dielectric, not oren_nayar"),
        ({"preset": "marble", "reflectance": 0.91}, "must lie in 0.01..0.9"),
        ({"preset": "marble", "reflectance": 0.0}, "must lie in 0.01..0.9"),
        ({"preset": "marble", "scattering_per_mm": 0.01}, "greater than or equal to 0.05"),
    ],
)
def test_impossible_media_are_refused(values: dict[str, Any], expected: str) -> None:
    with pytest.raises(ValidationError, match=expected):
        MaterialDescription.model_validate(values)


def test_geometric_engine_warns_of_translucent_part() -> None:
    settings = {"cell.part.material.preset": "marble", "scan.max_profiles": 12}
    found = scan(ball(0.02), engine="geometric", settings=settings)
    assert any("ignores scattering_per_mm of part" in warning for warning in found.warnings)


def test_values_override_preset() -> None:
    steel = MaterialDescription.model_validate({"preset": "polished_steel", "roughness": 0.2}).resolved()
    assert steel.roughness == 0.2
    assert steel.reflectance == PRESETS["polished_steel"].reflectance


BRUSHED = {
    "model": "grooved_conductor",
    "reflectance": 0.7,
    "roughness": 0.35,
    "roughness_along": 0.08,
    "groove_axis": [0, 1, 0],
}


def test_ray_tracer_gets_grooves_in_metres() -> None:
    """Circular grooves around an axis 300 mm beside the origin run along x there, as straight ones along x do."""
    given = {"groove_axis": [0, 0, 1], "groove_centre_mm": [0, 300, 0]}
    turned = MaterialDescription.model_validate(BRUSHED | given).resolved()
    a, b = [[0.3, 0.1, 0.9]], [[-0.2, 0.3, 0.8]]
    expected = sensor_rt.Material(0.7, "grooved_conductor", 0.35, 1.5, 0.08, [1, 0, 0])
    np.testing.assert_allclose(native_material(turned).pi_brdf(a, b), expected.pi_brdf(a, b), rtol=1e-9)


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"roughness_along": None}, "needs roughness_along and groove_axis"),
        ({"groove_axis": None}, "needs roughness_along and groove_axis"),
        ({"groove_axis": [0, 0, 0]}, "must not be zero"),
        ({"model": "rough_conductor"}, "belong to grooved_conductor, not rough_conductor"),
        ({"roughness_along": 0.001}, "roughness_along"),
        ({"groove_axis": [0, 1]}, "groove_axis"),
        ({"groove_axis": [0, float("nan"), 1]}, "groove_axis"),
    ],
)
def test_incomplete_grooves_are_rejected(change: dict[str, Any], complaint: str) -> None:
    with pytest.raises(ValidationError, match=complaint):
        MaterialDescription.model_validate(BRUSHED | change)


def test_materials_of_part_table_and_robot() -> None:
    overrides = ["cell.part.material.preset=polished_steel", "cell.table.material.preset=black_rubber"]
    cell = nominal_cell(load_setup(settings=overrides).cell, ball())
    material = {body.name: body.material for body in cell.bodies}
    assert material["part"] == PRESETS["polished_steel"]
    assert material["table"] == PRESETS["black_rubber"]
    assert material["base"].model == "lambert"
    assert build_scene(cell.bodies).bodies == [body.name for body in cell.bodies]
