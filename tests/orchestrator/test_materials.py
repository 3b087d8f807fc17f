"""Materials of a cell: presets, overrides, conversion for the ray tracer, invalid values."""

from __future__ import annotations

import pytest
from cells import ball

from scancell import sensor as sensor_rt
from scancell.config.loading import load_setup
from scancell.config.material import PRESETS, MaterialDescription
from scancell.nominal.cell import nominal_cell
from scancell.scanning.exposures import build_scene


@pytest.mark.parametrize("name", PRESETS)
def test_ray_tracer_accepts_presets(name: str) -> None:
    preset = MaterialDescription.model_validate({"preset": name}).resolved()
    material = sensor_rt.Material(preset.reflectance, preset.model, preset.roughness, preset.refractive_index)
    assert 0.0 < material.albedo([0.7])[0] < 1.0


def test_values_override_preset() -> None:
    steel = MaterialDescription.model_validate({"preset": "polished_steel", "roughness": 0.2}).resolved()
    assert steel.roughness == 0.2
    assert steel.reflectance == PRESETS["polished_steel"].reflectance


def test_materials_of_part_table_and_robot() -> None:
    overrides = ["cell.part.material.preset=polished_steel", "cell.table.material.preset=black_rubber"]
    cell = nominal_cell(load_setup(settings=overrides).cell, ball())
    material = {body.name: body.material for body in cell.bodies}
    assert material["part"] == PRESETS["polished_steel"]
    assert material["table"] == PRESETS["black_rubber"]
    assert material["base"].model == "lambert"
    assert build_scene(cell.bodies).bodies == [body.name for body in cell.bodies]
