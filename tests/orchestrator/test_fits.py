"""Fits of geometric elements: known truth, honest covariance, optimality of minimum zones, degenerate points."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from scancell.errors import FitError
from scancell.geometry import fits

FITS = {
    "line": fits.fit_line,
    "plane": fits.fit_plane,
    "circle": fits.fit_circle,
    "sphere": fits.fit_sphere,
    "cylinder": fits.fit_cylinder,
    "cone": fits.fit_cone,
}
FREE = {"line": 4, "plane": 3, "circle": 6, "sphere": 4, "cylinder": 5, "cone": 6}
ZONES = [kind for kind in FITS if kind != "line"]
HALF_ANGLE = 0.3
RADIUS = 0.02


def surface(kind: str, rng: np.random.Generator, count: int, noise: float, arc: float = 2 * np.pi) -> np.ndarray:
    """Points (count, 3), m, of an element of about 20 mm, displaced along the normal."""
    turn, height = rng.uniform(0, arc, count), rng.uniform(-0.03, 0.03, count)
    off = noise * rng.standard_normal((count, 3))
    around = np.stack([np.cos(turn), np.sin(turn), np.zeros(count)], 1)
    up = np.array([0.0, 0.0, 1.0])
    match kind:
        case "line":
            return height[:, None] * up + off * [1, 1, 0]
        case "plane":
            return np.stack([height, 0.02 * around[:, 0], off[:, 2]], 1)
        case "circle":
            return (RADIUS + off[:, :1]) * around + off[:, 1:2] * up
        case "sphere":
            ray = around * np.sqrt(1 - (height / 0.03) ** 2)[:, None] + (height / 0.03)[:, None] * up
            return (RADIUS + off[:, :1]) * ray
        case "cylinder":
            return (RADIUS + off[:, :1]) * around + height[:, None] * up
    radius = RADIUS + height * np.tan(HALF_ANGLE)
    normal = np.cos(HALF_ANGLE) * around - np.sin(HALF_ANGLE) * up
    return radius[:, None] * around + height[:, None] * up + off[:, :1] * normal


@pytest.mark.parametrize("kind", FITS)
def test_exact_points_give_the_element_anywhere_in_space(kind: str) -> None:
    rng = np.random.default_rng(1)
    for rotation, shift in zip(Rotation.random(20, rng=2), rng.uniform(-2, 2, (20, 3)), strict=True):
        points = surface(kind, rng, 60, 0.0, rng.uniform(0.7, 2 * np.pi))
        found = FITS[kind](rotation.apply(points) + shift)
        assert np.abs(found.residuals).max() < 1e-12
        if hasattr(found, "radius") and kind != "cone":
            assert found.radius == pytest.approx(RADIUS, abs=1e-10)
        if kind in {"line", "cylinder", "cone"}:
            assert np.linalg.norm(np.cross(found.direction, rotation.apply([0, 0, 1]))) < 1e-9
        if kind == "cone":
            apex = rotation.apply([0, 0, -RADIUS / np.tan(HALF_ANGLE)]) + shift
            assert np.abs(found.apex - apex).max() < 1e-9
            assert found.half_angle == pytest.approx(HALF_ANGLE, abs=1e-9)


@pytest.mark.parametrize("kind", [fits.CircleInPlane, *(getattr(fits, kind.capitalize()) for kind in FITS)])
def test_derivatives_of_distances_are_those_of_finite_steps(kind: type[fits.Element]) -> None:
    rng = np.random.default_rng(3)
    sizes = np.array([RADIUS, HALF_ANGLE])[: len(kind.lengths)]
    element = kind(rng.uniform(-0.1, 0.1, 3), Rotation.random(rng=4).as_matrix(), sizes)
    points = element.origin + rng.uniform(-0.05, 0.05, (30, 3))
    derivatives = element.linearised(points)[1]
    for column, step in zip(derivatives.T, 1e-6 * np.eye(derivatives.shape[1]), strict=True):
        behind, ahead = (element.moved(sign * step).linearised(points)[0] for sign in (-1, 1))
        np.testing.assert_allclose(column, (ahead - behind) / 2e-6, atol=1e-6)


@pytest.mark.parametrize("kind", FITS)
def test_fit_moves_with_the_points(kind: str) -> None:
    rng = np.random.default_rng(3)
    points = surface(kind, rng, 200, 20e-6)
    rotation, shift = Rotation.random(rng=4), np.array([0.4, -1.1, 0.7])
    here, there = FITS[kind](points), FITS[kind](rotation.apply(points) + shift)
    sign = 1.0 if kind != "plane" else np.sign(rotation.apply(here.normal) @ there.normal)
    assert np.abs(here.residuals - sign * there.residuals).max() < 1e-12


@pytest.mark.parametrize(("kind", "source"), [*((kind, "given") for kind in FITS), ("sphere", "residuals")])
def test_covariance_predicts_the_scatter_of_fits(kind: str, source: str) -> None:
    """Mahalanobis distances from the truth follow chi-square: 95 % regions contain 91 … 99 % of 200 draws."""
    rng = np.random.default_rng(5)
    noise = 10e-6
    truth = FITS[kind](surface(kind, np.random.default_rng(6), 400, 0.0))
    inside = 0
    for _ in range(200):
        points = surface(kind, rng, 120, noise)
        found = FITS[kind](points, noise if source == "given" else None)
        difference = found.parameters - parameters_of_truth_at(kind, truth, found)
        value, axis = np.linalg.eigh(found.covariance)
        kept = value > 1e-9 * value[-1] if kind != "cone" else np.arange(len(value)) >= len(value) - FREE[kind]
        distance = float(np.sum((axis[:, kept].T @ difference) ** 2 / value[kept]))
        inside += distance < chi2.ppf(0.95, FREE[kind])
    assert 182 <= inside <= 198, inside


def parameters_of_truth_at(kind: str, truth: fits.Fit, found: fits.Fit) -> np.ndarray:
    """Parameters of the true element with its reference point next to that of the fit."""
    there = truth.parameters.copy()
    point = found.parameters[:3]
    if kind in {"line", "cylinder", "cone"}:
        along = (point - there[:3]) @ there[3:6]
        there[:3] += along * there[3:6]
        if kind == "cone":
            there[6] += along * np.sin(there[7])
    if kind == "plane":
        there[:3] = point - ((point - there[:3]) @ there[3:6]) * there[3:6]
    return there


@pytest.mark.parametrize("kind", ZONES)
def test_minimum_zone_touches_enough_points(kind: str) -> None:
    """Chebyshev's condition: the extreme distance occurs at one point more than there are parameters, on both sides."""
    rng = np.random.default_rng(7)
    free = 3 if kind == "circle" else FREE[kind]
    for _ in range(5):
        points = surface(kind, rng, 500, 20e-6, rng.uniform(1.5, 2 * np.pi))
        squares, zone = FITS[kind](points), FITS[kind](points, criterion="minimum zone")
        extreme = np.abs(zone.residuals).max()
        touching = np.abs(zone.residuals) > extreme * (1 - 1e-6)
        assert zone.form < squares.form
        assert zone.form == pytest.approx(2 * extreme, rel=1e-9)
        assert touching.sum() == free + 1
        assert len(np.unique(np.sign(zone.residuals[touching]))) == 2


def test_minimum_zone_of_a_wave_is_its_amplitude() -> None:
    """A cylinder with lobes: the least largest deviation is the amplitude, whatever the mean of the lobes."""
    turn = np.linspace(0, 2 * np.pi, 720, endpoint=False)
    for lobes, amplitude in ((3, 5e-6), (5, 20e-6)):
        radius = RADIUS + amplitude * np.cos(lobes * turn)
        ring = np.stack([radius * np.cos(turn), radius * np.sin(turn), np.zeros_like(turn)], 1)
        points = np.concatenate([ring + np.array([0, 0, z]) for z in (-0.01, 0.0, 0.01)])
        assert fits.fit_cylinder(points, criterion="minimum zone").form == pytest.approx(2 * amplitude, rel=1e-6)
        assert fits.fit_circle(ring, criterion="minimum zone").form == pytest.approx(2 * amplitude, rel=1e-6)


def test_flatness_of_a_saddle() -> None:
    """The minimum zone of four corners raised and lowered by h in turn is 2 h wide."""
    corners = np.array([[1, 1, 1e-5], [-1, 1, -1e-5], [-1, -1, 1e-5], [1, -1, -1e-5]]) * [0.1, 0.1, 1]
    assert fits.fit_plane(corners, criterion="minimum zone").form == pytest.approx(2e-5, rel=1e-9)


@pytest.mark.parametrize("kind", FITS)
def test_degenerate_points_are_rejected(kind: str) -> None:
    along = np.linspace(0, 1, 20)[:, None]
    same, straight = np.ones((20, 3)), along * [1.0, 2.0, 3.0]
    flat = np.concatenate([straight, straight + [0.0, 0.3, 0.1] * along**2])
    cases = {"at one point": same}
    if kind != "line":
        cases["on one line"] = straight
    if kind in {"sphere", "cylinder", "cone"}:
        cases["in one plane"] = flat
    for reason, points in cases.items():
        with pytest.raises(FitError, match=reason):
            FITS[kind](points)
    with pytest.raises(FitError, match="needed"):
        FITS[kind](same[:1])
    with pytest.raises(FitError, match="finite"):
        FITS[kind](np.full((20, 3), np.nan))


def test_cone_needs_two_sections() -> None:
    turn = np.linspace(0, 2 * np.pi, 40, endpoint=False)
    ring = np.stack([np.cos(turn), np.sin(turn), np.zeros_like(turn)], 1)
    assert fits.fit_cone(np.concatenate([ring, 2 * ring + np.array([0, 0, 1])])).half_angle == pytest.approx(np.pi / 4)
    with pytest.raises(FitError, match="in one plane"):
        fits.fit_cone(ring)


def test_too_few_points_for_a_covariance_from_residuals() -> None:
    points = surface("sphere", np.random.default_rng(8), 4, 1e-6)
    assert np.isnan(fits.fit_sphere(points).covariance).all()
    assert np.isfinite(fits.fit_sphere(points, 1e-6).covariance).all()
