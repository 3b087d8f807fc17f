"""Distances, closest points and collisions of bodies against closed forms and FCL; batches, paths, threads, input."""

from dataclasses import replace
from types import SimpleNamespace

import fcl
import numpy as np
import pytest
import trimesh
from cells import ball, mesh_of, planning_cell
from fcl_collisions import colliding, collision_object

from scancell.config.loading import assets_dir, load_setup
from scancell.geometry import pose
from scancell.geometry.mesh import Mesh
from scancell.nominal.cell import nominal_cell
from scancell.nominal.parts import Body
from scancell.proximity.motion_check import MotionCheck
from scancell.proximity.scene import ProximityScene, cell_scene, intersecting_pairs

BOX = mesh_of(trimesh.creation.box((0.2, 0.2, 0.2)))
PLATE = mesh_of(trimesh.creation.box((0.6, 0.6, 0.02)).subdivide().subdivide())
BALL = mesh_of(trimesh.creation.icosphere(3, 0.1))
RNG = np.random.default_rng(5)


def _placed(*positions: np.ndarray) -> np.ndarray:
    """(n, bodies, 4, 4) from positions per body, each (n, 3) or (3,)."""
    return np.stack([pose.translation(np.broadcast_to(p, (len(positions[-1]), 3))) for p in positions], 1)


def test_corner_to_face_distance():
    rotation = pose.rotation_about(2, np.pi / 4) @ pose.rotation_about(0, 0.3)
    lowest = (BOX.vertices @ rotation.T)[:, 2].min()
    poses = np.stack([np.eye(4)[None], pose.from_rotation(rotation, (0.0, 0.0, 0.01 - lowest + 0.0123))[None]], 1)
    scene = ProximityScene({"plate": PLATE, "box": BOX}, [("plate", "box")])
    assert scene.distances(poses, 0.05)[0, 0] == pytest.approx(0.0123, abs=1e-12)


def test_clearance_violation_names_bodies_and_distance():
    scene = ProximityScene({"a": BOX, "b": BOX, "ball": BALL}, [("a", "b"), ("a", "ball"), ("b", "ball")])
    poses = _placed(np.zeros(3), (0.203, 0.0, 0.0), np.array([[0.0, 0.0, 0.9]]))
    (near,) = scene.clearance_violations(poses, 0.005)
    assert (near.index, near.body_a, near.body_b) == (0, "a", "b")
    assert near.distance == pytest.approx(0.003)


def test_bodies_that_intersect_violate_a_clearance_of_0():
    scene = ProximityScene({"a": BOX, "b": BOX}, [("a", "b")])
    poses = _placed(np.zeros(3), np.array([[0.199, 0.0, 0.0], [0.201, 0.0, 0.0]]))
    (clash,) = scene.clearance_violations(poses, 0.0)
    assert (clash.index, clash.distance) == (0, 0.0)


def test_unlisted_pairs_are_not_checked():
    scene = ProximityScene({"a": BOX, "b": BOX}, [])
    poses = _placed(np.zeros(3), np.zeros((2, 3)))
    assert scene.clearance_violations(poses, 0.1) == []
    assert scene.distances(poses, 0.1).shape == (2, 0)
    both = ProximityScene({"a": BOX, "b": BOX}, [("a", "b")])
    assert both.without({frozenset(("b", "a"))}).pairs == ()


def test_intersecting_pairs():
    scene = ProximityScene({"a": BOX, "b": BOX, "ball": BALL}, [("a", "b"), ("a", "ball")])
    ball = np.column_stack([np.zeros((20, 2)), np.where(np.arange(20) < 10, 0.15, 0.5)])
    poses = _placed(np.zeros(3), (0.1, 0.0, 0.0), ball)
    assert intersecting_pairs(scene, poses) == {frozenset(("a", "b"))}


def test_edge_to_edge_distance():
    quarter = pose.rotation_about(0, np.pi / 4)
    upper = pose.rotation_about(2, np.pi / 2) @ quarter
    half_diagonal = 0.1 * np.sqrt(2)
    gap = 0.0321
    scene = ProximityScene({"a": BOX, "b": BOX}, [("a", "b")])
    b = pose.from_rotation(upper, (0.0, 0.0, 2 * half_diagonal + gap))
    poses = np.stack([pose.from_rotation(quarter, (0.0, 0.0, 0.0)), b])[None]
    distance, points = scene.closest_points(poses, 1.0)
    assert distance[0, 0] == pytest.approx(gap, abs=1e-12)
    expected = np.array([[0, 0, half_diagonal], [0, 0, half_diagonal + gap]])
    assert np.abs(points[0, 0] - expected).max() < 1e-9


def test_ball_distance_is_between_polyhedron_and_sphere():
    # Two balls of n faces: the spheres are the lower bound; the vertices on the line between the centres attain it.
    scene = ProximityScene({"a": BALL, "b": BALL}, [("a", "b")])
    axis = BALL.vertices[0] / np.linalg.norm(BALL.vertices[0])
    centres = np.outer([0.2001, 0.21, 0.3, 0.4], axis)
    distance, points = scene.closest_points(_placed(np.zeros(3), centres), 1.0)
    assert np.abs(distance[:, 0] - (np.array([0.2001, 0.21, 0.3, 0.4]) - 0.2)).max() < 1e-12
    assert np.abs(points[:, 0, 0] - 0.1 * axis).max() < 1e-9
    assert np.abs(points[:, 0, 1] - (centres - 0.1 * axis)).max() < 1e-9


def test_small_triangles_keep_their_faces():
    # FCL's kernel ignores the faces of triangles below 0.2 mm and would answer with the distance of their edges.
    small = mesh_of(trimesh.creation.box((1e-4, 1e-4, 1e-4)))
    needle = Mesh(np.array([[0.0, 0, 0], [1e-5, 0, 1e-3], [0, 1e-5, 1e-3]]), np.array([[0, 1, 2]]))
    scene = ProximityScene({"small": small, "needle": needle}, [("small", "needle")])
    poses = _placed(np.zeros(3), np.array([[1e-5, 2e-5, 0.5e-4 + 1e-4]]))
    assert scene.distances(poses, 1.0)[0, 0] == pytest.approx(1e-4, abs=1e-12)


def test_points_are_nan_beyond_bound_and_when_intersecting():
    scene = ProximityScene({"a": BOX, "b": BOX}, [("a", "b")])
    centres = np.column_stack([[0.15, 0.21, 0.4], np.zeros(3), np.zeros(3)])
    distance, points = scene.closest_points(_placed(np.zeros(3), centres), 0.05)
    assert distance[:, 0] == pytest.approx([0.0, 0.01, 0.05], abs=1e-12)
    assert np.isnan(points[[0, 2]]).all()
    assert np.isfinite(points[1]).all()


def test_collision_matches_zero_distance():
    scene = ProximityScene({"plate": PLATE, "ball": BALL, "box": BOX}, [("plate", "ball"), ("ball", "box")])
    count = 400
    rotations = RNG.normal(size=(3, count, 4))
    poses = np.stack([pose.pose(RNG.uniform(-0.15, 0.15, (count, 3)), q) for q in rotations], 1)
    collision = scene.native.collisions(poses)
    assert collision.dtype == bool
    assert (collision == (scene.distances(poses, 1.0) == 0)).all()
    assert 0.1 < collision.mean() < 0.9
    assert (
        scene.native.collisions(_placed(np.zeros(3), (0.0, 0.0, 0.1101), np.array([[1.0, 0, 0]])))[0].tolist()
        == [False] * 2
    )


class Arm:
    """The default cell with a ball on its table."""

    def __init__(self):
        self.cell = planning_cell(ball())
        self.scene = self.cell.proximity
        self.meshes = {name: one.mesh for name, one in self.cell.reduced_meshes.items()}

    def poses(self, q, table):
        return self.cell.nominal.body_poses(np.column_stack([q, table]))

    def random_poses(self, count):
        lower, upper = self.cell.nominal.arm.limits
        return self.poses(RNG.uniform(lower, upper, (count, 6)), RNG.uniform(0, 2 * np.pi, count))

    def path(self, count):
        """From a view of the part down into it, with all joints and the table moving."""
        direction = np.array([0.1, 1.0, 0.3, -0.2, -0.6, 0.9, 1.0])
        start = np.append(np.radians([35, -25, 195, -68, 79, -10]), 0.0)
        points = start + np.arange(count)[:, None] * np.radians(0.5) * direction
        return self.poses(points[:, :6], points[:, 6])


@pytest.fixture(scope="module")
def arm():
    return Arm()


def _fcl_distances(arm, poses):
    objects = {name: collision_object(mesh) for name, mesh in arm.meshes.items()}
    distances = np.empty((len(poses), len(arm.scene.pairs)))
    for k, placed in enumerate(poses):
        for name, matrix in zip(arm.scene.names, placed, strict=True):
            objects[name].setTransform(fcl.Transform(matrix[:3, :3], matrix[:3, 3]))
        for p, (a, b) in enumerate(arm.scene.pairs):
            found = fcl.distance(objects[a], objects[b], fcl.DistanceRequest(), fcl.DistanceResult())
            distances[k, p] = max(found, 0.0)
    return distances


def _is_enclosed(arm, poses, pair) -> bool:
    """Whether a body surrounds a vertex of the other: by the solid angle of its surface (van Oosterom & Strackee)."""
    at = {name: pose.transform_points(poses[k], arm.meshes[name].vertices) for k, name in enumerate(arm.scene.names)}
    for inner, outer in (pair, pair[::-1]):
        corners = (at[outer] - at[inner][0])[arm.meshes[outer].faces]
        a, b, c = np.moveaxis(corners / np.linalg.norm(corners, axis=-1, keepdims=True), 1, 0)
        triple = np.einsum("ni,ni->n", a, np.cross(b, c))
        below = 1 + np.einsum("ni,ni->n", a, b) + np.einsum("ni,ni->n", b, c) + np.einsum("ni,ni->n", c, a)
        if abs(2 * np.arctan2(triple, below).sum()) > 2 * np.pi:
            return True
    return False


def test_arm_distances_match_fcl(arm):
    poses = arm.random_poses(12)
    expected = _fcl_distances(arm, poses)
    solid = arm.scene.distances(poses, np.inf) == 0
    for k, p in zip(*np.nonzero(solid & (expected > 0)), strict=True):  # FCL sees surfaces only
        assert _is_enclosed(arm, poses[k], arm.scene.pairs[p])
        expected[k, p] = 0.0
    full, points = arm.scene.closest_points(poses, np.inf)
    assert np.abs(full - expected).max() < 1e-9
    assert np.abs(arm.scene.distances(poses, 0.05) - np.minimum(expected, 0.05)).max() < 1e-9
    apart = full > 0
    assert np.abs(np.linalg.norm(points[..., 0, :] - points[..., 1, :], axis=-1)[apart] - full[apart]).max() < 1e-12


def test_arm_collisions_match_fcl(arm):
    poses = arm.random_poses(150)
    expected = colliding(arm.meshes, arm.scene.pairs, poses)
    index, pair = np.nonzero(arm.scene.native.collisions(poses))
    found = {(int(i), *arm.scene.pairs[p]) for i, p in zip(index, pair, strict=True)}
    assert expected <= found
    assert all(_is_enclosed(arm, poses[i], names) for i, *names in found - expected)  # FCL sees surfaces only
    assert expected


@pytest.mark.parametrize("bound", [0.005, 0.05, np.inf])
def test_path_matches_single_queries(arm, bound):
    poses = arm.path(150)[::5]
    single = np.concatenate([arm.scene.distances(p[None], bound) for p in poses])
    assert np.abs(arm.scene.distances(poses, bound) - single).max() < 1e-12
    assert np.ptp(np.minimum(single, 10.0), axis=0).max() > 1e-3
    collision = np.concatenate([arm.scene.native.collisions(p[None]) for p in poses])
    assert (arm.scene.native.collisions(poses) == collision).all()


@pytest.mark.parametrize("threads", [0, 3])
def test_results_do_not_depend_on_threads(arm, threads):
    poses = np.concatenate([arm.path(100), arm.random_poses(20)])
    distance, points = arm.scene.closest_points(poses, 0.03, threads=1)
    again, points_again = arm.scene.closest_points(poses, 0.03, threads=threads)
    assert (again == distance).all()
    assert np.array_equal(points_again, points, equal_nan=True)
    assert (arm.scene.native.collisions(poses, threads) == arm.scene.native.collisions(poses, 1)).all()


def test_bounds_per_pair(arm):
    poses = arm.random_poses(20)
    bounds = RNG.uniform(0.0, 0.2, len(arm.scene.pairs))
    full = arm.scene.distances(poses, np.inf)
    assert np.abs(arm.scene.distances(poses, bounds) - np.minimum(full, bounds)).max() < 1e-12
    assert (arm.scene.distances(poses, 0.0) == 0).all()


def test_without_shares_bodies(arm):
    poses = arm.random_poses(5)
    excluded = frozenset(arm.scene.pairs[3])
    rest = arm.scene.without({excluded})
    kept = [p for p, pair in enumerate(arm.scene.pairs) if frozenset(pair) != excluded]
    assert rest.pairs == tuple(arm.scene.pairs[p] for p in kept)
    assert (rest.distances(poses, 0.1) == arm.scene.distances(poses, 0.1)[:, kept]).all()


SCENE = ProximityScene({"a": BOX, "b": BALL}, [("a", "b")])
PLACED = _placed(np.zeros(3), np.array([[1.0, 0, 0]]))


def _changed(where, value):
    poses = PLACED.copy()
    poses[where] = value
    return poses


@pytest.mark.parametrize(
    ("poses", "bound", "message"),
    [
        (PLACED[0], 0.1, r"poses: expected shape \(n, 2, 4, 4\), got \(2, 4, 4\)"),
        (PLACED[:, :1], 0.1, r"poses: expected shape \(n, 2, 4, 4\), got \(1, 1, 4, 4\)"),
        (_changed((0, 1, 0, 3), np.nan), 0.1, r"poses\[0, 1\]: expected a rigid transform"),
        (_changed((0, 1, 0, 3), np.inf), 0.1, "rigid transform"),
        (_changed((0, 0, 0, 0), 1.01), 0.1, r"poses\[0, 0\]: expected a rigid transform"),
        (_changed((0, 0, 2, 2), -1.0), 0.1, "right-handed"),
        (_changed((0, 0, 3, 0), 0.1), 0.1, "rigid transform"),
        (PLACED, -0.1, "bound: expected distances >= 0"),
        (PLACED, np.nan, "bound: expected distances >= 0"),
        (PLACED, [0.1, 0.1], r"bound: expected a number, shape \(1\) or \(1, 1\), got \(2\)"),
    ],
)
def test_wrong_query_is_refused(poses, bound, message):
    with pytest.raises(ValueError, match=message):
        SCENE.distances(poses, bound)
    with pytest.raises(ValueError, match=message):
        SCENE.closest_points(poses, bound)
    if bound == 0.1:
        with pytest.raises(ValueError, match=message):
            SCENE.native.collisions(poses)


@pytest.mark.parametrize(
    ("mesh", "message"),
    [
        (SimpleNamespace(vertices=BOX.vertices, faces=np.zeros((0, 3), np.int64)), r"mesh 1 has no faces"),
        (
            SimpleNamespace(vertices=np.where(BOX.vertices > 0, np.nan, 0.0), faces=BOX.faces),
            r"meshes\[1\]: vertex \d+ is not finite",
        ),
        (SimpleNamespace(vertices=BOX.vertices, faces=BOX.faces + 1), r"meshes\[1\]: face \d+ names vertex 8 of 8"),
        (
            SimpleNamespace(vertices=BOX.vertices[:, :2], faces=BOX.faces),
            r"meshes\[1\] vertices: expected shape \(n, 3\), got \(8, 2\)",
        ),
        (
            SimpleNamespace(vertices=BOX.vertices, faces=BOX.faces.astype(float)),
            r"meshes\[1\] faces: expected integers",
        ),
    ],
)
def test_wrong_mesh_is_refused(mesh, message):
    """By the native scene; a `Mesh` refuses some of them itself."""
    with pytest.raises(ValueError, match=message):
        ProximityScene({"a": BOX, "b": mesh}, [("a", "b")])


def test_wrong_pair_is_refused():
    with pytest.raises(ValueError, match=r"expected two different numbers below 2, got \(0, 0\) at pair 1"):
        ProximityScene({"a": BOX, "b": BALL}, [("a", "b"), ("a", "a")])
    with pytest.raises(KeyError, match="ghost"):
        ProximityScene({"a": BOX, "b": BALL}, [("a", "ghost")])


def test_bodies_that_cannot_move_relative_to_each_other_are_no_pair() -> None:
    """The gripper's housing and the sensor are both screwed to the last link."""
    cell = nominal_cell(load_setup(assets_dir() / "cells" / "pick_and_place.toml").cell, None)
    rng = np.random.default_rng(2)
    poses = cell.body_poses(np.column_stack([rng.uniform(*cell.arm.limits, (20, 6)), rng.uniform(0, 6, 20)]))
    names = [body.name for body in cell.bodies]
    pairs = set(map(frozenset, cell_scene(cell, {body.name: body.mesh for body in cell.bodies}).pairs))
    for rigid in (("link6", "gripper"), ("sensor", "gripper")):
        one, other = (poses[:, names.index(name)] for name in rigid)
        between = pose.inverse(one) @ other
        np.testing.assert_allclose(between, np.broadcast_to(between[0], between.shape), atol=1e-12)
        assert frozenset(rigid) not in pairs
    assert {frozenset(("link4", "gripper")), frozenset(("gripper", "table"))} <= pairs


def _without_lid(mesh: Mesh) -> Mesh:
    """The box without the two faces of its top."""
    top = mesh.vertices[:, 2].max()
    return Mesh(mesh.vertices, mesh.faces[~(mesh.vertices[mesh.faces][:, :, 2] > top - 1e-9).all(1)])


def _joined(*meshes: trimesh.Trimesh) -> Mesh:
    return mesh_of(trimesh.util.concatenate(meshes))


SMALL = trimesh.creation.box((0.02, 0.02, 0.02))
HOLLOW = _joined(trimesh.creation.box((0.2, 0.2, 0.2)), trimesh.creation.box((0.16, 0.16, 0.16)))
BESIDE = _joined(SMALL.copy().apply_translation((0.5, 0.0, 0.0)), SMALL)


@pytest.mark.parametrize(
    ("outer", "inner", "expected"),
    [
        (BOX, mesh_of(SMALL), 0.0),  # enclosed
        (mesh_of(SMALL), BOX, 0.0),  # in either order
        (BOX, BESIDE, 0.0),  # one of two pieces
        (_without_lid(BOX), mesh_of(SMALL), 0.09),  # nothing is inside an open mesh
        (BOX, _without_lid(mesh_of(SMALL)), 0.0),  # which can itself be inside a closed one
        (HOLLOW, mesh_of(SMALL), 0.07),  # in the cavity of a hollow body
    ],
)
def test_closed_meshes_are_solid(outer, inner, expected):
    scene = ProximityScene({"a": outer, "b": inner}, [("a", "b")])
    rotation = pose.rotation_about(2, 0.3) if expected == 0.0 else np.eye(3)
    both = np.stack([pose.from_rotation(rotation, (0.3, 0.1, 0.0))] * 2)[None]
    assert scene.distances(both, np.inf)[0, 0] == pytest.approx(expected, abs=1e-12)
    assert scene.native.collisions(both)[0, 0] == (expected == 0.0)
    assert len(scene.clearance_violations(both, 0.001)) == (expected == 0.0)


def test_enclosure_is_known_along_a_path_in_and_out():
    """What is known of the pose before does not outlast a jump through the surface."""
    scene = ProximityScene({"a": BALL, "b": mesh_of(trimesh.creation.icosphere(2, 0.01))}, [("a", "b")])
    for step in (0.0007, 0.011, 0.06, 0.3):
        x = np.arange(-0.3, 0.3, step)
        x = np.concatenate([x, x[::-1]])
        poses = _placed(np.zeros(3), np.column_stack([x, np.full(len(x), 0.003), np.full(len(x), 0.002)]))
        outside = np.linalg.norm(poses[:, 1, :3, 3], axis=1) > 0.11
        distance = scene.distances(poses, 0.05)[:, 0]
        assert ((distance > 0) == outside).all()
        assert (scene.native.collisions(poses)[:, 0] == ~outside).all()


def test_motions_inside_a_closed_body_are_not_proved():
    """A voxel-like box around the wrist, which no surface touches."""
    nominal = planning_cell(ball()).nominal
    wrist = nominal.frame_poses(nominal.home)["sensor"][:3, 3]
    cage = mesh_of(trimesh.creation.box((3.0, 3.0, 3.0), pose.translation(wrist)))
    for mesh, is_free in ((cage, False), (_without_lid(cage), True)):
        bodies = (*nominal.bodies, Body("cage", "world", mesh, nominal.bodies[0].material))
        caged = replace(nominal, bodies=bodies)
        scene = ProximityScene({b.name: b.mesh for b in bodies}, [("sensor", "cage"), ("link5", "cage")])
        check = MotionCheck(caged, scene, 0.001)
        start = np.append(nominal.home, 0.0)
        end = start + np.array([0.1, 0, 0, 0.2, 0, 0, 0])
        assert (check.first_clashes(start, end) == [None]) == is_free
        assert check.violations(start[None], end[None]).any() != is_free
        assert np.isinf(check.first_violations(start[None], end[None], 4)).all() == is_free
        assert (check.distances(start[None], np.array([True, True])) > 0).all() == is_free
