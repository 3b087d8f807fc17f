"""Scans of a part on a moving belt: a roof of known shape, whose slopes show errors along the travel."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

import scancell
from scancell.evaluation.deviation import deviation_from_mesh
from scancell.scanning.pipeline import ScanPipeline
from scancell.views.recorded_run import open_run

Array = NDArray[np.float64]

LENGTH, WIDTH, HEIGHT = 0.02, 0.03, 0.006  # m: base along the belt, across it, height of the ridge
START, SENSOR = -0.03, -0.012  # m: the middle of the roof on the belt at the start, and the sensor
PITCH = 0.2e-3
MAX_SPEED_MM_S = 500.0
SETTINGS = {
    "cell.part.arrival.pose": {"x_mm": 1e3 * START},
    "scan.belt": {
        "pose": {"x_mm": 1e3 * SENSOR, "z_mm": 95.0, "rx_deg": 180.0},
        "pitch_mm": 1e3 * PITCH,
        "speed_mm_s": 50.0,
    },
}


def roof() -> scancell.Mesh:
    """A roof: two slopes that rise along ±x to a ridge along y, on the plane z = 0."""
    x, y = LENGTH / 2, WIDTH / 2
    vertices = [[-x, -y, 0], [x, -y, 0], [x, y, 0], [-x, y, 0], [0, -y, HEIGHT], [0, y, HEIGHT]]
    faces = [[0, 2, 1], [0, 3, 2], [0, 1, 4], [2, 3, 5], [1, 2, 5], [1, 5, 4], [3, 0, 4], [3, 4, 5]]
    return scancell.Mesh(np.array(vertices, float), np.array(faces), "roof")


ROOF = roof()


CELL = "assets/cells/pick_and_place.toml"


def make_scanner(**settings: Any) -> scancell.Scanner:
    return scancell.Scanner(CELL, settings=SETTINGS | settings, ideal=True)


@cache
def shared() -> scancell.Scanner:
    """One FMU instance for all scans."""
    return scancell.Scanner()


@pytest.fixture(scope="module", autouse=True)
def closed() -> Iterator[None]:
    yield
    shared().close()
    shared.cache_clear()


def scan(changes: dict[str, Any] | None = None, ideal: bool = True, **more: Any) -> scancell.ScanResult:
    setup = scancell.load_setup(CELL, settings=SETTINGS | (changes or {}), ideal=ideal)
    return shared().scan(ROOF, engine="geometric", normals=False, setup=setup, **more)


def slopes(points_in_part: Array) -> tuple[float, float]:
    """Where the two slopes are at half the height: x (m) of straight lines through their points."""
    inside = (points_in_part[:, 2] > 0.1 * HEIGHT) & (points_in_part[:, 2] < 0.9 * HEIGHT)
    x, _, z = points_in_part[inside].T
    middle = (x.min() + x.max()) / 2
    lower, upper = (np.polyfit(z[side] - HEIGHT / 2, x[side], 1)[1] for side in (x < middle, x > middle))
    return float(lower), float(upper)


def spacing(result: scancell.ScanResult) -> Array:
    return np.diff(result.recording.measured.axes[:, -1])


@pytest.mark.parametrize(
    "changes",
    [
        pytest.param(
            {"scan.belt.speed_mm_s": 2.0, "cell.conveyor[1].max_speed_mm_s": 2000.0, "scan.belt.pose.x_mm": -17.0},
            id="0.1 % of the largest speed",
        ),
        pytest.param({"scan.belt.speed_mm_s": 50.0}, id="constant speed"),
        pytest.param(
            {
                "scan.belt.speed_mm_s": MAX_SPEED_MM_S,
                "scan.belt.pose.x_mm": 30.0,
                "cell.conveyor[1].max_acceleration_mm_s2": 5000.0,
            },
            id="largest speed",
        ),
        pytest.param({"scan.belt.speed_mm_s": MAX_SPEED_MM_S}, id="acceleration"),
    ],
)
def test_moving_part_is_undistorted_at_any_speed(changes: dict[str, Any]) -> None:
    result = scan(changes)
    speed = 1e-3 * changes["scan.belt.speed_mm_s"]
    np.testing.assert_allclose(spacing(result), PITCH, atol=1e-6 * speed + 1e-7)
    assert len(result.recording) > LENGTH / PITCH
    assert result.deviation.figures.max_abs < 1.5e-6
    np.testing.assert_allclose(slopes(result.cloud.points_in_part), [-LENGTH / 4, LENGTH / 4], atol=1e-6)


def test_speed_of_the_scan_on_an_accelerating_belt_changes() -> None:
    """The case above is one of acceleration."""
    rates = scan({"scan.belt.speed_mm_s": MAX_SPEED_MM_S}).recording.measured.rates[:, -1]
    assert rates[-1] > 2 * rates[0]
    assert np.all(np.diff(rates) > 0)


def test_encoder_scale_error_stretches_and_shifts_the_cloud() -> None:
    """An encoder that reads 1 % more: lengths along the belt, and the travel up to the part, are 1 % longer."""
    result = scan(as_built={"belt.encoder_scale": 0.01})
    lower, upper = slopes(result.cloud.points_in_part)
    assert upper - lower == pytest.approx(1.01 * LENGTH / 2, rel=2e-4)
    travel = SENSOR - START
    assert (lower + upper) / 2 == pytest.approx(-0.01 * travel, rel=0.01)
    assert np.ptp(result.cloud.points_in_part[:, 1]) == pytest.approx(WIDTH, abs=4e-4)  # across: unchanged


def test_encoder_resolution_limits_the_places_of_the_profiles() -> None:
    coarse = scan({"cell.conveyor[1].encoder_resolution_mm": 0.1})
    travel = coarse.recording.measured.axes[:, -1]
    np.testing.assert_allclose(np.diff(travel), PITCH, atol=1e-9)
    slope = 2 * HEIGHT / LENGTH
    normal_error = 0.05e-3 * np.sin(np.arctan(slope))  # half a count along the belt
    assert 0.5 * normal_error < coarse.deviation.figures.max_abs < 1.1 * normal_error


def test_noise_is_that_of_a_scan_of_the_standing_part() -> None:
    """The same profiles by a pass of the arm over the part on the table; both without the errors of joint encoders."""
    exact = {f"cell.robot.joint[{i}].encoder_{key}_deg": 0.0 for i in range(1, 7) for key in ("resolution", "noise")}
    moving = scan(exact, ideal=False)
    raster = {"scan.sweep.enabled": False, "scan.sweep.standoff_mm": 1e3 * (0.095 - HEIGHT)}
    with scancell.Scanner(settings=exact | raster | {"scan.raster.pitch_mm": 1e3 * PITCH}) as scanner:
        still = scanner.scan(ROOF, engine="geometric", normals=False)
    on_slopes = [result.cloud.points_in_part[:, 2] > 0.1 * HEIGHT for result in (moving, still)]
    first, second = (r.deviation.distance[rows] for r, rows in zip((moving, still), on_slopes, strict=True))
    assert first.std() == pytest.approx(second.std(), rel=0.03)
    assert abs(first.mean() - second.mean()) < 0.05e-6


def test_cloud_states_its_frame(tmp_path: Any) -> None:
    trimesh.Trimesh(1e3 * ROOF.vertices, ROOF.faces).export(tmp_path / "roof.stl")
    with make_scanner(**{"scan.belt.pitch_mm": 1.0}) as scanner:
        result = scanner.scan(tmp_path / "roof.stl", engine="geometric")
    result.save(tmp_path / "run", frame="belt")
    with (tmp_path / "run" / "cloud.ply").open("rb") as file:
        assert b"comment frame belt (moves with conveyor[1])" in file.read(400)
    shown = open_run(tmp_path / "run")
    assert shown.cloud is not None
    np.testing.assert_allclose(slopes(shown.cloud.points_in_part), slopes(result.cloud.points_in_part), atol=2e-6)
    middle = len(result.recording) // 2
    time, true = result.recording.measured.time[middle], result.recording.truth_at_middle("part[1]")[middle]
    np.testing.assert_allclose(shown.motion.frames(time)["part"], true, atol=1e-9)
    on_belt, in_world = result.points_in("belt"), result.points_in("world")
    np.testing.assert_allclose(on_belt, result.cloud.points_in_part + np.array([START, 0, 0]), atol=1e-12)
    world_from_belt = scancell.location(0.37, -0.435, 0.1, rz=np.pi / 2)
    np.testing.assert_allclose(in_world, on_belt @ world_from_belt[:3, :3].T + world_from_belt[:3, 3], atol=1e-12)
    with pytest.raises(scancell.DescriptionError, match="expected part, belt, base or world"):
        result.points_in("table")
    assert "points on the belt" in result.summary()
    assert result.figures["coverage"] is None
    assert 0.3 < result.coverage.surface_fraction < 0.7


def test_saved_plan_gives_the_same_cloud(tmp_path: Any) -> None:
    with make_scanner(**{"scan.belt.pitch_mm": 1.0}) as scanner:
        plan = scanner.plan(ROOF)
        again = scancell.Plan.load(plan.save(tmp_path / "plan.json"))
        scans = [scanner.scan(ROOF, engine="geometric", plan=one) for one in (plan, again)]
    np.testing.assert_array_equal(scans[0].cloud.points_in_part, scans[1].cloud.points_in_part)
    assert len(scans[0].recording) == pytest.approx(len(plan.segment), abs=2)  # they begin with a controller cycle


def test_plan_with_a_belt_that_runs_away_is_refused(tmp_path: Any) -> None:
    with make_scanner(**{"scan.belt.pitch_mm": 1.0}) as scanner:
        file = scanner.plan(ROOF).save(tmp_path / "plan.json")
    text = file.read_text()
    for old, new, message in (
        ('"speed": 0.05', '"speed": -0.05', "a speed that leads from trigger_from to trigger_to"),
        ('"kind": "belt_travel"', '"kind": "time"', "expected belt where trigger.kind"),
    ):
        assert text.count(old) == 1
        file.write_text(text.replace(old, new))
        with pytest.raises(scancell.DescriptionError, match=message):
            scancell.Plan.load(file)


def test_reconstruction_uses_no_truth() -> None:
    with make_scanner(**{"scan.belt.pitch_mm": 1.0}) as scanner:
        result = scanner.scan(ROOF, engine="geometric")
        blind = result.recording.without_truth()
        cloud, _ = scanner.pipeline.reconstruct(result.world.estimated, blind, result.profiles, result.setup)
    np.testing.assert_array_equal(cloud.points_in_part, result.cloud.points_in_part)


def test_moving_arm_over_a_moving_belt_gives_the_same_shape() -> None:
    """The sensor passes over the part, which moves on with the belt."""
    world_from_belt = scancell.location(0.37, -0.435, 0.1, rz=np.pi / 2)
    start, end = (world_from_belt @ scancell.location(x, 0.0, 0.095, rx=np.pi) for x in (-0.05, 0.03))
    with make_scanner() as scanner, scanner.session(ROOF) as session:
        session.move_tool(start)
        session.run_conveyor(1, 0.02)
        cloud = session.scan_line(end, 2 * PITCH, engine="geometric")
        travelled = session.conveyor_travel(1)
        session.move_tool(world_from_belt @ scancell.location(START + travelled, 0.0, 0.095, rx=np.pi))
        profile = session.profile("geometric").points_in_part
    assert travelled > 0.005
    on_roof = profile[profile[:, 2] > 0.1 * HEIGHT]
    assert len(on_roof) > 100
    np.testing.assert_allclose(on_roof[:, 2], HEIGHT * (1 - 2 * np.abs(on_roof[:, 0]) / LENGTH), atol=3e-6)
    assert deviation_from_mesh(cloud, ROOF).figures.max_abs < 3e-6
    np.testing.assert_allclose(slopes(cloud.points_in_part), [-LENGTH / 4, LENGTH / 4], atol=2e-6)


def test_part_that_has_passed_is_refused() -> None:
    def bring(session: scancell.CellSession) -> None:
        session.run_conveyor(1, 0.05)
        session.wait(1.0)
        session.run_conveyor(1, 0.0)
        session.wait(0.2)

    with pytest.raises(scancell.CommandError, match=r"travelled 4.* mm beyond the first exposure"):
        scan(hook=bring)


def test_belt_may_run_backwards() -> None:
    changes = {"scan.belt.speed_mm_s": -50.0, "scan.belt.pose.x_mm": 1e3 * (2 * START - SENSOR)}
    result = scan(changes)
    np.testing.assert_allclose(spacing(result), -PITCH, atol=2e-7)
    assert result.deviation.figures.max_abs < 1.5e-6


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"scan.mode": "stop-and-look"}, 'needs mode = "dynamic"'),
        ({"scan.belt.speed_mm_s": 0.0}, "expected a speed other than 0"),
        ({"scan.belt.speed_mm_s": 501.0}, "scan.belt.speed_mm_s = 501.*at most 500"),
        ({"scan.belt.pose.x_mm": -40.0}, "the part starts .* mm beyond the laser sheet"),
        ({"scan.belt.pose.x_mm": 300.0}, "the part leaves the belt"),
        ({"scan.belt.pose.rz_deg": 90.0}, "the laser sheet is 0.0 deg from the direction of travel"),
        ({"scan.belt.pose.z_mm": 5.0}, "scan.belt.pose.*part"),
        ({"scan.pose": [{"z_mm": 100.0}]}, "give either belt or pose"),
    ],
)
def test_impossible_scans_are_refused(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(scancell.ScancellError, match=message), make_scanner(**changes) as scanner:
        scanner.plan(ROOF)


def test_part_on_the_table_is_refused() -> None:
    message = r"cell.part.arrival.*scan on a belt.*conveyor"
    with pytest.raises(scancell.DescriptionError, match=message):
        scancell.scan(ROOF, engine="geometric", settings={"scan.belt": SETTINGS["scan.belt"]})


def test_larger_spacing_is_reported() -> None:
    with make_scanner(**{"scan.max_profiles": 20}) as scanner:
        plan = scanner.plan(ROOF)
    assert len(plan.segment) <= 20
    assert any("scan.belt.pitch_mm is increased" in warning for warning in plan.warnings)


def test_normals_of_a_cloud_made_in_parts_are_those_of_the_whole() -> None:
    """As a live scan makes it: the sensor passes in the frame of the part, not in that of the table."""
    setup = scancell.load_setup(CELL, settings=SETTINGS | {"scan.belt.pitch_mm": 1.0}, ideal=True)
    whole = shared().scan(ROOF, engine="geometric", setup=setup)
    bare = replace(whole.cloud, normals=np.full_like(whole.cloud.normals, np.nan))
    with ScanPipeline() as pipeline:
        cloud = pipeline.with_normals(whole.nominal, whole.recording, bare)
    assert np.isfinite(cloud.normals).mean() > 0.9
    np.testing.assert_allclose(cloud.normals, whole.cloud.normals, atol=1e-12)


def test_belt_carries_the_part_past_a_sensor_on_a_post() -> None:
    folder, part = scancell.assets_dir(), scancell.assets_dir() / "parts/free_form.stl"
    setup = scancell.load_setup(folder / "cells/belt_post.toml", scan=folder / "scans/belt_post.toml", ideal=True)
    with scancell.Scanner(setup=setup) as scanner:
        result = scanner.scan(part, engine="geometric").evaluate()
    assert len(result.cloud) > 100_000
    assert result.deviation.rms < 0.1e-6
    measured = result.recording.measured
    assert np.ptp(measured.axes[:, : len(result.nominal.home) + 1], axis=0).max() == 0.0


@pytest.mark.parametrize(
    ("cell", "scan", "message"),
    [("belt_post", "belt", "not on the arm"), ("pick_and_place", "belt_post", "is on the arm.*expected a pose")],
)
def test_pose_over_the_belt_is_stated_where_the_arm_carries_the_sensor(cell: str, scan: str, message: str) -> None:
    folder = scancell.assets_dir()
    setup = scancell.load_setup(folder / f"cells/{cell}.toml", scan=folder / f"scans/{scan}.toml")
    with (
        scancell.Scanner(setup=setup) as scanner,
        pytest.raises(scancell.DescriptionError, match=rf"scan\.belt\.pose.*{message}"),
    ):
        scanner.plan(folder / "parts/free_form.stl")


def test_track_carries_the_arm_to_a_belt_out_of_reach() -> None:
    track = {"name": "track", "kind": "prismatic", "along": "y", "min_mm": -900.0, "max_mm": 100.0}
    track |= {"max_speed_mm_s": 500.0, "max_acceleration_mm_s2": 1000.0}
    far = {"cell.axis": [track], "cell.robot_moves_with": "track", "cell.conveyor[1].pose.y_mm": -1135.0}
    result = scan(far | {"scan.axis": [{"name": "track", "step_mm": 350.0}], "scan.belt.pitch_mm": 1.0})
    measured = result.recording.measured
    assert measured.axes[:, measured.names.index("track")] == pytest.approx(-0.7, abs=1e-9)
    assert result.evaluate().deviation.rms < 0.1e-6
    with pytest.raises(scancell.PlanningError, match="out of the arm's reach"):
        scan(far)
