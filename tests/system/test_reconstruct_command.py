"""`scancell reconstruct` on the files of a simulated run, as a real cell would leave them."""

from __future__ import annotations

import numpy as np
import pytest
from commands import PARTS, scancell_here

import scancell
from scancell.calibration.measured_table import write_measured_table

PART = PARTS / "sphere_on_foot.stl"


def succeeded(done):
    assert done.code == 0, done.err
    return done.last_line


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The points of a scan with joints as a table, and its cloud."""
    folder = tmp_path_factory.mktemp("real")
    result = scancell.scan(PART, engine="geometric", settings={"scan.max_profiles": 40, "scan.sweep.enabled": False})
    result.cloud.save(folder / "scan.ply")
    measured, row = result.recording.measured, result.profiles.frame
    joints = {f"q{i}_deg": column[row] for i, column in enumerate(np.degrees(measured.q).T, 1)}
    rates = {f"qd{i}_deg_s": column[row] for i, column in enumerate(np.degrees(measured.rates[:, :6]).T, 1)}
    table = {"table_deg": np.degrees(measured.table)[row], "table_rate_deg_s": np.degrees(measured.rates[:, 6])[row]}
    points = {f"{axis}_mm": 1e3 * result.profiles.points_in_sensor[:, i] for i, axis in enumerate("xyz")}
    write_measured_table(folder / "points.csv", {"exposure": measured.index[row], **joints, **rates, **table, **points})
    return folder


def test_cloud_of_measurements(folder) -> None:
    words = ("points.csv", "--part", PART, "--json", "--out", "real", "--format", "ply,xyz")
    report = succeeded(scancell_here("reconstruct", *words, cwd=folder))
    cloud = scancell.Cloud.load(folder / "scan.ply")
    found = scancell.Cloud.load(folder / "real" / "cloud.ply")
    assert report["figures"]["points"] == len(found) == len(cloud)
    assert np.abs(found.points_in_part - cloud.points_in_part).max() < 1e-9
    assert (folder / "real" / "cloud.xyz").is_file()
    evaluated = succeeded(scancell_here("evaluate", "real", "--mesh", PART, "--json", "--out", "evaluated", cwd=folder))
    assert evaluated["figures"]


def test_delay_is_an_option(folder) -> None:
    words = ("points.csv", "--part", PART, "--latency-ms", "0.5", "--json", "--out", "later")
    assert succeeded(scancell_here("reconstruct", *words, cwd=folder))["figures"]["latency_ms"] == pytest.approx(0.5)
    done = scancell_here("reconstruct", "points.csv", "--latency-ms", "soon", "--json", "--out", "no", cwd=folder)
    assert done.code == 1 and "--latency-ms" in done.message
    assert not (folder / "no").exists()


def test_real_run_is_not_repeated_by_simulation(folder) -> None:
    succeeded(scancell_here("reconstruct", "points.csv", "--part", PART, "--json", "--out", "real", cwd=folder))
    done = scancell_here("rerun", "real", "--json", "--out", "again", cwd=folder)
    assert done.code == 1 and "real measurements" in done.message
    assert not (folder / "again").exists()
