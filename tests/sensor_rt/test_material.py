"""BRDFs: energy conservation, white furnace, limits, appearance in images; test_bsdfs.cpp tests their sampling."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scenes import Array, one_plane, plane, pose, probe, still, stripe_centres

from scancell.sensor import Material, expected_electrons, scan

MATERIALS = {
    "lambert": Material(1.0),
    "slightly rough diffuse": Material(1.0, "oren_nayar", 0.1, 1.0),
    "rough diffuse": Material(1.0, "oren_nayar", 0.9, 1.0),
    "glossy paint": Material(1.0, "rough_dielectric", 0.1, 1.5),
    "matt paint": Material(1.0, "rough_dielectric", 0.6, 1.4),
    "polished metal": Material(1.0, "rough_conductor", 0.1, 1.0),
    "brushed metal": Material(1.0, "rough_conductor", 0.35, 1.0),
    "blasted metal": Material(1.0, "rough_conductor", 1.0, 1.0),
    "foil": Material(1.0, "retro_reflective", 0.2, 1.0),
    "grooves along the light": Material(1.0, "grooved_conductor", 0.35, 1.0, 0.1, [1.0, 0.0, 0.0]),
    "grooves across the light": Material(1.0, "grooved_conductor", 0.35, 1.0, 0.1, [0.0, 1.0, 0.0]),
    "slanted grooves": Material(1.0, "grooved_conductor", 0.6, 1.0, 0.15, [1.0, 0.7, 0.0]),
}
COSINES = np.array([0.08, 0.25, 0.5, 0.8, 0.99])


def towards(cosine: Array | float, azimuth: Array | float) -> Array:
    """Unit vectors (..., 3) at an angle to +z."""
    sine = np.sqrt(1 - np.square(cosine))
    return np.stack(np.broadcast_arrays(sine * np.cos(azimuth), sine * np.sin(azimuth), cosine), axis=-1)


def sent_back(material: Material, cosine: float) -> float:
    """Reflectance for one direction of incidence, by quadrature over the hemisphere.

    Polar coordinates around the mirror direction, so that narrow lobes are resolved: the angle t to it is spread
    by t = pi s^3.
    """
    n = 300
    s = (np.arange(n) + 0.5) / n
    angle, azimuth = np.meshgrid(np.pi * s**3, 2 * np.pi * (np.arange(n) + 0.5) / n, indexing="ij")
    weight = np.sin(angle) * (3 * np.pi * s**2 / n)[:, None] * (2 * np.pi / n)
    mirror = towards(cosine, np.pi)
    side = np.array([0.0, 1.0, 0.0])
    third = np.cross(mirror, side)
    out = (
        np.cos(angle)[..., None] * mirror
        + np.sin(angle)[..., None] * (np.cos(azimuth)[..., None] * side + np.sin(azimuth)[..., None] * third)
    ).reshape(-1, 3)
    weight = np.where(out[:, 2] > 0, weight.ravel() * out[:, 2], 0.0)
    source = np.broadcast_to(towards(cosine, 0.0), out.shape)
    return float(np.sum(weight * material.pi_brdf(source, out)) / np.pi)


@pytest.mark.parametrize("name", MATERIALS)
def test_white_furnace(name: str) -> None:
    """A lossless surface reflects all light for every direction."""
    for cosine in COSINES:
        assert sent_back(MATERIALS[name], cosine) == pytest.approx(1.0, abs=5e-3)


@pytest.mark.parametrize("model", ["oren_nayar", "rough_dielectric", "rough_conductor"])
@pytest.mark.parametrize("roughness", [0.05, 0.3, 0.8])
@pytest.mark.parametrize("reflectance", [0.0, 0.3, 0.8])
def test_energy_is_conserved_and_albedo_matches_reflectance(model: str, roughness: float, reflectance: float) -> None:
    material = Material(reflectance, model, roughness, 1.5)
    measured = np.array([sent_back(material, cosine) for cosine in COSINES])
    assert measured.max() < 1.0
    np.testing.assert_allclose(material.albedo(COSINES), measured, atol=3e-3)


@pytest.mark.parametrize("cosine", COSINES)
def test_lambert_limits(cosine: float) -> None:
    rng = np.random.default_rng(4)
    out = towards(rng.uniform(0.01, 1, 200), rng.uniform(0, 2 * np.pi, 200))
    source = np.broadcast_to(towards(cosine, 0.0), out.shape)
    smooth = Material(0.37, "oren_nayar", 0.0, 1.0)
    np.testing.assert_allclose(smooth.pi_brdf(source, out), 0.37, rtol=1e-12)
    np.testing.assert_allclose(Material(0.37).pi_brdf(source, out), 0.37, rtol=1e-12)
    without_coat = Material(0.37, "rough_dielectric", 0.3, 1.0)
    np.testing.assert_allclose(without_coat.pi_brdf(source, out), 0.37, rtol=1e-9)


@pytest.mark.parametrize("index", [1.3, 1.5, 2.0])
def test_smooth_coat_reflects_by_fresnel(index: float) -> None:
    """At normal incidence ((n - 1) / (n + 1))^2; the base is black."""
    coat = Material(0.0, "rough_dielectric", 0.02, index)
    assert coat.albedo([1.0])[0] == pytest.approx(((index - 1) / (index + 1)) ** 2, rel=2e-3)


def scattered(count: int = 400) -> tuple[Array, Array]:
    """Pairs of directions (n, 3) above the surface."""
    rng = np.random.default_rng(8)
    a, b = (towards(rng.uniform(0.1, 1, count), rng.uniform(0, 2 * np.pi, count)) for _ in range(2))
    return a, b


@pytest.mark.parametrize("roughness", [0.1, 0.5, 1.0])
def test_grooves_of_equal_widths_are_rough_metal(roughness: float) -> None:
    a, b = scattered()
    grooved = Material(0.6, "grooved_conductor", roughness, 1.0, roughness, [0.3, 1.0, 0.0])
    plain = Material(0.6, "rough_conductor", roughness, 1.0)
    np.testing.assert_allclose(grooved.pi_brdf(a, b), plain.pi_brdf(a, b), rtol=3e-3, atol=1e-3)
    np.testing.assert_allclose(grooved.albedo(COSINES), plain.albedo(COSINES), atol=2e-3)


def test_lobe_is_as_wide_as_the_roughness_across_and_along_grooves() -> None:
    """Retro-reflection at an angle t sees D at a slope tan t: alpha where 1 + tan² t / alpha² = 2, D a quarter."""
    metal = Material(1.0, "grooved_conductor", 0.3, 1.0, 0.03, [1.0, 0.0, 0.0])
    for azimuth, width in ((0.0, 0.03), (np.pi / 2, 0.3)):
        top, side = (towards(np.cos(t), azimuth) for t in (0.0, np.arctan(width)))
        peak, half = metal.pi_brdf([top, side], [top, side])
        assert half / peak == pytest.approx(0.25 * (1 + width**2) ** 2, rel=0.1)


def test_grooves_follow_axis_and_circles() -> None:
    a, b = scattered()

    def grooved(axis: tuple[float, float, float], centre: tuple[float, float, float] | None = None) -> Array:
        return Material(0.6, "grooved_conductor", 0.4, 1.0, 0.1, axis, centre).pi_brdf(a, b)

    straight = grooved((1.0, 0.0, 0.0))
    # Length, sign and the part along the normal do not count.
    np.testing.assert_allclose(grooved((-2.0, 0.0, 5.0)), straight, rtol=1e-9)
    np.testing.assert_allclose(grooved((0.0, 0.0, 1.0), (0.0, 0.2, -3.0)), straight, rtol=1e-9)
    assert abs(grooved((0.0, 1.0, 0.0)) / straight - 1).max() > 0.5
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    turned = Material(0.6, "grooved_conductor", 0.4, 1.0, 0.1, (0.0, 1.0, 0.0)).pi_brdf(a @ turn.T, b @ turn.T)
    np.testing.assert_allclose(turned, straight, rtol=1e-9)


@pytest.mark.parametrize("grooves", [((0.0, 1.0, 0.0), None), ((0.0, 0.0, 1.0), (0.0, 0.004, 0.0))])
def test_grooved_plane_looks_alike_in_all_engines(
    grooves: tuple[tuple[float, float, float], tuple[float, float, float] | None],
) -> None:
    """A tilted plane; paths, the mesh of the lit surface and the geometric engine find the same grooves."""
    metal = Material(0.6, "grooved_conductor", 0.5, 1.0, 0.2, *grooves)
    world_from_plane = pose((0.001, 0.002, 0.12), (0.1, np.radians(-12.0), 0.7))
    light = []
    for mode in ("fast", "path"):
        sensor = probe(render={"mode": mode, "noise": False})
        image = expected_electrons(plane(metal), sensor, still(world_from_plane))[0]
        light.append([stripe_centres(one)[1] for one in image])
    np.testing.assert_allclose(light[0], light[1], rtol=5e-3, atol=1e-3 * np.max(light[1]))
    exposures, noisy = still(world_from_plane), probe(render={"noise": True})
    profiles = (
        scan(plane(metal), noisy, exposures, "ray-traced").profiles,
        scan(plane(metal), noisy, exposures, "geometric").profiles,
    )
    y = np.linspace(-0.01, 0.01, 21)
    for camera in range(2):
        traced, cast = ([p.intensity[p.camera == camera], p.points_in_sensor[p.camera == camera, 1]] for p in profiles)
        order = [np.argsort(one[1]) for one in (traced, cast)]
        seen = [np.interp(y, one[1][k], one[0][k]) for one, k in zip((traced, cast), order, strict=True)]
        np.testing.assert_allclose(seen[1], seen[0], rtol=0.05, atol=2.0)  # noise of the amplitude
        assert np.ptp(seen[1]) > 0.2 * seen[1].mean()


def test_mirror_samples_single_direction() -> None:
    out, weight, _ = Material(0.8, "mirror", 0.0, 1.0).sample([towards(0.6, 0.3)], [[0.1, 0.2, 0.3]])
    np.testing.assert_allclose(out[0], towards(0.6, 0.3 + np.pi), atol=1e-12)
    assert weight[0] == 0.8


@pytest.mark.parametrize("cosine", [0.5, 0.8, 1.0])
def test_retro_reflective_foil_sends_light_back(cosine: float) -> None:
    """The lobe surrounds the source whatever the incidence; metal of equal roughness has it at the mirror direction."""
    foil, metal = (Material(0.7, model, 0.1, 1.0) for model in ("retro_reflective", "rough_conductor"))
    source, mirror = towards(cosine, 0.3), towards(cosine, 0.3 + np.pi)
    back, forth = foil.pi_brdf([source, source], [source, mirror])
    if cosine < 1.0:
        assert forth < 0.01 * back
        assert foil.pi_brdf([source], [source])[0] > 100 * metal.pi_brdf([source], [source])[0]
    # D G2 / (4 cos²) at the top of the lobe, with D = 1 / (pi alpha²), and what the coupled rest adds.
    peak = 0.7 / (4 * 0.1**2 * cosine**2)
    assert 0.5 * peak < back < 1.02 * peak + 0.7
    np.testing.assert_allclose(foil.albedo(COSINES), 0.7, atol=2e-3)


def test_image_brightness_matches_brdf() -> None:
    """The light of a lit plane relative to a Lambertian one is pi times the BRDF between laser and camera."""
    material = Material(0.6, "rough_conductor", 0.3, 1.0)
    sensor = probe()
    world_from_plane = pose((0, 0, 0.12), (0.0, np.radians(-12.0), 0.0))
    seen = {}
    for surface in (0.5, material):
        scene = plane(surface)
        seen[surface] = expected_electrons(scene, sensor, still(world_from_plane))[0]
    for k, camera in enumerate(sensor.cameras):
        middle = slice(635, 645)
        ratio = stripe_centres(seen[material][k])[1][middle] / stripe_centres(seen[0.5][k])[1][middle]
        to_laser, to_camera = (
            (p - [0, 0, 0.12]) @ world_from_plane[:3, :3] for p in (np.zeros(3), camera.sensor_from_camera[:3, 3])
        )
        flip = np.diag([1.0, 1.0, -1.0])  # the plane's normal points away from both
        expected = material.pi_brdf([to_laser @ flip], [to_camera @ flip])[0] / 0.5
        np.testing.assert_allclose(ratio, expected, rtol=5e-3)


def test_uniform_light_on_lossless_surface_hides_shape() -> None:
    """White furnace in images: under ambient light all lossless surfaces look equal."""
    sensor = probe(laser={"power": 0.0}, ambient={"irradiance": 3.0})
    lambert = one_plane(sensor, pose((0, 0, 0.13)), 1.0)
    for material in (MATERIALS["rough diffuse"], MATERIALS["brushed metal"], MATERIALS["matt paint"]):
        scene = plane(material)
        image = expected_electrons(scene, sensor, still(pose((0, 0, 0.13))))[0]
        np.testing.assert_allclose(image, lambert, rtol=5e-3)


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        ((1.2, "lambert", 0.0, 1.0), "reflectance"),
        ((0.5, "rough_conductor", 0.0, 1.0), "roughness"),
        ((0.5, "oren_nayar", 1.5, 1.0), "roughness"),
        ((0.5, "rough_dielectric", 0.3, 0.5), "refractive_index"),
        ((0.5, "velvet", 0.3, 1.5), "velvet"),
        ((0.5, "grooved_conductor", 0.3, 1.5), "roughness_along"),
        ((0.5, "grooved_conductor", 0.3, 1.5, 0.1), "groove_axis"),
        ((0.5, "grooved_conductor", 0.3, 1.5, 0.1, [0.0, 0.0, 0.0]), "groove_axis"),
        ((0.5, "grooved_conductor", 0.3, 1.5, 0.1, [0.0, np.nan, 0.0]), "groove_axis"),
        ((0.5, "grooved_conductor", 0.3, 1.5, 0.1, [0.0, 1.0, 0.0], [np.inf, 0.0, 0.0]), "groove"),
    ],
)
def test_invalid_materials_are_rejected(arguments: tuple[Any, ...], complaint: str) -> None:
    with pytest.raises(ValueError, match=complaint):
        Material(*arguments)
