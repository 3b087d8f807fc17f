"""Light below translucent surfaces: energy, widths, displacement, and the fast mode against random walks."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scenes import COARSE, pose, probe, still
from stripe_images import accepted, make_sensor

from scancell.sensor import Material, Scene, expected_electrons, extract, render

Array = NDArray[np.float64]

MARBLE = 2190.0  # reduced scattering coefficient in red light, 1/m (Jensen et al., SIGGRAPH 2001)
_FIRST, _COUNT = 210, 240  # rows of the camera
_ROWS = np.arange(float(_COUNT))
_CAMERA = COARSE | {"width_px": 16, "cx_px": 7.5, "height_px": _COUNT, "cy_px": COARSE["cy_px"] - _FIRST}


def translucent(scattering: float, reflectance: float = 0.8, index: float = 1.5) -> Material:
    return Material(reflectance, "rough_dielectric", 0.5, index, scattering=scattering)


def profiles(
    material: Material,
    tilt: tuple[float, float] = (0.0, 0.0),
    samples: int = 16,
    mode: str = "fast",
    face: float = 0.12,
) -> Array:
    """Electrons (cameras, rows), mean of sixteen columns, of a thick block."""
    scene = Scene()
    to_middle = face + 0.1 / np.cos(tilt[0]) / np.cos(tilt[1])
    scene.add_box("block", pose((0, 0, to_middle), (*tilt, 0)), np.array([0.4, 0.4, 0.2]), material)
    sensor = probe(camera=_CAMERA, render={"noise": False, "mode": mode, "samples_per_pixel": samples})
    return expected_electrons(scene, sensor, still(np.eye(4)))[0].astype(float).mean(-1)


def spread(profile: Array) -> tuple[float, float, float]:
    """Sum, mean row and variance, px²."""
    total = profile.sum()
    mean = float((profile * _ROWS).sum() / total)
    return float(total), mean, float((profile * (_ROWS - mean) ** 2).sum() / total)


def quantiles(profile: Array) -> Array:
    """Rows above which 30, 50 and 70 % of the light lie."""
    return np.interp([0.3, 0.5, 0.7], np.cumsum(profile) / profile.sum(), _ROWS + 0.5)


def chandrasekhar_albedo(albedo: float) -> float:
    """Share of light along the normal that leaves a half-space of isotropic scatterers: 1 - sqrt(1 - a) H(1)."""
    nodes, weights = np.polynomial.legendre.leggauss(64)
    nodes, weights = (nodes + 1) / 2, weights / 2
    root, h = np.sqrt(1.0 - albedo), np.ones(64)

    def next_h(at: Array) -> Array:
        return 1.0 / (root + albedo / 2 * (weights * nodes * h / (nodes + at[:, None])).sum(1))

    for _ in range(500):
        h = next_h(nodes)
    return float(1.0 - root * next_h(np.ones(1))[0])


@pytest.mark.parametrize("albedo", [0.2, 0.5, 0.9, 0.99, 0.998])
def test_reflectance_of_half_space_follows_chandrasekhar(albedo: float) -> None:
    material = translucent(MARBLE, chandrasekhar_albedo(albedo), index=1.0)
    assert material.scattering_albedo == pytest.approx(albedo, rel=0.01)
    found = chandrasekhar_albedo(float(material.scattering_albedo or 0.0))
    assert found == pytest.approx(material.reflectance, rel=0.03)


@pytest.mark.parametrize("tilt", [(0.0, 0.0), (0.2, 0.5), (0.0, -0.9)])
def test_light_spreads_without_loss(tilt: tuple[float, float]) -> None:
    opaque = profiles(translucent(0.0), tilt)
    for scattering in (5e3, 2e4, 1e6):
        below = profiles(translucent(scattering), tilt)
        np.testing.assert_allclose(below.sum(1), opaque.sum(1), rtol=0.02)


def test_dense_medium_looks_like_opaque_base() -> None:
    opaque, dense = profiles(translucent(0.0)), profiles(translucent(1e6))
    for camera in range(2):
        assert spread(dense[camera])[1] == pytest.approx(spread(opaque[camera])[1], abs=0.005)
        assert spread(dense[camera])[2] == pytest.approx(spread(opaque[camera])[2], rel=0.05)


def test_spread_and_displacement_grow_with_mean_free_path() -> None:
    opaque = spread(profiles(translucent(0.0))[0])
    coarse = spread(profiles(translucent(1e4))[0])
    fine = spread(profiles(translucent(2e4))[0])
    assert (coarse[1] - opaque[1]) / (fine[1] - opaque[1]) == pytest.approx(2.0, rel=0.1)
    assert (coarse[2] - opaque[2]) / (fine[2] - opaque[2]) == pytest.approx(4.0, rel=0.1)


def test_stripe_appears_below_the_surface_in_both_cameras() -> None:
    opaque, below = profiles(translucent(0.0)), profiles(translucent(MARBLE))
    near = profiles(translucent(0.0), face=0.119)
    towards_sensor = spread(near[0])[1] - spread(opaque[0])[1]
    shifts = [spread(below[camera])[1] - spread(opaque[camera])[1] for camera in range(2)]
    assert shifts[0] == pytest.approx(shifts[1], rel=1e-6)
    assert 0.02 < -shifts[0] / towards_sensor < 0.5  # mm


@pytest.mark.parametrize(("index", "tilt"), [(1.5, (0.0, 0.0)), (1.5, (0.2, 0.5)), (1.0, (0.0, 0.3))])
def test_fast_mode_agrees_with_random_walks(index: float, tilt: tuple[float, float]) -> None:
    material = translucent(4e3, 0.3, index)
    fast = profiles(material, tilt)
    walks = profiles(material, tilt, samples=128, mode="path")
    for camera in range(2):
        # The fast mode has the albedo of a diffuse base at all angles.
        assert fast[camera].sum() == pytest.approx(walks[camera].sum(), rel=0.15)
        np.testing.assert_allclose(quantiles(fast[camera]), quantiles(walks[camera]), atol=0.15)


def test_extraction_locates_core_of_stripe_with_halo() -> None:
    lenient = {"max_residual": 0.3, "max_asymmetry": 0.3}
    rows = {}
    for name, material, duration in (("opaque", translucent(0.0), 2e-4), ("marble", translucent(MARBLE), 3e-3)):
        scene = Scene()
        scene.add_box("block", pose((0, 0, 0.15)), np.array([0.2, 0.2, 0.06]), material)
        sensor = make_sensor(cameras=2, extraction=lenient)
        peaks = extract(render(scene, sensor, still(np.eye(4), duration=duration)), sensor)
        assert accepted(peaks).mean() > 0.99
        rows[name] = [float(np.median(peaks.row[accepted(peaks) & (peaks.camera == camera)])) for camera in range(2)]
        noise = np.std(peaks.row[accepted(peaks)])
        assert noise < 0.06
    below = np.subtract(rows["marble"], rows["opaque"])
    assert below[0] == pytest.approx(below[1], abs=0.02)
    assert 0.3 < below[0] < 1.5


def test_neighbouring_opaque_body_stays_dark() -> None:
    edge = -0.0003  # m beside the middle of the sheet: its direct light ends before
    sensor = probe(camera=_CAMERA)

    def light(*bodies: tuple[float, float, Material | float]) -> Array:
        scene = Scene()
        for number, (left, right, material) in enumerate(bodies):
            middle = pose(((left + right) / 2, 0, 0.14))
            scene.add_box(f"body{number}", middle, np.array([right - left, 0.1, 0.04]), material)
        return expected_electrons(scene, sensor, still(*[np.eye(4)] * len(bodies)))[0].astype(float).mean(-1)

    marble = translucent(MARBLE)
    alone = light((edge, 0.1, marble))
    beside = light((edge, 0.1, marble), (-0.1, edge, 0.5))
    whole = light((-0.1, 0.1, marble))
    assert alone.sum() < 0.9 * whole.sum()
    np.testing.assert_allclose(beside.sum(1), alone.sum(1), rtol=5e-3)


@pytest.mark.parametrize(
    ("numbers", "name"),
    [
        ((0.5, "lambert", 0.3, 1.5), "scattering belongs to rough_dielectric"),
        ((0.91, "rough_dielectric", 0.3, 1.5), "reflectance"),
    ],
)
def test_invalid_medium_is_refused(numbers: tuple[float, str, float, float], name: str) -> None:
    with pytest.raises(ValueError, match=name):
        Material(*numbers, scattering=MARBLE)
    with pytest.raises(ValueError, match="scattering must lie in"):
        Material(0.5, "rough_dielectric", 0.3, 1.5, scattering=1.0)
