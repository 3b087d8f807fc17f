"""Bounds and proofs of motions on random trees of fixed, revolute and prismatic joints, beside a judge in NumPy."""

from __future__ import annotations

from dataclasses import dataclass, replace

import fcl
import numpy as np
import pytest
from fcl_collisions import collision_object
from scipy.spatial.transform import Rotation

from scancell.geometry.mesh import Mesh, box_mesh
from scancell.proximity._native import CellMotion, MotionProof, PairDistances

FIXED, REVOLUTE, PRISMATIC = range(3)
JOINTS = 7


@dataclass(frozen=True)
class RandomTree:
    """Joints with kinds and parents (n,), and poses (n, 4, 4) before and behind them; bodies on frames.

    Joint i moves by axis i, also where it is fixed, so that any joint may be replaced by a fixed one.
    """

    kinds: np.ndarray
    parents: np.ndarray
    before: np.ndarray
    behind: np.ndarray
    frames: np.ndarray
    meshes: tuple[Mesh, ...]

    @property
    def pairs(self) -> np.ndarray:
        return np.array([(a, b) for a in range(len(self.meshes)) for b in range(a)])

    def poses(self, q: np.ndarray) -> np.ndarray:
        """Poses (bodies, 4, 4) of the bodies at q (n,), by homogeneous matrices."""
        found: list[np.ndarray] = []
        for i, kind in enumerate(self.kinds):
            motion = np.eye(4)
            if kind == REVOLUTE:
                motion[:3, :3] = Rotation.from_rotvec([0, 0, q[i]]).as_matrix()
            elif kind == PRISMATIC:
                motion[2, 3] = q[i]
            parent = np.eye(4) if self.parents[i] < 0 else found[self.parents[i]]
            found.append(parent @ self.before[i] @ motion @ self.behind[i])
        return np.array([np.eye(4) if frame < 0 else found[frame] for frame in self.frames])

    @property
    def rows(self) -> tuple[np.ndarray, np.ndarray]:
        """Joints (n, 35) and bodies (bodies, 22) for the compiled module."""
        axis = np.arange(JOINTS)
        columns = [self.kinds, self.parents, axis, self.before.reshape(-1, 16), self.behind.reshape(-1, 16)]
        return np.column_stack(columns), np.array([self._body(body) for body in range(len(self.meshes))])

    def motion(self) -> CellMotion:
        """The kinematics of the compiled module."""
        joints, bodies = self.rows
        return CellMotion(joints, JOINTS, bodies, self.pairs)

    def _body(self, body: int) -> np.ndarray:
        vertices, frame = self.meshes[body].vertices, int(self.frames[body])
        centre = vertices.mean(0)
        radius = np.linalg.norm(vertices - centre, axis=1).max()
        in_joint, joint = vertices, frame
        while joint >= 0:
            in_joint = in_joint @ self.behind[joint, :3, :3].T + self.behind[joint, :3, 3]
            if self.kinds[joint] != FIXED:
                break
            in_joint = in_joint @ self.before[joint, :3, :3].T + self.before[joint, :3, 3]
            joint = int(self.parents[joint])
        from_axis = np.linalg.norm(in_joint[:, :2], axis=1).max()
        return np.concatenate([[frame], centre, [radius, from_axis], np.eye(4).ravel()])


def random_tree(rng: np.random.Generator) -> RandomTree:
    """Branches of any depth, with poses of up to 0.15 m and any orientation between the joints."""
    poses = np.tile(np.eye(4), (2, JOINTS, 1, 1))
    poses[..., :3, :3] = Rotation.random(2 * JOINTS, rng).as_matrix().reshape(2, JOINTS, 3, 3)
    poses[..., :3, 3] = rng.uniform(-0.15, 0.15, (2, JOINTS, 3))
    parents = np.array([int(rng.integers(max(-1, i - 3), i)) for i in range(JOINTS)])
    sizes = rng.uniform(0.02, 0.2, (5, 3))
    frames = np.concatenate([[-1], rng.choice(JOINTS, 4, replace=False)])
    kinds = rng.choice([FIXED, REVOLUTE, PRISMATIC], JOINTS, p=[0.15, 0.5, 0.35])
    return RandomTree(kinds, parents, *poses, frames, tuple(box_mesh(tuple(size)) for size in sizes))


def random_travel(rng: np.random.Generator) -> np.ndarray:
    """From a step of an encoder to half a turn or 3 m of an axis, some at rest."""
    size = 10.0 ** rng.uniform(-6, 0.5, JOINTS)
    return np.where(rng.uniform(size=JOINTS) < 0.3, 0.0, rng.choice([-1, 1], JOINTS) * size)


def without_joint(tree: RandomTree, q: np.ndarray, rng: np.random.Generator) -> RandomTree:
    """The tree with a moving joint held where it is."""
    moving = np.flatnonzero(tree.kinds != FIXED)
    joint = int(rng.choice(moving))
    kinds, behind, motion = tree.kinds.copy(), tree.behind.copy(), np.eye(4)
    if kinds[joint] == REVOLUTE:
        motion[:3, :3] = Rotation.from_rotvec([0, 0, q[joint]]).as_matrix()
    else:
        motion[2, 3] = q[joint]
    kinds[joint], behind[joint] = FIXED, motion @ behind[joint]
    return replace(tree, kinds=kinds, behind=behind)


def excess(tree: RandomTree, error: str, rng: np.random.Generator) -> float:
    """Largest change of a distance of points, as a share of its bound; bounds by a tree with an `error`."""
    q, half = rng.uniform(-2, 2, JOINTS), random_travel(rng)
    slack = np.where(rng.uniform(size=JOINTS) < 0.5, 0.0, 10.0 ** rng.uniform(-6, -1, JOINTS))
    stated = np.where(tree.kinds == PRISMATIC, 0.5, 1.0) if error == "half of the travel" else np.ones(JOINTS)
    assumed = without_joint(tree, q, rng) if error == "joint left out" else tree
    bound = assumed.motion().bounds(q[None], (stated * half)[None], (stated * slack)[None])[0]

    def points(at: np.ndarray) -> list[np.ndarray]:
        return [m.vertices @ p[:3, :3].T + p[:3, 3] for m, p in zip(tree.meshes, tree.poses(at), strict=True)]

    middle, largest = points(q), np.zeros(len(tree.pairs))
    for s in (-1.0, 1.0, *rng.uniform(-1, 1, 6)):
        now = points(q + s * half + rng.choice([-1.0, 1.0], JOINTS) * slack)
        for k, (a, b) in enumerate(tree.pairs):
            before, after = (np.linalg.norm(cloud[a][:, None] - cloud[b][None], axis=2) for cloud in (middle, now))
            largest[k] = max(largest[k], np.abs(after - before).max())
    moved = largest > 1e-12
    with np.errstate(divide="ignore"):
        return float(np.max(largest[moved] / bound[moved], initial=0.0))


@pytest.mark.parametrize("error", ["none", "half of the travel", "joint left out"])
def test_points_move_within_their_bounds(error: str) -> None:
    """With the travel of prismatic joints halved, or a joint held in place, the same judge finds points beyond."""
    rng = np.random.default_rng(20)
    found = np.array([excess(random_tree(rng), error, rng) for _ in range(300)])
    if error == "none":
        assert found.max() < 1.0 + 1e-9
        assert np.median(found[found > 0]) > 0.2  # not true only because the bounds are huge
    else:
        assert (found > 1.01).sum() > 50


def test_proved_motions_keep_their_clearance() -> None:
    """python-fcl and homogeneous matrices judge samples of the motions on random trees that are proved."""
    rng, counts = np.random.default_rng(21), {True: 0, False: 0}
    for _ in range(60):
        tree = random_tree(rng)
        objects = [collision_object(mesh) for mesh in tree.meshes]
        scene = PairDistances([(mesh.vertices, mesh.faces) for mesh in tree.meshes], tree.pairs)
        proof = MotionProof(scene, tree.motion())
        start = rng.uniform(-2, 2, (4, JOINTS))
        end = start + np.array([random_travel(rng) for _ in start])
        required = np.full((4, len(tree.pairs)), 0.003)
        clashes = proof.first_clashes(start, end, np.zeros_like(start), required, 1e-4)
        for a, b, clash in zip(start, end, clashes, strict=True):
            nearest = np.inf
            for s in np.linspace(0, 1, 25):
                for one, at in zip(objects, tree.poses(a + s * (b - a)), strict=True):
                    one.setTransform(fcl.Transform(at[:3, :3], at[:3, 3]))
                for k, m in tree.pairs:
                    result = fcl.DistanceResult()
                    nearest = min(nearest, fcl.distance(objects[k], objects[m], fcl.DistanceRequest(), result))
            assert clash is not None or nearest >= 0.003 - 1e-9
            counts[clash is None] += 1
    assert min(counts.values()) > 20


def test_jacobian_is_the_derivative_of_the_pose() -> None:
    rng = np.random.default_rng(22)
    for _ in range(50):
        tree = random_tree(rng)
        body = int(rng.integers(1, 5))
        frame, q, step = int(tree.frames[body]), rng.uniform(-2, 2, JOINTS), 1e-6
        pose, jacobian = (values[0] for values in tree.motion().tool_poses(q[None], frame, np.eye(4)))
        np.testing.assert_allclose(pose, tree.poses(q)[body], atol=1e-13)
        for axis in range(JOINTS):
            up, down = (tree.poses(q + sign * step * np.eye(JOINTS)[axis])[body] for sign in (1, -1))
            turned = Rotation.from_matrix(up[:3, :3] @ down[:3, :3].T).as_rotvec()
            expected = np.concatenate([up[:3, 3] - down[:3, 3], turned]) / (2 * step)
            np.testing.assert_allclose(jacobian[:, axis], expected, atol=1e-8)


@pytest.mark.parametrize(
    ("array", "column", "value", "message"),
    [
        (0, 0, 3, "joints: kind"),
        (0, 0, 0.5, "joints: kind"),
        (0, 1, JOINTS, "joints: parent"),
        (0, 1, np.nan, "joints: parent"),
        (0, 2, JOINTS, "joints: axis"),
        (1, 0, JOINTS, "bodies: frame"),
        (1, 0, -2, "bodies: frame"),
    ],
)
def test_wrong_trees_are_refused(array: int, column: int, value: float, message: str) -> None:
    tree = random_tree(np.random.default_rng(23))
    rows = tree.rows
    rows[array][-1, column] = value
    with pytest.raises(ValueError, match=f"{message}: unexpected number"):
        CellMotion(rows[0], JOINTS, rows[1], tree.pairs)
