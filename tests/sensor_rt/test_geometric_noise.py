"""Noise of the geometric engine compared with that of rendered images of the same exposures."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import pytest
from numpy.typing import NDArray
from scenes import Array, moving, pose, still
from stripe_images import sensor_description

from scancell.sensor import PEAK_FLAGS, Exposures, Material, Profiles, Scene, Sensor, check_engine, scan

Engine = Literal["ray-traced", "geometric"]
ENGINES: tuple[Engine, ...] = ("ray-traced", "geometric")
MIDDLE = 0.015  # m: profiles are compared where both cameras see them, away from the ends


def noisy(**overrides: Any) -> Sensor:
    """Two-camera probe with the detector of the shipped sensor; keywords as in `sensor_description`."""
    detector = {"prnu": 0.005, "dsnu_e": 1.0, "dark_current_e_per_s": 20.0} | overrides.pop("detector", {})
    laser = {"power": 2e-3} | overrides.pop("laser", {})
    limits = {"near": 0.06, "far": 0.2} | overrides.pop("range", {})
    return Sensor(json.dumps(sensor_description(cameras=2, detector=detector, laser=laser, range=limits, **overrides)))


@dataclass
class Errors:
    """Standard deviation of one camera's points along their direction of uncertainty, and its stated value, m."""

    found: float
    stated: float
    height: float  # median amplitude, DN
    per_profile: float

    @classmethod
    def of(cls, profiles: Profiles, camera: int, world_from_plane: Array, count: int) -> Errors:
        points, normal = profiles.points_in_sensor, world_from_plane[:3, 2]
        mine = np.flatnonzero((profiles.camera == camera) & (np.abs(points[:, 1]) < MIDDLE))
        covariance = profiles.covariance[mine]
        # A point displaced by d along the unit vector e has the distance d (e n) from the plane.
        along = np.sqrt(np.einsum("i,nij,j->n", normal, covariance, normal)) / profiles.sigma[mine]
        off = (points[mine] - world_from_plane[:3, 3]) @ normal / along
        stated = float(np.sqrt((profiles.sigma[mine].astype(float) ** 2).mean()))
        return cls(float(off.std()), stated, float(np.median(profiles.intensity[mine])), len(mine) / count)


def plane(world_from_plane: Array, material: Material | float) -> Scene:
    scene = Scene()
    scene.add_plane("plane", np.eye(4), [1, 1], material)
    return scene


def tilted(z: float, about_x: float = 5.0, about_y: float = 0.0) -> Array:
    """A small tilt about X makes the stripe cover all sub-pixel positions."""
    return pose((0, 0, z), np.radians([about_x, about_y, 0.0]))


def compare(
    sensor: Sensor,
    world_from_plane: Array,
    material: Material | float,
    exposures: Exposures | None = None,
    count: int = 4,
) -> list[tuple[Errors, Errors]]:
    """Errors in both engines, per camera."""
    scene = plane(world_from_plane, material)
    exposures = exposures or still(world_from_plane, count=count)
    profiles = [scan(scene, sensor, exposures, engine).profiles for engine in ENGINES]
    return [tuple(Errors.of(p, k, world_from_plane, count) for p in profiles) for k in (0, 1)]  # type: ignore[misc]


def assert_alike(traced: Errors, geometric: Errors, what: object = "") -> None:
    said = (what, traced, geometric)
    assert geometric.per_profile > 300, said
    assert traced.found / 1.25 < geometric.found < 1.25 * traced.found, said
    assert geometric.stated == pytest.approx(geometric.found, rel=0.1), said
    assert geometric.stated == pytest.approx(traced.stated, rel=0.15), said
    assert geometric.height == pytest.approx(traced.height, rel=0.1), said


@pytest.mark.parametrize("z", [0.085, 0.12, 0.155])
@pytest.mark.parametrize("incidence", [0.0, 35.0, 50.0, 70.0])
def test_noise_matches_images_over_range_incidence_and_reflectance(z: float, incidence: float) -> None:
    ratios = []
    for reflectance in (0.12, 0.3, 0.9):
        for traced, geometric in compare(noisy(), tilted(z, about_x=max(incidence, 3.0)), reflectance):
            assert_alike(traced, geometric, (z, incidence, reflectance))
            ratios.append(geometric.found / traced.found)
    print(f"z {1e3 * z:g} mm, {incidence:g} deg: standard deviations {min(ratios):.3f} to {max(ratios):.3f} of images'")


@pytest.mark.parametrize("about_y", [30.0, -50.0])
def test_noise_matches_images_for_unequal_stripe_widths(about_y: float) -> None:
    one, other = compare(noisy(), tilted(0.12, about_y=about_y), 0.8)
    for traced, geometric in (one, other):
        assert_alike(traced, geometric)
    assert not 0.8 < one[0].found / other[0].found < 1.25


def shares(sensor: Sensor, world_from_plane: Array, reflectances: Array, engine: Engine) -> NDArray[np.float64]:
    """(n, 2) points per camera in the middle of a profile, relative to the maximum."""
    counts = []
    for reflectance in reflectances:
        scene = plane(world_from_plane, float(reflectance))
        profiles = scan(scene, sensor, still(world_from_plane, count=2), engine).profiles
        middle = np.abs(profiles.points_in_sensor[:, 1]) < MIDDLE
        counts.append([(middle & (profiles.camera == k)).sum() for k in (0, 1)])
    return np.array(counts) / np.max(counts, axis=0)


@pytest.mark.parametrize(("z", "angles"), [(0.085, (5, 0)), (0.155, (5, 0)), (0.12, (60, 0)), (0.12, (5, 30))])
def test_detection_limit_of_reflectance_matches_images(z: float, angles: tuple[float, float]) -> None:
    reflectances = np.geomspace(0.008, 0.15, 16)
    half = []
    for engine in ENGINES:
        share = shares(noisy(), tilted(z, *angles), reflectances, engine)
        assert share[0].max() == 0.0
        assert share[-1].min() > 0.98
        half.append([np.exp(np.interp(0.5, share[:, k], np.log(reflectances))) for k in (0, 1)])
    print(f"half of the points lost at reflectance: images {half[0]}, geometric {half[1]}")
    np.testing.assert_allclose(np.log(half[1]), np.log(half[0]), atol=np.log(1.5))


VARIANTS: dict[str, dict[str, Any]] = {
    "diffraction": {"camera": {"psf_sigma_px": 1.1}},
    "defocus": {"camera": {"focus": 0.131, "f_number": 22.0}, "laser": {"power": 6e-3}},
    "lens": {"camera": {"distortion": [-0.12, 0.05, 0.002, -0.001, 0.03], "scheimpflug_x": -0.2, "offset_y": 2e-4}},
    "divergent sheet": {"laser": {"waist_z": 0.06, "divergence": 2e-3, "power": 3e-3}},
    "bright in the middle": {"laser": {"profile_angle": [-0.28, 0.0, 0.28], "profile_power": [0.2, 1.0, 0.2]}},
    "read noise": {"detector": {"read_noise_e": 40.0}},
    "row noise": {"detector": {"row_noise_e": 40.0}},
    "12 bit": {"detector": {"bit_depth": 12, "gain_dn_per_e": 0.3}, "extraction": {"min_amplitude_dn": 30.0}},
    "ambient light": {"ambient": {"irradiance": 30.0}},
    "laser-off images": {"ambient": {"irradiance": 30.0}, "detector": {"laser_off_frame": True}},
    "speckle": {"speckle": {"contrast": 0.5}},
    "log parabola": {"extraction": {"detector": "log_parabola"}},
    "Steger": {"extraction": {"detector": "steger"}},
}


@pytest.mark.parametrize("name", VARIANTS)
def test_noise_depends_on_optics_detector_and_extraction(name: str) -> None:
    for traced, geometric in compare(noisy(**VARIANTS[name]), tilted(0.13, about_x=15.0), 0.5):
        assert_alike(traced, geometric, name)


@pytest.mark.parametrize(
    "material",
    [
        Material(0.6, "oren_nayar", 0.4, 1.5),
        Material(0.6, "rough_conductor", 0.35, 1.5),
        Material(0.3, "rough_dielectric", 0.2, 1.5),
    ],
    ids=["Oren-Nayar", "conductor", "dielectric"],
)
def test_height_and_noise_depend_on_material(material: Material) -> None:
    for traced, geometric in compare(noisy(), tilted(0.12, about_x=10.0, about_y=8.0), material):
        assert_alike(traced, geometric)


def test_motion_widens_stripe() -> None:
    """Plane that approaches by ten sheet widths during the exposure."""
    sensor = noisy(laser={"power": 8e-3})
    middle = tilted(0.12)
    start, end = (pose((0, 0, shift)) @ middle for shift in (-3e-4, 3e-4))
    motion = moving([[start], [end]], [np.eye(4)] * 2, count=4)
    at_rest = compare(sensor, middle, 0.5)
    in_motion = compare(sensor, middle, 0.5, motion)
    for still_errors, (traced, geometric) in zip(at_rest, in_motion, strict=True):
        assert geometric.height < 0.6 * still_errors[1].height
        assert traced.found / 1.25 < geometric.found < 1.25 * traced.found
        assert geometric.height == pytest.approx(traced.height, rel=0.25)


def test_lamps_add_noise_but_no_points() -> None:
    world_from_plane = tilted(0.12)
    dark, lit = plane(world_from_plane, 0.5), plane(world_from_plane, 0.5)
    lit.add_light("plane", "point", pose((0, 0, -0.3)), [0, 0], 500.0, 0.3)
    exposures = still(world_from_plane, count=4)
    without, with_lamp = (
        Errors.of(scan(scene, noisy(), exposures, "geometric").profiles, 0, world_from_plane, 4)
        for scene in (dark, lit)
    )
    traced = Errors.of(scan(lit, noisy(), exposures).profiles, 0, world_from_plane, 4)
    assert with_lamp.found > 1.2 * without.found
    assert_alike(traced, with_lamp)


def box_mesh(size: float) -> tuple[Array, NDArray[np.uint32]]:
    """Upper half of a tilted box, whose coordinates are not exact in single precision."""
    corners = pose(angles=(0.2, 0.1, 0.3))[:3, :3] @ (size * np.array([[-1, 1, 1, -1], [-1, -1, 1, 1], [0, 0, 0, 0]]))
    return corners.T, np.array([[0, 1, 2], [0, 2, 3]], np.uint32)


@pytest.mark.parametrize("shape", ["mesh", "large mesh", "plane", "box", "cylinder"])
def test_lamp_reaches_every_point_of_a_lit_surface(shape: str) -> None:
    """A lamp far above: the stated sigma varies slowly along the profile and exceeds that without the lamp."""
    scenes = []
    for lamp in (0.0, 400.0):
        scene = Scene()
        if shape.endswith("mesh"):
            scene.add_mesh("body", *box_mesh(100.0 if shape == "large mesh" else 0.3), 0.5)
        elif shape == "plane":
            scene.add_plane("body", np.eye(4), [0.7, 0.7], 0.5)
        elif shape == "box":
            scene.add_box("body", pose((0, 0, 0.05)), [0.3, 0.3, 0.1], 0.5)
        else:
            scene.add_cylinder("body", pose((0, 0, 0.05)), 0.3, 0.1, 0.5)
        scene.add_light("lamp", "point", np.eye(4), [0, 0], lamp, 0.3)
        scenes.append(scene)
    level = np.linalg.inv(pose(angles=(0.2, 0.1, 0.3))) if shape.endswith("mesh") else np.eye(4)
    exposures = still(tilted(0.12) @ level, pose((0.02, 0, -0.3)))
    dark, lit = (scan(scene, noisy(), exposures, "geometric").profiles for scene in scenes)
    assert len(dark) > 2000
    for camera in (0, 1):
        without, stated = (p.sigma[p.camera == camera] for p in (dark, lit))
        np.testing.assert_array_less(1.2 * without.mean(), stated)
        np.testing.assert_allclose(stated[16:], stated[:-16], rtol=0.03)


@pytest.mark.parametrize(
    ("detector", "frames", "tolerance"),
    [({"prnu": 0.005}, 1, 0.02), ({"prnu": 0.02}, 1, 0.02), ({"row_noise_e": 10.0}, 8, 0.1)],
    ids=str,
)
@pytest.mark.parametrize("engine", ENGINES)
def test_stated_sigma_includes_noise_that_pixels_share(
    engine: Engine, detector: dict[str, float], frames: int, tolerance: float
) -> None:
    """Planes at distances of millimetres, so that every stripe falls on other pixels of the fixed pattern.

    The error of rows is one for all columns, so that it takes many frames to tell its size.
    """
    scores = []
    for z in np.linspace(0.09, 0.15, 40):
        plane_pose = tilted(z)
        exposures = still(plane_pose, count=frames, first=round(1e6 * z))
        profiles = scan(plane(plane_pose, 0.5), noisy(detector=dict(detector)), exposures, engine).profiles
        points, normal = profiles.points_in_sensor, plane_pose[:3, 2]
        stated = np.sqrt(np.einsum("i,nij,j->n", normal, profiles.covariance, normal))
        off = (points - plane_pose[:3, 3]) @ normal
        scores.append((off / stated)[np.abs(points[:, 1]) < MIDDLE])
    score = np.concatenate(scores)
    print(f"{engine}, {detector}: error over stated sigma {score.std():.4f}, n = {len(score)}")
    assert len(score) > 40_000
    assert score.std() == pytest.approx(1.0, abs=tolerance)


def test_sensitivities_to_uniform_light_cancel_in_differences() -> None:
    """The background's pattern adds to sigma, but not where the image without laser is subtracted."""
    plane_pose = tilted(0.12)
    growth = {}
    for engine in ENGINES:
        for off in (False, True):
            stated = []
            for prnu in (0.0, 0.02):
                sensor = noisy(ambient={"irradiance": 100.0}, detector={"prnu": prnu, "laser_off_frame": off})
                stated.append(scan(plane(plane_pose, 0.2), sensor, still(plane_pose), engine).profiles.sigma.mean())
            growth[engine, off] = float(np.sqrt((stated[1] / stated[0]) ** 2 - 1.0))
    print(growth)
    for off in (False, True):
        assert growth["geometric", off] == pytest.approx(growth["ray-traced", off], rel=0.1)
    assert growth["ray-traced", False] > 1.5 * growth["ray-traced", True]


def test_saturated_stripes_are_flagged_then_lost() -> None:
    world_from_plane = tilted(0.12)
    for power, flagged, kept in ((2e-3, False, True), (8e-3, True, True), (50.0, True, False)):
        sensor = noisy(laser={"power": power})
        profiles = scan(plane(world_from_plane, 0.6), sensor, still(world_from_plane), "geometric").profiles
        assert (len(profiles) > 1000) == kept
        if kept:
            assert ((profiles.flags & PEAK_FLAGS["saturated"]) != 0).all() == flagged


def test_errors_follow_sensor_as_built_and_sigma_the_nominal_sensor() -> None:
    world_from_plane = tilted(0.13)
    sensor, as_built = noisy(), noisy(detector={"read_noise_e": 80.0})
    exposures = still(world_from_plane, count=4)
    profiles = [scan(plane(world_from_plane, 0.3), sensor, exposures, e, as_built=as_built).profiles for e in ENGINES]
    traced, geometric = (Errors.of(p, 0, world_from_plane, 4) for p in profiles)
    assert geometric.found > 1.5 * geometric.stated
    assert geometric.found == pytest.approx(traced.found, rel=0.25)
    assert geometric.stated == pytest.approx(traced.stated, rel=0.15)


def test_errors_depend_only_on_seed_frame_and_camera() -> None:
    world_from_plane = tilted(0.12)
    scene = plane(world_from_plane, 0.5)

    def rows(seed: int, first: int, count: int, camera: int, threads: int = 1) -> Array:
        sensor = noisy(render={"noise": True, "seed": seed})
        found = scan(scene, sensor, still(world_from_plane, count=count, first=first), "geometric", threads).profiles
        return found.row[(found.camera == camera) & (found.frame == first + count - 1)]

    reference = rows(1, 4, 2, 0)
    np.testing.assert_array_equal(reference, rows(1, 0, 6, 0, threads=3))
    for other in (rows(2, 4, 2, 0), rows(1, 5, 2, 0)):
        assert (reference != other).mean() > 0.99
    error = [rows(1, 4, 2, k) - rows(1, 5, 2, k) for k in (0, 1)]
    assert abs(np.corrcoef(error[0], error[1][::-1])[0, 1]) < 0.15
    assert abs(np.corrcoef(error[0], error[1])[0, 1]) < 0.15


def test_errors_are_normal_and_unbiased() -> None:
    world_from_plane = tilted(0.12)
    scene, exposures = plane(world_from_plane, 0.5), still(world_from_plane, count=30)
    profiles = scan(scene, noisy(detector={"prnu": 0.0}), exposures, "geometric").profiles
    normal = world_from_plane[:3, 2]
    sigma = np.sqrt(np.einsum("i,nij,j->n", normal, profiles.covariance, normal))
    score = (profiles.points_in_sensor - world_from_plane[:3, 3]) @ normal / sigma
    n = len(score)
    assert n > 30_000
    assert abs(score.mean()) < 5 / np.sqrt(n)
    assert score.std() == pytest.approx(1.0, abs=0.02)
    assert (np.abs(score) > 2.0).mean() == pytest.approx(0.0455, abs=0.005)
    assert np.abs(score).max() < 6.0


def test_short_runs_and_run_ends_are_discarded() -> None:
    """Two isolated strips: the extraction rejects a column at either end, and runs of fewer than eight."""
    scene = Scene()
    scene.add_plane("wide", np.eye(4), [0.1, 0.01], 0.6)
    scene.add_plane("narrow", pose((0, 0.012, 0)), [0.1, 2e-4], 0.6)
    poses = (pose((0, 0, 0.12)),) * 2
    exact = scan(scene, noisy(render={"noise": False}), still(*poses), "geometric").profiles
    found = scan(scene, noisy(), still(*poses), "geometric").profiles
    y, expected = found.points_in_sensor[:, 1], exact.points_in_sensor[:, 1]
    assert (expected > 0.01).any()
    assert (y < 0.01).all()
    for camera in (0, 1):
        columns = (np.sort(p.column[(p.camera == camera) & (p.points_in_sensor[:, 1] < 0.01)]) for p in (found, exact))
        kept, all_columns = columns
        assert 1 <= kept[0] - all_columns[0] <= 3
        assert 1 <= all_columns[-1] - kept[-1] <= 3


@pytest.mark.parametrize("noise", [True, False])
def test_fusion_merges_two_points_into_one(noise: bool) -> None:
    world_from_plane = tilted(0.12)
    scene, exposures = plane(world_from_plane, 0.5), still(world_from_plane, count=4)
    apart, fused = (
        scan(scene, noisy(render={"noise": noise}, extraction={"fusion": fusion}), exposures, "geometric").profiles
        for fusion in ("none", "weighted")
    )
    assert len(fused) == pytest.approx(len(apart) / 2, rel=0.02)
    assert (fused.camera == 0).mean() > 0.98
    if noise:
        one, both = (Errors.of(p, 0, world_from_plane, 4) for p in (apart, fused))
        assert both.found == pytest.approx(one.found / np.sqrt(2), rel=0.1)
        assert both.stated == pytest.approx(one.stated / np.sqrt(2), rel=0.1)
    else:
        off = (fused.points_in_sensor - world_from_plane[:3, 3]) @ world_from_plane[:3, 2]
        assert np.abs(off).max() < 1e-12


def test_without_noise_rows_and_points_are_exact() -> None:
    world_from_plane = tilted(0.12)
    profiles = scan(
        plane(world_from_plane, 0.5), noisy(render={"noise": False}), still(world_from_plane), "geometric"
    ).profiles
    off = (profiles.points_in_sensor - world_from_plane[:3, 3]) @ world_from_plane[:3, 2]
    assert np.abs(off).max() < 1e-15
    assert not profiles.sigma.any()
    assert not profiles.covariance.any()


@pytest.mark.parametrize(
    ("section", "values", "message"),
    [
        ("detector", {"row_readout": 1e-5}, r'sensor\.detector\.shutter = "rolling"'),
        ("render", {"bounces": 2}, r"sensor\.render\.bounces = 2"),
        ("render", {"mode": "path"}, r'sensor\.render\.mode = "path"'),
    ],
)
def test_unsupported_options_of_geometric_engine_are_rejected_by_key(
    section: str, values: dict[str, Any], message: str
) -> None:
    sensor, world_from_plane = noisy(**{section: values}), tilted(0.12)
    check_engine(sensor, "ray-traced")
    with pytest.raises(ValueError, match=message):
        check_engine(sensor, "geometric")
    for pair in ((sensor, noisy()), (noisy(), sensor)):
        with pytest.raises(ValueError, match=message):
            scan(plane(world_from_plane, 0.5), pair[0], still(world_from_plane), engine="geometric", as_built=pair[1])
