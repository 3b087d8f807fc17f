"""Programme and statistics of acceptance tests."""

from __future__ import annotations

import numpy as np
import pytest

from scancell.config.loading import Setup, assets_dir, load_setup
from scancell.evaluation.artefact import evaluate_against_artefact
from scancell.evaluation.characteristics import faces_of
from scancell.geometry.mesh import sample_surface
from scancell.geometry.shapes import Sphere
from scancell.studies.acceptance.measure import (
    ALL_ROUND,
    Programme,
    Samples,
    Station,
    Trial,
    _undetermined,
    artefact_scale,
    scaled_artefact,
    stations,
)
from scancell.studies.acceptance.report import contributions, figure_row, largest_rows
from scancell.studies.factors import Inputs

SENSORS = ("two_camera_probe", "short_range_8", "medium_range_50", "long_range_400")
ARTEFACTS = Programme().artefacts


def setup_with(sensor: str = "two_camera_probe") -> Setup:
    return load_setup(sensor=assets_dir() / "sensors" / f"{sensor}.toml")


@pytest.mark.parametrize("sensor", SENSORS)
@pytest.mark.parametrize("name", ARTEFACTS)
def test_visible_surface_lies_in_the_measuring_range_at_every_position(sensor: str, name: str) -> None:
    """What faces the sensor within 66 deg of its axis: from the top of the artefact to its lowest measured point."""
    setup = setup_with(sensor)
    artefact = scaled_artefact(name, artefact_scale(setup))
    near, far = 1e-3 * setup.sensor.range.near_mm, 1e-3 * setup.sensor.range.far_mm
    mesh = artefact.mesh(50e-6)
    top = mesh.bounds[1, 2]
    points, faces = sample_surface(mesh, 4000, 7)
    signed, _, number = artefact.nearest(points)
    measured = np.array([one.role == "measured" for one in artefact.shapes])
    seen = (mesh.normals[faces][:, 2] > 0.42) & measured[number] & (signed > -1e-4)
    found = list(stations(name, artefact, setup, Programme()))
    assert {one.mode for one in found} == {"dynamic", "stop-and-look"}
    for station in found:
        distance = station.standoff + top - points[seen, 2]
        assert near < distance.min()
        assert distance.max() < far
    standoffs = {one.standoff for one in found if one.position != ALL_ROUND}
    assert len(standoffs) == 3
    assert max(standoffs) - min(standoffs) > 0.2 * (far - near)


def test_artefact_keeps_its_shape_when_made_smaller() -> None:
    """A ball bar of a fifth of the size: diameters and spacing of a fifth, measured exactly."""
    small, shipped = (scaled_artefact("ball_bar", scale) for scale in (0.2, 1.0))
    balls, of_shipped = faces_of(small), faces_of(shipped)
    assert [one.size for one in balls] == pytest.approx([0.2 * one.size for one in of_shipped])
    spacing = np.linalg.norm(balls[0].point - balls[1].point)
    assert spacing == pytest.approx(0.2 * np.linalg.norm(of_shipped[0].point - of_shipped[1].point))
    rng = np.random.default_rng(0)
    directions = rng.normal(size=(4000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    points = np.concatenate([ball.point + ball.size * directions for ball in balls])
    found = evaluate_against_artefact(points, small, guard=0.2e-3)
    errors = {one.name: one.error for one in found.characteristics}
    assert abs(errors["sphere spacing"]) < 1e-12
    assert abs(errors["probing size"]) < 1e-12


@pytest.mark.parametrize(("cap_deg", "is_determined"), [(3.0, False), (40.0, True)])
def test_sphere_of_a_small_cap_is_not_determined(cap_deg: float, is_determined: bool) -> None:
    """By theory the radius of a cap of 3 deg with noise of 2 um is uncertain by some millimetres."""
    artefact = scaled_artefact("sphere", 1.0)
    (ball,) = (one for one in artefact.shapes if one.role == "measured")
    assert isinstance(ball.shape, Sphere)
    rng = np.random.default_rng(3)
    cosine, around = rng.uniform(np.cos(np.radians(cap_deg)), 1.0, 800), rng.uniform(0, 2 * np.pi, 800)
    sine = np.sqrt(1 - cosine**2)
    away = np.column_stack([sine * np.cos(around), sine * np.sin(around), cosine])
    radius = ball.shape.radius + rng.normal(0.0, 2e-6, 800)
    evaluation = evaluate_against_artefact(ball.frame_from_shape[:3, 3] + radius[:, None] * away, artefact, guard=0.0)
    found = _undetermined(evaluation)
    assert found == ({} if is_determined else {"ball": "ball: the points do not determine the probing size"})


def test_setup_of_a_station_has_its_views_alone() -> None:
    setup = setup_with()
    described = Setup(
        setup.cell, setup.sensor, setup.scan.replace({"coverage.enabled": True, "raster.speed_mm_s": 80.0})
    )
    passes = Station("plane", "near", 0.09, "stop-and-look").setup(described, 50).scan
    assert (passes.mode, passes.sweep.enabled, passes.raster.enabled) == ("stop-and-look", False, True)
    assert (passes.coverage.enabled, passes.max_profiles) == (False, 50)
    assert passes.sweep.standoff_mm == pytest.approx(90.0)
    assert passes.raster.speed_mm_s == 80.0
    assert Station("sphere", ALL_ROUND, 0.09, "dynamic").setup(described, 50).scan.sweep.enabled


def samples_of(rng: np.random.Generator, count: int, effect: dict[str, float], noise: float) -> list[Samples]:
    """Errors of a characteristic at three positions in two modes, with a known effect of the position."""
    found = []
    for position, shift in effect.items():
        for mode in ("dynamic", "stop-and-look"):
            errors = (shift + noise * rng.standard_normal(count)).tolist()
            station = Station("sphere", position, 0.1, mode)  # type: ignore[arg-type]
            found.append(Samples(station, "ball", "probing size", "um", 0.0, errors, list(range(count)), [0.5] * count))
    return found


def test_statistics_of_repeats() -> None:
    """Normal errors: mean, standard uncertainty and 95 % intervals as those of their distribution."""
    samples = samples_of(np.random.default_rng(1), 2000, {"near": 3.0}, 2.0)
    row = figure_row(samples[0])
    assert row["mean"] == pytest.approx(3.0, abs=0.2)
    assert row["standard_uncertainty"] == pytest.approx(2.0, rel=0.06)
    for name in ("interval_symmetric", "interval_shortest"):
        assert row[name] == pytest.approx((3.0 - 3.92, 3.0 + 3.92), abs=0.45)
    assert row["fit_uncertainty"] == pytest.approx(0.5)
    low, high = row["interval_shortest"]
    assert high - low <= np.ptp(row["interval_symmetric"]) + 1e-12


def test_largest_error_is_that_of_the_worst_position() -> None:
    rows = [
        figure_row(one)
        for one in samples_of(np.random.default_rng(2), 30, {"near": 1.0, "middle": 0.1, "far": -4.0}, 0.1)
    ]
    largest = largest_rows(rows)
    assert [row["mode"] for row in largest] == ["dynamic", "stop-and-look"]
    assert all(row["position"] == "far" and row["mean"] == pytest.approx(-4.0, abs=0.1) for row in largest)


def test_contributions_add_up_and_find_the_position() -> None:
    """Positions spread by a standard deviation of 2, repeats by 1: shares 4/5 and 1/5."""
    spread = 2.0 * np.sqrt(1.5)
    effect = {"near": -spread, "middle": 0.0, "far": spread}
    samples = samples_of(np.random.default_rng(3), 400, effect, 1.0)
    trials = [Trial(k, (), lambda setup: Inputs(setup, ())) for k in range(400)]
    (found,) = contributions(samples, trials, (), 0)
    shares = {row["factor"]: row["share"] for row in found["budget"]}
    assert sum(shares.values()) == pytest.approx(1.0)
    assert shares["position"] == pytest.approx(0.8, abs=0.03)
    assert shares["repeatability"] == pytest.approx(0.2, abs=0.03)
    assert shares["mode"] < 0.01


def test_contribution_of_a_drawn_factor() -> None:
    """Errors of three times a drawn factor, of variance 9, and noise of variance 1."""
    rng = np.random.default_rng(4)
    drawn = rng.standard_normal(400)
    samples = samples_of(rng, 400, {"near": 0.0, "far": 0.0}, 1.0)
    for one in samples:
        one.errors = (np.array(one.errors) + 3.0 * drawn).tolist()
    trials = [Trial(k, (float(drawn[k]),), lambda setup: Inputs(setup, ())) for k in range(400)]
    (found,) = contributions(samples, trials, ("tool.x",), 0)
    shares = {row["factor"]: row["share"] for row in found["budget"]}
    assert shares["tool.x"] == pytest.approx(0.9, abs=0.03)
