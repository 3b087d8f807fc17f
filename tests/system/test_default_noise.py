"""With every noise of the default sensor and encoders on: points scatter, but not to one side."""

from __future__ import annotations

import numpy as np
import pytest
from line import figures_um

# A third of the default density: the mean of over 100,000 points needs no more.
FEWER = "scan.max_profiles=300"


@pytest.mark.parametrize("part", ["sphere_on_foot", "free_form"])
def test_default_noise_is_unbiased_and_equal_in_both_engines(planned, part) -> None:
    line = planned(part, FEWER, ideal=False)
    assert line.setup.sensor.render.noise
    assert line.setup.cell.table.encoder_resolution_deg > 0
    rms, sigma = {}, {}
    for engine in ("ray-traced", "geometric"):
        cloud = line.scan(engine)
        found = figures_um(line.signed(cloud))
        sigma[engine] = 1e6 * np.sqrt((cloud.sigma**2).mean())
        print(part, engine, {name: round(value, 2) for name, value in found.items()}, len(cloud), sigma[engine])
        assert len(cloud) > 50_000
        assert abs(found["mean"]) <= 10.0
        rms[engine] = found["rms"]
    # Images bring errors at edges and creases as well.
    assert 0.7 * rms["ray-traced"] < rms["geometric"] < 1.1 * rms["ray-traced"]
    assert sigma["geometric"] == pytest.approx(sigma["ray-traced"], rel=0.1)
