"""Batches end to end: every file holds what it says, whatever happens on the way, and the truth is true."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import time
from pathlib import Path

import h5py
import numpy as np
import pyarrow.parquet
import pytest
import trimesh
from commands import COMMAND, PARTS, PATIENCE_S, environment, scancell_here

from scancell import sensor as sensor_rt
from scancell.geometry import pose
from scancell.output.run_folder import build_version
from scancell.reconstruction.cloud_files import read_ply
from scancell.studies.engine import close_workers

DESCRIPTION = """
images = true
formats = ["ply", "npz", "laz"]
set = ["scan.max_profiles=24"]
seed = 5

[[factor]]
path = "as_built.tool.x_mm"
distribution = { kind = "uniform", low = 0.05, high = 0.2 }

[[factor]]
path = "as_built.sensor.camera[1].tilt_deg"
distribution = { kind = "normal", std = 0.02 }
"""
QUICK = ("--engine", "geometric", "--set", "scan.max_profiles=24", "--no-truth")


@pytest.fixture(autouse=True, scope="module")
def _no_worker_left():
    yield
    close_workers()


def batch(folder: Path, *words: str | Path, shard: str = "1/1"):
    """Scan what lies in parts/ in this process; returns the JSON report and the index."""
    done = scancell_here("batch", "parts", "--out", "out", "--shard", shard, "--json", *words, cwd=folder)
    assert done.code == 0, done.err
    index = folder / "out" / "index.parquet"
    return done.last_line, pyarrow.parquet.read_table(index).to_pylist() if index.exists() else []


def parts(folder: Path, *names: str) -> None:
    (folder / "parts").mkdir()
    for name in names:
        (folder / "parts" / f"{name}.stl").write_bytes((PARTS / f"{name}.stl").read_bytes())


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Three parts, one of them broken, in two variants each, with images and truth."""
    folder = tmp_path_factory.mktemp("batch")
    parts(folder, "free_form", "step_block")
    (folder / "parts" / "broken.stl").write_text("solid nothing\nendsolid\n")
    (folder / "batch.toml").write_text(DESCRIPTION)
    return folder, *batch(folder, "--config", "batch.toml", "--variants", "2")


def scans(made):
    folder, _, rows = made
    for row in rows:
        if row["status"] == "ok":
            place = folder / "out" / "scans" / row["scan"]
            with h5py.File(place / "measured.h5") as measured, h5py.File(place / "truth.h5") as truth:
                yield row, place, measured, truth["truth"]


def test_index_matches_files(made) -> None:
    folder, report, rows = made
    assert [row["scan"] for row in rows] == [
        f"{part}-{n:06d}" for part in ("broken", "free_form", "step_block") for n in (1, 2)
    ]
    for row in rows:
        place = folder / "out" / "scans" / row["scan"]
        listed = {path for key, path in row.items() if key.startswith("file.") and path is not None}
        there = {f"scans/{row['scan']}/{path.name}" for path in place.iterdir()} - {
            f"scans/{row['scan']}/{name}" for name in ("scan.json", "done.json")
        }
        assert listed == there
        if row["part"] == "broken":
            assert row["status"] == "failed"
            assert "broken.stl: no triangles (0 vertices, 0 faces)" in row["message"]
            continue
        assert row["status"] == "ok", row["message"]
        words = dict(word.split("=") for word in row["as_built"])
        assert float(words["tool.x_mm"]) == row["as_built.tool.x_mm"]
        assert row["points"] == len(read_ply(place / "cloud.ply"))
        assert row["file.cloud.laz"] == f"scans/{row['scan']}/cloud.laz"
    assert report["figures"]["failed"] == 2
    assert "broken-000001" in report["warnings"][0]
    assert len({row["seed"] for row in rows}) == 6
    assert {row["scancell"] for row in rows} == {build_version()}


def test_true_points_lie_on_triangles(made) -> None:
    for row, _, _, truth in scans(made):
        mesh = trimesh.load(made[0] / "parts" / f"{row['part']}.stl", process=False)
        part = list(truth.attrs["bodies"]).index("part")
        for group in (truth["cloud"], truth["stripe"]):
            chosen = group["body"][:] == part
            corners = mesh.triangles[group["face"][:][chosen]]
            points, normals = (group[name][:][chosen] for name in ("points_in_part_mm", "normals"))
            assert len(points) > 3000
            nearest = trimesh.triangles.closest_point(corners, points)
            assert np.linalg.norm(nearest - points, axis=1).max() < 1e-6
            across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
            across /= np.linalg.norm(across, axis=1, keepdims=True)
            assert np.abs(normals - across).max() < 1e-3, "32 bits, and float vertices of narrow triangles"
        assert (truth["cloud/body"][:] == part).mean() > 0.99, "what was taken for the part is the part"


def test_true_stripe_matches_laser_and_cameras(made) -> None:
    """Carried into the true sensor, its points lie in the sheet, and the camera sees them in their pixel."""
    for _, _, _, truth in scans(made):
        stripe, sensor = truth["stripe"], sensor_rt.Sensor(truth.attrs["sensor_json"])
        exposure, camera = stripe["exposure"][:], stripe["camera"][:]
        sensor_from_part = pose.inverse(truth["exposures/part_from_sensor"][:])[exposure]
        points = np.einsum("nij,nj->ni", sensor_from_part[:, :3, :3], 1e-3 * stripe["points_in_part_mm"][:])
        points += sensor_from_part[:, :3, 3]
        assert np.abs(points[:, 0]).max() < 20e-6
        assert np.quantile(np.abs(points[:, 0]), 0.99) < 1e-6
        for k in range(len(sensor.cameras)):
            seen = sensor.cameras[k].project(points[camera == k])
            expected = np.stack([stripe["column"][:], stripe["row_px"][:]], -1)[camera == k]
            assert np.quantile(np.abs(seen - expected), 0.999) < 1e-6


def test_cloud_error_matches_perturbation(made) -> None:
    """The sensor is shifted by a tenth of a millimetre: with measured poses and tilt the true place is taken amiss."""
    for row, place, measured, truth in scans(made):
        cloud = read_ply(place / "cloud.ply")
        true = 1e-3 * truth["cloud/points_in_part_mm"][:]
        assert len(cloud) == len(true)
        exposure = np.searchsorted(measured["index"][:], cloud.profile)
        true_pose = pose.inverse(truth["exposures/part_from_sensor"][:])[exposure]
        in_sensor = np.einsum("nij,nj->ni", true_pose[:, :3, :3], true) + true_pose[:, :3, 3]
        believed, as_built = (sensor_rt.Sensor(file.attrs["sensor_json"]) for file in (measured, truth))
        rows = truth["cloud/row_px"][:]
        for k in range(2):
            chosen = np.flatnonzero((cloud.camera == k) & np.isfinite(rows))
            pixels = as_built.cameras[k].project(in_sensor[chosen])
            seen_as = sensor_rt.triangulate_pixels(pixels, believed, k, "exact")
            found_pose = measured["part_from_sensor"][:][exposure[chosen]]
            predicted = np.einsum("nij,nj->ni", found_pose[:, :3, :3], seen_as) + found_pose[:, :3, 3]
            amiss = np.linalg.norm(cloud.points_in_part[chosen] - predicted, axis=1)
            moved = np.linalg.norm(cloud.points_in_part[chosen] - true[chosen], axis=1)
            print(row["scan"], k, np.median(amiss), np.median(moved))
            assert np.median(amiss) < 3e-6
            assert np.median(moved) > 0.9e-3 * row["as_built.tool.x_mm"]


def test_stored_images_reproduce_cloud(made) -> None:
    for _, place, measured, _ in scans(made):
        cloud, sensor = read_ply(place / "cloud.ply"), sensor_rt.Sensor(measured.attrs["sensor_json"])
        images = measured["images"][:]
        assert images.dtype == np.uint8
        points = sensor_rt.triangulate(sensor_rt.extract(images.astype(np.uint16), sensor), sensor)
        found_pose = measured["part_from_sensor"][:][points.frame]
        carried = np.einsum("nij,nj->ni", found_pose[:, :3, :3], points.points_in_sensor) + found_pose[:, :3, 3]
        keys = np.stack([measured["index"][:][points.frame], points.camera, points.column], -1)
        again = {tuple(key): point for key, point in zip(keys.tolist(), carried, strict=True)}
        wanted = np.stack([cloud.profile, cloud.camera, cloud.column], -1).tolist()
        np.testing.assert_allclose([again[tuple(key)] for key in wanted], cloud.points_in_part, atol=1e-9)


def test_masks_contain_laser_light(made) -> None:
    for _, _, measured, truth in scans(made):
        images, mask = measured["images"][:], truth["mask"][:].astype(bool)
        assert mask.shape == images.shape
        dark = images[~mask]
        noise = max(1.0, float(dark.std()))
        assert dark.max() - np.median(dark) < 7 * noise + 1
        stripe = {name: truth["stripe"][name][:] for name in ("exposure", "camera", "column", "row_px")}
        middle = np.rint(stripe["row_px"]).astype(int)
        inside = (middle >= 0) & (middle < images.shape[2])
        held = mask[stripe["exposure"], stripe["camera"], middle.clip(0, images.shape[2] - 1), stripe["column"]]
        assert held[inside].mean() > 0.999
        assert 2 < mask.sum() / len(middle) < 40, "pixels per column of the stripe"
        assert images[mask].mean() > np.median(dark) + 5


def test_results_are_independent_of_workers(made, tmp_path) -> None:
    folder, _, _ = made
    words = ("batch", folder / "parts", "--config", folder / "batch.toml", "--variants", "2", "--workers", "2")
    assert scancell_here(*words, "--out", tmp_path / "out", cwd=tmp_path).code == 0
    assert contents(tmp_path / "out") == contents(folder / "out")


def test_rerun_adds_missing_and_new_scans(tmp_path) -> None:
    parts(tmp_path, "free_form")
    batch(tmp_path, *QUICK)
    before = contents(tmp_path / "out" / "scans")
    (tmp_path / "parts" / "z.stl").write_bytes((PARTS / "step_block.stl").read_bytes())
    report, rows = batch(tmp_path, *QUICK, "--variants", "2")
    assert report["figures"]["new"] == 3
    assert [row["scan"] for row in rows] == ["free_form-000001", "free_form-000002", "z-000001", "z-000002"]
    after = contents(tmp_path / "out" / "scans")
    assert before.items() <= after.items()
    # A mesh that changes is another part under the same name.
    (tmp_path / "parts" / "z.stl").write_bytes((PARTS / "sphere_on_foot.stl").read_bytes())
    report, rows = batch(tmp_path, *QUICK, "--variants", "2")
    assert report["figures"]["new"] == 2
    assert len({row["mesh_sha256"] for row in rows}) == 2
    assert contents(tmp_path / "out" / "scans")["z-000001/cloud.ply"] != after["z-000001/cloud.ply"]


def test_moved_parts_and_results_are_reused(tmp_path) -> None:
    here, there = tmp_path / "here", tmp_path / "there"
    here.mkdir()
    parts(here, "step_block")
    _, (before,) = batch(here, *QUICK)
    here.rename(there)
    report, (after,) = batch(there, *QUICK)
    assert report["figures"]["new"] == 0
    assert report["warnings"] == []
    assert after == {**before, "mesh": str(there / "parts" / "step_block.stl")}


def test_shards_complete_batch(tmp_path) -> None:
    parts(tmp_path, "step_block")
    for shard in ("1/2", "2/2"):
        assert batch(tmp_path, *QUICK, "--variants", "3", shard=shard)[1] == []
    report, rows = batch(tmp_path, *QUICK, "--variants", "3")
    assert report["figures"]["new"] == 0
    assert len(rows) == 3


def test_batch_fails_if_all_scans_fail(tmp_path) -> None:
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "empty.obj").write_text("")
    done = scancell_here("batch", "parts", "--out", "out", "--shard", "1/1", "--json", cwd=tmp_path)
    assert done.code == 1
    assert "all 1 scans failed" in done.message
    assert "empty.obj" in done.message
    assert len(pyarrow.parquet.read_table(tmp_path / "out" / "index.parquet")) == 1
    # Nothing is finished that another batch could spoil: the folder takes a mended one.
    shutil.rmtree(tmp_path / "parts")
    parts(tmp_path, "step_block")
    words = ("batch", "parts", *QUICK, "--out", "out", "--seed", "2", "--shard", "1/1", "--json")
    done = scancell_here(*words, cwd=tmp_path)
    assert done.code == 0, done


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory) -> tuple[tuple[str | Path, ...], dict[str, bytes]]:
    """A batch of 14 scans, which takes seconds after the first have finished, and what it leaves when not killed."""
    folder = tmp_path_factory.mktemp("undisturbed")
    parts(folder, "free_form", "step_block")
    words = ("batch", folder / "parts", *QUICK, "--format", "ply,npz", "--variants", "7")
    assert scancell_here(*words, "--out", "out", "--shard", "1/1", cwd=folder).code == 0
    return words, contents(folder / "out")


@pytest.mark.parametrize("shot", [signal.SIGKILL, signal.SIGINT])
def test_killed_batch_resumes_identically(tmp_path, undisturbed, shot) -> None:
    words, expected = undisturbed
    command = [*COMMAND, *words, "--out", "out", "--workers", "2"]
    running = subprocess.Popen(command, cwd=tmp_path, env=environment(), stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + PATIENCE_S
    while len(list((tmp_path / "out" / "scans").glob("[!.]*"))) < 2 and time.monotonic() < deadline:
        time.sleep(0.02)
    os.kill(running.pid, shot)
    _, said = running.communicate(timeout=PATIENCE_S)
    finished = list((tmp_path / "out" / "scans").glob("[!.]*"))
    assert 2 <= len(finished) < 14
    for place in finished:
        assert set(json.loads((place / "done.json").read_text())["files"]) <= {path.name for path in place.iterdir()}
    if shot == signal.SIGINT:
        assert running.returncode == 130
        assert "the same command resumes" in said
        assert not list((tmp_path / "out" / "scans").glob(".*")), "no half file"
    again = scancell_here(*words, "--out", "out", "--shard", "1/1", cwd=tmp_path)
    assert again.code == 0, again.err
    assert contents(tmp_path / "out") == expected
