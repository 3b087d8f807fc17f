"""Speed of distance and collision queries between the bodies of a cell, beside FCL through python-fcl."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import fcl
import numpy as np
import trimesh
from numpy.typing import NDArray

from scancell.config.loading import assets_dir, load_setup
from scancell.geometry.mesh import Mesh, box_mesh, decimated, load_mesh
from scancell.nominal.cell import NominalCell, nominal_cell
from scancell.proximity.scene import ProximityScene, cell_scene

from .table import Row, processor_row
from .timing import measure, scaled

Array = NDArray[np.float64]

FACES = 5200
BODIES, PAIRS = 12, 48
BOUND = 0.05  # m
CLEARANCE = 0.005  # m, a planner's
STEP = np.radians(0.5)
POSES = 200
PEER_POSES = 5
LIMIT_COLD_US, LIMIT_PATH_US, LIMIT_COLLISION_US = 1000.0, 50.0, 30.0


def refined(mesh: Mesh, faces: int = FACES) -> Mesh:
    """The same surface with about `faces` triangles: edges halved where they are long, or decimated."""
    edge = float(np.ptp(mesh.bounds, axis=0).max())
    vertices, triangles = mesh.vertices, mesh.faces
    while len(triangles) < 0.9 * faces:
        edge *= 0.9
        vertices, triangles = trimesh.remesh.subdivide_to_size(mesh.vertices, mesh.faces, edge, max_iter=60)
    return decimated(Mesh(np.asarray(vertices), np.asarray(triangles, np.int64), mesh.source), faces)


class Scene:
    """The default cell and a wall beside it: 12 bodies of about 5200 triangles and 48 pairs."""

    def __init__(self) -> None:
        self.nominal: NominalCell = nominal_cell(load_setup().cell, load_mesh(assets_dir() / "parts" / "free_form.stl"))
        self.meshes = {body.name: refined(body.mesh) for body in self.nominal.bodies}
        arm_pairs = cell_scene(self.nominal, self.meshes).pairs
        self.meshes["wall"] = refined(box_mesh((0.02, 1.0, 0.8), "wall"))
        assert len(self.meshes) == BODIES, len(self.meshes)
        moving = ("link5", "link6", "sensor")
        pairs = [*arm_pairs, *((name, "wall") for name in moving)][:PAIRS]
        self.scene = ProximityScene(self.meshes, pairs)

    def poses(self, q: Array, table: Array) -> Array:
        """(n, 12, 4, 4) for joints (n, 6) and table angles (n,), rad."""
        wall = np.eye(4)
        wall[:3, 3] = 0.0, -0.6, 0.4
        bodies = self.nominal.body_poses(np.column_stack([q, table]))
        return np.concatenate([bodies, np.broadcast_to(wall, (len(bodies), 1, 4, 4))], 1)

    def random_poses(self, count: int) -> Array:
        """Independent poses over the arm's joint range."""
        rng = np.random.default_rng(1)
        lower, upper = self.nominal.arm.limits
        return self.poses(rng.uniform(lower, upper, (count, 6)), rng.uniform(0, 2 * np.pi, count))

    def path(self, count: int) -> Array:
        """Poses of straight joint motions between random ones; the fastest joint moves by `STEP` a pose."""
        rng = np.random.default_rng(2)
        lower, upper = self.nominal.arm.limits
        points: list[Array] = []
        start = np.append((lower + upper) / 2, 0.0)
        while sum(map(len, points)) < count:
            end = np.append(rng.uniform(lower, upper), rng.uniform(0, np.pi))
            steps = int(np.ceil(np.abs(end - start).max() / STEP)) + 1
            points.append(np.linspace(start, end, steps))
            start = end
        q = np.concatenate(points)[:count]
        return self.poses(q[:, :6], q[:, 6])


class _PythonFcl:
    """The same queries, one by one, through python-fcl."""

    def __init__(self, scene: Scene) -> None:
        self._names = scene.scene.names
        self._pairs = scene.scene.pairs
        self._objects = {name: self._object(mesh) for name, mesh in scene.meshes.items()}

    @staticmethod
    def _object(mesh: Mesh) -> Any:
        model = fcl.BVHModel()
        model.beginModel(len(mesh.vertices), len(mesh.faces))
        model.addSubModel(np.ascontiguousarray(mesh.vertices), np.ascontiguousarray(mesh.faces))
        model.endModel()
        return fcl.CollisionObject(model, fcl.Transform())

    def _each_pair(self, poses: Array, query: Any) -> None:
        for placed in poses:
            for name, matrix in zip(self._names, placed, strict=True):
                self._objects[name].setTransform(fcl.Transform(matrix[:3, :3], matrix[:3, 3]))
            for a, b in self._pairs:
                query(self._objects[a], self._objects[b])

    def distances(self, poses: Array) -> None:
        self._each_pair(poses, lambda a, b: fcl.distance(a, b, fcl.DistanceRequest(), fcl.DistanceResult()))

    def collisions(self, poses: Array) -> None:
        self._each_pair(poses, lambda a, b: fcl.collide(a, b, fcl.CollisionRequest(), fcl.CollisionResult()))


def proximity_rows() -> Iterator[Row]:
    """Processor time per pose on one thread: unrelated poses one by one, and a path in one call."""
    scene = Scene()
    peer = _PythonFcl(scene)
    native = scene.scene
    random, path = scene.random_poses(POSES), scene.path(2 * POSES)
    peer_distance = scaled(measure(lambda: peer.distances(random[:PEER_POSES]), 1), 1e6 / PEER_POSES).processor
    peer_collision = scaled(measure(lambda: peer.collisions(random), 1), 1e6 / POSES).processor

    def row(name: str, work: Any, count: int, peer_us: float, limit_us: float) -> Iterator[Row]:
        timing, name = scaled(measure(work, 3), 1e6 / count), f"proximity: {name}"
        yield processor_row(name, timing, "us/pose", "python-fcl", peer_us)
        yield processor_row(name, timing, "us/pose", "limit, 1 thread", limit_us, "at most")

    for bound in (BOUND, CLEARANCE):
        label = f"{1e3 * bound:g} mm"
        single = [pose[None] for pose in random]
        yield from row(
            f"distances below {label}, cold",
            lambda bound=bound, single=single: [native.distances(pose, bound, 1) for pose in single],
            POSES,
            peer_distance,
            LIMIT_COLD_US,
        )
        yield from row(
            f"distances below {label}, path",
            lambda bound=bound: native.distances(path, bound, 1),
            len(path),
            peer_distance,
            LIMIT_PATH_US,
        )
    yield from row(
        "collisions, cold",
        lambda: [native.collisions(pose[None], 1) for pose in random],
        POSES,
        peer_collision,
        LIMIT_COLLISION_US,
    )
    yield from row(
        "collisions, path", lambda: native.collisions(path, 1), len(path), peer_collision, LIMIT_COLLISION_US
    )
