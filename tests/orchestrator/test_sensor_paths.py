"""Sensor paths: geometry of spirals, waypoints and recorded poses, constant speed, bad input."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from cells import ball, block

from scancell.config.scan import PathDescription, SpiralDescription, WaypointDescription
from scancell.errors import DescriptionError, PlanningError
from scancell.geometry import pose
from scancell.planning.views.sensor_paths import SensorPath, recorded_poses, sensor_paths

HERE = np.eye(4)


def only(description: PathDescription, part=None) -> SensorPath:  # type: ignore[no-untyped-def]
    (path,) = sensor_paths(description, part or block(0.04, 0.04, 0.02), HERE)
    return path


def test_a_spiral_keeps_its_distance_and_direction() -> None:
    spiral = SpiralDescription(turns=2.0, elevation_deg=(20.0, 70.0), radius_mm=(15.0, 15.0), height_mm=(5.0, 10.0))
    path = only(PathDescription(standoff_mm=90.0, spiral=spiral))
    middle = path.poses[:, :3, 3] + 0.09 * path.poses[:, :3, 2]
    np.testing.assert_allclose(np.hypot(middle[:, 0], middle[:, 1]), 0.015, atol=1e-12)
    np.testing.assert_allclose(middle[[0, -1], 2], [0.005, 0.010], atol=1e-12)
    elevation = np.degrees(np.arcsin(-path.poses[:, 2, 2]))
    np.testing.assert_allclose(elevation[[0, -1]], [20.0, 70.0], atol=1e-9)
    # The laser line, along the sensor's y axis, stays in the plane of z and the viewing direction.
    np.testing.assert_allclose(np.cross(path.poses[:, :3, 1], path.poses[:, :3, 2])[:, 2], 0.0, atol=1e-12)
    azimuth = np.unwrap(np.arctan2(-path.poses[:, 1, 2], -path.poses[:, 0, 2]))
    assert azimuth[-1] - azimuth[0] == pytest.approx(4 * np.pi)


def test_a_spiral_without_radius_follows_the_contour_at_its_standoff() -> None:
    path = only(PathDescription(spiral=SpiralDescription(elevation_deg=(30.0, 30.0))), ball(0.03))
    distance = np.linalg.norm(path.poses[:, :3, 3], axis=1)  # the ball's centre is the origin
    np.testing.assert_allclose(distance, 0.08 + 0.03, atol=1e-3)  # to the facets of the ball


def test_exposures_along_a_path_are_its_pitch_apart() -> None:
    path = only(PathDescription(spiral=SpiralDescription()))
    at = path.at(np.arange(0.0, path.length, path.pitch))
    steps = np.linalg.norm(np.diff(at[:, :3, 3], axis=0), axis=1)
    np.testing.assert_allclose(steps, path.pitch, rtol=2e-3)


def test_a_path_goes_on_straight_and_smoothly_beyond_its_ends() -> None:
    path = only(PathDescription(spiral=SpiralDescription()))
    step = 1e-4
    for end in (0.0, path.length):
        at = path.at(end + step * np.array([-1.0, 0.0, 1.0]))
        moved = np.diff(at[:, :3, 3], axis=0)
        turned = pose.log_rotation(at[1:, :3, :3] @ np.swapaxes(at[:-1, :3, :3], -1, -2))
        np.testing.assert_allclose(moved[0], moved[1], atol=1e-3 * step)
        np.testing.assert_allclose(turned[0], turned[1], atol=2e-2 * np.linalg.norm(turned[0]))


def test_legs_between_waypoints_are_straight() -> None:
    corners = [(-20.0, 0.0, 20.0), (20.0, 0.0, 20.0), (20.0, 15.0, 20.0)]
    points = tuple(WaypointDescription(x_mm=x, y_mm=y, z_mm=z) for x, y, z in corners)
    legs = sensor_paths(PathDescription(waypoint=points), block(0.04, 0.04, 0.02), HERE)
    assert [round(leg.length, 9) for leg in legs] == [0.040, 0.015]
    for leg in legs:
        at = leg.at(np.linspace(0.0, leg.length, 9))
        np.testing.assert_allclose(np.linalg.norm(np.diff(at[:, :3, 3], axis=0), axis=1), leg.length / 8, atol=1e-12)
        np.testing.assert_allclose(at[:, :3, 2], [[0.0, 0.0, -1.0]] * 9, atol=1e-12)
        np.testing.assert_allclose(at[:, 2, 3], 0.1, atol=1e-12)


def test_recorded_poses_are_read_as_they_are(tmp_path: Path) -> None:
    file = tmp_path / "poses.csv"
    file.write_text("x_mm,y_mm,z_mm,rx_deg,ry_deg,rz_deg\n0,0,100,180,0,0\n10,0,100,180,0,30\n20,0,100,180,0,60\n")
    path = only(PathDescription(recorded=str(file)))
    np.testing.assert_allclose(path.at(np.array([0.0, 0.01, 0.02])), recorded_poses(file), atol=1e-9)
    np.testing.assert_allclose(recorded_poses(file)[:, 0, 3], [0.0, 0.01, 0.02])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("x_mm,y_mm\n1,2\n3,4\n", "line 2, column 'z_mm' = None: expected a number"),
        ("x_mm,y_mm,z_mm,rx_deg,ry_deg,rz_deg\n0,0,1,0,0,0\n", "1 poses; expected at least two"),
        (
            "x_mm,y_mm,z_mm,rx_deg,ry_deg,rz_deg\n0,0,1,0,0,0\n0,0,nan,0,0,0\n",
            "line 3, column 'z_mm' = 'nan': expected a",
        ),
        ("", "the file is empty"),
        ("x_mm,y_mm,z_mm,rx_deg,ry_deg,rz_deg\n", "0 poses; expected at least two"),
    ],
)
def test_bad_recordings_are_refused_with_line_and_column(tmp_path: Path, text: str, message: str) -> None:
    file = tmp_path / "poses.csv"
    file.write_text(text)
    with pytest.raises(DescriptionError) as refused:
        recorded_poses(file)
    assert str(file) in str(refused.value)
    assert message in str(refused.value)


def test_a_path_without_length_is_refused() -> None:
    point = WaypointDescription(x_mm=0.0, y_mm=0.0, z_mm=0.0)
    with pytest.raises(PlanningError, match="all poses are at one position"):
        only(PathDescription(waypoint=(point, point)))


@pytest.mark.parametrize(
    "given", [{}, {"recorded": "a.csv", "spiral": {}}, {"waypoint": [{"x_mm": 0, "y_mm": 0, "z_mm": 0}]}]
)
def test_a_description_names_exactly_one_kind_of_path(given: dict[str, object]) -> None:
    with pytest.raises(
        DescriptionError, match=r"give exactly one of spiral, contour, waypoint and recorded|expected at least two"
    ):
        PathDescription(**given)  # type: ignore[arg-type]
