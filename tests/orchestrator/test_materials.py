"""Materials of a cell: presets, values on top, refusals, and their way to the ray tracer."""

from __future__ import annotations

import pytest
from cells import ball

import sensor_rt
from orchestrator.cell.nominal import nominal_cell
from orchestrator.config import load_setup
from orchestrator.config.material import PRESETS, MaterialDescription
from orchestrator.errors import DescriptionError
from orchestrator.scanning.exposures import build_scene


@pytest.mark.parametrize("name", PRESETS)
def test_presets_are_materials_that_the_ray_tracer_accepts(name: str) -> None:
    preset = MaterialDescription.model_validate({"preset": name}).resolved()
    material = sensor_rt.Material(preset.reflectance, preset.model, preset.roughness, preset.refractive_index)
    assert 0.0 < material.albedo([0.7])[0] < 1.0


def test_values_replace_those_of_the_preset() -> None:
    steel = MaterialDescription.model_validate({"preset": "polished_steel", "roughness": 0.2}).resolved()
    assert steel.roughness == 0.2
    assert steel.reflectance == PRESETS["polished_steel"].reflectance


def test_part_table_and_robot_take_materials() -> None:
    overrides = ["cell.part.material.preset=polished_steel", "cell.table.material.preset=black_rubber"]
    cell = nominal_cell(load_setup(overrides=overrides).cell, ball())
    material = {body.name: body.material for body in cell.bodies}
    assert material["part"] == PRESETS["polished_steel"]
    assert material["table"] == PRESETS["black_rubber"]
    assert material["base"].model == "lambert"
    assert build_scene(cell.bodies).bodies == [body.name for body in cell.bodies]


@pytest.mark.parametrize(
    ("override", "complaint"),
    [
        ("cell.part.material.preset=chrome", "matt_white"),
        ("cell.part.material.roughness=0.4", "preset"),
        ("cell.part.material={preset='polished_steel', roughness=0.001}", "0.01"),
        ("cell.part.material={model='lambert', reflectance=1.3}", "reflectance"),
    ],
)
def test_wrong_materials_are_refused(override: str, complaint: str) -> None:
    with pytest.raises(DescriptionError, match=complaint):
        load_setup(overrides=[override])
