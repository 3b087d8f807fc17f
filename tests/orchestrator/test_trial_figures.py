"""Figures of a sphere in the cloud of a trial, against spheres of known place, size and form; memory of a worker."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

from scancell.config.study import FittedSphereDescription
from scancell.reconstruction.cloud import Cloud
from scancell.studies.study import _sphere_figures

SPHERE = FittedSphereDescription(name="ball", centre_mm=(10.0, 20.0, 30.0), radius_mm=12.5, above_mm=25.0, reach_mm=1.0)


def cloud(points: np.ndarray) -> Cloud:
    n = len(points)
    integers = np.zeros(n, np.int32)
    return Cloud(
        points_in_part=points,
        normals=np.tile([0.0, 0.0, 1.0], (n, 1)),
        sigma=np.full(n, 1e-6, np.float32),
        intensity=np.ones(n, np.float32),
        quality=np.ones(n, np.float32),
        camera=integers,
        column=integers,
        profile=integers,
        segment=integers,
        time=np.zeros(n),
        saturated=np.zeros(n, bool),
    )


def ball(centre_mm: tuple[float, float, float], radius_mm: float, noise: float = 0.0, count: int = 5000) -> np.ndarray:
    rng = np.random.default_rng(1)
    direction = rng.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    distance = 1e-3 * radius_mm + noise * rng.standard_normal(count)
    return np.asarray(1e-3 * np.array(centre_mm) + distance[:, None] * direction)


def test_displacement_and_diameter_are_in_um() -> None:
    figures = _sphere_figures(SPHERE, cloud(ball((10.1, 19.95, 30.02), 12.52)))
    for name, value in {"x_um": 100.0, "y_um": -50.0, "z_um": 20.0, "diameter_error_um": 40.0}.items():
        assert figures[f"ball.{name}"] == pytest.approx(value, abs=1e-3)
    assert figures["ball.rms_um"] == pytest.approx(0.0, abs=1e-3)


def test_form_and_rms_are_those_of_the_noise() -> None:
    figures = _sphere_figures(SPHERE, cloud(ball((10.0, 20.0, 30.0), 12.5, noise=5e-6, count=20_000)))
    assert figures["ball.rms_um"] == pytest.approx(5.0, rel=0.05)
    assert figures["ball.form_um"] == pytest.approx(2 * 1.96 * 5.0, rel=0.05)  # 95 % of a normal distribution


def test_points_below_and_far_away_are_left_out() -> None:
    points = ball((10.0, 20.0, 30.0), 12.5)
    kept = points[points[:, 2] >= 0.025]
    foot = np.column_stack([np.linspace(0, 0.02, 50), np.full(50, 0.02), np.full(50, 0.01)])
    other = ball((10.0, 20.0, 30.0), 13.6)
    assert _sphere_figures(SPHERE, cloud(np.concatenate([points, foot, other])))["ball.points"] == len(kept)


@pytest.mark.parametrize("count", [0, 9])
def test_too_few_points_give_no_figures(count) -> None:
    points = ball((10.0, 20.0, 30.0), 12.5)
    figures = _sphere_figures(SPHERE, cloud(points[points[:, 2] > 0.03][:count]))
    assert figures["ball.points"] == count
    assert figures["ball.diameter_error_um"] is None


def test_memory_of_a_process_grows_by_what_it_holds() -> None:
    # In a process of its own: one that has run other tests may hold free memory that an array takes.
    code = (
        "import numpy as np; from scancell.studies.study import _process; before = _process()['memory_mb'];"
        "held = np.ones(16_000_000); print(_process()['memory_mb'] - before, 1e-6 * held.nbytes)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    grown, held = map(float, done.stdout.split())
    assert grown == pytest.approx(held, rel=0.1)
