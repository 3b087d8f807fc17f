"""Clashes and distances against closed forms, against each other, and in batches."""

import numpy as np
import pytest
import trimesh

from orchestrator.geometry import pose
from orchestrator.geometry.mesh import Mesh
from orchestrator.proximity.bounds import SphereBounds, cover
from orchestrator.proximity.pairs import always_touching, cell_pairs
from orchestrator.proximity.scene import ProximityScene


def _mesh(made: trimesh.Trimesh) -> Mesh:
    return Mesh(np.asarray(made.vertices, float), np.asarray(made.faces, np.int64))


BOX = _mesh(trimesh.creation.box((0.2, 0.2, 0.2)))
PLATE = _mesh(trimesh.creation.box((0.6, 0.6, 0.02)).subdivide().subdivide())
BALL = _mesh(trimesh.creation.icosphere(3, 0.1))
RNG = np.random.default_rng(5)


def _placed(*positions: np.ndarray) -> np.ndarray:
    """(n, bodies, 4, 4) from positions per body, each (n, 3) or (3,)."""
    return np.stack([pose.translation(np.broadcast_to(p, (len(positions[-1]), 3))) for p in positions], 1)


def test_boxes_clash_exactly_when_their_faces_overlap():
    scene = ProximityScene({"a": BOX, "b": BOX}, [("a", "b")])
    gaps = np.array([-0.05, -1e-6, 1e-6, 0.01])
    poses = _placed(np.zeros(3), np.column_stack([0.2 + gaps, np.full(4, 0.03), np.full(4, 0.07)]))
    assert [(c.index, c.body_a, c.body_b) for c in scene.clashes(poses)] == [(0, "a", "b"), (1, "a", "b")]


def test_distance_between_boxes_is_exact_below_the_bound_and_the_bound_beyond():
    scene = ProximityScene({"a": BOX, "b": BOX}, [("a", "b")])
    gaps = np.array([-0.05, 0.001, 0.02, 0.049, 0.051, 0.5])
    poses = _placed(np.zeros(3), np.column_stack([0.2 + gaps, np.zeros(6), np.zeros(6)]))
    expected = np.clip(gaps, 0.0, 0.05)
    assert np.abs(scene.distances(poses, 0.05)[:, 0] - expected).max() < 1e-12


def test_corner_to_face_distance_of_a_turned_box():
    turn = pose.rotation_about(2, np.pi / 4) @ pose.rotation_about(0, 0.3)
    lowest = (BOX.vertices @ turn.T)[:, 2].min()
    poses = np.stack([np.eye(4)[None], pose.from_rotation(turn, (0.0, 0.0, 0.01 - lowest + 0.0123))[None]], 1)
    scene = ProximityScene({"plate": PLATE, "box": BOX}, [("plate", "box")])
    assert scene.distances(poses, 0.05)[0, 0] == pytest.approx(0.0123, abs=1e-12)


def test_clash_and_distance_agree_on_random_poses():
    scene = ProximityScene({"plate": PLATE, "ball": BALL}, [("plate", "ball")])
    count = 300
    plate = pose.pose(np.zeros((count, 3)), RNG.normal(size=(count, 4)))
    ball = pose.translation(RNG.uniform(-0.3, 0.3, (count, 3)))
    poses = np.stack([plate, ball], 1)
    hit = {clash.index for clash in scene.clashes(poses)}
    distance = scene.distances(poses, 0.2)[:, 0]
    assert hit == set(np.flatnonzero(distance == 0))
    assert 0 < len(hit) < count


def test_too_near_names_bodies_and_distance():
    scene = ProximityScene({"a": BOX, "b": BOX, "ball": BALL}, [("a", "b"), ("a", "ball"), ("b", "ball")])
    poses = _placed(np.zeros(3), (0.203, 0.0, 0.0), np.array([[0.0, 0.0, 0.9]]))
    (near,) = scene.too_near(poses, 0.005)
    assert (near.index, near.body_a, near.body_b) == (0, "a", "b")
    assert near.distance == pytest.approx(0.003)


def test_pairs_that_were_not_asked_for_are_not_checked():
    scene = ProximityScene({"a": BOX, "b": BOX}, [])
    poses = _placed(np.zeros(3), np.zeros((2, 3)))
    assert scene.clashes(poses) == []
    assert scene.distances(poses, 0.1).shape == (2, 0)
    both = ProximityScene({"a": BOX, "b": BOX}, [("a", "b")])
    assert both.without({frozenset(("b", "a"))}).pairs == ()


def test_answers_do_not_depend_on_what_else_is_in_the_batch():
    scene = ProximityScene({"plate": PLATE, "ball": BALL}, [("plate", "ball")])
    # Repeats and returns: the answer of a pair that has not moved is reused.
    heights = np.array([0.15, 0.15, 0.13, 0.15, 0.13, 0.13, 0.11])
    poses = _placed(np.zeros(3), np.column_stack([np.zeros((7, 2)), heights]))
    batch = scene.distances(poses, 0.1)
    single = np.concatenate([scene.distances(p[None], 0.1) for p in poses])
    assert (batch == single).all()
    # The polyhedral ball may hang a little short of the sphere around it.
    assert np.abs(batch[:, 0] - (heights - 0.11)).max() < 1e-3


@pytest.mark.parametrize("pieces", [1, 5, 24])
def test_covers_hold_every_point_of_the_surface(pieces):
    for mesh in (BOX, PLATE, BALL):
        spheres = cover(mesh, pieces)
        assert len(spheres) <= pieces
        weights = RNG.dirichlet(np.ones(3), size=(len(mesh.faces), 5))
        points = np.einsum("mki,mij->mkj", weights, mesh.vertices[mesh.faces]).reshape(-1, 3)
        inside = np.linalg.norm(points[:, None] - spheres[:, :3], axis=-1) <= spheres[:, 3] + 1e-12
        assert inside.any(1).all()


def test_bounds_never_drop_a_near_pair():
    scene = ProximityScene({"plate": PLATE, "box": BOX}, [("plate", "box")])
    count = 200
    poses = np.stack([pose.pose(RNG.uniform(-0.2, 0.2, (count, 3)), RNG.normal(size=(count, 4))) for _ in range(2)], 1)
    poses[:, 1, :3, 3] *= 3
    # With a bound beyond every distance, no case is dropped.
    exact = scene.distances(poses, 10.0)[:, 0]
    named, _ = SphereBounds([PLATE, BOX], np.array([[0, 1]])).possibly_within(poses, 0.05)
    assert set(np.flatnonzero(exact < 0.05)) <= set(named)
    assert len(named) < count


def test_cell_pairs_leave_out_neighbours_and_what_stands_on_each_other():
    pairs = {frozenset(p) for p in cell_pairs(["base", "link1", "link2", "sensor"], ["table", "part"])}
    assert frozenset(("base", "link1")) not in pairs
    assert frozenset(("table", "part")) not in pairs
    assert {
        frozenset(p) for p in (("base", "link2"), ("base", "sensor"), ("sensor", "part"), ("base", "part"))
    } <= pairs


def test_bodies_drawn_into_each_other_are_found():
    scene = ProximityScene({"a": BOX, "b": BOX, "ball": BALL}, [("a", "b"), ("a", "ball")])
    ball = np.column_stack([np.zeros((20, 2)), np.where(np.arange(20) < 10, 0.15, 0.5)])
    poses = _placed(np.zeros(3), (0.1, 0.0, 0.0), ball)
    assert always_touching(scene, poses) == {frozenset(("a", "b"))}
