"""Warnings about valid but implausible descriptions."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import numpy as np
import pytest
import trimesh

from scancell.config.cell import CellDescription
from scancell.config.loading import Setup, assets_dir, load_setup
from scancell.config.scan import PathDescription
from scancell.errors import DescriptionError
from scancell.nominal.plausibility import setup_warnings
from scancell.planning.options import scan_options


def warnings(*words: str) -> list[str]:
    return setup_warnings(load_setup(settings=words))


@pytest.mark.parametrize("name", ["default", "pick_and_place"])
def test_shipped_cells_give_no_warning(name: str) -> None:
    assert setup_warnings(load_setup(assets_dir() / "cells" / f"{name}.toml")) == []


@pytest.mark.parametrize(("key", "value", "made_for"), [("a_mm", 300, 270), ("d_mm", -30, 0), ("alpha_deg", 5, 0)])
def test_edited_link_with_shipped_mesh_warning(key: str, value: float, made_for: float) -> None:
    (text,) = warnings(f"cell.robot.joint[2].{key}={value}")
    assert text.startswith("cell.robot.joint[2]: mesh link2.stl does not fit")
    assert f"{key} is {value}, the mesh was made for {made_for}" in text


def test_calibrated_values_and_joint_zeros_give_no_warning() -> None:
    words = [f"cell.robot.joint[{i}].{key}" for i in range(1, 7) for key in ("theta_deg=1.5", "max_speed_deg_s=100")]
    assert warnings(*words, "cell.robot.joint[2].a_mm=270.4", "cell.robot.joint[4].d_mm=294.6") == []


def test_platter_mesh_of_other_dimensions_warning(tmp_path: Path) -> None:
    words = ["cell.table.radius_mm=160"]
    (text,) = warnings(*words)
    assert text.endswith("reaches 120.0 mm from the axis, but cell.table.radius_mm = 160")
    platter = trimesh.creation.cylinder(160.0, 20.0, sections=90)  # its middle, not its top, at z = 0
    platter.export(tmp_path / "platter.stl")
    (text,) = warnings(*words, f"cell.table.platter_mesh={tmp_path / 'platter.stl'}")
    assert "platter.stl: its top is at z = 10.0 mm" in text


@pytest.fixture
def own_meshes(tmp_path: Path) -> CellDescription:
    """The default cell with copies of the link meshes in a folder without a robot file."""
    shutil.copytree(assets_dir() / "robots" / "six_axis", tmp_path / "arm")
    files = {f"robot.joint[{i}].mesh": str(tmp_path / "arm" / f"link{i}.stl") for i in range(1, 7)}
    return CellDescription.default().replace({**files, "robot.base_mesh": str(tmp_path / "arm" / "base.stl")})


def with_cell(cell: CellDescription) -> Setup:
    return load_setup(cell)


def test_link_mesh_tolerance_at_joint_axis(own_meshes: CellDescription) -> None:
    """The upper arm extends 66 mm beyond the axis of joint 2, which is a_mm from the origin of the link's frame."""
    beyond = -trimesh.load(own_meshes.robot.joint[1].mesh).bounds[0, 0]
    for a in (beyond - 60, beyond + 9):
        assert setup_warnings(with_cell(own_meshes.replace({"robot.joint[2].a_mm": a}))) == []
    (text,) = setup_warnings(with_cell(own_meshes.replace({"robot.joint[2].a_mm": beyond + 12})))
    assert "joint[2]: mesh link2.stl does not fit the link: it ends 12 mm from the axis of joint 2" in text


def test_link_short_of_next_joint_warning(own_meshes: CellDescription, tmp_path: Path) -> None:
    stump = trimesh.creation.box((60, 60, 60), transform=trimesh.transformations.translation_matrix((-270, 0, 80)))
    stump.export(tmp_path / "stump.stl")
    changed = own_meshes.replace({"robot.joint[2].mesh": str(tmp_path / "stump.stl")})
    (text,) = setup_warnings(with_cell(changed))
    assert "stump.stl does not fit the link: it ends 240 mm from the axis of joint 3" in text


@pytest.mark.parametrize(("joint", "longer", "before"), [(1, 120, "the base"), (4, 90, "link 3")])
def test_gap_along_joint_axis_warning(own_meshes: CellDescription, joint: int, longer: float, before: str) -> None:
    """A larger d moves the link along the joint axis, away from the previous one."""
    d = own_meshes.robot.joint[joint - 1].d_mm + longer
    (text,) = setup_warnings(with_cell(own_meshes.replace({f"robot.joint[{joint}].d_mm": d})))
    found = re.search(r"gap of (\d+) mm between it and (.*) along the axis of joint (\d)", text)
    assert found is not None
    assert longer - 20 < int(found[1]) < longer + 10
    assert (found[2], int(found[3])) == (before, joint)


@pytest.mark.parametrize(
    "values",
    [
        {"tilt_deg": 42.0},
        {"tilt_deg": 15.0},
        {"tilt_deg": 31.0, "half_angle_deg": 3.0},
        {"height_mm": 75.0},
        {"baseline_mm": 110.0},
        {"height_mm": -60.0, "cy_px": 700.0},
    ],
)
def test_visible_range_fraction_matches_trapezoid(values: dict[str, float]) -> None:
    """Closed form: image rows map to z = b + a / tan(phi - atan(p_y / f)) on the sheet."""
    setup = load_setup()
    camera = setup.sensor.camera[1].replace(values)
    phi, f = np.radians(camera.tilt_deg), 512 / np.tan(np.radians(camera.half_angle_deg))
    # Rows grow towards larger range.
    p_y = np.array([-0.5, 1023.5]) - (511.5 if camera.cy_px is None else camera.cy_px)
    low, high = camera.height_mm + camera.baseline_mm / np.tan(phi - np.arctan(p_y / f))
    near, far = setup.sensor.range.near_mm, setup.sensor.range.far_mm
    share = (min(high, far) - max(low, near)) / (far - near)
    assert 0.02 < share < 0.5
    (text,) = warnings(*[f"sensor.camera[2].{key}={value}" for key, value in values.items()])
    assert text.startswith("sensor.camera[2] 'minus': sees the laser line in ")
    found = re.search(r"in (\d+)% of .* sees ([-\d.]+) mm to ([-\d.]+) mm", text)
    assert found is not None
    assert abs(int(found[1]) / 100 - share) < 0.011
    assert [float(found[2]), float(found[3])] == pytest.approx([low, high], abs=0.06)


def test_region_beside_the_measuring_range_is_named() -> None:
    both = ["sensor.camera[1].region_rows_px=[400, 400]", "sensor.camera[2].region_rows_px=[400, 400]"]
    assert [text[-46:] for text in warnings(*both)] == 2 * ["its region_rows_px and sensor.range must match"]
    assert warnings(*both, "sensor.range.near_mm=99", "sensor.range.far_mm=134", "scan.sweep.standoff_mm=110") == []
    with pytest.raises(DescriptionError, match=r"nowhere .* region_rows_px"):
        warnings("sensor.camera[1].region_rows_px=[0, 200]", "sensor.range.near_mm=110")


@pytest.mark.parametrize("words", [["tilt_deg=75"], ["height_mm=300"], ["tilt_deg=75", "distortion=[-1, 0, 0, 0, 0]"]])
def test_camera_without_view_is_rejected(words: list[str]) -> None:
    """Points that distortion folds into the image from outside the field of view do not count."""
    with pytest.raises(DescriptionError, match=r"sensor.camera\[1\] 'plus': sees the laser line nowhere .* tilt_deg"):
        warnings(*[f"sensor.camera[1].{word}" for word in words])


def test_camera_panned_out_of_laser_fan_is_rejected() -> None:
    with pytest.raises(DescriptionError, match="sees the laser line nowhere"):
        warnings("sensor.camera[1].pan_deg=10", "sensor.laser.fan_half_angle_deg=0.5", "sensor.camera[1].width_px=200")


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["sensor.detector.exposure_ms=9"], []),
        (["sensor.detector.exposure_ms=11"], ["scan.raster.pitch_mm"]),
        (["sensor.detector.exposure_ms=9", "sensor.detector.laser_off_frame=true"], ["scan.raster.pitch_mm"]),
        (["sensor.detector.exposure_ms=26"], ["scan.sweep.angle_step_deg", "scan.raster.pitch_mm"]),
        (["sensor.detector.exposure_ms=26", "scan.sweep.enabled=false"], ["scan.raster.pitch_mm"]),
        (["sensor.detector.exposure_ms=26", "scan.mode=stop-and-look"], []),
        (["sensor.detector.exposure_ms=26", 'scan.raster.pitch_mm="sensor"'], ["scan.sweep.angle_step_deg"]),
        (["sensor.detector.exposure_ms=26", 'scan.sweep.angle_step_deg="sensor"'], ["scan.raster.pitch_mm"]),
        (["sensor.detector.exposure_ms=26", "scan.pose=[{z_mm=100}]"], []),
        (
            ['sensor.detector.shutter="rolling"', "sensor.detector.row_readout_us=10"],
            ["scan.raster.pitch_mm"],
        ),
        (["scan.sweep.speed_deg_s=200"], ["scan.sweep.speed_deg_s = 200"]),
        (["scan.sweep.standoff_mm=70"], ["scan.sweep.standoff_mm = 70"]),
        (["scan.sweep.standoff_mm=165"], []),
    ],
)
def test_exposure_speed_and_standoff_warnings(words: list[str], expected: list[str]) -> None:
    found = warnings(*words)
    assert len(found) == len(expected)
    for text, start in zip(found, expected, strict=True):
        assert text.startswith(start)


@pytest.mark.parametrize(("pitch", "count"), [(0.001, 1), (0.5, 0)])
def test_sensor_paths_faster_than_the_sensor_give_a_warning(pitch: float, count: int) -> None:
    setup, path = load_setup(), PathDescription.default().replace({"pitch_mm": pitch})
    scan = setup.scan.model_copy(update={"path": (path,)})
    found = [line for line in setup_warnings(Setup(setup.cell, setup.sensor, scan)) if "path[1].pitch_mm" in line]
    assert len(found) == count


@pytest.mark.parametrize("sensor", sorted((assets_dir() / "sensors").glob("*.toml")), ids=lambda file: file.stem)
def test_default_standoff_is_in_the_nearer_half_of_the_measuring_range(sensor: Path) -> None:
    setup = load_setup(sensor=sensor)
    near, far = setup.sensor.range.near_mm, setup.sensor.range.far_mm
    standoff = 1e3 * scan_options(setup.scan, setup.sensor).standoff
    assert near < standoff <= (near + far) / 2
    assert not [text for text in setup_warnings(setup) if "standoff" in text]
