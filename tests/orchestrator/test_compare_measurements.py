"""Comparison of measurements with the simulation of the same poses: a simulated run agrees with itself."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import scancell
from scancell.cell.recording import write_recording
from scancell.config.loading import assets_dir
from scancell.errors import DescriptionError
from scancell.output.manifest import resolved_toml
from scancell.output.run_files import write_profiles
from scancell.recorded.compare import Residuals

PART = assets_dir() / "parts" / "sphere_on_foot.stl"
SMALL = {
    **{"scan.max_profiles": 24, "sensor.detector.laser_off_frame": False, "scan.sweep.enabled": False},
    **{f"sensor.camera[{i}].{key}": value for i in (1, 2) for key, value in (("width_px", 320), ("height_px", 256))},
}


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> Path:
    """What `compare` reads of the run folder of a ray-traced scan."""
    folder = tmp_path_factory.mktemp("run")
    with scancell.Scanner(settings=SMALL) as scanner:
        result = scanner.scan(PART, seed=11)
    write_recording(result.recording, folder / "recording.parquet")
    write_profiles(result.profiles, result.recording.measured.index, result.camera_names, folder / "profiles.parquet")
    made = {"part": str(PART), "unit": "mm", "engine": "ray-traced", "as_built": [], "seed": 11}
    (folder / "resolved.toml").write_text(resolved_toml(result.setup, made))
    return folder


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
    one = Residuals(distance, zero, zero, zero, column // 1000, np.zeros(count, np.int32), column.astype(np.int32))
    noise, pairs = one.noise(np.ones(count, bool))
    assert noise == pytest.approx(5e-6, rel=0.05) and pairs == count - 4


def test_run_without_a_part_is_refused(run, tmp_path) -> None:
    with pytest.raises(DescriptionError, match="a run folder"):
        scancell.compare(tmp_path)
    text = (run / "resolved.toml").read_text()
    (tmp_path / "resolved.toml").write_text(text.replace(json.dumps(str(PART)), '""').replace(f"'{PART}'", '""'))
    with pytest.raises(DescriptionError, match="nothing of known shape"):
        scancell.compare(tmp_path)
