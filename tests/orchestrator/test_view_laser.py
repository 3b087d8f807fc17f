"""The laser in pictures: where its sheet crosses rays, against closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from scancell.geometry import pose
from scancell.views.camera import LaserSheet

FAR, SOURCE_Z, SLOPE, HALF_WIDTH = 0.2, -0.02, 0.5, 1e-3  # m
EYE = np.array([0.1, 0.03, 0.05])


@pytest.fixture(params=["at the origin", "moved"])
def sheet(request: pytest.FixtureRequest) -> LaserSheet:
    moved = pose.from_euler_xyz((0.3, -0.2, 0.5), (0.4, -0.9, 2.0))
    return LaserSheet(np.eye(4) if request.param == "at the origin" else moved, SOURCE_Z, SLOPE, HALF_WIDTH, FAR)


def rays(sheet: LaserSheet, targets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The eye, and directions to `targets` (n, 3), given in the sensor frame, of a third of the distance."""
    eye, to = (pose.transform_points(sheet.world_from_sensor, points) for points in (EYE[None], targets))
    return eye[0], (to - eye) / 3


def test_veil_is_where_rays_cross_the_sheet_in_front_of_surfaces(sheet: LaserSheet) -> None:
    z = np.array([0.0, 0.02, 0.1, 0.5, 1.0])
    inside = np.stack([np.zeros(5), 0.9 * SLOPE * (z - SOURCE_Z), z], 1)
    outside = inside * [1.0, 1.2, 1.0]
    beyond = np.array([[0.0, 0.0, 10.1 * FAR + SOURCE_Z], [0.0, 0.0, SOURCE_Z - 0.01]])
    behind = 2 * EYE - inside[:1]  # the ray leads away from the sheet
    eye, directions = rays(sheet, np.vstack([inside, outside, beyond, behind]))
    rows, points, light = sheet.veil(eye, directions, np.full(len(directions), np.inf))
    np.testing.assert_array_equal(rows, range(5))
    np.testing.assert_allclose(points, pose.transform_points(sheet.world_from_sensor, inside), atol=1e-12)
    np.testing.assert_allclose(light, np.minimum(1.0, FAR / 4 / (z - SOURCE_Z)), rtol=1e-12)
    assert light[0] == light[1] == 1.0
    # Surfaces just in front of the sheet hide it, and those just behind do not.
    assert len(sheet.veil(eye, directions, np.full(len(directions), 2.999))[0]) == 0
    assert len(sheet.veil(eye, directions, np.full(len(directions), 3.001))[0]) == 5


def test_stripe_fades_across_the_sheet_and_is_a_few_pixels_wide_at_least(sheet: LaserSheet) -> None:
    x = HALF_WIDTH * np.array([-1.6, -1.0, -0.4, 0.0, 0.4, 1.0, 1.25, 1.6])
    eye, directions = rays(sheet, np.stack([x, np.zeros(8), np.full(8, 0.1)], 1))
    depth = np.full(8, 3.0)
    rows, light = sheet.stripe(eye, directions, depth, 1e6)
    np.testing.assert_array_equal(rows, range(1, 7))
    np.testing.assert_allclose(light, [0.5, 1.0, 1.0, 1.0, 0.5, 0.25], atol=1e-9)
    # Where a pixel is a millimetre wide, the half width is one and a half.
    rows, light = sheet.stripe(eye, directions, depth, 3e3)
    np.testing.assert_array_equal(rows, range(8))
    np.testing.assert_allclose(light, np.minimum(1.0, 1.5 - np.abs(x) / 1.5e-3), atol=1e-9)
    assert len(sheet.stripe(eye, directions, np.full(8, np.inf), 1e6)[0]) == 0
