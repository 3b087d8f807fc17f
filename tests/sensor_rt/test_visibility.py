"""Search for sensor poses: visibility compared with closed forms for spheres, holes and plates."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

from scancell.sensor import PoseSearch, Scene, occluded

Array = NDArray[np.float64]

HEIGHT = 0.120  # of the laser source above the sample
ANGLE = np.radians(25.0)  # between laser ray and camera ray
LOOKING_DOWN = np.diag([1.0, -1.0, -1.0])
AZIMUTHS = np.radians(15.0) * np.arange(24)
UP = np.array([0.0, 0.0, 1.0])


def search(mesh: trimesh.Trimesh, samples: Array, normals: Array, **changed: Any) -> PoseSearch:
    """Sensor that looks straight down, with one camera that sees the sample at the centre of the sheet."""
    given = {
        "orientations": LOOKING_DOWN[None],
        "lowest": [0.0],
        "azimuths": len(AZIMUTHS),
        "field_points": [[0.0, HEIGHT]],
        "field_seen": [[1]],
        "cameras": [[HEIGHT * np.tan(ANGLE), 0.0, 0.0]],
        "source_z": 0.0,
        "incidence_limit": np.radians(75.0),
        "position_step": 5e-3,
    }
    return PoseSearch(mesh.vertices, mesh.faces, samples, normals, **(given | changed))


def measured(found: PoseSearch, count: int, threads: int = 0) -> NDArray[np.bool_]:
    mask = np.zeros(count, bool)
    mask[found.next(np.arange(count), threads)[0]] = True
    return mask


def to_camera() -> Array:
    """(24, 3) unit directions from the sample to the camera."""
    flat = np.sin(ANGLE) * np.stack([np.cos(AZIMUTHS), np.sin(AZIMUTHS)], -1)
    return np.column_stack([flat, np.full(len(AZIMUTHS), np.cos(ANGLE))])


@pytest.mark.parametrize("limit_deg", [20.0, 40.0, 75.0])
def test_visible_area_of_sphere_is_limited_by_incidence(limit_deg: float) -> None:
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.025)
    samples, normals = ball.triangles_center, ball.face_normals
    least = np.cos(np.radians(limit_deg))
    cosine = np.minimum(normals @ UP, (normals @ to_camera().T).max(1))
    found = measured(search(ball, samples, normals, incidence_limit=np.radians(limit_deg)), len(samples))
    clear = np.abs(cosine - least) > 1e-6
    assert np.array_equal(found[clear], (cosine >= least)[clear])
    assert 0 < found.mean() < 0.5


def test_rim_of_hole_occludes_camera_ray() -> None:
    """The vertical laser ray is unobstructed; the camera ray is D tan(25 deg) off the vertical at the rim."""
    radius, depth = 0.010, 0.015 / np.tan(ANGLE)
    tube = trimesh.creation.annulus(radius, 2 * radius, depth, sections=720)
    floor = trimesh.creation.cylinder(
        2 * radius, 1e-3, transform=trimesh.transformations.translation_matrix([0, 0, -depth / 2 - 0.5e-3])
    )
    rng = np.random.default_rng(2)
    where, around = radius * np.sqrt(rng.uniform(size=3000)), rng.uniform(0, 2 * np.pi, 3000)
    samples = np.stack([where * np.cos(around), where * np.sin(around), np.full(3000, -depth / 2)], -1)
    found = measured(search(tube + floor, samples, np.tile(UP, (3000, 1))), 3000)
    at_rim = samples[:, None, :2] + depth * np.tan(ANGLE) * to_camera()[:, :2] / np.sin(ANGLE)
    nearest = np.linalg.norm(at_rim, axis=2).min(1)
    clear = np.abs(nearest - radius) > 1e-4
    assert np.array_equal(found[clear], (nearest < radius)[clear])
    share = 1 - (0.005 / radius) ** 2  # azimuths through the sample leave the ring beyond 5 mm
    assert share - 0.02 < found.mean() < share + 0.01


@pytest.mark.parametrize("side", [1.0, 100.0, 2000.0])
def test_large_plate_does_not_occlude_itself(side: float) -> None:
    """Samples at its corner, where single precision rounds by a hundred micrometres on the largest one."""
    turn = trimesh.transformations.euler_matrix(0.2, 0.1, 0.3)[:3, :3]
    flat = np.array([[0, 0, 0], [side, 0, 0], [side, side, 0], [0, side, 0]]) - [0.5, 0.5, 0]
    plate = trimesh.Trimesh(flat @ turn.T, [[0, 1, 2], [0, 2, 3]], process=False)
    places = np.random.default_rng(1).uniform(-0.1, 0.1, (200, 3)) * [1, 1, 0]
    found = measured(search(plate, places @ turn.T, np.tile(turn @ UP, (200, 1)), lowest=[1.0]), 200)
    assert found.all()


def test_only_plates_below_sensor_occlude() -> None:
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.025)
    plates = [trimesh.creation.box((0.5, 0.5, 1e-3)).apply_translation([0, 0, z]) for z in (0.05, 0.3)]
    top = ball.face_normals[:, 2] > 0.5
    for plate, visible in zip(plates, (False, True), strict=True):
        found = measured(search(ball + plate, ball.triangles_center, ball.face_normals), len(top))
        assert (found[top] == visible).all()


@pytest.mark.parametrize(("lowest", "found"), [(-HEIGHT + 1e-3, True), (-HEIGHT - 1e-3, False)])
def test_housing_stays_above_table(lowest: float, found: bool) -> None:
    plate = trimesh.creation.box((0.1, 0.1, 0.01)).apply_translation([0, 0, -0.005])
    assert measured(search(plate, np.zeros((1, 3)), UP[None], lowest=[lowest]), 1).all() == found


def tilted(angle: float) -> Array:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[1.0, 0, 0], [0, c, -s], [0, s, c]]) @ LOOKING_DOWN


FIELD = np.array([[-0.02, 0.1], [0.0, 0.1], [0.02, 0.1], [0.0, 0.16]])
SEEN = np.array([[1, 1], [1, 0], [0, 1], [1, 1]])
CAMERAS = np.array([[0.06, 0.0, 0.0], [-0.06, 0.01, 0.0]])
SOURCE_Z = 0.005
ORIENTATIONS = np.array([tilted(a) for a in (0.0, 0.6, 1.2, 2.0)])
STEP = 2e-3


def every_pose(samples: PoseSearch, count: int) -> tuple[Array, Array, Array]:
    """Sample, key and positions of all poses of all samples."""
    parts = []
    rows = np.arange(count)
    while len(rows):
        rows, keys, positions = samples.next(rows)
        parts.append((rows, keys, positions))
    return tuple(np.concatenate(part) for part in zip(*parts, strict=True))


def grid_search(mesh: trimesh.Trimesh, samples: Array, normals: Array) -> PoseSearch:
    return search(
        mesh,
        samples,
        normals,
        orientations=ORIENTATIONS,
        lowest=[-1.0] * len(ORIENTATIONS),
        field_points=FIELD,
        field_seen=SEEN,
        cameras=CAMERAS,
        source_z=SOURCE_Z,
        position_step=STEP,
    )


def test_plane_yields_each_pose_within_incidence_limit_once() -> None:
    ground = trimesh.creation.box((0.01, 0.01, 0.01)).apply_translation([0, 0, 1.995])
    sample = np.array([[0.001, 0.002, 2.0]])
    found = len(every_pose(grid_search(ground, sample, UP[None]), 1)[0])
    in_sheet = np.column_stack([np.zeros(len(FIELD)), FIELD])
    to_optics = np.stack([[0.0, 0.0, SOURCE_Z] - in_sheet, *(c - in_sheet for c in CAMERAS)], 1)
    cosine = (ORIENTATIONS[:, None, None] @ to_optics[None, ..., None])[..., 2, 0]
    met = cosine / np.linalg.norm(to_optics, axis=-1) >= np.cos(np.radians(75.0))
    expected = (met[..., 0] & (met[..., 1:] & (SEEN == 1)).any(-1)).sum() * len(AZIMUTHS)
    assert found == expected > 100


def test_found_poses_are_consistent() -> None:
    part = trimesh.creation.box((0.06, 0.04, 0.02)) + trimesh.creation.icosphere(3, 0.015).apply_translation(
        [0.01, 0, 0.02]
    )
    part.apply_translation([0.02, 0.01, 1.0])
    samples, normals = part.triangles_center[::7], part.face_normals[::7]
    sample, keys, positions = every_pose(grid_search(part, samples, normals), len(samples))
    assert len(sample) > 1000
    at, source, camera = np.swapaxes(positions, 0, 1)
    rotation = ORIENTATIONS[keys[:, 0]]
    origin = source - SOURCE_Z * rotation[:, :, 2]
    assert np.array_equal(np.round(origin / STEP).astype(int), keys[:, 1:])
    in_sensor = np.einsum("nji,nj->ni", rotation, at - origin)
    point = np.linalg.norm(in_sensor[:, None, 1:] - FIELD, axis=2).argmin(1)
    assert np.abs(in_sensor - np.column_stack([0 * point, FIELD[point]])).max() < 1e-12
    optic = np.linalg.norm(np.einsum("nji,nj->ni", rotation, camera - origin)[:, None] - CAMERAS, axis=2)
    assert optic.min(1).max() < 1e-12 and (SEEN[point, optic.argmin(1)] == 1).all()
    # Rotate back to the azimuth of the pose, which moves the rotated sample to its position.
    turn = np.arctan2(samples[sample, 1], samples[sample, 0]) - np.arctan2(at[:, 1], at[:, 0])
    assert np.abs(np.remainder(turn / np.radians(15) + 0.5, 1.0) - 0.5).max() < 1e-6
    scene = Scene()
    scene.add_mesh("part", part.vertices, part.faces, 0.5)
    for end in (source, camera):
        c, s = np.cos(turn), np.sin(turn)
        placed = np.stack([c * end[:, 0] - s * end[:, 1], s * end[:, 0] + c * end[:, 1], end[:, 2]], -1)
        start = samples[sample] + 1e-5 * normals[sample]
        assert not occluded(scene, np.eye(4)[None], start, placed).any()
        way = placed - samples[sample]
        assert ((way * normals[sample]).sum(1) / np.linalg.norm(way, axis=1) >= np.cos(np.radians(75.001))).all()


def small_ball() -> tuple[trimesh.Trimesh, Array, Array]:
    ball = trimesh.creation.icosphere(2, 0.02).apply_translation([0, 0, 1.0])
    return ball, ball.triangles_center, ball.face_normals


def test_unreachable_poses_are_not_returned_again() -> None:
    ball = small_ball()
    _, keys, _ = every_pose(grid_search(*ball), len(ball[1]))
    pose_search = grid_search(*ball)
    distinct = np.unique(keys, axis=0)
    pose_search.record_reachability(distinct, distinct[:, 0] == 1)
    _, left, _ = every_pose(pose_search, len(ball[1]))
    assert len(left) == (keys[:, 0] == 1).sum() > 0 and (left[:, 0] == 1).all()


@pytest.mark.parametrize(("missed", "cube_gone"), [(2, False), (3, True)])
def test_three_unreachable_poses_exclude_cube(missed: int, cube_gone: bool) -> None:
    ball = small_ball()
    _, keys, _ = every_pose(grid_search(*ball), len(ball[1]))
    pose_search = grid_search(*ball)
    key = keys[len(keys) // 2]
    pose_search.record_reachability(np.repeat(key[None], missed, 0), np.zeros(missed, bool))
    _, left, _ = every_pose(pose_search, len(ball[1]))
    same = (keys == key).all(1).sum()
    assert (len(left) < len(keys) - same) == cube_gone
    gone = set(map(tuple, keys)) - set(map(tuple, left))
    distance = np.abs(np.array(sorted(gone)) - key)
    assert (distance[:, 0] == 0).all() and distance[:, 1:].max() <= 9  # 8 steps, and rounding
    pose_search = grid_search(*ball)
    pose_search.record_reachability(np.repeat(key[None], missed, 0), np.zeros(missed, bool))
    pose_search.record_reachability(key[None], np.ones(1, bool))
    assert len(every_pose(pose_search, len(ball[1]))[0]) == len(keys) - same


def test_skip_directions_skips_similar_poses() -> None:
    ball = small_ball()
    every = every_pose(grid_search(*ball), len(ball[1]))[0]
    skipping = grid_search(*ball)
    rows, found = np.arange(len(ball[1])), np.zeros(len(ball[1]), int)
    while len(rows):
        rows = skipping.next(rows)[0]
        found[rows] += 1
        skipping.skip_directions(rows)
    counts = np.bincount(every, minlength=len(found))
    assert np.array_equal(found > 0, counts > 0)
    assert (found <= counts).all() and found.sum() < 0.8 * counts.sum()
    assert found.max() <= 19 * 36  # tiles of 10 degrees of latitude and longitude


def test_results_do_not_depend_on_threads() -> None:
    ball = small_ball()
    answers = [grid_search(*ball).next(np.arange(len(ball[1])), threads) for threads in (1, 3)]
    assert len(answers[0][0]) > 100
    assert all(np.array_equal(a, b) for a, b in zip(*answers, strict=True))


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"azimuths": 7}, "azimuths"),
        ({"field_seen": [[1, 1]]}, "field_seen"),
        ({"lowest": [0.0, 0.0]}, "lowest"),
        ({"incidence_limit": 2.0}, "incidence_limit"),
        ({"position_step": 0.0}, "position_step"),
    ],
)
def test_invalid_arguments_are_rejected_by_name(changed: dict[str, Any], message: str) -> None:
    box = trimesh.creation.box((0.1, 0.1, 0.1))
    with pytest.raises(ValueError, match=message):
        search(box, np.zeros((1, 3)), UP[None], **changed)
    with pytest.raises(IndexError, match="sample 3"):
        search(box, np.zeros((1, 3)), UP[None]).next(np.array([3]))
