"""Distance of points from the laser's sheet by two cameras, against points triangulated by hand."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from scancell.config.loading import load_setup
from scancell.evaluation.plane_trial import sheet_deviation
from scancell.scanning.world import make_sensor

SENSOR = make_sensor(load_setup().sensor, 0)
CENTRES = np.array([camera.sensor_from_camera[:3, 3] for camera in SENSOR.cameras])


def seen(offset: float, slope: float, spacing: float = 0.1e-3) -> SimpleNamespace:
    """Points of both cameras where their rays to a line at an offset from the sheet meet the sheet."""
    profiles = []
    for number, centre in enumerate(CENTRES):
        y = np.arange(-0.005, 0.005, spacing) + 0.3 * number * spacing  # the columns of the cameras differ
        true = np.stack([np.full_like(y, offset), y, 0.12 + slope * y], -1)
        share = centre[0] / (centre[0] - offset)
        profiles.append(centre + share * (true - centre))
    points = np.concatenate(profiles)
    camera = np.repeat([0, 1], len(points) // 2)
    return SimpleNamespace(points_in_sensor=points, frame=np.zeros(len(points), np.int64), camera=camera)


@pytest.mark.parametrize("slope", [0.0, 0.5, -1.0])
@pytest.mark.parametrize("offset", [-50e-6, 0.0, 20e-6])
def test_offset_of_a_line_is_found(offset: float, slope: float) -> None:
    profiles = seen(offset, slope)
    found = sheet_deviation(profiles, SENSOR)
    known = np.isfinite(found)
    assert known.mean() > 0.95
    # The formula is of first order: the error is of the order of the offset squared over the distance of the camera.
    np.testing.assert_allclose(found[known], offset, atol=3 * offset**2 / np.abs(CENTRES[:, 0]).min() + 1e-12)


def test_points_without_a_neighbour_of_the_other_camera_have_no_offset() -> None:
    assert np.isnan(sheet_deviation(seen(20e-6, 0.0, spacing=0.4e-3), SENSOR)).all()
    lone = seen(20e-6, 0.0)
    lone.camera[:] = 0
    assert np.isnan(sheet_deviation(lone, SENSOR)).all()


def test_frames_are_compared_with_themselves_alone() -> None:
    one, other = seen(20e-6, 0.0), seen(-30e-6, 0.3)
    both = SimpleNamespace(
        points_in_sensor=np.concatenate([one.points_in_sensor, other.points_in_sensor]),
        frame=np.repeat([4, 7], [len(one.frame), len(other.frame)]),
        camera=np.concatenate([one.camera, other.camera]),
    )
    expected = np.concatenate([sheet_deviation(profiles, SENSOR) for profiles in (one, other)])
    np.testing.assert_allclose(sheet_deviation(both, SENSOR), expected, atol=1e-15)
