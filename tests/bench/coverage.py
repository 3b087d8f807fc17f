"""Coverage of coverage-driven views, of passes and of the default scan: ``python -m bench.coverage [PART ...]``.

PYTHONPATH=tests. Every part is scanned with the geometric engine, and the cloud is evaluated by the fixed definition of
the measurable surface (docs/coverage.md). The passes over the top (boustrophedon) move at the speed at which their scan
lasts as long as the coverage-driven one. Distributions are over the covered samples of the measurable surface: of the
nearest point of the cloud, the angle of the laser ray to the surface normal, and the distance over the surface between
its profile and the next.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from scancell.config.files import assets_dir
from scancell.geometry import pose
from scancell.results import ScanResult
from scancell.scanner import Scanner

Array = NDArray[np.float64]

PARTS = ("free_form", "machined", "sphere_on_foot", "step_block")
PROFILES = 4000  # at most, for all ways to scan
_FASTEST, _SLOWEST = 300.0, 1.0  # mm/s


@dataclass(frozen=True)
class Row:
    """One scan: shares of the measurable surface, s, deg and mm."""

    part: str
    way: str
    coverage: float
    duration: float
    profiles: int
    views: int
    planning: float
    incidence: Array
    spacing: Array
    foreseen: float = np.nan
    least_time: float = np.nan


def run_part(part: Path, share: float = 0.99) -> list[Row]:
    """Coverage-driven scan, passes in the same time, and the default scan."""
    return [*chosen_and_passes(part, share), _scan(part, "default sweeps and passes", {"scan.max_profiles": PROFILES})]


def chosen_and_passes(part: Path, share: float = 0.99) -> tuple[Row, Row]:
    """Coverage-driven scan, and passes in the same time."""
    settings = {"scan.max_profiles": PROFILES}
    chosen = _scan(part, "coverage-driven", {**settings, "scan.coverage.enabled": True, "scan.coverage.share": share})
    passes = {**settings, "scan.sweep.enabled": False}
    speed = _speed_for(part, passes, chosen.duration)
    return chosen, _scan(part, "passes in equal time", {**passes, "scan.raster.speed_mm_s": speed})


def _scan(part: Path, way: str, settings: dict[str, float | int | str | bool]) -> Row:
    with Scanner(settings=settings) as scanner:
        scanner.pipeline.load(scanner.setup, scanner.load_part(part))
        start = time.perf_counter()
        plan = scanner.plan(part)
        planning = time.perf_counter() - start
        result = scanner.scan(part, engine="geometric", samples=False)
    incidence, spacing = distributions(result)
    report = plan.report
    return Row(
        part.stem, way, result.coverage.fraction, plan.program.duration, len(plan.q), len(np.unique(plan.segment)),
        planning, incidence, spacing,
        *((report.share, report.least_time) if report else ()),
    )  # fmt: skip


def _speed_for(part: Path, settings: dict[str, float | int | str | bool], duration: float) -> float:
    """Speed of passes (mm/s) at which their plan lasts as long, by bisection; the fastest that is tried otherwise."""
    low, high = _SLOWEST, _FASTEST
    with Scanner(settings={**settings, "scan.verify": False}) as scanner:
        for _ in range(9):
            speed = float(np.sqrt(low * high))
            scan = scanner.setup.scan.replace({"raster.speed_mm_s": speed})
            longer = scanner.plan(part, setup=replace(scanner.setup, scan=scan)).program.duration > duration
            low, high = (speed, high) if longer else (low, speed)
    return float(high)


def distributions(result: ScanResult) -> tuple[Array, Array]:
    """Incidence (deg) and spacing of profiles (mm) at every covered sample of the measurable surface."""
    covered = result.coverage.covered & result.measurable.measurable
    samples, normals = result.measurable.samples[covered], result.measurable.normals[covered]
    nearest = cKDTree(result.cloud.points_in_part).query(samples)[1]
    profile = result.cloud.profile[nearest]
    measured = result.recording.measured
    poses = result.nominal.part_from_sensor(measured.axes)
    row = np.searchsorted(measured.index, profile)
    source = poses[row][:, :3, 3]
    ray = source - samples
    cosine = (ray * normals).sum(1) / np.linalg.norm(ray, axis=1)
    # The neighbouring profile of the same segment; a sample lies in the sheet of its own profile.
    other = np.where(measured.segment[np.minimum(row + 1, len(poses) - 1)] == measured.segment[row], row + 1, row - 1)
    other = np.clip(other, 0, len(poses) - 1)
    beside = pose.transform_each(pose.inverse(poses[other]), samples)[:, 0]
    beside -= pose.transform_each(pose.inverse(poses[row]), samples)[:, 0]
    across = poses[row][:, :3, 0]
    slope = np.sqrt(np.maximum(1 - (across * normals).sum(1) ** 2, 1e-6))
    return np.degrees(np.arccos(np.clip(cosine, -1, 1))), 1e3 * np.abs(beside) / slope


def table_of(rows: list[Row]) -> Iterator[str]:
    """Markdown table."""
    yield (
        "| part | views | coverage | time | profiles | incidence 50 / 95 % | spacing 50 / 95 % | planned share |"
        " least time | planning |"
    )
    yield "|---|---|---|---|---|---|---|---|---|---|"
    for row in rows:
        angle = "{:.0f} / {:.0f}°".format(*np.percentile(row.incidence, (50, 95)))
        spacing = "{:.2f} / {:.2f} mm".format(*np.percentile(row.spacing, (50, 95)))
        planned = "" if np.isnan(row.foreseen) else f"{100 * row.foreseen:.2f} %"
        least = "" if np.isnan(row.least_time) else f"{row.least_time:.0f} s"
        yield (
            f"| {row.part} | {row.views} {row.way} | {100 * row.coverage:.2f} % | {row.duration:.1f} s |"
            f" {row.profiles} | {angle} | {spacing} | {planned} | {least} | {row.planning:.1f} s |"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("part", nargs="*", type=Path, help="meshes; default: the sample parts")
    parts = parser.parse_args().part or [assets_dir() / "parts" / f"{name}.stl" for name in PARTS]
    rows = [row for part in parts for row in run_part(part)]
    print("\n".join(table_of(rows)))


if __name__ == "__main__":
    main()
