"""With every noise of the default sensor and encoders on: points scatter, but not to one side."""

from __future__ import annotations

import pytest
from line import figures_um

# A third of the default density: the mean of over 100,000 points needs no more.
FEWER = "scan.max_profiles=300"


@pytest.mark.parametrize("part", ["sphere_on_foot", "free_form"])
def test_default_noise_brings_no_bias(planned, part) -> None:
    line = planned(part, FEWER, ideal=False)
    cloud = line.scan("ray-traced")
    found = figures_um(line.signed(cloud))
    print(part, {name: round(value, 2) for name, value in found.items()}, len(cloud))
    assert line.setup.sensor.render.noise
    assert line.setup.cell.table.encoder_resolution_deg > 0
    assert len(cloud) > 50_000
    assert abs(found["mean"]) <= 10.0
