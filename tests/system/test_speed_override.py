"""Scans with a speed override: the same cloud, whatever the speed."""

from __future__ import annotations

import numpy as np
import pytest

import scancell
from scancell.cell.session import CellSession
from scancell.config.files import assets_dir
from scancell.reconstruction.cloud import Cloud

PART = assets_dir() / "parts" / "free_form.stl"


class RandomOverride:
    """Sets the monitor speed to a random value in [0.1, 1] at random intervals of 0.1 to 1 s."""

    def __init__(self, seed: int) -> None:
        self._random = np.random.default_rng(seed)
        self._next_us = 0
        self.speeds: list[float] = []

    def __call__(self, session: CellSession) -> None:
        cell = session.cell

        def change() -> None:
            if cell.time_us >= self._next_us:
                self.speeds.append(float(self._random.uniform(0.1, 1.0)))
                session.set_monitor_speed(self.speeds[-1])
                self._next_us = cell.time_us + round(1e6 * self._random.uniform(0.1, 1.0))

        cell.on_step(change)


def points_by_key(cloud: Cloud) -> dict[tuple[int, int, int], np.ndarray]:
    """Points by profile, camera and column of its image."""
    keys = zip(cloud.profile.tolist(), cloud.camera.tolist(), cloud.column.tolist(), strict=True)
    return dict(zip(keys, cloud.points_in_part, strict=True))


@pytest.mark.parametrize("path", ["sweep", "raster"])
def test_random_override_gives_the_same_cloud(path: str) -> None:
    """Sweeps of the table, exposures by its angle; passes of the sensor, exposures by path distance."""
    other = {"sweep": "raster", "raster": "sweep"}[path]
    settings = {"scan.max_profiles": 60, f"scan.{other}.enabled": False}
    override = RandomOverride(seed=11)
    with scancell.Scanner(settings=settings, ideal=True) as scanner:
        full = scanner.scan(PART, engine="geometric")
        slowed = scanner.scan(PART, engine="geometric", hook=override)
    assert len(override.speeds) > 10
    assert slowed.recording.measured.time[-1] > 1.3 * full.recording.measured.time[-1]
    first, second = points_by_key(full.cloud), points_by_key(slowed.cloud)
    common = sorted(first.keys() & second.keys())
    # A ray that grazes an edge may miss it in one of the scans.
    assert len(common) > 0.9999 * max(len(first), len(second)) > 50_000
    away = np.linalg.norm(np.array([first[key] - second[key] for key in common]), axis=1)
    # An exposure begins at a whole microsecond: at 0.1 m/s within 0.1 um of its place. Where rays graze the surface
    # a point is further away than its ray.
    assert np.mean(away > 1e-6) < 1e-4
    assert away.max() < 1e-5
    assert np.sqrt(np.mean(away**2)) < 1e-7
