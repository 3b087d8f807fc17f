"""Comparison of measurements with the simulation of the same poses: a simulated run agrees with itself."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh

import scancell
from scancell.cell.recording import write_recording
from scancell.config.loading import assets_dir
from scancell.errors import DescriptionError
from scancell.geometry.mesh import Mesh, box_mesh
from scancell.output.run_folder import resolved_toml, write_profiles
from scancell.recorded.compare import Residuals, _from_edges, _repeated, _scatter_of_means

PART = assets_dir() / "parts" / "sphere_on_foot.stl"
SMALL = {
    **{"scan.max_profiles": 24, "sensor.detector.laser_off_frame": False, "scan.sweep.enabled": False},
    **{f"sensor.camera[{i}].{key}": value for i in (1, 2) for key, value in (("width_px", 320), ("height_px", 256))},
}


def run_of(folder: Path, part: Path, **more: object) -> Path:
    """What `compare` reads of the run folder of a ray-traced scan."""
    with scancell.Scanner(settings={**SMALL, **more}) as scanner:
        result = scanner.scan(part, seed=11)
    write_recording(result.recording, folder / "recording.parquet")
    write_profiles(result.profiles, result.recording.measured.index, result.setup, folder / "profiles.parquet")
    made = {"part": str(part), "unit": "mm", "engine": "ray-traced", "as_built": [], "seed": 11}
    (folder / "resolved.toml").write_text(resolved_toml(result.setup, made))
    return folder


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> Path:
    return run_of(tmp_path_factory.mktemp("run"), PART)


@pytest.fixture(scope="module")
def compared(run) -> scancell.ComparisonResult:
    return scancell.compare(run)


def test_simulated_run_agrees_with_itself(compared) -> None:
    """Only the noise differs; points at rest, by another seed."""
    points = compared.figures["points"]
    assert points["simulated"] == pytest.approx(points["real"], rel=0.03)
    for pair in (*compared.noise_by_angle, *compared.noise_by_range):
        if pair.real is not None and min(pair.real_count, pair.simulated_count) > 300:
            # Of a robust standard deviation by n differences, which overlap: about 1.2 / sqrt(n).
            assert pair.ratio == pytest.approx(1.0, abs=0.05 + 6.0 / np.sqrt(pair.real_count))
    middle = compared.quantiles[2:-2]
    assert np.abs(middle[:, 0] - middle[:, 1]).max() < 0.25 * np.ptp(middle[:, 0])
    assert compared.is_simulated and not compared.fitted


def test_wrong_noise_of_the_description_is_seen(run, compared, tmp_path) -> None:
    """A detector that is described with a tenth of the light predicts more noise."""
    for file in ("recording.parquet", "profiles.parquet", "resolved.toml"):
        (tmp_path / file).write_bytes((run / file).read_bytes())
    text = (tmp_path / "resolved.toml").read_text()
    setup = scancell.load_setup(run / "resolved.toml", run / "resolved.toml", run / "resolved.toml")
    power = f"power_mw = {setup.sensor.laser.power_mw!r}"
    assert power in text
    (tmp_path / "resolved.toml").write_text(text.replace(power, f"power_mw = {setup.sensor.laser.power_mw / 10!r}"))
    darker = scancell.compare(tmp_path)
    ratios = [pair.ratio for pair in darker.noise_by_range if pair.ratio is not None]
    assert min(ratios) > 1.5


def test_files(compared, tmp_path) -> None:
    names = {path.name for path in compared.save(tmp_path / "out")}
    assert names == {"comparison.json", "comparison.png", "comparison_manifest.json"}
    figures = json.loads((tmp_path / "out" / "comparison.json").read_text())
    assert figures == json.loads(json.dumps(compared.figures))
    assert "predicted" in compared.summary() and compared.picture().startswith(b"\x89PNG")


def test_noise_from_point_to_point_is_that_of_the_points() -> None:
    """A slow shape is no noise."""
    rng, count = np.random.default_rng(3), 4000
    column = np.arange(count)
    distance = 5e-6 * rng.normal(size=count) + 50e-6 * np.sin(column / 300)
    zero = np.zeros(count)
    camera = np.zeros(count, np.int32)
    one = Residuals(distance, zero, zero, zero, column // 1000, camera, column.astype(np.int32), zero)
    noise, pairs = one.noise(np.ones(count, bool))
    assert noise == pytest.approx(5e-6, rel=0.05) and pairs == count - 4


def test_scatter_of_profiles_is_pooled_over_groups_of_equal_poses() -> None:
    """Groups of any size about means of their own; points of a profile are averaged before."""
    rng, per_profile = np.random.default_rng(5), 50
    groups = [[0, 1], [2, 3, 4, 5, 6, 7], [8]]
    means = 4e-6 * rng.standard_normal(9) + np.repeat([1e-3, -2e-3, 0.0], [2, 6, 1])
    within = np.tile(np.linspace(-1e-4, 1e-4, per_profile), 9)
    exposure, zero = np.repeat(np.arange(9), per_profile), np.zeros(9 * per_profile)
    whole = zero.astype(np.int32)
    one = Residuals(np.repeat(means, per_profile) + within, zero, zero, zero, exposure, whole, whole, zero)
    scatter, degrees = _scatter_of_means(one, groups)
    assert degrees == 1 + 5
    expected = [np.sum((means[group] - means[group].mean()) ** 2) for group in groups]
    assert scatter == pytest.approx(np.sqrt(sum(expected) / degrees))
    assert np.isnan(_scatter_of_means(one, [[8]])[0])


def test_errors_near_edges_are_those_of_the_points_there() -> None:
    """Points on the top face of a box are as far from an edge as their coordinates say."""
    rng, count = np.random.default_rng(4), 5000
    box = box_mesh((0.04, 0.02, 0.01))
    points = np.column_stack([*rng.uniform([[-0.02], [-0.01]], [[0.02], [0.01]], (2, count)), np.full(count, 5e-3)])
    expected = np.minimum(0.02 - np.abs(points[:, 0]), 0.01 - np.abs(points[:, 1]))
    assert np.abs(_from_edges(points, box, 1) - expected).max() < 1e-9
    ball = trimesh.creation.icosphere(4, 0.01)
    assert np.isinf(_from_edges(points, Mesh(ball.vertices, ball.faces), 1)).all()


def test_edge_figures_of_a_simulated_run_agree_with_themselves(tmp_path) -> None:
    steps = assets_dir() / "parts" / "step_block.stl"
    found = scancell.compare(run_of(tmp_path, steps, **{"scan.max_profiles": 60, "scan.sweep.enabled": True}))
    judged = [pair for pair in found.edges if min(pair.real_count, pair.simulated_count) > 300]
    assert len(judged) > 1
    assert all(pair.ratio == pytest.approx(1.0, abs=0.25) for pair in judged)
    assert [part["from_mm"] for part in found.figures["rms_by_distance_from_edge_um"]] == [0, 0.25, 0.5, 1, 2]
    assert "RMS by distance from a sharp edge" in found.summary()


def test_run_without_a_part_is_refused(run, tmp_path) -> None:
    with pytest.raises(DescriptionError, match="a run folder"):
        scancell.compare(tmp_path)
    text = (run / "resolved.toml").read_text()
    (tmp_path / "resolved.toml").write_text(text.replace(json.dumps(str(PART)), '""').replace(f"'{PART}'", '""'))
    with pytest.raises(DescriptionError, match="nothing of known shape"):
        scancell.compare(tmp_path)


def test_rolling_shutter_of_a_moving_sensor_agrees_with_its_simulation_at_rest(tmp_path) -> None:
    rolling = {
        **{"sensor.detector.shutter": "rolling", "sensor.detector.row_readout_us": 40, "sensor.render.bounces": 0},
        **{"scan.raster.speed_mm_s": 200.0},
    }
    compared = scancell.compare(run_of(tmp_path, PART, **rolling))
    real, simulated = (float(np.median(np.abs(one.distance))) for one in (compared.real, compared.simulated))
    assert simulated == pytest.approx(real, rel=0.15)


def test_groups_of_equal_poses_are_those_of_a_comparison_of_all_pairs() -> None:
    rng = np.random.default_rng(3)
    poses = np.tile(np.eye(4), (200, 1, 1))
    poses[:, :3, 3] = rng.integers(0, 4, (200, 3)) * 1e-3 + rng.uniform(-1e-6, 1e-6, (200, 3))
    turn = rng.integers(0, 3, 200) * 1e-3
    poses[:, :3, :3] = scancell.pose.rotation_about(2, turn)
    key = [(*np.rint(one[:3, 3] * 1e3).astype(int), round(t * 1e3)) for one, t in zip(poses, turn, strict=True)]
    expected = {tuple(i for i, other in enumerate(key) if other == own) for own in key if key.count(own) > 1}
    assert {tuple(group) for group in _repeated(poses)} == expected
