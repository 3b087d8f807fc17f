"""Pixels that one plane or two faces fill are integrated in closed form: compared with dense sampling."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scenes import Array, cluttered_exposures, moving, plane, pose, probe, still, stripe_centres

from scancell.sensor import Exposures, Material, Scene, Sensor, expected_electrons

DENSE = 1024
DN_PER_ELECTRON = 0.0225


def sampled(samples: int, **render: Any) -> Sensor:
    return probe(1, render={"noise": False, "samples_per_pixel": samples} | render)


def grid_mesh(spacing: float, amplitude: float) -> tuple[Array, NDArray[np.uint32]]:
    """Waves of `amplitude` (m) as triangles with edges of about `spacing` (m)."""
    count = round(0.06 / spacing)
    place = np.stack(np.meshgrid(np.linspace(-0.03, 0.03, count), np.linspace(-0.03, 0.03, count), indexing="ij"), -1)
    height = amplitude * np.sin(300 * place[..., 1] + 0.3) * np.cos(200 * place[..., 0])
    vertices = np.concatenate([place, height[..., None]], axis=-1).reshape(-1, 3)
    corner = (np.arange(count - 1)[:, None] * count + np.arange(count - 1)).ravel()
    lower = np.stack([corner, corner + count, corner + 1], 1)
    upper = np.stack([corner + 1, corner + count, corner + count + 1], 1)
    return vertices, np.concatenate([lower, upper]).astype(np.uint32)


def exposures_of(place: Array, moves: bool) -> Exposures:
    """A shift and a turn by up to 0.9 px at the ends of the line during the exposure, or none."""
    later: Array = pose((1.2e-5, -8e-6, 8e-6), (8e-5, 4e-5, 8e-5)) @ place
    return moving([[place], [later]], [np.eye(4)] * 2) if moves else still(place)


def assert_matches_dense_sampling(scene: Scene, exposures: Exposures, **render: Any) -> None:
    light = expected_electrons(scene, sampled(16, **render), exposures)[0, 0].astype(np.float64)
    plain = expected_electrons(scene, sampled(16, **render), exposures, closed_form=False)[0, 0]
    dense = expected_electrons(scene, sampled(DENSE, **render), exposures, closed_form=False)[0, 0].astype(np.float64)
    assert (light != plain).sum() > 2500  # the closed form is used
    bright = dense > 0.01 * dense.max()
    error, peak = np.abs(light - dense), dense.max()
    relative = (error / (dense + 0.1 * peak))[bright]
    assert np.quantile(relative, 0.99) < 1e-3
    assert relative.max() < 3e-3
    (centre, total), (true_centre, true_total) = stripe_centres(light), stripe_centres(dense)
    whole = true_total > 0.5 * np.median(true_total[true_total > 0])
    assert whole.sum() > 300
    assert np.abs(centre - true_centre)[whole].max() < 1e-3
    np.testing.assert_allclose(total[whole], true_total[whole], rtol=1e-3)


@pytest.mark.parametrize("moves", [False, True])
@pytest.mark.parametrize("angles", [(0.25, -0.2, 0.4), (-0.5, 0.4, 0.0)])
@pytest.mark.parametrize("z", [0.08, 0.155])
def test_plane_matches_dense_sampling(z: float, angles: tuple[float, float, float], moves: bool) -> None:
    scene = plane(size=0.1)
    assert_matches_dense_sampling(scene, exposures_of(pose((0, 0, z), angles), moves))


@pytest.mark.parametrize("moves", [False, True])
@pytest.mark.parametrize("amplitude", [5e-5, 5e-4])
@pytest.mark.parametrize("spacing", [2e-4, 1e-3])
def test_faceted_surface_matches_dense_sampling(spacing: float, amplitude: float, moves: bool) -> None:
    """Edges between faces cross many pixels; with the larger amplitude they form angles of some degrees."""
    scene = Scene()
    scene.add_mesh("waves", *grid_mesh(spacing, amplitude), 0.5)
    assert_matches_dense_sampling(scene, exposures_of(pose((0, 0, 0.13), (0.1, 0.2, 0.3)), moves))


@pytest.mark.parametrize("model", ["oren_nayar", "rough_conductor", "rough_dielectric"])
def test_materials_match_dense_sampling(model: str) -> None:
    scene = Scene()
    scene.add_mesh("waves", *grid_mesh(1e-3, 5e-5), Material(0.6, model, 0.2, 1.5))
    assert_matches_dense_sampling(scene, exposures_of(pose((0, 0, 0.13), (0.1, 0.25, 0.3)), True))


def test_ambient_light_is_included() -> None:
    scene = plane(size=0.1)
    exposures = still(pose((0, 0, 0.13), (0.1, 0.2, 0.3)))
    sensor = probe(1, ambient={"irradiance": 2.0})
    light = expected_electrons(scene, sensor, exposures)[0, 0]
    plain = expected_electrons(scene, sensor, exposures, closed_form=False)[0, 0]
    stripe = plain > 2 * np.median(plain)
    assert stripe.sum() > 4000
    np.testing.assert_allclose(light, plain, atol=0.02 * plain.max())
    np.testing.assert_allclose(light[stripe].sum(), plain[stripe].sum(), rtol=1e-3)


def test_cluttered_scene_is_within_one_digital_number() -> None:
    scene, exposures = cluttered_exposures(False)
    light = expected_electrons(scene, probe(), exposures)
    plain = expected_electrons(scene, probe(), exposures, closed_form=False)
    lit = plain > 0
    assert np.mean(np.abs(light - plain) * DN_PER_ELECTRON <= 1.0) > 0.999
    assert np.mean(np.abs(light - plain)[lit] * DN_PER_ELECTRON <= 1.0) > 0.98
    assert light.sum() == pytest.approx(plain.sum(), rel=1e-4)


@pytest.mark.parametrize("case", ["speckle", "accelerated"])
def test_samples_stay_where_closed_form_does_not_hold(case: str) -> None:
    """Speckle varies within a pixel; accelerated motion is not linear in time."""
    scene = plane(size=0.1)
    place = pose((0, 0, 0.13), (0.1, 0.2, 0.3))
    exposures, sensor = still(place), probe(1)
    if case == "speckle":
        sensor = probe(1, speckle={"contrast": 0.8})
    else:
        steps = [[pose((shift, 0, 0)) @ place] for shift in (0.0, 0.0, 1e-5)]
        exposures = moving(steps, [np.eye(4)] * 3)
    light = expected_electrons(scene, sensor, exposures)
    np.testing.assert_array_equal(light, expected_electrons(scene, sensor, exposures, closed_form=False))
