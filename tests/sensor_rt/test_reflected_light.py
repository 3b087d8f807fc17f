"""Interreflection: energy compared with form factors, mirrors, agreement of the fast mode with path tracing."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scenes import Array, ball, moving, pose, probe, still
from stripe_images import make_sensor, width2

from scancell.config.material import PRESETS, Preset
from scancell.sensor import Camera, Exposures, Material, Scene, Sensor, expected_electrons, scan

PLANCK_C = 6.62607015e-34 * 299792458.0
POWER, HALF_FAN = 1e-3, 0.28
Z = 0.12  # range of the lit line
EDGE = 0.008  # x of the bottom of the groove; the laser hits only one wall, at x = 0
WALL = 0.06  # edge lengths of the walls
TO_WALL_A, TO_WALL_B = np.array([1.0, 0.0, -1.0]) / np.sqrt(2), np.array([-1.0, 0.0, -1.0]) / np.sqrt(2)
MIRROR = Material(0.9, "mirror", 0.0, 1.0)
FRAMES = 6


def small_probe(**overrides: Any) -> Sensor:
    render = {"noise": False, "bounces": 1} | overrides.pop("render", {})
    return make_sensor(320, 256, cameras=2, render=render, range={"near": 0.06, "far": 0.2}, **overrides)


def groove(wall_a: Material | float, wall_b: Material | float) -> tuple[Scene, list[Array]]:
    """Right-angled V-groove along y; its walls are at 45 degrees to the laser sheet, which hits wall a."""
    scene = Scene()
    scene.add_plane("a", np.eye(4), [WALL, 0.2], wall_a)
    scene.add_plane("b", np.eye(4), [WALL, 0.2], wall_b)
    bottom, half = np.array([EDGE, 0.0, Z + EDGE]), WALL / 2 / np.sqrt(2)
    a = pose(bottom + half * np.array([-1.0, 0.0, -1.0]), (0.0, np.radians(-45.0), 0.0))
    b = pose(bottom + half * np.array([1.0, 0.0, -1.0]), (0.0, np.radians(45.0), 0.0))
    return scene, [a, b]


def line_power(y: Array) -> Array:
    """Laser power per metre on the line at range Z, W/m."""
    return POWER / (2 * HALF_FAN) * Z / (y**2 + Z**2)


def line() -> tuple[Array, Array]:
    """Segments of the lit line: positions (n,) along y and power (n,), W."""
    ends = Z * np.tan(np.linspace(-HALF_FAN, HALF_FAN, 801))
    y = (ends[1:] + ends[:-1]) / 2
    return y, line_power(y) * np.diff(ends)


def irradiance_on_b(points: Array, reflectance: float) -> Array:
    """Irradiance (W/m²) from the lit line on the Lambertian wall a at points (n, 3) of wall b."""
    y, watts = line()
    view_ray = points[:, None, :] - np.stack([0 * y, y, 0 * y + Z], axis=1)
    distance2 = (view_ray**2).sum(axis=2)
    cosines = (view_ray @ TO_WALL_A) * -(view_ray @ TO_WALL_B) / distance2
    return (reflectance / np.pi * watts * cosines / distance2).sum(axis=1)


def seen_on_b(camera: Camera) -> tuple[Array, NDArray[np.bool_]]:
    """Points of wall b (h, w, 3) seen by the pixels, and a mask of the pixels that see only wall b."""
    rows, columns = np.mgrid[: camera.height_px, : camera.width_px]
    rays = camera.view_rays(np.stack([columns.ravel(), rows.ravel()], axis=1).astype(float))
    viewpoint = camera.sensor_from_camera[:3, 3]
    bottom = np.array([EDGE, 0.0, Z + EDGE])
    t = ((bottom - viewpoint) @ TO_WALL_B) / (rays @ TO_WALL_B)
    points = viewpoint + t[:, None] * rays
    before_a = ((viewpoint - bottom) @ TO_WALL_A > 0) & ((points - bottom) @ TO_WALL_A > 5e-4)
    on_b = before_a & ((points - bottom) @ TO_WALL_A < WALL - 5e-4) & (np.abs(points[:, 1]) < 0.0995)
    shape = (camera.height_px, camera.width_px)
    return points.reshape(*shape, 3), on_b.reshape(shape)


def electrons_per_irradiance(camera: Camera) -> Array:
    """Electrons (h, w) per W/m² of diffusely reflected irradiance."""
    rows, columns = np.mgrid[: camera.height_px, : camera.width_px]
    x = (columns - (camera.width_px - 1) / 2) / camera.focal_px
    y = (rows - (camera.height_px - 1) / 2) / camera.focal_px
    cosine4 = 1 / (1 + x**2 + y**2) ** 2
    return 0.8 * cosine4 / (4 * 11.0**2) * 25e-12 * 0.55 * 5e-4 * 660e-9 / PLANCK_C


def bounced(wall_a: Material | float, wall_b: Material | float, exposures: Exposures, **overrides: Any) -> Array:
    """Electrons (n, cameras, h, w) of reflected light in the fast mode."""
    scene, _ = groove(wall_a, wall_b)
    with_bounces = expected_electrons(scene, small_probe(**overrides), exposures)
    overrides["render"] = overrides.get("render", {}) | {"bounces": 0}
    direct = expected_electrons(scene, small_probe(**overrides), exposures)
    return np.asarray(with_bounces, float) - direct


def test_closed_form_of_groove() -> None:
    """In an infinite groove the wall receives (1 + cos 90°) / 2 of the light of a line."""
    s = np.linspace(0, 1, 120)[1:] ** 3 * 3.0  # along the wall from the bottom
    y = np.linspace(-1, 1, 161) ** 3 * 3.0
    grid_s, grid_y = np.meshgrid(s, y, indexing="ij")
    points = np.stack([EDGE + grid_s / np.sqrt(2), grid_y, Z + EDGE - grid_s / np.sqrt(2)], axis=-1)
    irradiance = irradiance_on_b(points.reshape(-1, 3), 1.0).reshape(grid_s.shape)
    energy = np.trapezoid(np.trapezoid(irradiance, y, axis=1), s)
    assert energy == pytest.approx(POWER / 2, rel=0.02)


@pytest.mark.parametrize("samples", [4, 16])
def test_photons_are_spread_evenly_over_the_lens(samples: int) -> None:
    """Out of focus the centre of the reflected light stays where it is in a sharp image of the same photons."""
    _, poses = groove(0.8, 0.8)
    render = {"samples_per_pixel": samples, "photons": 16_384}
    rows = []
    for focus in (0.0, 0.06):
        images = bounced(0.8, 0.8, still(*poses), render=render, camera={"focus": focus, "f_number": 0.5})
        light = images[0, 1].sum(axis=1)  # of the camera that sees it in the middle of its image
        rows.append((light * np.arange(len(light))).sum() / light.sum())
    assert rows[1] == pytest.approx(rows[0], abs=2.0)


def test_psf_adds_its_variance_to_reflected_light() -> None:
    """A mirror images the laser line on the other wall, also without depth of field."""
    _, poses = groove(MIRROR, 0.6)
    variances = []
    for sigma in (0.0, 2.0):
        camera = {"psf_sigma_px": sigma}
        image = bounced(MIRROR, 0.6, still(*poses), render={"photons": 262_144}, camera=camera)[0, 1]
        variances.append(np.mean([width2(image, column) for column in range(140, 180)]))
    assert variances[1] - variances[0] == pytest.approx(2.0**2, rel=0.05)


def test_first_bounce_in_groove_matches_form_factor() -> None:
    _, poses = groove(0.8, 0.6)
    images = bounced(0.8, 0.6, still(*poses, count=2)).mean(axis=0)
    for camera, image in zip(small_probe().cameras, images, strict=True):
        points, on_b = seen_on_b(camera)
        assert on_b.sum() > 5000
        expected = np.zeros(on_b.shape)
        expected[on_b] = 0.6 * irradiance_on_b(points[on_b], 0.8) * electrons_per_irradiance(camera)[on_b]
        away = on_b & (np.linalg.norm(points[..., [0, 2]] - [EDGE, Z + EDGE], axis=-1) > 2e-3)
        assert image[away].sum() == pytest.approx(expected[away].sum(), rel=0.01)
        height, width = image.shape
        blocks = (height // 16, 16, width // 32, 32)
        whole = away.reshape(blocks).all(axis=(1, 3))
        ratio = image.reshape(blocks).sum(axis=(1, 3))[whole] / expected.reshape(blocks).sum(axis=(1, 3))[whole]
        assert whole.sum() >= 5
        assert np.abs(ratio - 1).max() < 0.08


SIGMA = 8e-4  # a thick sheet is hit by more paths


def images_of(scene: Scene, poses: list[Array], **render: Any) -> Array:
    """Small noise-free images (FRAMES, cameras, h, w)."""
    sensor = make_sensor(
        160, 128, cameras=2, render={"noise": False} | render, laser={"sheet_sigma": SIGMA, "divergence": 0.0}
    )
    return np.asarray(expected_electrons(scene, sensor, still(*poses, count=FRAMES)), float)


def assert_agreement(truth: Array, fast: Array) -> None:
    """Sums over images and over blocks of 32 x 32 pixels agree within five standard errors of the frames."""
    shape = (FRAMES, 2, 4, 32, 5, 32)
    for true_sums, fast_sums, slack in (
        (truth.sum(axis=(2, 3)), fast.sum(axis=(2, 3)), 0.005),
        # Splats extend across block borders: a hundredth of the brightest neighbour.
        (truth.reshape(shape).sum(axis=(3, 5)), fast.reshape(shape).sum(axis=(3, 5)), 0.01),
    ):
        error = np.hypot(true_sums.std(axis=0, ddof=1), fast_sums.std(axis=0, ddof=1)) / np.sqrt(FRAMES)
        difference = fast_sums.mean(axis=0) - true_sums.mean(axis=0)
        np.testing.assert_array_less(np.abs(difference), 5 * error + slack * true_sums.mean(axis=0).max())


@cache
def path_traced(wall_a: Material | float, wall_b: Material | float, bounces: int) -> Array:
    return images_of(*groove(wall_a, wall_b), mode="path", bounces=bounces, samples_per_pixel=64)


@pytest.mark.parametrize("bounces", [1, 2])
@pytest.mark.parametrize(
    ("wall_a", "wall_b"),
    [
        (0.8, 0.6),
        (Material(0.7, "rough_conductor", 0.4, 1.0), Material(0.5, "rough_dielectric", 0.5, 1.5)),
        (Material(0.8, "oren_nayar", 0.5, 1.0), Material(0.9, "rough_conductor", 0.3, 1.0)),
    ],
)
def test_fast_mode_matches_path_tracing(wall_a: Material | float, wall_b: Material | float, bounces: int) -> None:
    truth = path_traced(wall_a, wall_b, bounces)
    fast = images_of(*groove(wall_a, wall_b), bounces=bounces, photons=32_768)
    assert fast.sum() == pytest.approx(truth.sum(), rel=0.01)
    assert_agreement(truth, fast)


@pytest.mark.parametrize("preset", ["matt_white", "machined_aluminium", "polished_steel", "painted_plastic"])
def test_presets_match_path_tracing_in_groove(preset: Preset) -> None:
    """Reflected light only, which exceeds the stripe itself between metallic walls."""
    found = PRESETS[preset]
    wall = Material(found.reflectance, found.model, found.roughness, found.refractive_index)
    scene, poses = groove(wall, wall)
    direct = images_of(scene, poses, bounces=0)
    truth = path_traced(wall, wall, 2) - direct
    fast = images_of(scene, poses, bounces=2, photons=131_072) - direct
    sums, true_sums = fast.sum(axis=(1, 2, 3)), truth.sum(axis=(1, 2, 3))
    noise = np.hypot(sums.std(ddof=1), true_sums.std(ddof=1)) / np.sqrt(FRAMES)
    print(preset, sums.mean() / true_sums.mean() - 1, noise / true_sums.mean(), truth.sum() / direct.sum())
    assert sums.std(ddof=1) < 0.03 * sums.mean()
    assert abs(sums.mean() - true_sums.mean()) < 3 * noise + 0.003 * true_sums.mean()
    assert_agreement(truth, fast)


def mirrored(points: Array, through: Array, normal: Array) -> Array:
    return points - 2 * ((points - through) @ normal)[:, None] * normal


def line_on_b(half_fan: float = HALF_FAN) -> tuple[Array, Array]:
    """Points (n, 3) of the line that the laser lights on wall b via mirror a, and the power (n,) at each, W."""
    length = Z + 2 * EDGE
    ends = length * np.tan(np.linspace(-half_fan, half_fan, 4001))
    y = (ends[1:] + ends[:-1]) / 2
    watts = POWER / (2 * half_fan) * length / (y**2 + length**2) * np.diff(ends)
    return np.stack([0 * y + 2 * EDGE, y, 0 * y + Z], axis=1), watts


def electrons_of(camera: Camera, points: Array, normal: Array, watts: Array) -> Array:
    """Electrons (n,) that a camera collects from Lambertian points with one normal, which reflect `watts` (n,)."""
    viewpoint, forward = camera.sensor_from_camera[:3, 3], camera.sensor_from_camera[:3, 2]
    view_ray = points - viewpoint
    distance = np.linalg.norm(view_ray, axis=1)
    solid = watts / np.pi * -(view_ray @ normal) / distance / distance**2  # W/sr per m² of aperture
    aperture = np.pi / 4 * (camera.focal_px * 5e-6 / 11.0) ** 2 * (view_ray @ forward) / distance
    return np.asarray(solid * aperture * 0.8 * 0.55 * 5e-4 * 660e-9 / PLANCK_C)


def assert_strip(strip: Array, top: int, rows: Array, expected: Array, tolerance: float = 0.02) -> None:
    """Light and mean row of a strip of an image, from the row `top` on, are those of points with these rows."""
    assert strip.sum() == pytest.approx(expected.sum(), rel=tolerance)
    row = (strip.sum(axis=1) * np.arange(top, top + len(strip))).sum() / strip.sum()
    assert row == pytest.approx(np.average(rows, weights=expected), abs=0.1)


def assert_stripe(image: Array, camera: Camera, points: Array, expected: Array, reach: int = 12) -> None:
    """Strips of 40 columns show points (n, 3) with the expected electrons (n,), within `reach` rows."""
    pixel = camera.project(points)
    top = max(0, int(pixel[:, 1].mean()) - reach)
    for first in range(40, 280, 40):
        inside = (pixel[:, 0] > first - 0.5) & (pixel[:, 0] < first + 39.5)
        assert_strip(image[top : top + 2 * reach + 1, first : first + 40], top, pixel[inside, 1], expected[inside])


BOTTOM = np.array([EDGE, 0.0, Z + EDGE])
B_IN_MIRROR_A = mirrored(TO_WALL_B[None] + BOTTOM, BOTTOM, TO_WALL_A)[0] - BOTTOM


def test_mirror_projects_second_stripe() -> None:
    """Laser, mirror, wall, camera: the sheet is deflected by 90 degrees and hits wall b at x = 2 EDGE."""
    _, poses = groove(MIRROR, 0.6)
    images = bounced(MIRROR, 0.6, still(*poses, count=2), render={"photons": 262_144}).mean(axis=0)
    # The walls exceed the fields of view; the stripe ends with the fan, at range Z + 2 EDGE.
    stripe, watts = line_on_b()
    for camera, image in zip(small_probe().cameras, images, strict=True):
        expected = electrons_of(camera, stripe, TO_WALL_B, 0.9 * 0.6 * watts)
        assert_stripe(image, camera, stripe, expected, reach=len(image))


@pytest.mark.parametrize("mode", ["fast", "path"])
def test_stripe_is_visible_in_mirror(mode: str) -> None:
    _, poses = groove(0.6, MIRROR)
    scene, _ = groove(0.6, MIRROR)
    sensor = small_probe(render={"mode": mode})
    images = expected_electrons(scene, sensor, still(*poses))[0].astype(float)
    y = np.linspace(-0.01, 0.01, 21)
    lit = np.stack([0 * y, y, 0 * y + Z], axis=1)
    ghost = mirrored(lit, BOTTOM, TO_WALL_B)
    for camera, image in zip(sensor.cameras[1:], images[1:], strict=True):  # the other camera does not see the mirror
        for point in camera.project(ghost):
            column, row = np.round(point).astype(int)
            window = image[row - 6 : row + 7, column]
            assert (window * np.arange(row - 6, row + 7)).sum() / window.sum() == pytest.approx(point[1], abs=0.3)


@pytest.mark.parametrize("mode", ["fast", "path"])
def test_mirror_shows_wall_that_it_lights(mode: str) -> None:
    """Laser, mirror, wall, mirror, camera: the mirror image shows the sheet as if it continued behind the mirror.

    Both cameras see it at the same point of the sheet, so that it is indistinguishable from a real wall.
    """
    scene, poses = groove(MIRROR, 0.6)
    wide = {"sheet_sigma": 2e-4, "divergence": 0.0}  # several pixels wide, or the row rounding dominates
    sensor = small_probe(render={"mode": mode, "bounces": 2, "photons": 262_144}, laser=wide)
    images = expected_electrons(scene, sensor, still(*poses)).mean(axis=0)
    stripe, watts = line_on_b()
    seen = mirrored(stripe, BOTTOM, TO_WALL_A)
    np.testing.assert_allclose(seen, stripe * [0, 1, 0] + [0, 0, Z + 2 * EDGE], atol=1e-12)
    for camera, image in zip(sensor.cameras, images, strict=True):
        assert_stripe(image, camera, seen, electrons_of(camera, seen, B_IN_MIRROR_A, 0.9**2 * 0.6 * watts))


def sheet_of_triangles(*flipped: bool) -> tuple[Array, NDArray[np.uint32]]:
    """A wall as a mesh with one pair of triangles for each two of `flipped`, which reverses their winding."""
    x, y = WALL / 2, 0.1
    corners = np.array([[-x, -y, 0.0], [x, -y, 0.0], [x, y, 0.0], [-x, y, 0.0]])
    halves = ([0, 1, 2], [0, 2, 3])
    faces = [halves[i % 2][::-1] if flip else halves[i % 2] for i, flip in enumerate(flipped)]
    return corners, np.array(faces, np.uint32)


@pytest.mark.parametrize(
    "flipped",
    [(False, False), (False, True), (False, False, True, True)],
    ids=["consistent", "mixed winding", "doubled sheet"],
)
def test_mirror_mesh_reflects_like_rectangle(flipped: tuple[bool, ...]) -> None:
    """Whatever the winding of its faces, a flat mesh is one mirror."""
    scene, poses = groove(MIRROR, 0.6)
    meshed = Scene()
    meshed.add_mesh("a", *sheet_of_triangles(*flipped), MIRROR)
    meshed.add_plane("b", np.eye(4), [WALL, 0.2], 0.6)
    sensor = small_probe(render={"bounces": 2})
    expected, light = (expected_electrons(s, sensor, still(*poses)).astype(float) for s in (scene, meshed))
    np.testing.assert_allclose(light.sum(axis=(0, 2, 3)), expected.sum(axis=(0, 2, 3)), rtol=2e-3)


def test_facets_of_large_mirror_are_one_plane() -> None:
    """Vertices in single precision, as in an STL file: on a wall of 100 m they lie micrometres off the plane."""
    size, count = 100.0, 9
    place = np.stack(np.meshgrid(*[np.linspace(-size / 2, size / 2, count)] * 2, [0.0], indexing="ij"), -1).reshape(
        -1, 3
    )
    corner = (np.arange(count - 1)[:, None] * count + np.arange(count - 1)).ravel()
    faces = np.concatenate(
        [
            np.stack([corner, corner + count, corner + 1], 1),
            np.stack([corner + 1, corner + count, corner + count + 1], 1),
        ]
    )
    turn = pose(angles=(0.3, 0.2, 0.1))
    vertices = (place @ turn[:3, :3].T).astype(np.float32).astype(float)
    light = []
    for mesh in (False, True):
        scene = Scene()
        if mesh:
            scene.add_mesh("a", vertices, faces.astype(np.uint32), MIRROR)
        else:
            scene.add_plane("a", turn, [size, size], MIRROR)
        scene.add_plane("b", np.eye(4), [WALL, 0.2], 0.6)
        _, (wall_a, wall_b) = groove(MIRROR, 0.6)
        poses = still(wall_a @ np.linalg.inv(turn), wall_b)
        light.append(expected_electrons(scene, small_probe(render={"bounces": 2}), poses).sum(axis=(0, 2, 3)))
    assert light[0].min() > 0.0
    np.testing.assert_allclose(light[1], light[0], rtol=5e-3)


@pytest.mark.parametrize("mode", ["fast", "path"])
def test_chain_of_two_mirrors_matches_image_method(mode: str) -> None:
    """Laser, mirror a, wall b, two mirrors, camera: mirror a and one across its end form a right angle.

    Together they show the lit line at its image in both, in either order of reflection.
    """
    scene, poses = groove(MIRROR, 0.6)
    side, fan = 0.018, 0.1
    scene.add_plane("end", np.eye(4), [0.4, 0.4], MIRROR)
    poses = [*poses, pose((0.0, side, Z), (np.radians(90), 0.0, 0.0))]
    wide = {"sheet_sigma": 2e-4, "divergence": 0.0, "fan_half_angle": fan}
    sensor = small_probe(render={"mode": mode, "bounces": 3, "photons": 262_144}, laser=wide)
    images = expected_electrons(scene, sensor, still(*poses)).mean(axis=0)
    stripe, watts = line_on_b(fan)
    in_a = mirrored(stripe, BOTTOM, TO_WALL_A)
    seen = mirrored(in_a, np.array([0.0, side, 0.0]), np.array([0.0, 1.0, 0.0]))
    for camera, image in zip(sensor.cameras, images, strict=True):
        pixel = camera.project(seen)
        expected = electrons_of(camera, seen, B_IN_MIRROR_A, 0.9**3 * 0.6 * watts)
        inside = (pixel[:, 0] > -0.5) & (pixel[:, 0] < image.shape[1] - 0.5)
        edge = round(float(np.abs(pixel[inside, 0] - (image.shape[1] - 1) / 2).min())) - 4
        beyond = np.abs(np.arange(image.shape[1]) - (image.shape[1] - 1) / 2) > edge
        beyond &= np.sign(np.arange(image.shape[1]) - image.shape[1] / 2) == np.sign(pixel[inside, 0].mean() - 160)
        assert inside.sum() > 100
        top = int(pixel[:, 1].mean()) - 12
        assert_strip(image[top : top + 25, beyond], top, pixel[inside, 1], expected[inside], 0.03)


@pytest.mark.parametrize("thickness", [0.0, 0.01])
def test_reflected_light_in_mirror_matches_path_tracing(thickness: float) -> None:
    """A mirror (a plane or the side of a box) across the end of a groove shows the interreflection of the walls."""
    scene, poses = groove(0.8, 0.6)
    if thickness > 0.0:
        scene.add_box("mirror", pose((0, 0, -thickness / 2)), [0.2, 0.2, thickness], MIRROR)
    else:
        scene.add_plane("mirror", np.eye(4), [0.2, 0.2], MIRROR)
    poses = [*poses, pose((0, 0.004, Z), (np.radians(90), 0, 0))]
    once, twice = (
        [
            images_of(scene, poses, bounces=n, mode="path", samples_per_pixel=32, photons=65_536),
            images_of(scene, poses, bounces=n, photons=65_536),
        ]
        for n in (1, 2)
    )
    assert_agreement(*twice)
    # The mirror fills one side of each image; with one reflection it shows only the stripe.
    reflected = [b - a for a, b in zip(once, twice, strict=True)]
    sums = np.array([i[:, 0, :, :60].sum(axis=(1, 2)) + i[:, 1, :, 100:].sum(axis=(1, 2)) for i in reflected])
    truth, fast = sums.mean(axis=1)
    noise = np.hypot(*sums.std(axis=1, ddof=1)) / np.sqrt(FRAMES)
    print(truth, fast, noise, once[0][:, 0, :, :60].mean(axis=0).sum())
    assert noise < 0.02 * truth
    assert abs(fast - truth) < 4 * noise + 0.005 * truth


@pytest.mark.parametrize("shapes", ["ball and box", "ring and cone"])
def test_white_furnace_of_path_tracing(shapes: str) -> None:
    """Lossless bodies under uniform light are invisible, including all shadows and interreflection."""
    scene, metal = Scene(), Material(1.0, "rough_conductor", 0.4, 1.0)
    if shapes == "ball and box":
        scene.add_sphere("a", [0, 0, 0], 0.012, 1.0)
        scene.add_box("b", np.eye(4), [0.02, 0.03, 0.01], metal)
    else:
        scene.add_ring("a", np.eye(4), 0.006, 0.014, 0.01, 1.0)
        scene.add_cone("b", np.eye(4), 0.012, 0.005, 0.014, metal)
    scene.add_plane("floor", np.eye(4), [0.5, 0.5], Material(1.0, "oren_nayar", 0.6, 1.0))
    render = {"mode": "path", "bounces": 64, "samples_per_pixel": 64}
    sensor = make_sensor(
        160, 128, cameras=2, render=render | {"noise": False}, laser={"power": 0.0}, ambient={"irradiance": 3.0}
    )
    poses = [pose((0, -0.01, 0.13)), pose((0, 0.016, 0.135), (0.3, 0.2, 0.1)), pose((0, 0, 0.145))]
    images = expected_electrons(scene, sensor, still(*poses, count=4)).mean(axis=0)
    for camera, image in zip(sensor.cameras, images, strict=True):
        ratio = image / (3.0 * electrons_per_irradiance(camera))
        assert ratio.mean() == pytest.approx(1.0, abs=2e-3)
        blocks = ratio.reshape(4, 32, 5, 32).mean(axis=(1, 3))
        assert np.abs(blocks - 1).max() < 5e-3


def test_reflected_light_depends_on_frame_not_on_threads() -> None:
    scene, poses = groove(0.8, Material(0.6, "rough_conductor", 0.2, 1.0))
    later = [pose((1e-4, 0, 2e-4)) @ p for p in poses]
    exposures = moving([poses, later], [np.eye(4)] * 2, count=4)
    sensor = small_probe(render={"bounces": 2})
    one, many = (expected_electrons(scene, sensor, exposures, threads=t) for t in (1, 3))
    np.testing.assert_array_equal(one, many)
    assert np.any(one[0] != one[1])
    assert one.sum(axis=(1, 2, 3)).std() < 2e-3 * one.sum(axis=(1, 2, 3)).mean()


def test_bounces_do_not_change_direct_light_of_convex_body() -> None:
    """A single convex body: bounces do not change a bit."""
    scene = ball(0.015, 0.8)
    images = [expected_electrons(scene, small_probe(render={"bounces": n}), still(pose((0, 0, 0.13)))) for n in (0, 2)]
    np.testing.assert_array_equal(*images)


def test_bounces_cause_ghost_points() -> None:
    """With bounces a polished groove shows stripes off the sheet."""
    scene, poses = groove(MIRROR, 0.6)
    found = [len(scan(scene, probe(render={"noise": False, "bounces": n}), still(*poses)).profiles) for n in (0, 1)]
    assert found[0] == 0
    assert found[1] > 200
