"""Regular grids of voxels, and the surface of those that are occupied."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scancell.arrays import Array, Flags
from scancell.geometry.mesh import Mesh

MAX_VOXELS = 50_000_000


@dataclass(frozen=True)
class VoxelGrid:
    """Cubes of edge `spacing` (m) in a box; `origin` (3,) is the box's lower corner, m.

    `occupied` (nx, ny, nz): which of them are occupied.
    """

    origin: Array
    spacing: float
    occupied: Flags

    @classmethod
    def around(cls, points: ArrayLike, spacing: float, inflation: float = 0.0) -> VoxelGrid:
        """The voxels that hold one of the points (n, 3), m, or come within `inflation` (m) of one that does.

        Raises `ValueError` if there is no point, one is not finite, or the grid would have more than 50 million voxels.
        """
        points = np.asarray(points, float)
        if not len(points):
            raise ValueError("no point")
        if not np.isfinite(points).all():
            raise ValueError(f"point {int(np.flatnonzero(~np.isfinite(points).all(1))[0])} is not finite")
        low = np.floor(points.min(0) / spacing - inflation / spacing - 1) * spacing
        high = points.max(0) + inflation + 2 * spacing
        shape = np.ceil((high - low) / spacing)
        if shape.prod() > MAX_VOXELS:
            raise ValueError(
                f"{shape.prod():.2g} voxels of {spacing * 1e3:g} mm would be needed, at most 5e7 are allowed"
            )
        grid = cls(low, spacing, np.zeros(shape.astype(int), bool))
        grid.occupied[tuple(grid.index(points).T)] = True
        return grid.inflated(inflation)

    def index(self, points: ArrayLike) -> NDArray[np.int64]:
        """Voxel numbers (..., 3) of points (..., 3), m; outside the box they are negative or too large."""
        return np.floor((np.asarray(points, float) - self.origin) / self.spacing).astype(np.int64)

    def contains(self, points: ArrayLike) -> Flags:
        """Whether points (..., 3), m, lie in the box."""
        index = self.index(points)
        return np.asarray(((index >= 0) & (index < self.occupied.shape)).all(-1))

    @property
    def centres(self) -> Array:
        """(nx, ny, nz, 3) centres of the voxels, m."""
        steps = [np.arange(n) + 0.5 for n in self.occupied.shape]
        return np.asarray(self.origin + self.spacing * np.stack(np.meshgrid(*steps, indexing="ij"), -1))

    def inflated(self, distance: float) -> VoxelGrid:
        """The grid with all voxels occupied that come within `distance` (m) of an occupied one; the box stays."""
        if distance <= 0.0:
            return self
        from scipy.ndimage import binary_dilation  # noqa: PLC0415  (takes a while to import)

        reach = int(np.ceil(distance / self.spacing))
        offset = np.stack(np.meshgrid(*[np.arange(-reach, reach + 1)] * 3, indexing="ij"), -1)
        gap = np.maximum(np.abs(offset) - 1, 0) * self.spacing
        near = np.linalg.norm(gap, axis=-1) <= distance
        return replace(self, occupied=np.asarray(binary_dilation(self.occupied, near)))

    def surface(self, source: str = "voxels") -> Mesh:
        """The surface between occupied and other voxels, m, its faces in one plane merged to rectangles."""
        filled = np.pad(self.occupied, 1)
        corners = []
        for axis in range(3):
            ahead = np.moveaxis(filled, axis, 0)
            for k in np.flatnonzero((ahead[1:] != ahead[:-1]).any((1, 2))):
                # One sheet per direction, so that all faces look out of the occupied voxels.
                for outwards in (True, False):
                    sheet = (ahead[k] & ~ahead[k + 1]) if outwards else (ahead[k + 1] & ~ahead[k])
                    corners += [_corners(axis, int(k), box, outwards) for box in _rectangles(sheet[1:-1, 1:-1])]
        vertices = self.origin + self.spacing * np.array(corners, float).reshape(-1, 3)
        first = np.arange(0, len(vertices), 4)[:, None, None]
        faces = (first + np.array([[0, 1, 2], [0, 2, 3]])).reshape(-1, 3)
        return Mesh(vertices, faces.astype(np.int64), source)


def _rectangles(sheet: Flags) -> list[tuple[int, int, int, int]]:
    """Rectangles (first row, end row, first column, end column) that cover the true cells once.

    Runs in a row grow over the following rows as long as these have the same run.
    """
    found, open_runs = [], dict[tuple[int, int], int]()
    for row in range(len(sheet) + 1):
        runs: set[tuple[int, int]] = set()
        if row < len(sheet):
            edges = np.flatnonzero(np.diff(np.concatenate([[0], sheet[row].astype(np.int8), [0]])))
            runs = set(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))
        for run in [run for run in open_runs if run not in runs]:
            found.append((open_runs.pop(run), row, *run))
        for run in runs:
            open_runs.setdefault(run, row)
    return found


def _corners(axis: int, k: int, box: tuple[int, int, int, int], outwards: bool) -> list[list[int]]:
    """Corners (4, 3) of a rectangle in plane `k` across `axis`, in units of voxels, in the order of its winding."""
    first, end, low, high = box
    in_plane = [(first, low), (end, low), (end, high), (first, high)]
    # The other two axes in their order are right-handed about x and z, left-handed about y.
    if outwards == (axis == 1):
        in_plane.reverse()
    others = [other for other in range(3) if other != axis]
    corners = []
    for pair in in_plane:
        corner = [k, k, k]
        corner[others[0]], corner[others[1]] = pair
        corners.append(corner)
    return corners
