"""Calibration of a camera with a laser line by images of a chessboard with the stripe on it, and flange poses."""

from __future__ import annotations

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

import scancell
from bench.board_prediction import prediction_error
from board_recordings import BASE_FROM_BOARD, BOARD, FLANGE_FROM_SENSOR, BoardRecording, record, recorded_sensor
from scancell import sensor as sensor_rt
from scancell.calibration.board.solve import BoardProblem, hand_eye, solve, start_rig
from scancell.calibration.board.views import Board, read_views
from scancell.calibration.measured_table import write_measured_table
from scancell.cli import app
from scancell.errors import CalibrationError, DescriptionError, ImageError
from scancell.geometry import pose
from scancell.progress import NullProgress
from scancell.scanning.world import make_sensor


@pytest.fixture(scope="module")
def recording() -> BoardRecording:
    return record(1, 10)


@pytest.fixture(scope="module")
def folder(recording, tmp_path_factory) -> Path:
    return recording.write(tmp_path_factory.mktemp("board") / "images")


@pytest.fixture(scope="module")
def report(folder) -> scancell.BoardCalibrationReport:
    return scancell.calibrate_from_images(folder, "7x6x10", sensor=recorded_sensor(), threads=1)


@pytest.fixture(scope="module")
def views(folder):
    return read_views(folder, BOARD, recorded_sensor(), None, 1, NullProgress())


def test_camera_sheet_hand_eye_and_board_are_found_within_their_intervals(report) -> None:
    """Of the described sensor: it is rotated by a quarter turn against the recorded images."""
    true = recorded_sensor().camera[0]
    assert report.quarter_turns == 1 and not report.warnings
    half = {row.name: row.half_width for row in report.rows}
    found = report.sensor.camera[0]
    focal = {
        "found": found.height_px / np.tan(np.radians(found.half_angle_deg)) / 2,
        "true": 640 / np.tan(np.radians(15)) / 2,
    }
    assert abs(focal["found"] - focal["true"]) < 2 * half["focal_px"] < 12.0
    assert abs(found.cx_px - true.cx_px) < 2 * half["cy_px"]
    assert abs(found.cy_px - true.cy_px) < 2 * half["cx_px"]
    assert abs(found.baseline_mm - true.baseline_mm) < 2 * half["sheet.distance_mm"] < 1.5
    assert found.tilt_deg == pytest.approx(true.tilt_deg, abs=0.15)
    assert found.roll_deg == pytest.approx(true.roll_deg, abs=0.15)
    for name, expected in (("flange_from_sensor", FLANGE_FROM_SENSOR), ("base_from_board", BASE_FROM_BOARD)):
        error = pose.inverse(expected) @ getattr(report, name)
        assert np.linalg.norm(error[:3, 3]) < 1e-3, name
    turned = pose.inverse(FLANGE_FROM_SENSOR) @ report.flange_from_sensor
    assert np.degrees(np.linalg.norm(pose.log_rotation(turned[:3, :3]))) < 0.15


def test_sizes_of_errors_are_found(report) -> None:
    """Positions and orientations of the robot scatter by 0.2 mm and 1 mrad, corners by less than a tenth of a pixel."""
    corners, stripe, position, orientation, _ = report.result.sizes
    assert corners < 0.15 and stripe < 0.1
    assert position == pytest.approx(0.2, rel=0.4)
    assert orientation == pytest.approx(1.0, rel=0.4)
    figures = report.figures
    assert figures["standard_deviation_of_positions_mm"] == pytest.approx(0.2, rel=0.4)
    assert figures["standard_deviation_of_orientations_deg"] == pytest.approx(np.degrees(1e-3 * orientation))
    worst = max(figures["errors_of_images"], key=lambda image: float(image["position_mm"]))
    assert 0.2 < worst["position_mm"] < 1.0
    turned = [float(image["orientation_deg"]) for image in figures["errors_of_images"]]
    assert 0.05 < np.mean(turned) < 0.2
    assert 0.01 < figures["rms_of_stripe_to_board_mm"] < 0.5


def test_described_sensor_triangulates_as_the_rig(report) -> None:
    native = make_sensor(report.sensor, 0)
    rng = np.random.default_rng(2)
    recorded = np.column_stack([rng.uniform(150, 500, 50), rng.uniform(20, 490, 50)])
    turned = np.column_stack([recorded[:, 1], report.size[0] - 1 - recorded[:, 0]])
    points = sensor_rt.triangulate_pixels(turned, native, 0, "ray")
    expected = report.result.rig.on_sheet(recorded)
    camera_from_sensor = pose.inverse(report.flange_from_camera) @ report.flange_from_sensor
    assert pose.transform_points(camera_from_sensor, points) == pytest.approx(expected, abs=1e-7)


def test_strongly_rolled_camera_measures_a_plane() -> None:
    """Real cameras are mounted as there is room: a roll of 15 deg is rendered, extracted and triangulated."""
    sensor = recorded_sensor().replace({"camera[1].roll_deg": -15.0, "laser.power_mw": 60.0})
    native = make_sensor(sensor, 1)
    scene = sensor_rt.Scene()
    scene.add_plane("plate", np.eye(4), [0.4, 0.4], 0.6)
    board = pose.from_rotation(pose.rotation_about(0, np.pi + 0.1), (0.0, 0.0, 0.24))
    exposure = sensor_rt.Exposures(
        np.eye(4)[None, None], board[None, None, None], np.array([native.exposure]), np.array([1], np.int64)
    )
    peaks = sensor_rt.extract(sensor_rt.render(scene, native, exposure, 1), native, 1)
    points = np.asarray(sensor_rt.triangulate(peaks, native).points_in_sensor)
    assert len(points) > 300
    height = pose.transform_points(pose.inverse(board), points)[:, 2]
    assert np.sqrt(np.mean(height**2)) < 0.02e-3


def test_board_of_a_left_out_image_is_predicted_within_its_interval(views, report) -> None:
    """By calibrations without the image; and what one calibration of all images tells of each agrees with them."""
    inside, one_step = [], report.result.left_out
    for left_out in (0, 3, 6):
        train = [view for i, view in enumerate(views.views) if i != left_out]
        found = solve(train, start_rig(train, views.size))
        held = views.views[left_out]
        error = prediction_error(found, held)
        inside.extend(np.abs(error.displacement) < error.half_width)
        row = list(one_step.exposure).index(left_out)
        difference = one_step.displacement[row] - error.displacement
        assert (np.abs(difference) < one_step.half_widths()[row] / 3).all()
        assert one_step.half_widths()[row] == pytest.approx(error.half_width, rel=0.5)
        stripe = found.rig.on_sheet(held.stripe)
        on_board = pose.transform_points(pose.inverse(found.rig.camera_from_board(held.flange)), stripe)
        assert np.sqrt(np.mean(on_board[:, 2] ** 2)) < 0.8e-3
    assert sum(inside) >= 15  # of 18
    assert np.mean(np.abs(one_step.displacement) < one_step.half_widths()) >= 0.8


def test_derivatives_of_residuals(views) -> None:
    problem, rig = BoardProblem(views.views), start_rig(views.views, views.size)
    errors = 0.1 * np.random.default_rng(3).normal(size=(len(views.views), 8))
    (by_rig, by_error), step = problem.derivatives(rig, errors), 1e-4
    for unknown in (0, 3, 8, 12, 15, 20):
        x = step * np.eye(22)[unknown]
        up, down = (np.concatenate(problem.residuals(rig.moved(sign * x), errors)) for sign in (1, -1))
        assert by_rig[:, unknown] == pytest.approx((up - down) / (2 * step), abs=1e-3)
    shift = np.zeros_like(errors)
    shift[2, 4] = step
    up, down = (np.concatenate(problem.residuals(rig, errors + sign * shift)) for sign in (1, -1))
    own = np.concatenate([problem.corner_view, problem.stripe_view]) == 2
    assert np.where(own, by_error[:, 4], 0.0) == pytest.approx((up - down) / (2 * step), abs=1e-3)


def test_projection_and_rays_are_inverse(report) -> None:
    pixels = np.random.default_rng(4).uniform(50, 450, (40, 2))
    rig = report.result.rig
    assert rig.project(0.3 * rig.rays(pixels)) == pytest.approx(pixels, abs=1e-3)


def test_board_that_hides_corners_and_images_without_a_board_are_left_out(recording, tmp_path) -> None:
    images = recording.images.copy()
    images[2] = 60
    path = BoardRecording(images, recording.flange).write(tmp_path / "some")
    (warning,) = scancell.calibrate_from_images(path, "7x6x10", sensor=recorded_sensor(), threads=1).warnings
    assert warning == "image02.png: the 7 x 6 corners of the board were not found"


def test_stripe_along_rows_is_found_as_well(recording) -> None:
    image = recording.images[0]
    pixels = BOARD.find(image)
    across = read_stripe(image, pixels)
    turned = np.ascontiguousarray(np.rot90(image))
    along = read_stripe(turned, BOARD.find(turned))
    back = np.column_stack([image.shape[1] - 1 - along[:, 1], along[:, 0]])
    slope, offset = np.polyfit(across[:, 1], across[:, 0], 1)
    assert len(along) > 50
    assert np.abs(back[:, 0] - slope * back[:, 1] - offset).max() < 0.6


def test_stripe_that_goes_on_beside_the_board_is_cut_there(recording) -> None:
    """On another surface it lies in a line of its own."""
    image = recording.images[0].copy()
    pixels = BOARD.find(image)
    stripe = read_stripe(image, pixels)
    beyond = int(np.quantile(stripe[:, 1], 0.8))
    image[beyond:] = np.roll(image[beyond:], 28, axis=1)
    found = read_stripe(image, pixels)
    slope, offset = np.polyfit(stripe[:, 1], stripe[:, 0], 1)
    assert len(found) > 0.7 * len(stripe)
    assert np.abs(found[:, 0] - slope * found[:, 1] - offset).max() < 5.0
    assert found[:, 1].max() <= beyond + 2


def read_stripe(image: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    from scancell.calibration.board.views import find_stripe  # noqa: PLC0415

    return find_stripe(image, BOARD, pixels, recorded_sensor())[0]


def test_end_of_the_board_is_told_by_its_dark_square(recording) -> None:
    image = recording.images[1]
    turned = np.ascontiguousarray(np.rot90(image, 2))
    first, second = BOARD.find(image), BOARD.find(turned)
    height, width = image.shape
    assert second == pytest.approx(np.array([width - 1, height - 1]) - first, abs=0.1)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("7x6", "expected columns x rows of inner corners x side"),
        ("7x7x10", "expected an odd and an even number of corners"),
        ("2x7x10", "expected columns x rows"),
        ("7x6x-1", "expected columns x rows"),
    ],
)
def test_wrong_boards_are_refused(text: str, message: str) -> None:
    with pytest.raises(DescriptionError, match=message):
        Board.parse(text)


def quaternions(recording: BoardRecording, order: list[int]) -> dict[str, np.ndarray]:
    """Columns of the poses, whose header says w, x, y, z."""
    numbers = Rotation.from_matrix(recording.flange[:, :3, :3]).as_quat()[:, order]
    position = {f"flange_{axis}_mm": 1e3 * recording.flange[:, i, 3] for i, axis in enumerate("xyz")}
    return position | {f"flange_wxyz_{i}": values for i, values in enumerate(numbers.T, 1)}


def test_wrong_convention_is_recognised(recording, tmp_path) -> None:
    path = recording.write(tmp_path / "images", quaternions(recording, [0, 1, 2, 3]))
    with pytest.raises(CalibrationError, match=r"poses.csv: the flange poses do not fit .* as wxyz .* as xyzw"):
        scancell.calibrate_from_images(path, "7x6x10", sensor=recorded_sensor(), threads=1)


def test_wrong_pose_is_named(recording, tmp_path) -> None:
    flange = recording.flange.copy()
    flange[4, :3, 3] += [0.012, 0.0, 0.016]
    path = BoardRecording(recording.images, flange).write(tmp_path / "images")
    with pytest.raises(CalibrationError, match=r"1 of 10 images disagree .*: image04.png by ([\d.]+) mm") as refused:
        scancell.calibrate_from_images(path, "7x6x10", sensor=recorded_sensor(), threads=1)
    away = re.search(r"image04.png by ([\d.]+) mm", str(refused.value))
    assert away is not None and float(away[1]) == pytest.approx(20.0, abs=2.0)


def test_wrong_folders_are_refused(folder, recording, tmp_path) -> None:
    def refused(path: Path, message: str, error: type[Exception] = DescriptionError) -> None:
        with pytest.raises(error, match=message):
            scancell.calibrate_from_images(path, "7x6x10", sensor=recorded_sensor(), threads=1)

    refused(tmp_path / "none", "none: no such folder")
    (tmp_path / "empty").mkdir()
    refused(tmp_path / "empty", r"holds no table of flange poses; expected poses\.csv")
    copy = shutil.copytree(folder, tmp_path / "copy")
    (copy / "image03.png").rename(copy / "other.png")
    refused(copy, r"poses.csv: column 'image', row 4 = 'image03.png': expected an image in")
    (copy / "other.png").rename(copy / "image03.png")
    shutil.copy(copy / "image03.png", copy / "image99.png")
    refused(copy, r"no flange pose of 1 of the 11 images of its folder; expected a row with image99.png")
    (copy / "image99.png").unlink()
    cv2.imwrite(str(copy / "image05.png"), recording.images[5][:-2])
    refused(copy, r"image05.png: is 640 x 510 pixels; expected 640 x 512, as the images before", ImageError)
    (copy / "image05.png").write_text("no image")
    refused(copy, r"image05.png: cannot be read as an image", ImageError)
    few = replace(recording, images=recording.images[:3], flange=recording.flange[:3]).write(tmp_path / "few")
    refused(few, "3 images show the board; expected 4 or more", CalibrationError)
    dark = replace(recording, images=np.minimum(recording.images, 100)).write(tmp_path / "dark")
    refused(dark, "0 images show the stripe on the board's plane; expected 3 or more", CalibrationError)


def test_hand_eye_needs_turns_of_the_camera() -> None:
    flange = np.stack([pose.translation([0.01 * i, 0.0, 0.0]) for i in range(5)])
    board = np.stack([pose.translation([-0.01 * i, 0.0, 0.3]) for i in range(5)])
    with pytest.raises(CalibrationError, match="turn it about two axes"):
        hand_eye(flange, board)


def test_command_writes_the_described_sensor(folder, report, tmp_path) -> None:
    recorded_sensor().to_toml(tmp_path / "sensor.toml")
    words = ["calibrate", "sensor", str(tmp_path / "sensor.toml"), "--from-images", str(folder)]
    missing = CliRunner().invoke(app, words)
    assert missing.exit_code != 0 and "--board" in str(missing.output) + str(missing.exception)
    done = CliRunner().invoke(app, [*words, "--board", "7x6x10", "--threads", "1", "--out", str(tmp_path / "out")])
    assert done.exit_code == 0, done.output
    figures = json.loads((tmp_path / "out" / "calibration.json").read_text())
    assert figures["images"] == 10
    assert figures["flange_from_sensor_m"] == pytest.approx(report.flange_from_sensor, abs=1e-6)
    written = scancell.load_setup(sensor=tmp_path / "out" / "calibrated_sensor.toml").sensor
    assert written.camera[0].tilt_deg == pytest.approx(report.sensor.camera[0].tilt_deg, abs=1e-6)
    assert {file.name for file in (tmp_path / "out").iterdir()} == {
        "calibrated_sensor.toml",
        "calibration.json",
        "manifest.json",
        "residuals.png",
    }


def test_table_of_poses_may_be_yaml(recording, folder, report, tmp_path) -> None:
    import yaml  # noqa: PLC0415

    path = shutil.copytree(folder, tmp_path / "images")
    (path / "poses.csv").unlink()
    columns = quaternions(recording, [3, 0, 1, 2])
    entries = [
        {"image": f"image{i:02d}.png", **{name: float(values[i]) for name, values in columns.items()}}
        for i in range(len(recording.images))
    ]
    (path / "poses.yaml").write_text(yaml.safe_dump(entries))
    again = scancell.calibrate_from_images(path, "7x6x10", sensor=recorded_sensor(), threads=1)
    assert again.flange_from_sensor == pytest.approx(report.flange_from_sensor, abs=1e-6)
    write_measured_table(path / "poses.csv", {"image": ["image00.png"], "flange_x_mm": [1.0]})
    with pytest.raises(DescriptionError, match="'flange_y_mm': is missing"):
        scancell.calibrate_from_images(path, "7x6x10", sensor=recorded_sensor())
