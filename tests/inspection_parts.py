"""CAD parts made of exact shapes without the CAD kernel, and clouds of them with planted errors."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from scancell.arrays import Array
from scancell.geometry import pose
from scancell.geometry.cad import CAD_CHORD_ERROR, CadFace, CadMesh
from scancell.geometry.mesh import joined, sample_surface
from scancell.geometry.shapes import Box, Cylinder, PlacedShape, Ring, Sphere

Change = Callable[[Array, Array], Array]  # of points (n, 3) in the frame of a face, by their unit normals (n, 3)

_TURNS = {0: np.roll(np.eye(3), 2, axis=1), 1: np.roll(np.eye(3), 1, axis=1), 2: np.eye(3)}


def cad_part(shapes: Sequence[PlacedShape]) -> CadMesh:
    """Part whose faces are those of shapes, in their order; a box has six, by axis and then sign."""
    meshes, faces, numbers = [], [], []
    for placed in shapes:
        mesh = placed.shape.mesh(CAD_CHORD_ERROR)
        made, number = _faces(placed, mesh.normals, mesh.vertices[mesh.faces].mean(1))
        numbers.append(number + len(faces))
        faces += made
        meshes.append(mesh.transformed(placed.frame_from_shape))
    whole = joined(meshes, "part")
    return CadMesh(
        whole.vertices,
        whole.faces,
        "part",
        cad_faces=tuple(faces),
        cad_face=np.concatenate(numbers),
        chord_error=CAD_CHORD_ERROR,
    )


def _faces(placed: PlacedShape, normals: Array, centres: Array) -> tuple[list[CadFace], Array]:
    shape, frame = placed.shape, placed.frame_from_shape
    match shape:
        case Box():
            size = shape.size
            ends = [(axis, sign) for axis in range(3) for sign in (1, -1)]
            number = np.argmax([normals @ (sign * np.eye(3)[axis]) for axis, sign in ends], axis=0)
            at = [pose.from_rotation(_TURNS[axis], sign * np.eye(3)[axis] * size[axis] / 2) for axis, sign in ends]
            return [CadFace("plane", frame @ one) for one in at], number
        case Sphere(radius):
            return [CadFace("sphere", frame, radius)], np.zeros(len(normals), int)
        case Cylinder(radius, height) | Ring(radius, _, height):
            radial = np.hypot(*centres[:, :2].T)
            is_wall = np.abs(normals[:, 2]) < 0.5
            number = np.where(is_wall, 0, np.where(normals[:, 2] > 0, 1, 2))
            made = [CadFace("cylinder", frame, radius)]
            made += [CadFace("plane", frame @ pose.translation([0, 0, sign * height / 2])) for sign in (1, -1)]
            if isinstance(shape, Ring):
                number = np.where(is_wall & (radial > (shape.outer_radius + radius) / 2), 3, number)
                made.append(CadFace("cylinder", frame, shape.outer_radius))
            return made, number
        case _:
            raise TypeError(type(shape).__name__)


def cloud_of(
    part: CadMesh, count: int, seed: int, sigma: float = 0.0, changes: Mapping[int, Change] | None = None
) -> Array:
    """Points (n, 3) evenly on the faces of a part, m, with noise along the normals, and changes of some faces."""
    random, found = np.random.default_rng(seed), []
    sampled, triangle = sample_surface(part, count, seed)
    number = part.cad_face[triangle]
    for face, one in enumerate(part.cad_faces):
        local = pose.transform_points(pose.inverse(one.part_from_face), sampled[number == face])
        across = {"plane": [0.0, 0.0, 0.0], "cylinder": [1.0, 1.0, 0.0], "sphere": [1.0, 1.0, 1.0]}[one.kind]
        normal = local * across
        length = np.linalg.norm(normal, axis=1)[:, None]
        normal = normal / length if one.kind != "plane" else np.tile([0.0, 0.0, 1.0], (len(local), 1))
        local = local + (one.radius - length) * normal if one.kind != "plane" else local
        if changes and face in changes:
            local = changes[face](local, normal)
        local = local + sigma * random.standard_normal((len(local), 1)) * normal
        found.append(pose.transform_points(one.part_from_face, local))
    return np.concatenate(found)
