"""Descriptions: units, overrides, refusals."""

from __future__ import annotations

import math
import tomllib
from pathlib import Path

import pytest

from orchestrator.config import CellDescription, ScanDescription, SensorDescription, load_setup
from orchestrator.config.loading import assets_dir, parse_assignment, split_path
from orchestrator.config.resolved import sensor_json
from orchestrator.config.schema import json_schemas
from orchestrator.config.toml_text import to_toml
from orchestrator.config.units import si_value, split_unit, to_si
from orchestrator.errors import DescriptionError


def test_units_are_stripped_and_scaled_once() -> None:
    si = to_si({"a_mm": 335.0, "tilt_deg": 180.0, "nested": [{"t_ms": 2.0}], "width_px": 1280, "pitch_um": 5.0})
    assert si["a"] == pytest.approx(0.335)
    assert si["tilt"] == pytest.approx(math.pi)
    assert si["nested"][0]["t"] == pytest.approx(0.002)
    assert si["width_px"] == 1280
    assert si["pitch"] == pytest.approx(5e-6)


def test_a_single_value_is_that_of_the_whole_description() -> None:
    table = load_setup().cell.table
    for key in ("radius_mm", "max_speed_deg_s", "friction"):
        assert si_value(table, key) == to_si(table.model_dump())[split_unit(key)[0]]


def test_every_dimensioned_key_of_the_shipped_sensor_reaches_si() -> None:
    resolved = sensor_json(load_setup().sensor, seed=3)
    camera = resolved["cameras"][0]
    assert resolved["render"]["seed"] == 3
    assert camera["baseline"] == pytest.approx(0.06)
    assert camera["focal_px"] == pytest.approx(512 / math.tan(math.radians(9.34)))
    assert not [key for key in camera if key.endswith(("_mm", "_deg", "_um"))]


@pytest.mark.parametrize(
    ("word", "fragments"),
    [
        ("cell.table.raduis_mm=3", ["table.raduis_mm", "unknown key", "radius_mm"]),
        ("cell.table.radius_mm=-3", ["table.radius_mm", "-3", "greater than 0"]),
        ("cell.table.radius_mm=nan", ["table.radius_mm", "nan", "finite"]),
        ("sensor.detector.bit_depth=99", ["detector.bit_depth", "99", "16"]),
        ("sensor.camera[3].tilt_deg=2", ["[3]", "there are 2"]),
        ("sensor.camera[0].tilt_deg=2", ["[0]", "counting from 1"]),
        ("sensor.camera[1].half_angle_deg=40", ["half_angle_deg", "tilt_deg"]),
        ("scan.mode='fly'", ["mode", "fly", "dynamic"]),
        ("cell.robot.joint[2].min_deg=90", ["min_deg", "max_deg"]),
        ("cell.world.controller_cycle_us=1500", ["controller_cycle_us", "1500", "multiple"]),
        ("table.radius_mm=3", ["cell, sensor, scan"]),
        ("cell.part.x_mm", ["key=value"]),
        ("cell.name.x=1", ["'x' is not inside a table"]),
    ],
)
def test_a_wrong_override_is_refused_with_key_value_and_expectation(word: str, fragments: list[str]) -> None:
    with pytest.raises(DescriptionError) as caught:
        load_setup(overrides=[word])
    for fragment in fragments:
        assert fragment in str(caught.value)


def test_a_wrong_file_is_named(tmp_path: Path) -> None:
    wrong = tmp_path / "sensor.toml"
    wrong.write_text("name = 1 2\n")
    with pytest.raises(DescriptionError, match=r"sensor.toml: not valid TOML.*line"):
        load_setup(sensor=wrong)
    with pytest.raises(DescriptionError, match=r"missing\.toml: no such file"):
        load_setup(cell=tmp_path / "missing.toml")
    with pytest.raises(DescriptionError, match="cannot be read"):
        load_setup(cell=tmp_path)
    wrong.write_bytes(b"\xff\xfe")
    with pytest.raises(DescriptionError, match="not valid TOML"):
        load_setup(sensor=wrong)


def test_all_faults_of_a_file_are_told_at_once(tmp_path: Path) -> None:
    text = (assets_dir() / "scans" / "default.toml").read_text()
    wrong = tmp_path / "scan.toml"
    wrong.write_text("max_profile = 3\nsettle_ms = -1\n" + text)
    with pytest.raises(DescriptionError) as caught:
        load_setup(scan=wrong)
    assert "max_profile" in str(caught.value)
    assert "settle_ms" in str(caught.value)


def test_ideal_switches_every_noise_off_and_nothing_else() -> None:
    noisy, ideal = load_setup(), load_setup(ideal=True)
    assert not ideal.sensor.render.noise
    assert all(j.encoder_noise_deg == j.encoder_resolution_deg == 0.0 for j in ideal.cell.robot.joint)
    assert ideal.sensor.detector == noisy.sensor.detector
    assert ideal.scan == noisy.scan


def test_resolved_toml_reads_back_as_the_same_descriptions() -> None:
    setup = load_setup(overrides=["cell.part.x_mm=0.1", "sensor.camera[2].cx_px=600.25"])
    sections = {name: getattr(setup, name).model_dump() for name in ("cell", "sensor", "scan")}
    read = tomllib.loads(to_toml(sections))
    assert CellDescription.model_validate(read["cell"]) == setup.cell
    assert SensorDescription.model_validate(read["sensor"]) == setup.sensor
    assert ScanDescription.model_validate(read["scan"]) == setup.scan


def test_words_and_paths() -> None:
    assert parse_assignment("a.b=[1, 2]") == ("a.b", [1, 2])
    assert parse_assignment("mode=dynamic") == ("mode", "dynamic")
    assert split_path("camera[2].tilt_deg") == ["camera", 1, "tilt_deg"]


def test_schemas_name_every_key_and_forbid_others() -> None:
    schemas = json_schemas()
    assert set(schemas) == {"cell", "robot", "sensor", "scan", "study", "batch"}
    assert set(schemas["scan"]["properties"]) == set(ScanDescription.model_fields)
    assert all(schema["additionalProperties"] is False for schema in schemas.values())


def test_descriptions_cannot_be_changed_after_checking() -> None:
    setup = load_setup()
    with pytest.raises(ValueError, match="frozen"):
        setup.scan.max_profiles = 3  # type: ignore[misc]
