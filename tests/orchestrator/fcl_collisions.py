"""Collision check with FCL, independent of the distance queries of the planner."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations

import fcl
import numpy as np
from numpy.typing import NDArray

from scancell.geometry import pose
from scancell.geometry.mesh import Mesh
from scancell.planning.model import PlanningCell

Array = NDArray[np.float64]


def colliding(meshes: Mapping[str, Mesh], pairs: Sequence[tuple[str, str]], poses: Array) -> set[tuple[int, str, str]]:
    """Pose number and names of all pairs that intersect at poses (n, bodies, 4, 4) in the order of `meshes`."""
    number = {name: i for i, name in enumerate(meshes)}
    objects = [collision_object(mesh) for mesh in meshes.values()]
    centre = np.array([mesh.bounds.mean(0) for mesh in meshes.values()])
    radius = np.array([np.linalg.norm(np.ptp(mesh.bounds, axis=0)) / 2 for mesh in meshes.values()])
    centres = pose.transform_points(poses, centre[:, None])[:, :, 0]
    found = set()
    for first, second in pairs:
        a, b = number[first], number[second]
        near = np.linalg.norm(centres[:, a] - centres[:, b], axis=1) <= radius[a] + radius[b]
        for k in np.flatnonzero(near):
            for body in (a, b):
                objects[body].setTransform(fcl.Transform(poses[k, body, :3, :3], poses[k, body, :3, 3]))
            if fcl.collide(objects[a], objects[b], fcl.CollisionRequest(), fcl.CollisionResult()):
                found.add((int(k), first, second))
    return found


def collision_object(mesh: Mesh) -> fcl.CollisionObject:
    """The mesh as a body of FCL."""
    model = fcl.BVHModel()
    model.beginModel(len(mesh.vertices), len(mesh.faces))
    model.addSubModel(np.ascontiguousarray(mesh.vertices), np.ascontiguousarray(mesh.faces))
    model.endModel()
    return fcl.CollisionObject(model, fcl.Transform())


def path_collisions(cell: PlanningCell, path: Array) -> set[tuple[int, str, str]]:
    """As `colliding` along joints and table angles (n, axes), of all bodies that move relative to each other.

    Bodies that touch each other where it begins, such as neighbouring links, are left out.
    """
    meshes = {body.name: body.mesh for body in cell.nominal.bodies}
    poses = cell.nominal.body_poses(path)
    relative = {
        (a, b): pose.inverse(poses[:, i]) @ poses[:, k] for (i, a), (k, b) in combinations(enumerate(meshes), 2)
    }
    moving = [pair for pair, at in relative.items() if np.ptp(at, axis=0).max() > 1e-9]
    touching = {(a, b) for _, a, b in colliding(meshes, moving, poses[:1])}
    return colliding(meshes, [pair for pair in moving if pair not in touching], poses)
