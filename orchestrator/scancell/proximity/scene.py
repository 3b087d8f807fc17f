"""Distances, closest points and collisions of rigid bodies, for many poses in one call; the scene of a cell."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scancell.arrays import Array
from scancell.geometry.mesh import Mesh
from scancell.nominal.cell import OCCUPIED, NominalCell, with_table
from scancell.nominal.parts import Body
from scancell.proximity._native import PairDistances

_CONTACT = 1e-9  # m: bodies closer than this intersect
_UNTOLD = 0.025  # m: nearer measured space may belong to the body itself
_RESTING = 1e-4  # m: bodies at rest that are closer stand on each other


@dataclass(frozen=True)
class Clash:
    """Two bodies nearer than `clearance` (m) at pose number `index`; `distance` (m) is 0 when they intersect."""

    index: int
    body_a: str
    body_b: str
    distance: float
    clearance: float


class ProximityScene:
    """Rigid bodies and the pairs of them to check.

    Closed meshes are solid: inside them, and where surfaces intersect, the distance is 0. Open meshes have no inside;
    they can lie inside a closed one. Along a path, pass consecutive poses in one call: what is known of a pair at one
    pose shortens the search at the next one.

    Poses (n, bodies, 4, 4) are ``world_from_body`` in the order of `names`. `threads` = 0 uses every core; results do
    not depend on it.

    Raises `ValueError` if a mesh has no faces or is not finite, or a pair names one body twice; `KeyError` if a pair
    names a body that has no mesh.

    Parameters
    ----------
    meshes
        Mesh of each body by name, in the body's frame, m.
    pairs
        Names of the bodies to compare, in either order.

    Attributes
    ----------
    names
        Bodies in the order of their poses.
    pairs
        Names of the bodies compared, in the order of the results.
    native
        The scene of the compiled module.
    """

    def __init__(self, meshes: Mapping[str, Mesh], pairs: Sequence[tuple[str, str]]) -> None:
        self.names = tuple(meshes)
        self.pairs = tuple(pairs)
        self.native = PairDistances([(mesh.vertices, mesh.faces) for mesh in meshes.values()], self._numbers())

    def _numbers(self) -> NDArray[np.int64]:
        number = {name: i for i, name in enumerate(self.names)}
        return np.array([(number[a], number[b]) for a, b in self.pairs], np.int64).reshape(-1, 2)

    def without(self, excluded: Collection[frozenset[str]]) -> ProximityScene:
        """The scene without the `excluded` pairs; it shares the bodies."""
        scene = object.__new__(ProximityScene)
        scene.names = self.names
        scene.pairs = tuple(pair for pair in self.pairs if frozenset(pair) not in excluded)
        scene.native = self.native.with_pairs(scene._numbers())
        return scene

    def distances(self, poses: ArrayLike, bound: ArrayLike, threads: int = 0) -> Array:
        """Distances (n, pairs), m, exact below the bound and equal to it otherwise; 0 when intersecting.

        Raises `ValueError` if a shape is wrong, a pose is not a rigid transform, or a bound is negative or NaN.

        Parameters
        ----------
        poses
            (n, bodies, 4, 4)
        bound
            One for all pairs, (pairs,) or (n, pairs), m; the smaller, the faster. ``inf`` gives the distance of any
            two bodies.
        """
        return self.native.distances(poses, bound, threads)

    def closest_points(self, poses: ArrayLike, bound: ArrayLike, threads: int = 0) -> tuple[Array, Array]:
        """Distances (n, pairs), m, and the closest points (n, pairs, 2, 3) of both bodies in the world, m.

        The points are NaN when the bodies intersect or are not nearer than the bound. Where several points are equally
        close, such as on parallel faces, any of them. Parameters and errors as in `distances`.
        """
        return self.native.closest_points(poses, bound, threads)

    def clearance_violations(self, poses: ArrayLike, clearance: ArrayLike, threads: int = 0) -> list[Clash]:
        """All pairs that intersect or are nearer than `clearance` (m, one or (pairs,)) at poses (n, bodies, 4, 4).

        Errors as in `distances`.
        """
        required = np.broadcast_to(np.maximum(np.asarray(clearance, float), _CONTACT), (len(self.pairs),))
        distance = self.distances(poses, required, threads)
        index, pair = np.nonzero(distance < required)
        return [
            Clash(int(i), *self.pairs[p], float(distance[i, p]), float(required[p]))
            for i, p in zip(index, pair, strict=True)
        ]


def arm_chain(nominal: NominalCell) -> list[str]:
    """Names of the arm's bodies, base first, with all that the arm carries."""
    joints = set(nominal.arm.tree.axes)
    return [b.name for b in nominal.bodies if b.name == "base" or joints & set(nominal.tree.axes_of(b.moves_with))]


def cell_scene(
    nominal: NominalCell, meshes: Mapping[str, Mesh], loose: Collection[str] = frozenset()
) -> ProximityScene:
    """Scene of all bodies with the pairs of `moving_pairs`, except those that are in contact by construction.

    These intersect at nearly every configuration: links that reach into each other, a platter in its bearing; never a
    part. Measured space is always compared with the arm; of other bodies, it is not compared with those that are within
    25 mm at the home position: it cannot be told from them, as the unseen space of a survey. Of the pairs that only
    `loose` frames move, those that touch at the home position are excepted, too: one rests on the other.

    Parameters
    ----------
    meshes
        Mesh of each body by name, in the body's frame, m.
    loose
        See `moving_pairs`.
    """
    scene = ProximityScene({body.name: meshes[body.name] for body in nominal.bodies}, moving_pairs(nominal, loose))
    parts = {body.name for body in nominal.bodies if body.moves_with.startswith("part")}
    lower, upper = nominal.arm.limits
    rng = np.random.default_rng(0)
    q, table = rng.uniform(lower, upper, (100, len(lower))), rng.uniform(0.0, 2 * np.pi, 100)
    further = [rng.uniform(axis.min, axis.max, 100) for axis in nominal.further_axes]
    axes = np.column_stack([with_table(q, table), *further])
    overlapping = intersecting_pairs(scene, nominal.body_poses(axes))
    excepted = {pair for pair in overlapping if not pair & parts and not _measured(pair)}
    home, arm = nominal.body_poses(nominal.start)[None], set(arm_chain(nominal)) - {"base"}
    around = {pair for pair in map(frozenset, scene.pairs) if _measured(pair) and not pair & arm}
    if around:
        excepted |= around & {frozenset((c.body_a, c.body_b)) for c in scene.clearance_violations(home, _UNTOLD)}
    driven = set(map(frozenset, moving_pairs(nominal)))
    at_home = scene.clearance_violations(home, _RESTING) if loose else []
    excepted |= {frozenset((clash.body_a, clash.body_b)) for clash in at_home} - driven
    return scene.without(excepted) if excepted else scene


def moving_pairs(nominal: NominalCell, loose: Collection[str] = frozenset()) -> list[tuple[str, str]]:
    """Pairs of bodies that some axis moves relative to each other, those of the arm first.

    An axis moves two bodies relative to each other if it carries one of them and not the other, see `carrying_axes`.
    Excluded are neighbours: links of the arm that share a joint, the platter and the base of the table, the two fingers
    of a gripper, and measured space that counts twice, at rest and turning with the table.

    Parameters
    ----------
    loose
        Frames that move on their own, beside those that axes move: fingers, parts that belts or grippers carry.
    """
    arm = set(arm_chain(nominal))
    bodies = sorted(nominal.bodies, key=lambda body: body.name not in arm)
    pairs = [
        (a.name, b.name)
        for a, b in combinations(bodies, 2)
        if carrying_axes(nominal, a, loose) != carrying_axes(nominal, b, loose) and not _are_neighbours(nominal, a, b)
    ]
    return sorted(pairs, key=lambda pair: not arm.issuperset(pair))


def carrying_axes(nominal: NominalCell, body: Body, loose: Collection[str] = frozenset()) -> frozenset[str]:
    """Names of the axes that move a body in the world, and its own frame if it is `loose`."""
    driven = set(nominal.tree.axes_of(body.moves_with)) & set(nominal.axes)
    return frozenset(driven | {body.moves_with} & set(loose))


def _are_neighbours(nominal: NominalCell, a: Body, b: Body) -> bool:
    names = {a.name, b.name}
    links = ["base", *(f"link{i}" for i in range(1, len(nominal.arm.joints) + 1))]
    if names <= set(links):
        return abs(links.index(a.name) - links.index(b.name)) == 1
    fingers = all(body.moves_with.startswith("finger") for body in (a, b))
    return fingers or names == {"table", "table_base"} or len(_measured(names)) == 2


def _measured(names: Iterable[str]) -> set[str]:
    return {name for name in names if name.startswith(OCCUPIED)}


def intersecting_pairs(scene: ProximityScene, poses: ArrayLike) -> set[frozenset[str]]:
    """Pairs that intersect in at least 95 % of the poses (n, bodies, 4, 4): overlapping by construction."""
    poses = np.asarray(poses, float)
    count: dict[frozenset[str], int] = {}
    for clash in scene.clearance_violations(poses, _CONTACT):
        key = frozenset((clash.body_a, clash.body_b))
        count[key] = count.get(key, 0) + 1
    return {key for key, hits in count.items() if hits >= 0.95 * len(poses)}
