"""Lamps: inverse square law, cosines, form factors, filters, shadows, agreement with path tracing."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scenes import Array, ball, plane, pose, still
from stripe_images import make_sensor

from scancell.sensor import Camera, Material, Scene, Sensor, expected_electrons

PLANCK_C = 6.62607015e-34 * 299792458.0
Z = 0.12
REFLECTANCE = 0.5
DOWN = (np.pi, 0.0, 0.0)  # area lights shine towards sensor +Z by default; rotated they shine back


def sensor(mode: str = "fast", samples: int = 16, **overrides: Any) -> Sensor:
    render = {"noise": False, "mode": mode, "samples_per_pixel": samples} | overrides.pop("render", {})
    return make_sensor(160, 128, cameras=2, render=render, laser={"power": 0.0}, **overrides)


def lit_plane(tracing: Sensor, kind: str, place: Array, power: float = 2.0, **lamp: Any) -> Array:
    """Electrons (cameras, h, w) of a plane at range Z under one lamp."""
    scene = plane(REFLECTANCE)
    size = lamp.pop("size", [0.0, 0.0])
    scene.add_light("lamp", kind, np.eye(4), size, power, **(lamp or {"in_band": 1.0}))
    return np.asarray(expected_electrons(scene, tracing, still(pose((0, 0, Z)), place))[0], float)


def seen(camera: Camera) -> tuple[Array, Array]:
    """Points (h, w, 3) of the plane at the pixel centres, and electrons per W/m² of reflected irradiance."""
    rows, columns = np.mgrid[: camera.height_px, : camera.width_px]
    rays = camera.view_rays(np.stack([columns.ravel(), rows.ravel()], axis=1).astype(float))
    viewpoint = camera.sensor_from_camera[:3, 3]
    points = viewpoint + ((Z - viewpoint[2]) / rays[:, 2])[:, None] * rays
    x = (columns - (camera.width_px - 1) / 2) / camera.focal_px
    y = (rows - (camera.height_px - 1) / 2) / camera.focal_px
    cosine4 = 1 / (1 + x**2 + y**2) ** 2
    electrons = 0.8 * cosine4 / (4 * 11.0**2) * 25e-12 * 0.55 * 5e-4 * 660e-9 / PLANCK_C
    return points.reshape(*rows.shape, 3), electrons


def irradiance(tracing: Sensor, images: Array) -> list[tuple[Array, Array]]:
    """Per camera: points (h, w, 3) and measured irradiance (h, w)."""
    pairs = zip(tracing.cameras, images, strict=True)
    return [(seen(camera)[0], image / seen(camera)[1] / REFLECTANCE) for camera, image in pairs]


@pytest.mark.parametrize("mode", ["fast", "path"])
@pytest.mark.parametrize("place", [(0.0, 0.0, 0.0), (0.1, -0.05, 0.02), (0.0, 0.3, -0.4)])
def test_point_light_follows_inverse_square_and_cosine(mode: str, place: tuple[float, ...]) -> None:
    tracing = sensor(mode)
    for points, measured in irradiance(tracing, lit_plane(tracing, "point", pose(place))):
        way = points - place
        expected = 2.0 / (4 * np.pi) * way[..., 2] / np.linalg.norm(way, axis=-1) ** 3
        np.testing.assert_allclose(measured, expected, rtol=2e-3)


@pytest.mark.parametrize("f_number", [2.8, 1.4])
def test_pixel_collects_the_light_through_the_aperture(f_number: float) -> None:
    """Light from the patch that a pixel on the axis sees to all points of the aperture, summed point by point.

    With the f-number N it is that of the image irradiance pi L / (4 N²); pi L / (4 N² + 1), which holds for a
    luminous disc seen without a lens, is 3 % and 11 % less.
    """
    tracing = sensor(camera={"f_number": f_number})
    lamp = np.array([0.0, 0.0, -30.0])
    for camera, image in zip(tracing.cameras, lit_plane(tracing, "point", pose(lamp), power=1e6), strict=True):
        viewpoint, axes = camera.sensor_from_camera[:3, 3], camera.sensor_from_camera[:3, :3]
        patch = viewpoint + (Z - viewpoint[2]) / axes[2, 2] * axes[:, 2]
        depth, image_distance = float((patch - viewpoint) @ axes[:, 2]), camera.focal_px * 5e-6
        radius = image_distance / f_number / 2
        around, out = np.meshgrid(np.arange(64) * 2 * np.pi / 64, (np.arange(64) + 0.5) / 64)
        lens = viewpoint + (radius * out * np.cos(around))[..., None] * axes[:, 0]
        lens = lens + (radius * out * np.sin(around))[..., None] * axes[:, 1]
        to_lens = lens - patch
        distance = np.linalg.norm(to_lens, axis=-1)
        leaving, entering = np.abs(to_lens[..., 2]) / distance, np.abs(to_lens @ axes[:, 2]) / distance
        patch_area = (5e-6 * depth / image_distance) ** 2 / axes[2, 2]
        ring = radius**2 * out * (1 / 64) * (2 * np.pi / 64)
        way = patch - lamp
        radiance = REFLECTANCE / np.pi * 1e6 / (4 * np.pi) * way[2] / np.linalg.norm(way) ** 3
        watts = 0.8 * radiance * patch_area * (leaving * entering / distance**2 * ring).sum()
        expected = watts * 0.55 * 5e-4 * 660e-9 / PLANCK_C
        assert image[63:65, 79:81].mean() == pytest.approx(expected, rel=0.005)


def below_rectangle(width: float, height: float, distance: float) -> float:
    """Form factor from a small element to a parallel rectangle centred in front of it (Howell, configuration B-3)."""
    a, b = width / 2 / distance, height / 2 / distance
    p, q = np.sqrt(1 + a * a), np.sqrt(1 + b * b)
    return float(4 / (2 * np.pi) * (a / p * np.arctan(b / p) + b / q * np.arctan(a / q)))


@pytest.mark.parametrize("distance", [0.06, 0.2])
@pytest.mark.parametrize("kind", ["rectangle", "disc"])
def test_area_light_matches_form_factor(kind: str, distance: float) -> None:
    size = [0.08, 0.05] if kind == "rectangle" else [0.06, 0.06]
    area = size[0] * size[1] * (1.0 if kind == "rectangle" else np.pi / 4)
    radius = size[0] / 2
    factor = below_rectangle(*size, distance) if kind == "rectangle" else radius**2 / (radius**2 + distance**2)
    above = pose((0, 0, Z - distance))
    for mode, samples, tolerance in (("fast", 16, 3e-3), ("path", 1024, 0.01)):
        tracing = sensor(mode, samples, camera={"width_px": 16, "cx_px": 7.5})  # the middle columns, 0.3 mm each
        images = lit_plane(tracing, kind, above, size=size, in_band=1.0)
        for points, measured in irradiance(tracing, images):
            near = np.linalg.norm(points[..., :2], axis=-1) < 1e-3
            assert near.sum() > 5
            assert measured[near].mean() == pytest.approx(2.0 / area * factor, rel=tolerance)
    images = lit_plane(sensor(), kind, above @ pose(angles=DOWN), size=size, in_band=1.0)
    assert np.all(images == 0.0)  # area lights are one-sided


def smith(cosine: Array, alpha: float) -> Array:
    """Smith's lambda function of GGX facets."""
    return np.asarray((np.sqrt(1 + alpha**2 * (1 / cosine**2 - 1)) - 1) / 2)


@cache
def light_lost(alpha: float) -> tuple[Array, Array]:
    """Share of the light that lossless GGX facets reflect more than once, over the root of the cosine of incidence.

    By quadrature over the normals of the facets, denser where steep ones turn light below the horizon.
    """
    s, around = np.meshgrid((np.arange(200) + 0.5) / 200, (np.arange(64) + 0.5) / 64 * np.pi)
    tan2 = alpha**2 * (1 / s**4 - 1)
    h = np.stack([np.sqrt(tan2) * np.cos(around), np.sqrt(tan2) * np.sin(around), np.ones_like(s)]) / np.sqrt(1 + tan2)
    root = np.linspace(0.1, 1.0, 60)
    lost = []
    for c in root**2:
        facing = np.maximum(np.sqrt(1 - c * c) * h[0] + c * h[2], 0.0)
        out = 2 * facing * h[2] - c
        both = np.where(out > 1e-6, 1 / (1 + smith(c, alpha) + smith(np.where(out > 1e-6, out, 1.0), alpha)), 0.0)
        lost.append((4 * s**3 * facing / (c * h[2]) * (1 / (1 + smith(c, alpha)) - both)).mean())
    return root, np.array(lost)


def conductor(to_eye: Array, to_lamp: Array, alpha: float, reflectance: float) -> Array:
    """pi times the BRDF (n,) of rough metal with the normal -z: directions (3,) to the eye and (n, 3) to the lamp."""
    half = to_eye + to_lamp
    half /= np.linalg.norm(half, axis=-1)[..., None]
    cos_eye, cos_lamp, cos_half = -to_eye[2], -to_lamp[..., 2], -half[..., 2]
    spread = alpha**2 / (np.pi * (1 - cos_half**2 * (1 - alpha**2)) ** 2)
    masking = 1 / (1 + smith(cos_eye, alpha) + smith(cos_lamp, alpha))
    fresnel = reflectance + (1 - reflectance) * (1 - (half * to_lamp).sum(axis=-1)) ** 5
    single = np.pi * spread * masking * fresnel / (4 * cos_eye * cos_lamp)
    root, lost = light_lost(alpha)
    mean_lost = float(np.trapezoid(4 * root**3 * lost, root))
    mean_fresnel = reflectance + (1 - reflectance) / 21
    more = mean_fresnel**2 * (1 - mean_lost) / (1 - mean_fresnel * mean_lost) / mean_lost
    return np.asarray(
        single + more * np.interp(np.sqrt(cos_eye), root, lost) * np.interp(np.sqrt(cos_lamp), root, lost)
    )


def on_lamp(kind: str, size: list[float], at: Array, u: Array, v: Array) -> Array:
    """Points (n, 3) of a lamp, uniform over its area for uniform u and v in 0 .. 1."""
    x, y = (u - 0.5) * size[0], (v - 0.5) * size[1]
    if kind == "disc":
        x, y = (size[0] / 2 * np.sqrt(u) * turn(2 * np.pi * v) for turn in (np.cos, np.sin))
    return np.asarray(np.stack([x, y, 0 * x], axis=1) @ at[:3, :3].T + at[:3, 3])


def fine_parts(kind: str, size: list[float], at: Array, point: Array, view: Array, alpha: float) -> tuple[Array, Array]:
    """Middles (n, 3) of small parts of a lamp as seen from a point, and their share (n,) of it.

    They seem smaller than the lobe, which lies where the half vector between lamp and `view` is the normal -z.
    """
    count = 16  # at least, since the middles of parts of a disc are not the centroids
    low = np.stack(np.meshgrid(*[np.arange(count) / count] * 2), axis=-1).reshape(-1, 2)
    width = np.full_like(low, 1 / count)
    done: list[tuple[Array, Array]] = []
    while len(low):
        place = [on_lamp(kind, size, at, *(low + width * share).T) for share in ([0.5, 0.5], [1, 0.5], [0.5, 1])]
        edges = 2 * np.linalg.norm(np.array(place[1:]) - place[0], axis=-1).T
        distance = np.linalg.norm(place[0] - point, axis=1)
        seems = edges.max(axis=1) / distance
        half = (place[0] - point) / distance[:, None] + view
        away = np.linalg.norm(half[:, :2], axis=1) / np.linalg.norm(half, axis=1) - seems
        fine = seems < np.clip(0.2 * away, min(0.5 * alpha, 0.04), 0.04)
        done.append((place[0][fine], width[fine].prod(axis=1)))
        low, width, axis = low[~fine], width[~fine], np.eye(2)[edges[~fine].argmax(axis=1)]
        width = width * (1 - axis / 2)
        low, width = np.concatenate([low, low + width * axis]), np.concatenate([width, width])
    middles, shares = zip(*done, strict=True)
    return np.concatenate(middles), np.concatenate(shares)


ABOVE = pose((-0.058, 0.003, 0.004), (0.1, 0.3, 0.0))
LEANING = pose((-0.02, 0.002, Z - 0.04), (0.2, np.pi / 2 - 0.2, 0.1))  # reaches below the surface
LAMPS = {
    "rectangle": ("rectangle", [0.06, 0.04], ABOVE),
    "disc": ("disc", [0.05, 0.05], ABOVE),
    "strip": ("rectangle", [0.002, 0.5], ABOVE),
    "small": ("disc", [1e-3, 1e-3], ABOVE),
    "large": ("disc", [4.0, 4.0], pose((0.0, 0.0, Z - 0.5), (0.1, 0.3, 0.0))),
    "far": ("rectangle", [100.0, 100.0], pose((-60.0, 0.0, -100.0), (0.0, 0.4, 0.0))),
    "close": ("disc", [0.02, 0.02], pose((0.0, 0.0, Z - 0.004), (0.2, 0.1, 0.0))),
    "standing": ("rectangle", [0.1, 0.08], pose((-0.02, 0.002, Z - 0.05), (0.0, np.pi / 2, 0.0))),
    "standing disc": ("disc", [0.1, 0.1], pose((-0.02, 0.002, Z - 0.05), (0.0, np.pi / 2, 0.0))),
    "leaning": ("rectangle", [0.1, 0.08], LEANING),
    "leaning disc": ("disc", [0.1, 0.1], LEANING),
}


@pytest.mark.parametrize(
    ("roughness", "model"),
    [(roughness, "rough_conductor") for roughness in (0.02, 0.05, 0.1, 0.3, 0.5)] + [(0.05, "retro_reflective")],
)
def test_area_lights_on_glossy_surfaces_match_their_integrals(roughness: float, model: str) -> None:
    """Pixels of a grid, the brightest one and those unlike their neighbours, against a sum over parts of the lamp."""
    reflectance, tracing = 0.7, sensor(camera={"width_px": 64, "cx_px": 31.5})
    for name, (kind, size, at) in LAMPS.items():
        power = max(2.0, 800.0 * size[0] * size[1])  # enough that no pixel is too faint to be stored
        scene = plane(Material(reflectance, model, roughness, 1.0))
        scene.add_light("lamp", kind, np.eye(4), size, power, in_band=1.0)
        images = expected_electrons(scene, tracing, still(pose((0, 0, Z)), at))[0].astype(float)
        for camera, image in zip(tracing.cameras, images, strict=True):
            points, electrons = seen(camera)
            picked = np.zeros(image.shape, bool)
            smooth = (image[:-2, 1:-1] + image[2:, 1:-1] + image[1:-1, :-2] + image[1:-1, 2:]) / 4
            uneven = np.abs(image[1:-1, 1:-1] - smooth) / (image[1:-1, 1:-1] + 1e-3 * image.max())
            picked[1:-1, 1:-1].flat[uneven.argmax()] = True
            picked[20::80, 15::35] = picked[np.unravel_index(image.argmax(), image.shape)] = True
            expected = []
            for point, factor in zip(points[picked], electrons[picked], strict=True):
                to_eye = camera.sensor_from_camera[:3, 3] - point
                to_eye /= np.linalg.norm(to_eye)
                view, albedo = to_eye, 1.0
                if model == "retro_reflective":  # metal that reflects all light, seen in the mirrored direction
                    view, albedo = to_eye * [-1, -1, 1], reflectance
                middles, shares = fine_parts(kind, size, at, point, view, roughness)
                to_lamp = middles - point
                distance = np.linalg.norm(to_lamp, axis=1)
                to_lamp /= distance[:, None]
                emitted, met = -to_lamp @ at[:3, 2], -to_lamp[:, 2]
                lit = (emitted > 0) & (met > 0)
                brdf = albedo * conductor(view, to_lamp[lit], roughness, reflectance / albedo)
                light = (brdf * (emitted * met / distance**2 * shares)[lit]).sum()
                expected.append(light * power / np.pi * factor)
            where = f"{name}, {camera.sensor_from_camera[:3, 3]}"
            np.testing.assert_allclose(image[picked], expected, rtol=0.02, err_msg=where)
            assert image[picked].sum() == pytest.approx(sum(expected), rel=0.005), where


@pytest.mark.parametrize("kind", ["rectangle", "disc"])
@pytest.mark.parametrize("roughness", [0.02, 0.1, 0.5])
def test_light_of_area_lights_on_metal_is_that_of_path_tracing(kind: str, roughness: float) -> None:
    scene = plane(Material(0.7, "rough_conductor", roughness, 1.0))
    scene.add_light("lamp", kind, np.eye(4), [0.05, 0.05], 2.0, in_band=1.0)
    fast, paths = (
        expected_electrons(scene, tracing, still(pose((0, 0, Z)), ABOVE))[0].astype(float).sum(axis=(1, 2))
        for tracing in (sensor(), sensor("path", 64))
    )
    np.testing.assert_allclose(fast, paths, rtol=0.01)


def test_filter_transmits_in_band_fraction() -> None:
    tracing = sensor(band_pass={"centre": 655e-9, "width": 12e-9})
    place = pose((0.02, 0.0, 0.0))
    whole = lit_plane(tracing, "point", place, in_band=1.0)
    np.testing.assert_allclose(lit_plane(tracing, "point", place, in_band=0.25), 0.25 * whole, rtol=1e-5)
    wavelength = np.linspace(400e-9, 900e-9, 200_001)

    def bell(centre: float, width: float) -> Array:
        return np.asarray(np.exp(-4 * np.log(2) * ((wavelength - centre) / width) ** 2))

    for centre, width in ((660e-9, 1e-9), (640e-9, 30e-9), (600e-9, 80e-9)):
        spectrum = bell(centre, width) / bell(centre, width).sum()
        passed = (spectrum * bell(655e-9, 12e-9)).sum() / np.interp(660e-9, wavelength, bell(655e-9, 12e-9))
        measured = lit_plane(tracing, "point", place, spectrum=(centre, width))
        np.testing.assert_allclose(measured, passed * whole, rtol=1e-4)


@pytest.mark.parametrize("samples", [4, 16])
def test_defocused_surface_under_lamp_stays_in_place(samples: int) -> None:
    """A small plate out of focus: blur is symmetric, so that the centre of its light is that of a sharp image."""
    centres = []
    for focus in (0.0, 0.04):
        scene = Scene()
        scene.add_plane("plate", np.eye(4), [0.006, 0.004], REFLECTANCE)
        scene.add_light("lamp", "point", np.eye(4), [0, 0], 2.0, in_band=1.0)
        tracing = sensor(samples=samples, camera={"focus": focus, "f_number": 4.0})
        images = expected_electrons(scene, tracing, still(pose((0, 0, Z)), pose((0, 0, -0.05))))[0].astype(float)
        assert (images > 0).sum() > 100
        rows, columns = np.mgrid[:128, :160]
        centres.append([((images * grid).sum((1, 2)) / images.sum((1, 2))) for grid in (rows, columns)])
    np.testing.assert_allclose(centres[1], centres[0], atol=0.1)


@pytest.mark.parametrize("mode", ["fast", "path"])
def test_bodies_cast_lamp_shadows(mode: str) -> None:
    lamp, ball, radius = np.array([0.05, 0.0, -0.05]), np.array([0.01, 0.002, 0.07]), 0.004
    scene = plane(REFLECTANCE)
    scene.add_sphere("ball", [0, 0, 0], radius, 0.0)
    scene.add_light("lamp", "point", np.eye(4), [0, 0], 2.0, in_band=1.0)
    tracing = sensor(mode)
    images = expected_electrons(scene, tracing, still(pose((0, 0, Z)), pose(ball), pose(lamp)))[0]
    for camera, image in zip(tracing.cameras, images, strict=True):
        points, _ = seen(camera)
        viewpoint = camera.sensor_from_camera[:3, 3]
        from_lamp, from_viewpoint = (distance_to_ball(points, start, ball) / radius for start in (lamp, viewpoint))
        shadow, free = from_lamp < 0.95, (from_lamp > 1.05) & (from_viewpoint > 1.1)
        assert (shadow & (from_viewpoint > 1.1)).sum() > 50
        assert np.all(image[shadow] == 0.0)
        assert np.all(image[free] > 0.0)


def distance_to_ball(points: Array, start: Array, ball: Array) -> Array:
    """Distance (h, w) of the sphere's centre from the lines between `start` and the points."""
    way = points - start
    along = way @ (ball - start)
    foot = start + (along / (way**2).sum(axis=-1))[..., None] * way
    return np.asarray(np.linalg.norm(foot - ball, axis=-1))


def test_lamp_moves_with_body() -> None:
    scene = plane(REFLECTANCE)
    on_arm = pose((0.01, 0.02, -0.03), (0.1, 0.2, 0.3))
    scene.add_light("arm", "rectangle", on_arm, [0.02, 0.03], 2.0, in_band=1.0)
    arm = pose((0.02, 0.01, -0.01), (-0.2, 0.1, 0.0))
    carried = expected_electrons(scene, sensor(), still(pose((0, 0, Z)), arm))[0]
    fixed = lit_plane(sensor(), "rectangle", arm @ on_arm, size=[0.02, 0.03], in_band=1.0)
    np.testing.assert_allclose(carried, fixed, rtol=1e-5)
    assert scene.bodies == ["plane", "arm"]


def blocks(images: NDArray[np.float32]) -> Array:
    return np.asarray(images, float).reshape(*images.shape[:2], 8, 16, 10, 16).mean(axis=(3, 5))


def test_fast_mode_matches_path_tracing() -> None:
    """Blocks of 16 x 16 pixels with glossy surfaces and penumbrae: five standard errors of the paths plus 1 %."""
    scene = Scene()
    scene.add_plane("plane", np.eye(4), [1.0, 1.0], Material(0.6, "rough_dielectric", 0.4, 1.5))
    scene.add_sphere("ball", [0, 0, 0], 0.008, Material(0.8, "rough_conductor", 0.4, 1.5))
    scene.add_light("lamp", "rectangle", np.eye(4), [0.05, 0.04], 1.0, in_band=0.5)
    scene.add_light("bulb", "point", np.eye(4), [0, 0], 0.5, spectrum=(650e-9, 20e-9))
    poses = [pose((0, 0, Z)), pose((0, 0, Z - 0.012)), pose((0.06, 0.01, 0.0), (0, -0.3, 0)), pose((-0.05, 0, 0.02))]
    truth = blocks(expected_electrons(scene, sensor("path", 64), still(*poses, count=4)))
    fast = blocks(expected_electrons(scene, sensor(), still(*poses)))[0]
    error = truth.std(axis=0, ddof=1) / 2
    np.testing.assert_array_less(np.abs(fast - truth.mean(axis=0)), 5 * error + 0.01 * truth.mean(axis=0) + 0.05)
    assert fast.sum() == pytest.approx(truth.mean(axis=0).sum(), rel=3e-3)


def test_invalid_lamps_are_rejected() -> None:
    scene = Scene()
    for arguments, message in (
        (("bulb", np.eye(4), [0, 0], 1.0, 1.0), "kind"),
        (("disc", np.eye(4), [0, 0], 1.0, 1.0), "sizes"),
        (("point", np.eye(4), [0, 0], -1.0, 1.0), "power"),
        (("point", np.eye(4), [0, 0], 1.0, 1.5), "in_band"),
        (("point", np.eye(4), [0, 0], 1.0, None, (0.0, 1e-9)), "wavelength"),
        (("point", np.eye(4), [0, 0], 1.0), "either in_band or spectrum"),
    ):
        with pytest.raises(ValueError, match=message):
            scene.add_light("lamp", *arguments)


@pytest.mark.parametrize("wall", [Material(0.85, "oren_nayar", 0.3, 1.0), Material(0.9, "rough_conductor", 0.35, 1.0)])
def test_reflected_lamp_light_matches_path_tracing(wall: Material) -> None:
    """Deep groove under a lamp: a fifth to two thirds of its light is interreflection."""
    scene = Scene()
    side = 0.08
    for name in ("a", "b"):
        scene.add_plane(name, np.eye(4), [0.3, side], wall)
    scene.add_light("lamp", "rectangle", np.eye(4), [0.6, 0.15], 20.0, in_band=0.05)
    half = side / 2 / np.sqrt(2)
    walls = [
        pose((0, -half, Z + 0.03 - half), (np.radians(45), 0, 0)),
        pose((0, half, Z + 0.03 - half), (np.radians(-45), 0, 0)),
    ]
    exposures = still(*walls, pose((0.3, 0, -0.5)), count=4)
    images = {}
    for mode, bounces in (("fast", 0), ("fast", 2), ("path", 2)):
        render = {"noise": False, "mode": mode, "bounces": bounces, "samples_per_pixel": 16}
        tracing = make_sensor(320, 256, cameras=2, render=render, laser={"power": 0.0})
        images[mode, bounces] = np.asarray(expected_electrons(scene, tracing, exposures), float)
    direct, fast, truth = images.values()
    assert direct.sum() < 0.85 * truth.sum()
    assert fast.sum() == pytest.approx(truth.sum(), rel=0.005)
    blocks = (4, 2, 8, 32, 10, 32)
    fast_blocks, true_blocks = (image.reshape(blocks).sum(axis=(3, 5)) for image in (fast, truth))
    brightest = true_blocks.mean(axis=0).max()
    noise = np.hypot(fast_blocks.std(axis=0, ddof=1), true_blocks.std(axis=0, ddof=1)) / 2
    difference = np.abs(fast_blocks.mean(axis=0) - true_blocks.mean(axis=0))
    print(
        direct.sum() / truth.sum(),
        fast.sum() / truth.sum(),
        fast_blocks.std(axis=0).mean() / fast_blocks.mean(),
        difference.max() / brightest,
    )
    np.testing.assert_array_less(difference, 5 * noise + 0.03 * brightest)  # the bottom of the groove is smoothed


@pytest.mark.parametrize("mode", ["fast", "path"])
@pytest.mark.parametrize("edge", [1.0, 100.0, 1000.0])
def test_large_mesh_casts_no_shadow_on_itself(edge: float, mode: str) -> None:
    """Rays start above a surface by more than the rounding of its coordinates in single precision."""
    tracing = sensor(mode)
    floor_from_plane = pose((0, 0, 0), (0.2, 0.1, 0.3))  # coordinates of the mesh are not exact
    at = pose((0, 0, Z))
    lamp = pose((0.1, 0.05, -0.1))
    across, along = np.array([-0.19, 0.81, 0.81, -0.19]), np.array([-0.33, -0.33, 0.67, 0.67])
    corners = edge * np.stack([across, along, 0 * across], axis=1) @ floor_from_plane[:3, :3].T
    images = []
    for mesh in (False, True):
        scene = Scene()
        if mesh:
            scene.add_mesh("floor", corners, np.array([[0, 1, 2], [0, 2, 3]], np.uint32), REFLECTANCE)
        else:
            scene.add_plane("floor", floor_from_plane, [1.0, 1.0], REFLECTANCE)
        scene.add_light("lamp", "point", np.eye(4), [0.0, 0.0], 2.0, in_band=1.0)
        images.append(expected_electrons(scene, tracing, still(at, lamp))[0])
    np.testing.assert_allclose(images[1], images[0], rtol=2e-3)


@pytest.mark.parametrize("distance", [100.0, 1000.0])
def test_cell_far_from_world_origin_looks_the_same(distance: float) -> None:
    """The laser's light, lamps and reflected light depend on relative poses alone."""
    scene = ball(0.01, 0.6)
    scene.add_box("box", np.eye(4), [0.05, 0.05, 0.01], 0.5)
    scene.add_light("lamp", "point", np.eye(4), [0.0, 0.0], 2.0, in_band=1.0)
    tracing = make_sensor(160, 128, cameras=2, render={"noise": False, "bounces": 1, "photons": 4096})
    poses = [pose((0, 0.002, Z)), pose((0, 0, Z + 0.012), (0.1, 0.2, 0.3)), pose((0.1, 0.05, -0.1))]
    away = pose((0.8 * distance, -0.6 * distance, 0.1 * distance))
    near, far = (
        expected_electrons(scene, tracing, still(*(place @ p for p in poses), sensor=place))[0].astype(float)
        for place in (np.eye(4), away)
    )
    assert near.sum() > 0.0
    difference = np.abs(far - near)
    # A photon that meets a silhouette may go another way; the poses are rounded at 1e-13 m.
    assert np.quantile(difference, 0.999) < 1e-3 * near.max()
    assert far.sum() == pytest.approx(near.sum(), rel=1e-4)
