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
    _, a, b = _edges(mesh)
    shared = b >= 0
    a, b = a[shared], b[shared]
    smooth = np.einsum("ni,ni->n", mesh.normals[a], mesh.normals[b]) > np.cos(np.radians(sharp_deg))
    label = connected_components(len(mesh.faces), a[smooth], b[smooth])
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


def sharp_edges(mesh: Mesh, sharp_deg: float = _SHARP_DEG) -> Array:
    """Ends (k, 2, 3), m, of the edges at which two faces meet at `sharp_deg` or more, or not exactly two faces."""
    ends, a, b = _edges(mesh)
    cosine = np.einsum("ni,ni->n", mesh.normals[a], mesh.normals[b])
    has_area = mesh.areas > 0
    is_bent = (cosine <= np.cos(np.radians(sharp_deg))) & has_area[a] & has_area[b]
    return np.asarray(mesh.vertices[ends[is_bent | (b < 0)]], np.float64)


def _edges(mesh: Mesh) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Vertices (k, 2) of each edge, a face at it, and the other one; -1 where there are not exactly two faces."""
    first, number = weld(mesh.vertices)
    faces = first[number][mesh.faces]
    ends = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    owner = np.tile(np.arange(len(faces)), 3)
    order = np.lexsort((ends[:, 1], ends[:, 0]))
    ends, owner = ends[order], owner[order]
    begin = np.flatnonzero(np.append(True, (ends[1:] != ends[:-1]).any(1)))
    count = np.diff(np.append(begin, len(ends)))
    last = begin + count - 1
    return ends[begin], owner[begin], np.where(count == 2, owner[last], -1)
