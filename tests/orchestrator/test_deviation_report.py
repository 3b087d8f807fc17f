"""The report of a deviation: its sentence agrees with the figures, and no outlier or bare surface is left out."""

from __future__ import annotations

import html
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cells import cloud_of

import scancell
from scancell.evaluation import deviation
from scancell.evaluation.deviation import Deviation, UnseenSurface, deviation_from_mesh, find_outliers, unseen_surface
from scancell.geometry.mesh import box_mesh, sample_surface
from scancell.output.deviation_report import DeviationReport, um_text

BOX = box_mesh((0.08, 0.06, 0.04))
NOISE = 5e-6
WILD = np.array([[0.0, 0.0, 0.0215], [0.03, 0.02, 0.0209], [0.041, 0.0, 0.0], [0.0, 0.2, 0.0]])


def cloud_with(wild: np.ndarray, count: int = 20_000) -> np.ndarray:
    """Points on the box with noise along its normals, and the wild ones at the end."""
    points, face = sample_surface(BOX, count, 3)
    noise = np.random.default_rng(1).normal(0.0, NOISE, (count, 1))
    return np.concatenate([points + noise * BOX.normals[face], wild])


def report_of(points: np.ndarray, name: str = "box", share: float = 0.9) -> DeviationReport:
    deviation = deviation_from_mesh(cloud_of(points), BOX)
    samples, _ = sample_surface(BOX, 1000, 0)
    covered = np.arange(1000) >= 100
    bare = UnseenSurface.without_reason(samples, covered, float(BOX.areas.sum()), 1e-3, "nobody looked")
    return DeviationReport(name, points, deviation, BOX, bare, (share, "surface"))


@pytest.fixture(scope="module")
def scan() -> scancell.ScanResult:
    part = scancell.assets_dir() / "parts" / "step_block.stl"
    return scancell.scan(part, engine="geometric", settings={"scan.max_profiles": 150})


def written(report: DeviationReport, folder: Path) -> str:
    assert report.write(folder / "report.html") == (folder / "report.html").stat().st_size
    return (folder / "report.html").read_text(encoding="utf-8")


def listed_positions(text: str) -> np.ndarray:
    """Positions of the places in the table of outliers, m."""
    return np.array([[float(value) for value in at.split(",")] for at in re.findall(r'data-at="([^"]*)"', text)])


def test_every_outlier_stands_in_the_list(tmp_path: Path) -> None:
    points = cloud_with(WILD)
    deviation = deviation_from_mesh(cloud_of(points), BOX)
    outliers = find_outliers(points, deviation.distance, BOX)
    assert set(range(20_000, 20_004)) <= set(outliers.rows.tolist())
    assert sum(place.count for place in outliers.places) == len(outliers.rows)
    at = listed_positions(written(report_of(points), tmp_path))
    assert len(at) == len(outliers.places)
    away = np.linalg.norm(points[outliers.rows][:, None] - at, axis=-1).min(1)
    assert away.max() <= outliers.reach * (1 + 1e-9)
    for wild in WILD:
        assert np.linalg.norm(at - wild, axis=1).min() < 1e-6
    # The largest deviations stand first.
    assert np.argmin(np.linalg.norm(at - WILD[3], axis=1)) == 0


def test_noise_alone_has_hardly_any_outliers() -> None:
    """Five standard deviations: 6 of 10 million normal values lie beyond."""
    points = cloud_with(np.zeros((0, 3)), 50_000)
    distance = np.random.default_rng(2).normal(1e-3, NOISE, 50_000)
    assert len(find_outliers(points, distance, BOX).rows) <= 2
    assert len(find_outliers(points, np.full(50_000, 1e-17), BOX).rows) == 0


def test_verdict_agrees_with_the_figures(tmp_path: Path) -> None:
    points = cloud_with(WILD)
    report = report_of(points, share=0.875)
    text = written(report, tmp_path)
    verdict = html.unescape(re.search(r'<p id="verdict">(.*?)</p>', text)[1])
    figures = report.deviation.figures
    assert f"{figures.count:,} points lie within {um_text(figures.d95)}" in verdict
    assert "12.5 % of the surface has no points" in verdict
    wild = find_outliers(points, report.deviation.distance, BOX)
    assert f"{len(wild.rows)} outliers at {len(wild.places)} places" in verdict
    assert verdict.count(".") == len(re.findall(r"\d\.\d", verdict)) + 1  # one sentence


def test_verdict_without_outliers_and_without_points() -> None:
    report = report_of(cloud_with(np.zeros((0, 3)), 100))
    assert "no outliers" in report.verdict(find_outliers(report.points_in_part, report.deviation.distance, BOX))
    empty = replace(
        report,
        points_in_part=np.zeros((0, 3)),
        deviation=Deviation.of(cloud_of(WILD[:0]), np.zeros(0), np.zeros(0, int)),
    )
    assert "no point" in empty.verdict(find_outliers(WILD[:0], np.zeros(0), BOX))


def test_page_refers_to_nothing_outside_and_escapes_names(tmp_path: Path) -> None:
    text = written(report_of(cloud_with(WILD), "<b>&@DATA@"), tmp_path)
    assert not re.search(r"https?://|src=|href=|import\(|fetch\(|@import|url\(", text)
    assert not re.search(r"@(?!DATA@)[A-Z]+@", text)
    assert "<b>" not in text
    assert "<title>&lt;b&gt;&amp;@DATA@: deviation from CAD</title>" in text


@pytest.mark.parametrize("count", [1, 2])
def test_tiny_clouds_have_a_page(tmp_path: Path, count: int) -> None:
    assert "verdict" in written(report_of(cloud_with(WILD)[:count]), tmp_path)


def test_page_of_a_large_cloud_is_small_and_says_what_it_draws(tmp_path: Path) -> None:
    text = written(report_of(cloud_with(WILD, 400_000)), tmp_path)
    assert len(text) < 2_500_000
    assert re.search(r"120,000 of 400,004 points, evenly chosen, and all outliers are drawn", text)


def test_shares_of_unseen_surface_add_up_to_what_is_not_covered(scan: scancell.ScanResult) -> None:
    shares = scan.unseen.shares
    assert sum(shares.values()) == pytest.approx(1 - scan.coverage.surface_fraction)
    measurable = (scan.coverage.measurable & ~scan.coverage.covered).mean()
    others = {deviation.STANDS_ON, deviation.NOT_MEASURABLE}
    assert sum(share for reason, share in shares.items() if reason not in others) == pytest.approx(measurable)


def test_surface_on_which_the_part_stands_is_named(scan: scancell.ScanResult) -> None:
    part = scan.nominal.part
    lowest = part.vertices[part.faces][..., 2].max(1) < part.bounds[0, 2] + 1e-9
    share = part.areas[lowest].sum() / part.areas.sum()
    assert scan.unseen.shares[deviation.STANDS_ON] == pytest.approx(share, abs=0.015)


def test_what_the_scan_measured_is_in_view_of_its_exposures(scan: scancell.ScanResult) -> None:
    """The judgement of exposures by rays agrees with the points of the geometric engine."""
    none = replace(scan.coverage, covered=np.zeros_like(scan.coverage.covered))
    margin = 1e-3 * scan.setup.scan.table_margin_mm
    poses, sensor = scan.part_from_sensor, scan.setup.sensor
    found = unseen_surface(none, scan.measurable, scan.nominal, sensor, poses, margin)
    in_view = np.isin(
        found.reason, [found.reasons.index(name) for name in (deviation.NO_POINT, deviation.TAKEN_FOR_TABLE)]
    )
    measured = scan.coverage.covered & scan.coverage.measurable
    assert in_view[measured].mean() > 0.9  # shadows end within the tolerance
    assert in_view[scan.coverage.measurable & ~measured].mean() < 0.1
    # From far away nothing is in range.
    far = poses.copy()
    far[:, :3, 3] += 10.0
    away = unseen_surface(none, scan.measurable, scan.nominal, sensor, far, margin)
    assert set(away.shares) <= {deviation.STANDS_ON, deviation.NOT_MEASURABLE, deviation.NOT_CROSSED}
