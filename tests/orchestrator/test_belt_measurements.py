"""Measurements of parts on a belt: recordings give the cloud of their scan, and the pose of a part is found."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from test_reconstruct_measurements import require_same, write_table

import scancell
from scancell.calibration.measured_table import MeasuredTable, write_measured_table
from scancell.cell.recording import slopes
from scancell.config.loading import load_resolved
from scancell.evaluation.alignment import PartPlacement, place_part
from scancell.geometry import pose
from scancell.geometry.mesh import box_mesh, sample_surface
from scancell.geometry.shapes import PartSurface, revolved_mesh
from scancell.views.recorded_run import open_run

ASSETS = scancell.assets_dir()
MACHINED = ASSETS / "parts/machined.stl"
POST = {"cell": ASSETS / "cells/belt_post.toml", "scan": ASSETS / "scans/belt_post.toml"}
ARM = {"cell": ASSETS / "cells/pick_and_place.toml", "scan": ASSETS / "scans/belt.toml"}
QUICK = {"scan.belt.pitch_mm": 3.0, "sensor.geometric.rays": 256, "scan.belt.speed_mm_s": 300.0}
TURNED = {"x_mm": -147.3, "y_mm": 6.4, "rz_deg": 37.0}


@cache
def scanned(on_post: bool = True, turned: bool = False) -> scancell.ScanResult:
    changes = QUICK | ({"cell.part.arrival.pose": TURNED} if turned else {})
    setup = scancell.load_setup(**(POST if on_post else ARM), settings=changes)
    with scancell.Scanner(setup=setup) as scanner:
        return scanner.scan(MACHINED, engine="geometric", seed=5)


def columns_of(result: scancell.ScanResult, *names: str) -> dict[str, np.ndarray]:
    """Positions, rates and accelerations of some axes by exposure, as tables name them."""
    measured = result.recording.measured
    acceleration = slopes(measured.rates, measured.time, measured.segment)
    found: dict[str, np.ndarray] = {"exposure": measured.index, "time_s": measured.time}
    for name in names:
        row, scale = measured.names.index(name), 1e3 if name.startswith("conveyor") else 180 / np.pi
        unit = "mm" if name.startswith("conveyor") else "deg"
        joint = name.removeprefix("joint[").removesuffix("]") if name.startswith("joint") else None
        of_position, of_rate, of_acceleration = (
            (f"q{joint}", f"qd{joint}", f"qdd{joint}") if joint else (name, f"{name}_rate", f"{name}_acceleration")
        )
        found[f"{of_position}_{unit}"] = scale * measured.axes[:, row]
        found[f"{of_rate}_{unit}_s"] = scale * measured.rates[:, row]
        found[f"{of_acceleration}_{unit}_s2"] = scale * acceleration[:, row]
    return found


@pytest.mark.parametrize("on_post", [True, False], ids=["post", "arm"])
def test_recording_gives_the_cloud_of_its_scan(on_post: bool, tmp_path: Path) -> None:
    result = scanned(on_post)
    table = write_table(result, tmp_path / "p.parquet", columns_of(result, *result.recording.measured.names))
    found = scancell.reconstruct(table, part=MACHINED, **(POST if on_post else ARM))
    require_same(found.cloud, result.cloud, 1e-9)
    assert found.data.made.dropped.as_json() == result.dropped.as_json()
    assert found.deviation is not None
    assert found.deviation.rms == pytest.approx(result.deviation.rms, rel=1e-4)


def test_joints_are_not_needed_where_no_sensor_moves_with_them(tmp_path: Path) -> None:
    result = scanned()
    table = write_table(result, tmp_path / "p.csv", columns_of(result, "conveyor[1]"))
    require_same(scancell.reconstruct(table, part=MACHINED, **POST).cloud, result.cloud, 1e-8)
    table = write_table(scanned(on_post=False), tmp_path / "arm.csv", columns_of(scanned(on_post=False), "conveyor[1]"))
    with pytest.raises(scancell.DescriptionError, match="neither joints nor flange poses"):
        scancell.reconstruct(table, part=MACHINED, **ARM)


def test_travel_is_the_pitch_where_no_encoder_is_recorded(tmp_path: Path) -> None:
    """The shape is that of the scan; its place along the belt is unknown, so that the part is located."""
    result = scanned()
    table = write_table(result, tmp_path / "p.parquet", columns_of(result))
    pitch = {"scan.belt.pitch_mm": 3.0}
    found = scancell.reconstruct(table, settings=pitch, **POST).cloud.points_in_part
    known = write_table(result, tmp_path / "known.parquet", columns_of(result, "conveyor[1]"))
    expected = scancell.reconstruct(known, **POST).cloud.points_in_part
    shift = found - expected
    np.testing.assert_allclose(shift, np.broadcast_to(shift[0], shift.shape), atol=2e-6)
    located = scancell.reconstruct(table, part=MACHINED, settings=pitch, locate=True, **POST)
    assert located.deviation is not None
    assert located.deviation.rms < 3e-6


def test_profiles_of_a_sensor_with_encoder_counts(tmp_path: Path) -> None:
    """A format of one's own states the counts of the belt's encoder as y."""
    result = scanned()
    profiles, travel = result.profiles, 1e3 * result.recording.measured.axes[:, -1]
    points = 1e3 * np.asarray(profiles.points_in_sensor, float)
    counts = {"Profile": profiles.frame + 1, "Encoder": travel[profiles.frame] / 0.0125}
    write_measured_table(tmp_path / "log.csv", counts | {"X": points[:, 1], "Z": points[:, 2]})
    (tmp_path / "log.toml").write_text(
        '[format]\nname = "belt log"\nlayout = "points"\nprofile_column = "Profile"\nx = { column = "X" }\n'
        'y = { column = "Encoder", scale_mm = 0.0125 }\nz = { column = "Z" }\n'
    )
    found = scancell.reconstruct(tmp_path / "log.csv", table_format=tmp_path / "log.toml", part=MACHINED, **POST)
    np.testing.assert_allclose(found.cloud.points_in_part, result.cloud.points_in_part, atol=1e-8)


def test_a_cloud_states_no_travel(tmp_path: Path) -> None:
    (tmp_path / "cloud.csv").write_text("Info\n1,2\nY\\X,0.0,10.0\n0.0,1.0,2.0\n5.0,4.0,6.0\nEnd\n")
    with pytest.raises(scancell.DescriptionError, match="states no travel of the belt"):
        scancell.reconstruct(tmp_path / "cloud.csv", part=MACHINED, **ARM)


def test_a_part_that_lies_elsewhere_is_located(tmp_path: Path) -> None:
    """The description places the part 37 + 90 deg and several mm away from where it lies."""
    result = scanned(turned=True)
    table = write_table(result, tmp_path / "p.parquet", columns_of(result, "conveyor[1]"))
    described = scancell.reconstruct(table, part=MACHINED, **POST)
    assert any("`locate` finds its pose" in warning for warning in described.warnings)
    found = scancell.reconstruct(table, part=MACHINED, locate=True, **POST)
    placement, true = found.placement, scancell.location(-0.1473, 0.0064, 0.0, rz=np.radians(37.0))
    assert placement is not None
    assert found.deviation is not None
    error = pose.inverse(true) @ placement.support_from_part
    assert np.linalg.norm(error[:3, 3]) < 2e-6
    assert np.degrees(np.linalg.norm(pose.log_rotation(error[:3, :3]))) < 0.002
    assert found.deviation.rms == pytest.approx(result.deviation.rms, rel=0.01)
    assert not found.warnings
    stated = found.figures["part_placement"]
    assert stated["frame"] == "conveyor[1]"
    assert stated["pose"]["rz_deg"] == pytest.approx(37.0, abs=0.002)
    assert not stated["is_ambiguous"]
    # The run folder holds the description with the pose found: it gives the same cloud without a search.
    found.save(tmp_path / "run")
    resolved = tmp_path / "run/resolved.toml"
    assert load_resolved(resolved)[0].cell.part.arrival.pose.y_mm == pytest.approx(6.4, abs=0.002)
    again = scancell.reconstruct(tmp_path / "run/points.parquet", part=MACHINED, cell=resolved, scan=resolved)
    np.testing.assert_allclose(again.cloud.points_in_part, found.cloud.points_in_part, atol=1e-9)
    shown = open_run(tmp_path / "run")
    assert shown.cloud is not None
    first = result.recording.measured.time[0]
    assert shown.motion.frames(first)["part"] == pytest.approx(result.recording.truth_at_middle("part[1]")[0], abs=5e-6)


def test_a_part_on_the_table_is_located(tmp_path: Path) -> None:
    place = {"cell.part.x_mm": 4.0, "cell.part.y_mm": -3.0, "cell.part.rz_deg": 101.0}
    with scancell.Scanner(settings={"scan.max_profiles": 60, "sensor.geometric.rays": 256, **place}) as scanner:
        result = scanner.scan(MACHINED, engine="geometric", seed=1)
    names = result.recording.measured.names
    table = write_table(result, tmp_path / "p.parquet", columns_of(result, *names))
    found = scancell.reconstruct(table, part=MACHINED, locate=True)
    assert found.deviation is not None
    assert found.deviation.rms < 3e-6
    part = found.setup.cell.part
    np.testing.assert_allclose([part.x_mm, part.y_mm, part.z_mm], [4.0, -3.0, 0.0], atol=5e-3)
    assert part.rz_deg == pytest.approx(101.0, abs=5e-3)


def test_what_is_located_needs_a_part(tmp_path: Path) -> None:
    table = write_table(scanned(), tmp_path / "p.parquet", columns_of(scanned(), "conveyor[1]"))
    with pytest.raises(scancell.DescriptionError, match=r"locate.*`part`"):
        scancell.reconstruct(table, locate=True, **POST)


def test_damaged_travel_is_named(tmp_path: Path) -> None:
    table = write_table(scanned(), tmp_path / "p.parquet", columns_of(scanned(), "conveyor[1]"))
    read = MeasuredTable(table)
    columns = {name: read.numbers(name).copy() for name in read.names}
    columns["conveyor[1]_mm"][7] = np.nan
    write_measured_table(tmp_path / "broken.csv", columns)
    with pytest.raises(scancell.DescriptionError, match=r"conveyor\[1\]_mm', row 8"):
        scancell.reconstruct(tmp_path / "broken.csv", part=MACHINED, **POST)


def seen_from_above(part: scancell.Mesh, count: int, seed: int, noise: float) -> np.ndarray:
    """Points (n, 3) of the surface that faces upwards, with noise along its normals, m."""
    points, face = sample_surface(part, 4 * count, seed)
    normals = part.normals[face]
    rows = np.flatnonzero(normals[:, 2] > 0.3)[:count]
    return points[rows] + normals[rows] * np.random.default_rng(seed).normal(0.0, noise, (len(rows), 1))


def place(part: scancell.Mesh, points: np.ndarray, true: np.ndarray, nominal: np.ndarray) -> PartPlacement:
    surface = PartSurface(part)
    on_support = pose.transform_points(true, points)
    return place_part(on_support, lambda at: surface.nearest(at, 1), part.bounds, "conveyor[1]", nominal)


@pytest.mark.parametrize("name", ["free_form", "machined"])
@pytest.mark.parametrize("turn", range(3))
def test_any_turn_is_found_from_above(name: str, turn: int) -> None:
    part = scancell.load_part(ASSETS / f"parts/{name}.stl")
    rng = np.random.default_rng(turn)
    true = scancell.location(*rng.uniform(-0.03, 0.03, 2), 0.0, rz=rng.uniform(-np.pi, np.pi))
    points = seen_from_above(part, 5000, turn, 5e-6)
    found = place(part, points, true, scancell.location(-0.15, 0.0, 0.0, rz=-np.pi / 2))
    error = found.support_from_part @ pose.inverse(true)
    errors = np.concatenate([found.support_from_part[:3, 3] - true[:3, 3], pose.log_rotation(error[:3, :3])])
    assert np.linalg.norm(errors[:3]) < 10e-6
    assert np.degrees(np.linalg.norm(errors[3:])) < 0.01
    assert found.determined.all()
    assert np.abs(errors / found.sigmas).max() < 5.0
    assert not found.warnings


def test_stated_standard_deviations_are_those_of_the_errors() -> None:
    part = scancell.load_part(MACHINED)
    scaled = []
    for seed in range(12):
        true = scancell.location(0.01, 0.002, 0.0, rz=0.3)
        found = place(part, seen_from_above(part, 1500, seed, 20e-6), true, true)
        turn = pose.log_rotation(found.support_from_part[:3, :3] @ true[:3, :3].T)
        scaled.append(np.concatenate([found.support_from_part[:3, 3] - true[:3, 3], turn]) / found.sigmas)
    assert np.sqrt(np.mean(np.square(scaled))) == pytest.approx(1.0, abs=0.3)


def test_another_face_may_be_down() -> None:
    part = scancell.load_part(MACHINED)
    lying = part.transformed(scancell.location(0.0, 0.0, 0.0, rx=np.pi / 2))
    points = seen_from_above(lying, 5000, 2, 5e-6)
    true = scancell.location(0.02, -0.01, 0.03, rz=2.0)
    found = place(part, points, true, np.eye(4))
    error = pose.inverse(true @ scancell.location(0.0, 0.0, 0.0, rx=np.pi / 2)) @ found.support_from_part
    assert np.linalg.norm(error[:3, 3]) < 10e-6
    assert np.degrees(np.linalg.norm(pose.log_rotation(error[:3, :3]))) < 0.01


def test_symmetric_parts_are_said_to_be_ambiguous() -> None:
    box = box_mesh((0.04, 0.03, 0.02), "box").transformed(pose.translation((0.0, 0.0, 0.01)))
    points = sample_surface(box, 4000, 0)[0]
    found = place(box, points[points[:, 2] > 1e-4], np.eye(4), np.eye(4))
    assert len(found.others) == 1
    assert found.as_json()["is_ambiguous"]
    assert "turned by 180.0 deg" in found.warnings[0]
    disc = revolved_mesh(np.array([[0.0, 0.0], [0.02, 0.0], [0.02, 0.01], [0.0, 0.01]]), 96, "disc")
    points = sample_surface(disc, 4000, 0)[0]
    assert len(place(disc, points[points[:, 2] > 1e-4], np.eye(4), np.eye(4)).others) >= 5


def test_what_a_plane_does_not_determine_is_not_stated() -> None:
    box = box_mesh((0.04, 0.03, 0.02), "box").transformed(pose.translation((0.0, 0.0, 0.01)))
    points = sample_surface(box, 4000, 0)[0]
    top = points[(points[:, 2] > 0.0199) & (np.abs(points[:, :2]) < 0.01).all(1)]
    found = place(box, top, np.eye(4), np.eye(4))
    assert found.determined.tolist() == [False, False, True, True, True, False]
    assert found.as_json()["standard_deviation"]["x_mm"] is None
    assert found.as_json()["standard_deviation"]["z_mm"] is not None
    assert replace(found, others=()).text().count("not determined") == 3


def test_points_of_another_part_are_doubted() -> None:
    part, other = box_mesh((0.04, 0.03, 0.02), "box"), scancell.load_part(ASSETS / "parts/sphere_on_foot.stl")
    found = place(part, seen_from_above(other, 500, 0, 0.0), np.eye(4), np.eye(4))
    assert any("are these points of the part" in warning for warning in found.warnings)
    with pytest.raises(scancell.ScancellError, match=r"at least 6"):
        place(part, np.zeros((5, 3)), np.eye(4), np.eye(4))
