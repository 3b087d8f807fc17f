"""Several sensors in a cell: descriptions, scans without error by each, noise of their own, files, guard, studies."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet
import pytest
from cells import cell_file
from scipy.spatial.transform import Rotation

import scancell
from scancell import (
    CalibrationError,
    CalibrationRequest,
    CameraFeed,
    Cloud,
    DescriptionError,
    EstimatedDescription,
    LiveCell,
    LiveScan,
    Scanner,
    ScanResult,
    assets_dir,
    load_setup,
    nominal_cell,
)
from scancell.geometry import pose
from scancell.geometry.shapes import PartSurface
from scancell.live.camera import CameraFrame
from scancell.live.scan import LiveChunk
from scancell.output.image_files import ImageSet
from scancell.progress import NullProgress, Stopwatch
from scancell.proximity.scene import arm_chain
from scancell.scanning.scan import Scan
from scancell.scanning.sense import expose
from scancell.scanning.session import guard_of
from scancell.scanning.world import still_exposures

PART = assets_dir() / "parts/machined.stl"  # asymmetric
FEW = {"scan.max_profiles": 60}
PRESETS = assets_dir() / "sensors"
# On the flange beside the main one, on the third link, on the table, on a post, and on a track; all see the part.
MOUNTS = """
[[axis]]
name = "track"
kind = "prismatic"
along = "y"
pose = { x_mm = 450.0, y_mm = 260.0 }
min_mm = -100.0
max_mm = 100.0
start_mm = 20.0
max_speed_mm_s = 300.0
max_acceleration_mm_s2 = 600.0

[[further_sensor]]
name = "beside"
moves_with = "link[6]"
pose = { x_mm = 30.0, y_mm = 4.0, z_mm = 85.0, ry_deg = -12.0, rz_deg = 8.0 }

[[further_sensor]]
name = "rider"
moves_with = "table"
pose = { x_mm = 100.0, y_mm = 12.0, z_mm = 60.0, ry_deg = -115.0 }

[[further_sensor]]
name = "post"
sensor = "PRESETS/medium_range_50.toml"
pose = { x_mm = 450.0, y_mm = -62.0, z_mm = 190.0, rx_deg = -140.0 }

[[further_sensor]]
name = "carriage"
sensor = "PRESETS/long_range_400.toml"
moves_with = "track"
pose = { y_mm = 150.0, z_mm = 420.0, rx_deg = 127.0, rz_deg = 10.0 }
delay_ms = 1.5
"""
# The presets have what a calibration leaves.
EXACT = {f"cell.further_sensor[{number}].sensor.laser.straightness_mrad": [] for number in (3, 4)}


def mounts(folder: Path, text: str = MOUNTS) -> Path:
    return cell_file(folder, text.replace("PRESETS", str(PRESETS)))


def twins() -> scancell.CellDescription:
    """The default cell with a second sensor exactly where the first one is, and encoders without error."""
    twin = {"name": "twin", "moves_with": "link[6]", "pose": {"z_mm": 80.0}}
    joints = {f"robot.joint[{number}].encoder_resolution_deg": 0.0 for number in range(1, 7)}
    return load_setup().cell.replace({"further_sensor": [twin], "table.encoder_resolution_deg": 0.0, **joints})


def rms(result: ScanResult, number: int) -> float:
    return float(np.sqrt(np.mean(result.deviation.distance[result.cloud.sensor == number] ** 2)))


@pytest.fixture(scope="module")
def sample() -> Iterator[ScanResult]:
    """The sample cell, with noise and motion, sensed geometrically."""
    with Scanner(assets_dir() / "cells/two_sensors.toml", settings=FEW, threads=1) as scanner:
        yield scanner.scan(PART, engine="geometric", seed=5)


def test_each_sensor_measures_an_asymmetric_part_without_error_wherever_it_is_mounted(tmp_path) -> None:
    with Scanner(mounts(tmp_path), settings={"scan.max_profiles": 150, **EXACT}, ideal=True) as scanner:
        result = scanner.scan(PART, engine="geometric")
    assert result.sensor_names == ("two_camera_probe", "beside", "rider", "post", "carriage")
    for number in range(1, 6):
        assert (result.cloud.sensor == number).sum() > 2000, number
        assert rms(result, number) < 0.1e-6, number
    assert result.deviation.rms < 0.1e-6
    assert {name: one.count for name, one in result.by_sensor.items()} == {
        name: int((result.cloud.sensor == number).sum()) for number, name in enumerate(result.sensor_names, 1)
    }
    # What the arm carries is seen by sensors that it does not carry, and removed by nominal geometry.
    assert sum(result.dropped.foreign.get(name, 0) for name in arm_chain(result.nominal)) > 100


def test_ray_traced_clouds_of_two_sensors_on_the_flange_agree_with_the_part() -> None:
    beside = {
        "name": "beside", "moves_with": "link[6]",
        "pose": {"x_mm": 30.0, "z_mm": 85.0, "ry_deg": -12.0, "rz_deg": 8.0},
    }  # fmt: skip
    cell = load_setup().cell.replace({"further_sensor": [beside]})
    with Scanner(cell, settings={"scan.max_profiles": 40}, ideal=True) as scanner:
        result = scanner.scan(assets_dir() / "parts/free_form.stl")
    for number in (1, 2):
        assert (result.cloud.sensor == number).sum() > 10_000
        assert rms(result, number) < 2e-6, number
    assert result.deviation.rms < 2e-6
    assert sorted({(one.sensor, one.images.shape) for one in result.sample_images}) == [
        (1, (2, 1024, 1280)), (2, (2, 1024, 1280)),
    ]  # fmt: skip


@pytest.mark.parametrize("engine", ["geometric", "ray-traced"])
def test_noise_of_two_sensors_at_one_place_is_independent_and_of_the_stated_size(engine: str) -> None:
    with Scanner(twins(), settings={"scan.max_profiles": 26}) as scanner:
        noisy = scanner.scan(assets_dir() / "artefacts/plane.toml", engine=engine, seed=3)
    with Scanner(setup=load_setup(twins(), settings={"scan.max_profiles": 26}, ideal=True)) as scanner:
        exact = scanner.scan(assets_dir() / "artefacts/plane.toml", engine="geometric", seed=3)
    first, second = (exact.profiles.points_in_sensor[exact.profiles.sensor == number] for number in (1, 2))
    assert np.array_equal(first, second)
    cloud, distance = noisy.cloud, noisy.deviation.distance
    keys = cloud.profile.astype(np.int64) * 100_000 + cloud.camera * 10_000 + cloud.column
    own = [np.flatnonzero(cloud.sensor == number) for number in (1, 2)]
    _, a, b = np.intersect1d(keys[own[0]], keys[own[1]], return_indices=True)
    pair = np.stack([distance[own[0][a]], distance[own[1][b]]])
    assert len(a) > 5000
    # Errors of the poses, here none, would be common to both.
    assert abs(np.corrcoef(pair)[0, 1]) < 0.05
    # Standard deviations are stated along the direction of the largest one, the sensor's z within the triangulation.
    sigma = np.stack([np.asarray(cloud.sigma, float)[own[0][a]], np.asarray(cloud.sigma, float)[own[1][b]]])
    ratio = (pair / sigma).std(axis=1)
    assert ratio == pytest.approx([ratio[0]] * 2, rel=0.05)
    assert ratio.min() > 0.7 and ratio.max() < 1.1


def test_normalised_residuals_of_each_sensor_and_of_all_are_near_one(tmp_path) -> None:
    """Distances from the part over their standard deviations by the covariances of the points."""
    pooled = []
    with Scanner(mounts(tmp_path), settings=EXACT) as scanner:
        world = scanner._world(PART, "mm", seed=8)
        nominal, surface = world.nominal, PartSurface(world.nominal.part)
        axes = nominal.with_further_axes(np.array([[*nominal.home, turn] for turn in np.linspace(0, 6, 40)]))
        above = pose.translation((0.0, 0.0, 0.12)) @ np.diag([1.0, -1.0, -1.0, 1.0])
        q = nominal.arm.ik(nominal.world_from_table @ above @ pose.inverse(nominal.flange_from_sensor))
        axes[:, :6] = q[np.isfinite(q).all(-1)][0]
        frames, index = nominal.frame_poses(axes), np.arange(1, len(axes) + 1)
        for one in world.sensors:
            taken = still_exposures(frames, one.bodies, index, one.windows[:, 1], one.frame)
            seen = expose(one.scene, one.sensor, one.sensor_true, taken, index, "geometric", covariance=True)
            part_from_sensor = (pose.inverse(frames["part"]) @ frames[one.frame])[seen.points.frame]
            points = pose.transform_each(part_from_sensor, seen.points.points_in_sensor)
            distance, face = surface.distances(points)
            normal = np.einsum("nji,nj->ni", part_from_sensor[:, :3, :3], nominal.part.normals[face])
            assert seen.covariance is not None
            sigma = np.sqrt(np.einsum("ni,nij,nj->n", normal, seen.covariance, normal))
            # Points of the table and of the arm are beyond it; beside edges the nearest face is another one.
            own = (np.abs(distance) < 6 * sigma) & (sigma > 0.2 * np.asarray(seen.points.sigma))
            assert own.sum() > 500, one.name
            pooled.append((distance / sigma)[own])
            assert np.sqrt(np.mean(pooled[-1] ** 2)) == pytest.approx(1.0, abs=0.1), one.name
    assert np.sqrt(np.mean(np.concatenate(pooled) ** 2)) == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize("engine", ["geometric", "ray-traced"])
def test_cloud_does_not_depend_on_truth_after_rendering_or_on_threads(engine: str, tmp_path) -> None:
    files = []
    for threads in (1, 3):
        with Scanner(mounts(tmp_path), settings={"scan.max_profiles": 20}, threads=threads) as scanner:
            words = (
                "tool.x_mm=0.2",
                "sensor[2].ry_deg=0.1",
                "sensor[5].delay_ms=1.8",
                "sensor[4].laser.turn_y_deg=0.05",
            )
            world = scanner._world(PART, "mm", words, 4)
            scan = Scan(scanner.pipeline, world, engine, samples=False)
            plan = scan.plan(NullProgress())
            recording = scanner.pipeline.drive(world, plan, NullProgress())[::4]
            sensed = scan.sense(recording, NullProgress())
            assert set(np.unique(sensed.points.sensor)) == {1, 2, 3, 4, 5}
            lost = recording.without_truth()
            assert np.isnan(lost.columns["trigger.truth.sensor[5].position[1]"]).all()
            for name, one in (("with", recording), ("without", lost)):
                cloud = scan.of_profiles(one, sensed, plan, NullProgress(), Stopwatch()).cloud
                files.append(cloud.save(tmp_path / f"{name}_{threads}.ply").read_bytes())
    assert len(set(files)) == 1


def test_misaligned_further_sensor_is_corrected_by_what_is_estimated_of_it(tmp_path) -> None:
    settings = {"scan.max_profiles": 80, **EXACT}
    built = {"sensor[2].x_mm": 0.3, "sensor[2].ry_deg": 0.2, "sensor[4].rz_deg": -0.3, "sensor[4].y_mm": 0.1}
    found = {
        "sensor[2].x": 3e-4,
        "sensor[2].ry": np.radians(0.2),
        "sensor[4].rz": np.radians(-0.3),
        "sensor[4].y": 1e-4,
    }
    with Scanner(mounts(tmp_path), settings=settings, ideal=True) as scanner:
        wrong = scanner.scan(PART, engine="geometric", as_built=built)
        right = scanner.scan(PART, engine="geometric", as_built=built, estimated=EstimatedDescription.of(found, 6))
    assert [rms(wrong, number) > 2e-5 for number in range(1, 6)] == [False, True, False, True, False]
    assert all(rms(right, number) < 0.1e-6 for number in range(1, 6))
    estimated = EstimatedDescription.of(found, 6)
    assert {name: value for name, value in estimated.deviations().items() if value} == pytest.approx(found, abs=1e-9)
    # The values survive the file of the cell.
    file = tmp_path / "calibrated.toml"
    load_setup(mounts(tmp_path)).cell.model_copy(update={"estimated": estimated}).to_toml(file)
    assert load_setup(file).cell.estimated == estimated


def test_true_optics_and_delay_of_a_further_sensor_are_its_own(tmp_path) -> None:
    with Scanner(mounts(tmp_path), settings={"scan.max_profiles": 60, **EXACT}, ideal=True) as scanner:
        turned = scanner.scan(PART, engine="geometric", as_built={"sensor[4].laser.turn_y_deg": 0.05})
        late = scanner.scan(PART, engine="geometric", as_built={"sensor[5].delay_ms": 2.5})
    assert [rms(turned, number) > 5e-6 for number in range(1, 6)] == [False, False, False, True, False]
    assert [rms(late, number) > 5e-6 for number in range(1, 6)] == [False, False, False, False, True]


@pytest.mark.parametrize("engine", ["geometric", "ray-traced"])
def test_sensor_that_exposes_at_every_third_trigger_measures_the_same_there(engine: str) -> None:
    settings = {"scan.max_profiles": 20 if engine == "ray-traced" else 60}
    key, found = "cell.further_sensor[1].every", {}
    with Scanner(assets_dir() / "cells/two_sensors.toml", settings=settings) as scanner:
        for every in (1, 3):
            setup = load_setup(scanner.setup.cell, scan=scanner.setup.scan, settings={key: every})
            found[every] = scanner.scan(PART, engine=engine, seed=2, setup=setup)
    always, seldom = (found[every].profiles for every in (1, 3))
    index = found[3].recording.measured.index
    assert np.array_equal(index, found[1].recording.measured.index)
    own = seldom.sensor == 2
    assert set(np.unique(index[seldom.frame[own]] % 3)) == {1}
    for number, kept in ((1, slice(None)), (2, index[always.frame[always.sensor == 2]] % 3 == 1)):
        for name in ("points_in_sensor", "frame", "sigma"):
            was, now = (getattr(one, name)[one.sensor == number] for one in (always, seldom))
            assert np.array_equal(was[kept], now), (number, name)
    assert all((one.trigger - 1) % 3 == 0 for one in found[3].sample_images if one.sensor == 2)
    assert rms(found[3], 2) == pytest.approx(rms(found[1], 2), rel=0.1)


def test_time_between_triggers_follows_the_sensors_that_expose_at_them() -> None:
    cell = load_setup(assets_dir() / "cells/two_sensors.toml").cell
    slow = {"cell.further_sensor[1].sensor.detector.exposure_ms": 40.0}
    times = [
        load_setup(cell, settings={**slow, "cell.further_sensor[1].every": every}).profile_time
        for every in (1, 2, 5, 1000)
    ]
    assert times[0] >= 0.04
    assert times[1:3] == pytest.approx([times[0] / 2, times[0] / 5])
    assert times[3] == load_setup().profile_time < times[2]


@pytest.mark.parametrize(
    ("word", "message"),
    [
        ("sensor[6].laser.turn_y_deg=0.1", r"there is no such sensor"),
        ("sensor[1].laser.turn_y_deg=0.1", r"there is no such sensor"),
        ("sensor[2].range.near_mm=1", r"a key of sensor\[2\]\.laser"),
        ("sensor[2].delay_ms=1000", r"delay_ms"),
        ("sensor[2].delay_ms=soon", r"delay_ms"),
        ("sensor[2].x=1", r"a unit in the key"),
        ("sensor[7].x_mm=1", r"unknown perturbation"),
        ("sensor[2].laser.turn_y_deg=400", r"turn_y_deg"),
    ],
)
def test_wrong_deviations_of_further_sensors_are_refused(word: str, message: str, tmp_path) -> None:
    with Scanner(mounts(tmp_path), settings=FEW) as scanner, pytest.raises(DescriptionError, match=message):
        scanner.scan(PART, engine="geometric", as_built=[word])


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"cell.further_sensor[1].name": "two_camera_probe"}, "is the name of the main sensor, too"),
        ({"cell.further_sensor[1].name": "post"}, "the name 'post' is taken"),
        ({"cell.further_sensor[1].name": "table"}, "the name 'table' is taken"),
        ({"cell.further_sensor[1].moves_with": "part"}, "expected world"),
        ({"cell.further_sensor[1].moves_with": "link[7]"}, "expected world"),
        ({"cell.further_sensor[3].sensor.detector.exposure_ms": -1}, r"further_sensor\[3\]\.sensor\.detector"),
        ({"cell.further_sensor[1].delay_ms": 101}, "delay_ms"),
        ({"cell.further_sensor[1].every": 0}, r"every = 0"),
        ({"cell.further_sensor[1].every": 1.5}, r"every = 1\.5"),
        ({"cell.estimated.further_sensor": [{}] * 5}, r"estimated\.further_sensor has 5 rows: expected at most 4"),
    ],
)
def test_wrong_descriptions_are_refused(settings: dict[str, object], message: str, tmp_path) -> None:
    with pytest.raises(DescriptionError, match=message):
        load_setup(mounts(tmp_path), settings=settings)


def test_file_of_a_sensor_that_is_missing_or_wrong_is_named(tmp_path) -> None:
    text = '[[further_sensor]]\nname = "post"\nsensor = "nowhere.toml"\n'
    with pytest.raises(DescriptionError, match=r"further_sensor\[1\]\.sensor = 'nowhere\.toml'.*no such file"):
        load_setup(cell_file(tmp_path, text))
    (tmp_path / "nowhere.toml").write_text('name = "x"\n')
    with pytest.raises(DescriptionError, match=r"nowhere\.toml: .*laser"):
        load_setup(cell_file(tmp_path, text))


def test_resolved_description_of_a_run_holds_the_sensors(sample, tmp_path) -> None:
    sample.save(tmp_path / "run")
    again = load_setup(*[tmp_path / "run/resolved.toml"] * 3)
    assert again == sample.setup
    assert again.cell.further_sensor[0].sensor == scancell.SensorDescription.from_toml(PRESETS / "medium_range_80.toml")


@pytest.mark.parametrize("suffix", ["ply", "npz"])
def test_files_of_clouds_hold_the_number_of_the_sensor(sample, suffix: str, tmp_path) -> None:
    file = sample.cloud.save(tmp_path / f"cloud.{suffix}")
    again = Cloud.load(file)
    assert np.array_equal(again.sensor, sample.cloud.sensor) and set(np.unique(again.sensor)) == {1, 2}
    alone = sample.cloud[sample.cloud.sensor == 1]
    written = alone.save(tmp_path / f"alone.{suffix}").read_bytes()
    assert b"uchar sensor" not in written and b"sensor.npy" not in written
    # A block of a file may hold no point of another sensor.
    order = np.argsort(sample.cloud.sensor, kind="stable")
    sorted_cloud = Cloud.load(sample.cloud[order].save(tmp_path / f"sorted.{suffix}"))
    assert np.array_equal(sorted_cloud.sensor, sample.cloud.sensor[order])


def test_files_of_other_programs_hold_the_number_of_the_sensor(sample, tmp_path) -> None:
    laspy, pye57 = pytest.importorskip("laspy"), pytest.importorskip("pye57")
    cloud = sample.cloud
    las = laspy.read(cloud.save(tmp_path / "cloud.laz"))
    assert np.array_equal(las["sensor"], cloud.sensor)
    e57 = pye57.E57(str(cloud.save(tmp_path / "cloud.e57")))
    header = e57.get_header(0)
    assert "scancell:sensor" in header.point_fields or "sensor" in str(header.point_fields)
    # Rows are profiles: those of both sensors at one exposure are two.
    profiles = len(np.unique(np.stack([cloud.profile, cloud.sensor]), axis=1).T)
    assert header["indexBounds"]["rowMaximum"].value() == profiles - 1
    text = cloud.save(tmp_path / "cloud.xyz").read_text().splitlines()
    assert text[0].split()[-1] == "sensor" and int(text[-1].split()[-1]) == cloud.sensor[-1]
    pcd = cloud.save(tmp_path / "cloud.pcd").read_bytes()
    assert b" saturated sensor\n" in pcd


def test_run_folder_names_the_sensors(sample, tmp_path) -> None:
    sample.save(tmp_path / "run")
    table = pyarrow.parquet.read_table(tmp_path / "run/profiles.parquet")
    assert np.array_equal(np.unique(table["sensor"]), [1, 2])
    assert table.schema.metadata[b"sensors"] == b"two_camera_probe,post"
    assert b"post plus" in table.schema.metadata[b"cameras"]
    figures = scancell.files.read_json(tmp_path / "run/deviation.json")
    assert [*figures["by_sensor"]] == ["two_camera_probe", "post"]
    assert {"two_camera_probe plus", "post minus"} <= figures["by_camera"].keys()
    assert sum(one["count"] for one in figures["by_sensor"].values()) == len(sample.cloud)
    assert "sensor     post:" in sample.summary() and [*sample.figures["sensors"]] == ["two_camera_probe", "post"]
    assert "comment sensors two_camera_probe, post" in (tmp_path / "run/cloud.ply").read_bytes()[:2000].decode(
        "latin-1"
    )
    shown = (tmp_path / "run/deviation.html").read_text()
    assert "By sensor" in shown


def test_images_of_each_sensor_stand_in_a_folder_with_its_name(tmp_path) -> None:
    from scancell.output.image_files import ImageWriter  # noqa: PLC0415
    from scancell.output.run_folder import RunFolder  # noqa: PLC0415

    scan = {"scan.pose": [{"z_mm": 120.0, "rx_deg": 180.0}, {"y_mm": 5.0, "z_mm": 120.0, "rx_deg": 180.0}]}
    scanner, folder = Scanner(assets_dir() / "cells/two_sensors.toml", settings=scan), RunFolder(tmp_path / "run")
    with scanner, folder:
        images = ImageWriter(folder, scanner.setup)
        result = scanner.scan(PART, on_images=images)
        images.finish()
        result.save_into(folder, ["ply"])
    run, cameras = tmp_path / "run/images", ["plus", "minus"]
    sets = [ImageSet.from_files([place], cameras) for place in (run, run / "post")]
    assert [len(one) for one in sets] == [len(result.recording)] * 2
    assert len(list((run / "post").glob("profile_*.png"))) == len(list(run.glob("profile_*.png"))) > 0


def test_recorded_scan_gives_the_cloud_of_the_scan_again(sample, tmp_path) -> None:
    file = sample.recording.save(tmp_path / "recording.parquet")
    with Scanner(setup=sample.setup, threads=2) as scanner:
        again = scanner.render(file, PART, engine="geometric", seed=5)
        assert np.array_equal(again.cloud.points_in_part, sample.cloud.points_in_part)
        assert np.array_equal(again.cloud.sensor, sample.cloud.sensor)
        old = replace(
            sample.recording, columns={k: v for k, v in sample.recording.columns.items() if "sensor[2]" not in k}
        )
        with pytest.raises(DescriptionError, match=r"states no true pose of sensor\[2\]"):
            scanner.render(old, PART, engine="geometric")


def test_measured_table_of_several_sensors_gives_the_cloud_of_the_scan(sample, tmp_path) -> None:
    from test_reconstruct_measurements import joint_columns, write_table  # noqa: PLC0415

    from scancell.calibration.measured_table import MeasuredTable, write_measured_table  # noqa: PLC0415

    file = write_table(sample, tmp_path / "points.parquet", joint_columns(sample))
    table = MeasuredTable(file)
    columns = {name: table.numbers(name) for name in table.names} | {"sensor": sample.profiles.sensor.astype(np.int64)}
    write_measured_table(file, columns)
    found = scancell.reconstruct(file, cell=assets_dir() / "cells/two_sensors.toml", part=PART)
    assert len(found.cloud) == len(sample.cloud)
    assert np.abs(found.cloud.points_in_part - sample.cloud.points_in_part).max() < 1e-9
    assert np.array_equal(found.cloud.sensor, sample.cloud.sensor)
    assert found.covariance.shape == (len(found.cloud), 3, 3)
    # Covariances are turned by the pose of the sensor that measured the point.
    largest = np.linalg.eigh(found.covariance)[1][:, :, -1]
    own = np.flatnonzero(found.cloud.sensor == 2)
    axes = sample.recording.measured.axes[np.searchsorted(sample.recording.measured.index, found.cloud.profile[own])]
    expected = sample.nominal.part_from_sensor(axes, 2)[:, :3, 2]
    assert np.abs(np.einsum("ni,ni->n", largest[own], expected)).min() > 1 - 1e-9
    found.save(tmp_path / "out")
    again = scancell.reconstruct(
        tmp_path / "out/points.parquet", cell=assets_dir() / "cells/two_sensors.toml", part=PART
    )
    assert np.array_equal(again.cloud.sensor, found.cloud.sensor)
    with pytest.raises(DescriptionError, match=r"column 'sensor' = 2: .*1 to 1"):
        scancell.reconstruct(file, part=PART)


def test_guard_and_planner_know_the_housing(sample) -> None:
    nominal = sample.nominal
    names = [body.name for body in nominal.bodies]
    assert "post" in names and "post" not in arm_chain(nominal)
    # The planned program keeps the described clearance from it.
    clearance = 1e-3 * sample.setup.scan.clearance_mm
    from scancell.planning.model import PlanningCell, SensorRange  # noqa: PLC0415

    cell = PlanningCell(nominal, SensorRange.of(sample.world.sensor), 0.016)
    assert sample.plan is not None
    assert not cell.clearance_violations(sample.plan.axes, 0.99 * clearance)
    # Into its housing no pose is free of a collision.
    at_post = nominal.world_from("sensor[2]") @ pose.translation((0.0, 0.0, 0.02))
    held = nominal.arm.ik(at_post @ pose.inverse(nominal.flange_from_sensor))
    q = held[np.isfinite(held).all(-1)]
    assert len(q)
    into = np.column_stack([q, np.zeros(len(q))])
    clashes = cell.clearance_violations(into, 0.0)
    assert {"post"} <= {name for clash in clashes for name in (clash.body_a, clash.body_b)}
    guard = guard_of(sample.setup.cell, nominal.part, sample.setup.scan)
    found = [guard.check([axes, axes + 1e-4]) for axes in into]
    assert all(found) and any("post" in (one.body_a, one.body_b) for one in found if one is not None)


def test_housing_of_one_sensor_hides_the_part_from_the_other(tmp_path) -> None:
    """A housing right before the main sensor leaves it nothing to see; its own sensor sees past it."""
    box = scancell.geometry.mesh.box_mesh((0.2, 0.2, 0.01))
    import trimesh  # noqa: PLC0415

    file = tmp_path / "housing.stl"
    trimesh.Trimesh(1e3 * box.vertices, box.faces, process=False).export(file)
    shield = {"name": "shield", "moves_with": "link[6]", "pose": {"z_mm": 100.0}, "mesh": str(file)}
    cell = load_setup().cell.replace({"further_sensor": [shield]})
    with Scanner(cell, settings={"scan.max_profiles": 10, "scan.clearance_mm": 0.0}, ideal=True) as scanner:
        world = scanner._world(PART, "mm")
        frames = world.nominal.frame_poses(world.nominal.start)
        start = world.nominal.world_from_table @ pose.translation((0, 0, 0.12)) @ np.diag([1.0, -1, -1, 1])
        frames = {**frames, "sensor": start, "sensor[2]": start @ pose.translation((0, 0, 0.02))}
        at_rest = {name: value[None] for name, value in frames.items()}
        main, second = (
            one.expose_at_rest(at_rest, np.array([1]), one.windows, "geometric", threads=1) for one in world.sensors
        )
    assert len(main.points.frame) == 0
    assert len(second.points.frame) > 100


def test_angle_of_a_mounted_sensor_is_that_of_its_description(tmp_path) -> None:
    cell = nominal_cell(load_setup(mounts(tmp_path)).cell, None)
    axes = np.array([*cell.home, 0.4, 0.05])
    placed = cell.tree.place(axes)
    turn = Rotation.from_euler("XYZ", [0, -12, 8], degrees=True)
    expected = placed["link[6]"] @ pose.from_rotation(turn.as_matrix(), np.array([0.03, 0.004, 0.085]))
    assert placed["sensor[2]"] == pytest.approx(expected, abs=1e-12)
    held = cell.with_axes_held([0.05])
    assert held.tree.place([*cell.home, 0.4])["sensor[5]"] == pytest.approx(placed["sensor[5]"], abs=1e-12)
    assert [cell.carrier(f"sensor[{k}]") for k in range(2, 6)] == ["link[6]", "table", "world", "track"]


def test_survey_and_shot_are_those_of_the_main_sensor() -> None:
    with Scanner(assets_dir() / "cells/two_sensors.toml", ideal=True, threads=1) as scanner:
        shot = scanner.shot(PART, scancell.location(0, 0, 0.1, rx=np.pi), engine="geometric")
    assert len(shot.points_in_part) > 100 and set(np.unique(shot.profile.sensor)) == {1}


def test_feed_shows_images_and_profile_of_the_chosen_sensor() -> None:
    setup = load_setup(assets_dir() / "cells/two_sensors.toml")
    with Scanner(setup=setup, threads=1) as scanner, scanner.session(PART) as session:
        live = LiveCell(session)
        with CameraFeed(live, session, "geometric") as feed:
            assert (feed.sensor, feed.sensors) == ("two_camera_probe", ("two_camera_probe", "post"))
            with pytest.raises(DescriptionError, match="sensor = 'pots': expected two_camera_probe, post"):
                feed.sensor = "pots"
            feed.sensor = "post"
            feed.wanted = True
            live.run(lambda: feed.frame is not None and feed.frame.sensor == 2, realtime=False)
            frame = feed.frame
            assert frame is not None and len(frame.stripes) == 2 and len(frame.points_in_base) > 100
            base_from_sensor = pose.inverse(session.nominal.arm.world_from_base) @ session.nominal.world_from(
                "sensor[2]"
            )
            expected = pose.transform_points(base_from_sensor, frame.points_in_sensor)
            assert frame.points_in_base == pytest.approx(expected, abs=1e-9)
            # Deviations stay in force for all sensors while another one is chosen.
            feed.perturb({"sensor[2].laser.turn_y_deg": 0.5, "sensor.laser.turn_y_deg": 0.5})
            assert len(feed.as_built) == 2
            with pytest.raises(DescriptionError, match="there is no such sensor"):
                feed.perturb({"sensor[3].laser.turn_y_deg": 0.5})
            feed.sensor = "two_camera_probe"
            assert len(feed.as_built) == 2
            live.run(lambda: feed.frame is not None and feed.frame.sensor == 1, realtime=False)


def test_panel_follows_the_chosen_sensor() -> None:
    viser = pytest.importorskip("viser")
    from types import SimpleNamespace  # noqa: PLC0415

    from scancell.browser.panels.camera_panel import CameraPanel  # noqa: PLC0415

    sensor = load_setup().sensor
    other = scancell.SensorDescription.from_toml(PRESETS / "medium_range_50.toml")
    server = viser.ViserServer(port=0, verbose=False)
    try:
        feed = SimpleNamespace(frame=None, wanted=True, sensor="main", sensors=("main", "post"))
        panel = CameraPanel(server.gui, feed, {"main": sensor, "post": other}, beside=True)  # type: ignore[arg-type]

        def shown() -> list[bool]:
            return [view._marks.visible for view in panel._views]

        panel.show()
        assert shown() == [True, False]
        feed.sensor = "post"
        panel.show()
        assert shown() == [False, True] and panel._choice is not None and panel._choice.value == "post"
        images, points = np.full((1, 600, 1280), 9, np.uint8), np.array([[0.0, 0.001, 0.1]])
        frame = CameraFrame(
            4, 0.5, "ray-traced", (), images, (np.array([[5.0, 6.0]]),), points, points, np.ones(1),
            np.zeros(1, np.int32), sensor=2,
        )  # fmt: skip
        feed.frame = frame
        panel.show()
        assert panel._views[1]._image.visible and not panel._views[0]._image.visible
        # A late frame of the other sensor is not shown in its place.
        before = panel._views[1]._image.image
        feed.frame = replace(frame, number=5, sensor=1)
        panel.show()
        assert panel._views[1]._image.image is before
    finally:
        server.stop()


def test_live_scan_gives_the_cloud_of_the_scan() -> None:
    setup = load_setup(assets_dir() / "cells/two_sensors.toml", settings={"scan.max_profiles": 40})
    with Scanner(setup=setup, threads=1) as scanner, scanner.session(PART, seed=2) as session:
        live, chunks = LiveCell(session), list[LiveChunk]()
        scan = LiveScan("geometric", on_points=chunks.append)
        scan.start(live)
        live.run(scan.result.done, realtime=False)
        found = scan.result.result()
    assert set(np.unique(found.cloud.sensor)) == {1, 2}
    assert sum(len(chunk.time) for chunk in chunks) == len(found.cloud)
    assert found.deviation.by_sensor.keys() == {1, 2}
    assert bool((np.diff(found.cloud.time) >= 0).all())


def test_studies_vary_each_sensor_and_batches_refuse_what_they_lack(tmp_path) -> None:
    (tmp_path / "study.toml").write_text(
        f"""
        name = "mounts"
        part = "{PART}"
        cell = "{assets_dir() / "cells/two_sensors.toml"}"
        engine = "geometric"
        ideal = true
        coverage_samples = 0
        set = ["scan.max_profiles=30", "cell.further_sensor[1].sensor.laser.straightness_mrad=[]"]
        [design]
        kind = "one_at_a_time"
        levels = 2
        [[factor]]
        path = "as_built.sensor[2].ry_deg"
        distribution = {{ kind = "normal", std = 0.1 }}
        [[factor]]
        path = "as_built.sensor[2].laser.offset_x_mm"
        mode = "additive"
        distribution = {{ kind = "normal", std = 0.05 }}
        """
    )
    scancell.study(tmp_path / "study.toml", tmp_path / "out", workers=1)
    rows = pyarrow.parquet.read_table(tmp_path / "out/results.parquet").to_pylist()
    assert len(rows) == 5 and all(row["status"] == "ok" for row in rows)
    rms = [row["rms_um"] for row in rows]
    assert rms[0] < 0.1 and min(rms[1:]) > 10
    (tmp_path / "wrong.toml").write_text(
        (tmp_path / "study.toml").read_text().replace("sensor[2].ry_deg", "sensor[3].ry_deg")
    )
    with pytest.raises(DescriptionError, match=r"unknown perturbation 'sensor\[3\]\.ry_deg'"):
        scancell.study(tmp_path / "wrong.toml", tmp_path / "other", workers=1)
    (tmp_path / "batch.toml").write_text(f'cell = "{assets_dir() / "cells/two_sensors.toml"}"\nengine = "geometric"\n')
    with pytest.raises(DescriptionError, match="truth = True: is of one sensor; the cell has several"):
        scancell.batch([PART], tmp_path / "clouds", config=tmp_path / "batch.toml", workers=1)


def test_further_sensor_on_the_flange_is_calibrated_in_place_of_the_main_one(tmp_path) -> None:
    text = MOUNTS[MOUNTS.index("[[further_sensor]]") : MOUNTS.index('name = "post"')].rpartition("[[further_sensor]]")[
        0
    ]
    built = {"sensor[2].x_mm": 0.3, "sensor[2].ry_deg": 0.2, "tool.y_mm": 0.4, "sensor[3].x_mm": 1.0}
    settings = {"scan.max_profiles": 60}
    with Scanner(mounts(tmp_path, text), settings=settings) as scanner:
        request = CalibrationRequest("tool", further_sensor="beside")
        report = scanner.calibrate(request, as_built=built)
        assert [row.name for row in report.rows] == [f"sensor[2].{key}" for key in ("x", "y", "z", "rx", "ry", "rz")]
        assert all(abs(row.value - (row.true or 0.0)) < 5e-3 for row in report.rows)
        found = report.estimated.deviations()
        assert found["sensor[2].x"] == pytest.approx(3e-4, abs=5e-6) and found["tool.y"] == 0.0
        result = scanner.scan(PART, engine="geometric", as_built=built, estimated=report.estimated)
        assert rms(result, 2) < 1e-5 < rms(result, 1)
        report.save(tmp_path / "out")
        calibrated = load_setup(tmp_path / "out/calibrated.toml").cell
        assert calibrated.further_sensor == scanner.setup.cell.further_sensor
        assert calibrated.estimated == report.estimated
        stated = scancell.files.read_json(tmp_path / "out/calibration.json")
        assert stated["deviations"][0]["name"] == "sensor[2].x"
        # What was found of one sensor stays when the other one is calibrated.
        setup = replace(scanner.setup, cell=calibrated)
        both = scanner.calibrate("tool", as_built=built, setup=setup).estimated
        result = scanner.scan(PART, engine="geometric", as_built=built, estimated=both)
        assert max(rms(result, 1), rms(result, 2)) < 1e-5
        with pytest.raises(DescriptionError, match=r"further_sensor\[2\]\.moves_with = 'table'.*link\[6\], world"):
            scanner.calibrate(CalibrationRequest("tool", further_sensor="rider"))
        with pytest.raises(DescriptionError, match="further_sensor = 'main': expected beside, rider"):
            scanner.calibrate(CalibrationRequest("tool", further_sensor="main"))


@pytest.mark.parametrize(("name", "number", "carrier"), [("post", 4, "world"), ("carriage", 5, "track")])
def test_sensor_that_the_arm_does_not_carry_is_calibrated_by_turns_of_the_table(
    name: str, number: int, carrier: str, tmp_path
) -> None:
    frame = f"sensor[{number}]"
    text = MOUNTS.replace("medium_range_50", "medium_range_80").replace(
        "y_mm = -62.0, z_mm = 190.0", "y_mm = -96.0, z_mm = 230.0"
    )
    built = {f"{frame}.x_mm": 0.4, f"{frame}.z_mm": -0.3, f"{frame}.rx_deg": 0.2, f"{frame}.rz_deg": -0.2}
    with Scanner(setup=load_setup(mounts(tmp_path, text), settings={**FEW, **EXACT}, ideal=True)) as scanner:
        report = scanner.calibrate(CalibrationRequest("tool", further_sensor=name), as_built=built)
        blind = scanner.scan(PART, engine="geometric", as_built=built)
        mended = scanner.scan(PART, engine="geometric", as_built=built, estimated=report.estimated)
    assert [row.name for row in report.rows] == [f"{frame}.{key}" for key in ("x", "y", "z", "rx", "ry", "rz")]
    for row in report.rows:
        assert row.true == pytest.approx(built.get(f"{row.name}_{row.unit}", 0.0))
        assert abs(row.error) < {"mm": 2e-3, "deg": 2e-3}[row.unit], row.name
    assert rms(mended, number) < 2e-6
    assert rms(blind, number) > 1e-4
    # The arm stays at home, and the table turns the artefact.
    axes = report.calibration.problem.observations.readings.axes
    assert np.ptp(axes[:, :6], axis=0).max() < 1e-6
    assert np.ptp(axes[:, 6]) > 0.3
    assert f"{carrier}_from_sensor_m" in report.figures
    with pytest.raises(DescriptionError, match="the sensor is not on the flange"):
        _ = report.flange_from_sensor


def test_calibrations_that_turns_of_the_table_do_not_determine_are_refused() -> None:
    wanted = CalibrationRequest("tool", further_sensor="post", poses=8)
    with Scanner(assets_dir() / "cells/two_sensors.toml", settings=FEW) as scanner:
        for what in ("table", "latency", "all", "grasp"):
            with pytest.raises(CalibrationError, match=f"what = '{what}': the arm moves neither.*expected tool"):
                scanner.calibrate(replace(wanted, what=what))
        with pytest.raises(CalibrationError, match="passes = 2: the arm moves neither"):
            scanner.calibrate(replace(wanted, passes=2))
        with pytest.raises(CalibrationError, match="do not determine"):
            scanner.calibrate(replace(wanted, is_pose_known=False))
        with pytest.raises(CalibrationError, match="random views show 30 points of it"):
            away = load_setup(scanner.setup.cell, settings={"cell.further_sensor[1].pose.x_mm": 700.0})
            scanner.calibrate(wanted, setup=away)


def test_poses_of_the_flange_do_not_place_what_other_links_carry(sample, tmp_path) -> None:
    from test_reconstruct_measurements import flange_columns_of, write_table  # noqa: PLC0415

    from scancell.calibration.measured_table import MeasuredTable, write_measured_table  # noqa: PLC0415

    file = write_table(sample, tmp_path / "points.parquet", flange_columns_of(sample, "wxyz"))
    table = MeasuredTable(file)
    columns = {name: table.numbers(name) for name in table.names} | {"sensor": sample.profiles.sensor.astype(np.int64)}
    write_measured_table(file, columns)
    cell = assets_dir() / "cells/two_sensors.toml"
    found = scancell.reconstruct(file, cell=cell, part=PART)
    assert any("points on the arm stay in the cloud" in warning for warning in found.warnings)
    assert len(found.cloud) >= len(sample.cloud)
    assert (found.cloud.sensor == 2).sum() >= (sample.cloud.sensor == 2).sum()
    with pytest.raises(DescriptionError, match=r"further_sensor\[1\]\.moves_with = 'link\[3\]'"):
        scancell.reconstruct(file, cell=cell, settings={"cell.further_sensor[1].moves_with": "link[3]"}, part=PART)
