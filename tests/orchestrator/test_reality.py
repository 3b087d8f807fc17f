"""The figures of public recordings, by small synthetic recordings of the same formats."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bench import reality
from bench.robot_ball import robot_ball_lines
from board_recordings import record
from scancell.geometry import pose


def write_etna(folder: Path) -> Path:
    """Images and poses as ``openlmd/etna`` keeps them: text files of position (m) and quaternion x, y, z, w."""
    data = folder / "etna" / "etna_calib" / "data"
    data.mkdir(parents=True)
    made = record(1, 6)
    for number, (image, flange) in enumerate(zip(made.images, made.flange, strict=True), 1):
        cv2.imwrite(str(data / f"frame{number:04d}.png"), image)
        quaternion = Rotation.from_matrix(flange[:3, :3]).as_quat()
        text = repr((tuple(flange[:3, 3].tolist()), tuple(quaternion.tolist())))
        (data / f"pose{number:04d}.txt").write_text(text)
    cv2.imwrite(str(data / "board1.png"), made.images[0])
    return data


def write_ball(folder: Path, poses: int = 3, repeats: int = 5) -> Path:
    """Profiles of a ball before a plane: x, z (towards the sensor), label in mm, rounded to 5 µm."""
    data = folder / "ball" / "data" / "Standard_sphere_seg_dataset_v1"
    (data / "label_out_1").mkdir(parents=True)
    rng = np.random.default_rng(4)
    for number in range(1, poses + 1):
        centre, radius = np.array([rng.uniform(-10, 10), rng.uniform(200, 240)]), rng.uniform(15, 18.5)
        for repeat in range(1, repeats + 1):
            x = np.linspace(-45, 45, 700)
            on_ball = np.abs(x - centre[0]) < 0.85 * radius
            z = np.where(on_ball, centre[1] + np.sqrt(np.maximum(radius**2 - (x - centre[0]) ** 2, 0.0)), 110.0)
            z = np.round((z + rng.normal(scale=8e-3, size=len(z))) / 5e-3) * 5e-3
            np.savetxt(data / "label_out_1" / f"{number}_{repeat}.csv", np.column_stack([x, z, on_ball]), delimiter=",")
    return data


def write_robot_ball(folder: Path, count: int = 8) -> tuple[Path, np.ndarray]:
    """Profiles of a ball of radius 40 mm with poses of a flange, as the set keeps them, and the tool (4, 4)."""
    data = folder / "robot" / "data" / "ScanData"
    data.mkdir(parents=True)
    rng = np.random.default_rng(8)
    tool = pose.from_euler_xyz((-0.15, 0.715, 0.083), (0.0, 0.01, np.pi))
    stated = []
    for number in range(1, count + 1):
        turn = Rotation.from_euler("xyz", np.add([np.pi, 0, np.pi], rng.uniform(-0.2, 0.2, 3)))
        centre = np.array([rng.uniform(-0.03, -0.005), rng.uniform(-0.02, 0.02), rng.uniform(0.41, 0.44)])
        position = [-0.04, 2.02, 0.02] - turn.apply(pose.transform_points(tool, centre[None])[0])
        stated.append([*(1e3 * position), *turn.as_euler("xyz", degrees=True)])
        angle = np.linspace(-1, 1, 800)
        radius = np.sqrt(0.04**2 - centre[0] ** 2) + rng.normal(scale=10e-6, size=len(angle))
        y, z = centre[1] + radius * np.sin(angle), centre[2] - radius * np.cos(angle)
        line = 1e3 * np.column_stack([y, np.zeros(len(y)), 0.4 - z]).ravel()
        numbers = ", ".join(f"{value:.6e}" for value in line)
        (data / f"p{number}.yml").write_text(f"%YAML:1.0\n---\nscan_line: [ {numbers} ]\n")
    (data / "RobPoses.rob").write_text(json.dumps({"RobPoses": stated}))
    # Their sensor frame: x along the line, z towards the sensor, origin 400 mm from it.
    theirs = tool @ pose.from_rotation(np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]]), [0, 0, 0.4])
    theirs[:3, 3] *= 1e3
    (data / "calibration.sec").write_text(json.dumps({"Solution": {"HTM": theirs.tolist()}}))
    return data, tool


def test_ball_on_a_robot(tmp_path) -> None:
    """Exact poses: all three tools are the true one, and left-out profiles agree with the others."""
    data, tool = write_robot_ball(tmp_path)
    rows = [line.split("|")[1:-1] for line in robot_ball_lines(data) if line]
    for row in rows[2:5]:
        found = [float(cell.split("±")[0]) for cell in row[1:]]
        assert found == pytest.approx(1e3 * tool[:3, 3], abs=1.0), row[0]
    for row, limit in zip(rows[7:], (0.1, 0.3, 0.3), strict=True):
        assert float(row[1]) < limit, row[0]


def test_profiles_of_a_ball(tmp_path) -> None:
    """Without a systematic shape of the profiles, both intervals hold."""
    lines = list(reality.ball_lines(write_ball(tmp_path)))
    assert "| 15; 15 |" in lines[2]
    assert "100.0 %" in lines[3]
    inside = [int(line.split("|")[2].split()[0]) for line in lines[-2:]]
    assert all(36 <= number <= 45 for number in inside)  # of 45


def test_half_of_the_ball_predicts_the_noise_of_the_other(tmp_path) -> None:
    """The recordings have independent errors of 8 µm in each point."""
    rows = {
        row[1].strip(): row[2:4]
        for row in (line.split("|") for line in reality.ball_half_lines(write_ball(tmp_path, 4)))
    }
    for cell in rows["noise"]:
        real, simulated, ratio = (float(value) for value in cell.replace(";", ",").split(","))
        assert 4.0 < real < 8.5  # 8 µm in z, across slopes of up to 60°
        assert ratio == pytest.approx(simulated / real, abs=0.02)
        assert ratio == pytest.approx(1.0, abs=0.25)


def test_command_writes_the_tables_between_the_marks(tmp_path, monkeypatch, capsys) -> None:
    write_etna(tmp_path)
    write_ball(tmp_path, poses=1)
    monkeypatch.setattr(reality, "prediction_lines", lambda poses: [f"| {len(poses)} pose |"])
    page = tmp_path / "page.md"
    page.write_text(
        "Before\n<!-- etna -->\nstale\n<!-- end of etna -->\n<!-- halves -->\n<!-- end of halves -->\n"
        "Between\n<!-- ball -->\n<!-- end of ball -->\n"
        "<!-- robot ball -->\n<!-- end of robot ball -->\n<!-- ball halves -->\n<!-- end of ball halves -->\nAfter\n"
    )
    monkeypatch.setattr(reality, "FOLDERS", (".",))
    monkeypatch.setattr("sys.argv", ["reality", "--data", str(tmp_path), "--out", str(page)])
    reality.main()
    text = page.read_text()
    assert "stale" not in text and "Between" in text and text.endswith("After\n")
    (row,) = [line for line in text.splitlines() if line.startswith("| all |")]
    ours, chain = (float(value) for value in row.split("|")[3].split("/")[:2])
    assert ours < 1.0 and chain < 3.0  # mm, of the board at a left-out image
    assert "| 1 pose |" in text
    assert "of 30" in row  # six components of the board in five images
    assert "no checkout with data/ScanData" in capsys.readouterr().out
    monkeypatch.setattr("sys.argv", ["reality", "--data", str(tmp_path / "etna"), "--out", str(page)])
    monkeypatch.setattr(reality, "etna_lines", lambda data: [f"| {data.name} |"])
    reality.main()
    assert "no checkout with data/Standard_sphere_seg_dataset_v1" in capsys.readouterr().out
