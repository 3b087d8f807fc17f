"""The complete pipeline: images, stripes, points; order, repeatability, error messages."""

from __future__ import annotations

import json
import threading

import numpy as np
import pytest
import trimesh
from scenes import Array, pose, probe, still
from stripe_images import sensor_description

from scancell.sensor import Exposures, Scene, Sensor, cast_rays, extract, render, scan, tree_builds, triangulate


def wedge() -> tuple[Scene, Array]:
    """Asymmetric part: the surface descends towards +y, with a ridge on one side."""
    scene = Scene()
    scene.add_plane("part", pose(angles=(0.35, 0.0, 0.0)), [1, 1], 0.6)
    scene.add_cylinder("part", pose((0.0, 0.008, 0.0), (0.35, np.pi / 2, 0.0)), 0.004, 0.1, 0.6)
    return scene, pose((0, 0, 0.12))


@pytest.mark.parametrize("engine", ["ray-traced", "geometric"])
def test_points_lie_on_simulated_surface(engine: str) -> None:
    """Signs, axes and both cameras: an asymmetric object is not mirrored."""
    scene, world_from_part = wedge()
    profiles = scan(scene, probe(), still(world_from_part), engine=engine).profiles  # type: ignore[arg-type]
    points = profiles.points_in_sensor - [0, 0, 0.12]
    tilted = pose(angles=(0.35, 0.0, 0.0))
    axis = np.array([0.0, 0.008, 0.0])
    pin = pose((0.0, 0.008, 0.0), (0.35, np.pi / 2, 0.0))
    in_pin = (points - axis) @ pin[:3, :3]
    ridge = np.abs(np.hypot(in_pin[:, 0], in_pin[:, 1]) - 0.004)
    plane = np.abs(points @ tilted[:3, 2])
    error = np.minimum(plane, ridge)
    limit = 5e-6 if engine == "ray-traced" else 1e-12
    for camera in (0, 1):
        mine = profiles.camera == camera
        assert mine.sum() > 600
        assert np.sqrt((error[mine] ** 2).mean()) < limit
        assert (ridge[mine] < limit).sum() > 50
        assert (plane[mine] < limit).sum() > 300


def test_only_changed_shapes_are_rebuilt() -> None:
    ball, floor = trimesh.creation.icosphere(subdivisions=4, radius=0.015), trimesh.creation.box([0.2, 0.2, 0.01])
    ring = trimesh.creation.torus(0.012, 0.004)

    def cell(part: trimesh.Trimesh) -> Scene:
        scene = Scene()
        scene.add_mesh("part", part.vertices, part.faces, 0.5)
        scene.add_mesh("floor", floor.vertices, floor.faces, 0.4)
        return scene

    rng = np.random.default_rng(2)
    bodies = np.array([[pose((0, 0, 0.12), rng.uniform(-3, 3, 3)), pose((0, 0, 0.16))] for _ in range(10)])
    sensors = np.broadcast_to(np.eye(4), (10, 1, 4, 4))
    exposures = Exposures(sensors, bodies[:, :, None], np.full(10, 5e-4), np.arange(10))
    scene, before = cell(ball), tree_builds()
    for engine in ("geometric", "ray-traced"):
        scan(scene, probe(), exposures, engine=engine)  # type: ignore[arg-type]
    cast_rays(scene, bodies[0], np.zeros((5, 3)), np.tile([0, 0, 1.0], (5, 1)))
    assert tree_builds() == before
    scene.remove_shapes("part")
    scene.add_mesh("part", ring.vertices, ring.faces, 0.5)
    assert tree_builds() == before + 1
    assert scene.bodies == ["part", "floor"]
    edited, fresh = (scan(one, probe(), exposures, engine="geometric").profiles for one in (scene, cell(ring)))
    assert len(fresh) > 1000
    np.testing.assert_array_equal(edited.points_in_sensor, fresh.points_in_sensor)
    with pytest.raises(ValueError, match="no body lid"):
        scene.remove_shapes("lid")


def noisy() -> Sensor:
    return probe(render={"noise": True, "seed": 3})


def test_scan_equals_render_extract_triangulate() -> None:
    scene, world_from_part = wedge()
    sensor = noisy()
    exposures = still(world_from_part, count=2, first=5)
    result = scan(scene, sensor, exposures, keep_images=True)
    images = render(scene, sensor, exposures)
    assert images.shape == (2, 2, 1024, 1280)
    np.testing.assert_array_equal(result.images, images)
    points = triangulate(extract(images, sensor), sensor).points_in_sensor
    np.testing.assert_array_equal(result.profiles.points_in_sensor, points)
    assert set(result.profiles.frame) == {5, 6}
    assert set(result.timings) == {"cast", "render", "detect", "extract", "triangulate"}
    assert scan(scene, sensor, exposures).images is None


@pytest.mark.parametrize("engine", ["ray-traced", "geometric"])
def test_output_depends_on_seed_not_on_threads(engine: str) -> None:
    mesh = trimesh.creation.icosphere(subdivisions=4, radius=0.025)
    scene = Scene()
    scene.add_mesh("part", mesh.vertices, mesh.faces, 0.6)
    scene.add_cylinder("table", np.eye(4), 0.1, 0.01, 0.3)
    rng = np.random.default_rng(4)
    ends = rng.uniform(-2e-3, 2e-3, (6, 2, 3)), rng.uniform(-0.01, 0.01, (6, 2, 3))
    part = np.array(
        [[pose((0, 0, 0.13)) @ pose(*end) for end in zip(*both, strict=True)] for both in zip(*ends, strict=True)]
    )
    table = np.broadcast_to(pose((0, 0, 0.17)), part.shape)
    exposures = Exposures(
        np.broadcast_to(np.eye(4), part.shape), np.stack([part, table], axis=1), np.full(6, 5e-4), np.arange(6)
    )
    images = engine == "ray-traced"
    one = scan(scene, noisy(), exposures, engine, threads=1, keep_images=images)  # type: ignore[arg-type]
    two = scan(scene, noisy(), exposures, engine, threads=3, keep_images=images)  # type: ignore[arg-type]
    for name in ("points_in_sensor", "covariance", "intensity", "camera", "column", "row", "frame", "flags", "sigma"):
        assert getattr(one.profiles, name).tobytes() == getattr(two.profiles, name).tobytes()
    assert (np.diff(one.profiles.frame) >= 0).all()
    if one.images is not None and two.images is not None:
        assert one.images.tobytes() == two.images.tobytes()


def test_scan_releases_gil() -> None:
    scene, world_from_part = wedge()
    scanning, done = threading.Event(), threading.Event()
    ticks = 0

    def tick() -> None:
        nonlocal ticks
        while not done.wait(0.001):
            ticks += scanning.is_set()

    other = threading.Thread(target=tick)
    other.start()
    scanning.set()
    scan(scene, probe(), still(world_from_part, count=6), threads=1)
    scanning.clear()
    done.set()
    other.join()
    # A blocked thread ticks at most once before the call and once after it.
    assert ticks >= 5


def test_mismatched_exposures_are_rejected() -> None:
    scene, world_from_part = wedge()
    sensor = probe()
    with pytest.raises(ValueError, match="poses of 2 bodies, the scene has 1"):
        scan(scene, sensor, still(world_from_part, world_from_part))
    with pytest.raises(ValueError, match="expected ray-traced or geometric"):
        scan(scene, sensor, still(world_from_part), engine="magic")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="keep_images: the geometric engine makes no images"):
        scan(scene, sensor, still(world_from_part), engine="geometric", keep_images=True)
    identity = np.eye(4)
    good = (identity[None, None], identity[None, None, None], [1e-3], np.array([0]))

    def refuse(position: int, value: object, message: str) -> None:
        arguments = list(good)
        arguments[position] = value
        with pytest.raises(ValueError, match=message):
            Exposures(*arguments)

    refuse(0, np.full((1, 1, 4, 4), np.nan), "world_from_sensor: not a rigid transform")
    refuse(0, np.diag([1.0, 1.0, -1.0, 1.0])[None, None], "world_from_sensor: not a rigid transform")
    refuse(0, identity[None], "world_from_sensor: expected shape")
    refuse(0, np.zeros((1, 0, 4, 4)), "world_from_body: expected shape")
    refuse(1, 1.1 * identity[None, None, None], "world_from_body: not a rigid transform")
    refuse(1, np.zeros((2, 1, 1, 4, 4)), "world_from_body: expected shape")
    refuse(2, [0.0], "duration: must be finite and positive")
    refuse(2, [np.inf], "duration: must be finite and positive")
    refuse(2, [1.0, 1.0], "duration: expected shape")
    refuse(3, np.array([0, 1]), "index: expected shape")


def test_cameras_of_different_size_cannot_share_array() -> None:
    scene, world_from_part = wedge()
    description = sensor_description(cameras=2, render={"noise": False}, range={"near": 0.06, "far": 0.2})
    description["cameras"][1] |= {"width_px": 640, "cx_px": 319.5}
    sensor = Sensor(json.dumps(description))
    profiles = scan(scene, sensor, still(world_from_part)).profiles
    whole = scan(scene, probe(), still(world_from_part)).profiles
    np.testing.assert_array_equal(
        profiles.points_in_sensor[profiles.camera == 0], whole.points_in_sensor[whole.camera == 0]
    )
    assert 300 < (profiles.camera == 1).sum() < 640
    with pytest.raises(ValueError, match="camera 1 differs in size"):
        scan(scene, sensor, still(world_from_part), keep_images=True)
    with pytest.raises(ValueError, match="camera 1 differs in size"):
        render(scene, sensor, still(world_from_part))


def test_empty_batch_gives_empty_result() -> None:
    scene, _ = wedge()
    none = Exposures(np.zeros((0, 1, 4, 4)), np.zeros((0, 1, 1, 4, 4)), np.zeros(0), np.zeros(0, dtype=np.int64))
    for engine in ("ray-traced", "geometric"):
        result = scan(scene, probe(), none, engine, keep_images=engine == "ray-traced")  # type: ignore[arg-type]
        assert len(result.profiles) == 0
        assert result.profiles.points_in_sensor.shape == (0, 3)
    assert render(scene, probe(), none).shape == (0, 2, 1024, 1280)
