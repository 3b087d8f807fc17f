"""Lamps of a cell: description, conversion for the renderer, invalid values."""

from __future__ import annotations

import json
from typing import Any

import pytest
from cells import ball
from numpy.testing import assert_allclose

from scancell import sensor as sensor_rt
from scancell.config.description import validate
from scancell.config.devices import LightDescription
from scancell.config.loading import load_setup
from scancell.config.sensor import sensor_json
from scancell.errors import DescriptionError
from scancell.nominal.cell import Lamp, nominal_cell
from scancell.scanning.world import build_scene, visible_bodies

DISC: dict[str, Any] = {"kind": "disc", "power_mw": 500.0, "diameter_mm": 40.0, "in_band": 0.25}


def test_lamps_are_added_in_si_units() -> None:
    light = 'cell.light=[{kind="disc", frame="table", pose={z_mm=300}, power_mw=500, diameter_mm=40, in_band=0.25}]'
    cell = nominal_cell(load_setup(settings=[light]).cell, ball())
    (lamp,) = cell.lamps
    assert (lamp.moves_with, lamp.kind, lamp.in_band, lamp.spectrum) == ("table", "disc", 0.25, None)
    assert_allclose([*lamp.size, lamp.power], [0.04, 0.04, 0.5])
    assert_allclose(lamp.frame_from_lamp[:3, 3], [0, 0, 0.3])
    visible = visible_bodies(cell)
    assert isinstance(visible[-1], Lamp)
    assert build_scene(visible).bodies[-1] == "light[1]"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"diameter_mm": None}, "diameter_mm is missing"),
        ({"width_mm": 3.0}, "width_mm is not used"),
        ({"in_band": None}, "give either in_band, or wavelength_nm and bandwidth_nm"),
        ({"wavelength_nm": 600.0, "bandwidth_nm": 20.0}, "give either in_band"),
        ({"in_band": None, "wavelength_nm": 600.0}, "give either in_band"),
        ({"in_band": 1.5}, "in_band = 1.5"),
        ({"frame": "moon"}, "frame = 'moon'"),
    ],
)
def test_incomplete_lamps_are_rejected(change: dict[str, Any], message: str) -> None:
    with pytest.raises(DescriptionError, match=message):
        validate(LightDescription, DISC | change, "cell.toml")


def test_filter_defaults_to_laser_wavelength() -> None:
    for words, centre in (([], 660e-9), (["sensor.band_pass.centre_nm=655"], 655e-9)):
        data = sensor_json(load_setup(settings=words).sensor, seed=0)
        assert data["band_pass"] == pytest.approx({"centre": centre, "width": 20e-9})


def test_library_rejects_invalid_filter() -> None:
    data = sensor_json(load_setup().sensor, seed=0)
    data["band_pass"]["width"] = 0.0
    with pytest.raises(ValueError, match=r"band_pass\.width"):
        sensor_rt.Sensor(json.dumps(data))
