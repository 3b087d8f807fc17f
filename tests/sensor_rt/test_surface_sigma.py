"""Errors of points over their stated standard deviations on surfaces of different brightness; see docs/light.md."""

from __future__ import annotations

import numpy as np
import pytest

from bench.scenes import make_sensor
from bench.surface_sigma import ENGINES, EXACT, SENSORS, SURFACES, Engine, displacements, points_of
from scancell.config.material import Material
from scancell.sensor import PEAK_FLAGS


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("name", ["ideal", "realistic, sheet known"])
@pytest.mark.parametrize("surface", ["matt white", "black rubber"])
def test_errors_are_as_large_as_stated(surface: str, name: str, engine: Engine) -> None:
    path, settings = SENSORS[name]
    found = points_of(SURFACES[surface], make_sensor(settings, path), engine)
    print(f"{surface}, {name}, {engine}: {found.spread():.3f}, {len(found.stated)} points")
    assert len(found.stated) > 100_000
    assert 0.9 < found.spread() < 1.1


@pytest.mark.parametrize("engine", ENGINES)
def test_errors_of_saturated_stripes_are_as_large_as_stated(engine: Engine) -> None:
    found = points_of(Material(0.8), make_sensor(("sensor.laser.power_mw=16",)), engine)
    print(f"{engine}: {found.spread():.3f}, {len(found.stated)} points")
    assert ((found.flags & PEAK_FLAGS["saturated"]) != 0).all()
    assert 0.9 < found.spread() < 1.1


def test_light_of_grooved_metal_is_displaced_by_its_gradient_across_the_sheet() -> None:
    """The displacement, predicted from the brightness at both sides of the sheet, explains the errors of images."""
    material = SURFACES["grooves across the laser line"]
    found = points_of(material, make_sensor(), "ray-traced")
    predicted = displacements(material, None, (), found.place)
    print(f"about the truth {found.spread():.3f}, about the prediction {found.spread(predicted):.3f}")
    assert found.spread() > 1.2
    assert 0.98 < found.spread(predicted) < 1.02
    exact = points_of(material, make_sensor(EXACT), "ray-traced")
    predicted = displacements(material, None, (), exact.place)
    slope = (predicted @ exact.distance) / (predicted @ predicted)
    print(f"without noise {slope:.3f} of the predicted displacement, RMS {1e6 * np.sqrt(np.mean(predicted**2)):.2f} um")
    assert slope == pytest.approx(1.0, abs=0.1)
