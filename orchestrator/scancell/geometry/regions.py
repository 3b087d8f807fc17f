"""Smooth regions of a mesh: faces connected without a sharp edge between them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scancell.geometry.mesh import Mesh
from scancell.geometry.mesh_files import weld
from scancell.geometry.orientation import connected_components

Array = NDArray[np.float64]

_SHARP_DEG = 30.0  # angle between faces from which on their edge separates regions
_FLAT_COSINE = np.cos(np.radians(0.5))  # of all normals of a plane region with their mean


@dataclass(frozen=True)
class Regions:
    """Regions of a mesh by falling area, numbered from 0.

    Attributes
    ----------
    of_face
        (m,) region of each face.
    areas
        (k,) m².
    normals
        (k, 3) mean unit normals.
    centres
        (k, 3) centroids, m.
    is_plane
        (k,) whether all faces have the mean normal.
    """

    of_face: NDArray[np.int64]
    areas: Array
    normals: Array
    centres: Array
    is_plane: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.areas)


def smooth_regions(mesh: Mesh, sharp_deg: float = _SHARP_DEG) -> Regions:
    """Regions whose neighbouring faces meet at less than `sharp_deg`; edges of more than two faces separate, too."""
    first, number = weld(mesh.vertices)
    faces = first[number][mesh.faces]
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    owner = np.tile(np.arange(len(faces)), 3)
    order = np.lexsort((edges[:, 1], edges[:, 0]))
    edges, owner = edges[order], owner[order]
    same = (edges[1:] == edges[:-1]).all(1)
    # An edge of exactly two faces: equal to the next one, and to neither the one before nor the one after.
    alone = same & ~np.append(same[1:], False) & ~np.append(False, same[:-1])
    a, b = owner[:-1][alone], owner[1:][alone]
    smooth = np.einsum("ni,ni->n", mesh.normals[a], mesh.normals[b]) > np.cos(np.radians(sharp_deg))
    label = connected_components(len(faces), a[smooth], b[smooth])
    areas = np.bincount(label, mesh.areas).astype(float)
    rank = np.empty(len(areas), np.int64)
    rank[np.argsort(-areas, kind="stable")] = np.arange(len(areas))
    of_face = rank[label]
    summed, moment = (
        np.stack([np.bincount(of_face, mesh.areas * values[:, axis]) for axis in range(3)], 1)
        for values in (mesh.normals, mesh.vertices[mesh.faces].mean(1))
    )
    areas = np.sort(areas)[::-1]
    length = np.linalg.norm(summed, axis=1, keepdims=True)
    normals = summed / np.where(length > 0, length, 1.0)
    aligned = np.einsum("ni,ni->n", mesh.normals, normals[of_face]) >= _FLAT_COSINE
    bent = np.bincount(of_face, ~aligned & (mesh.areas > 0))
    centres = moment / np.where(areas > 0, areas, 1.0)[:, None]
    return Regions(of_face, areas, normals, centres, (bent == 0) & (length[:, 0] > 0))
