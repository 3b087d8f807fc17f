"""Types of the compiled module. Poses are (4, 4) matrices `target_from_source`; SI units throughout.

`threads = 0` uses every core; results do not depend on the number of threads. Wrong input raises ValueError and names
what was expected. The functions release the interpreter lock while they work.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

class PairDistances:
    """Rigid bodies with triangle meshes, and pairs of them.

    Parameters
    ----------
    meshes
        Vertices (k, 3), m, in the body's frame, and faces (m, 3) of each body.
    pairs
        (pairs, 2) numbers of the bodies to compare.
    """

    def __init__(self, meshes: Sequence[tuple[ArrayLike, ArrayLike]], pairs: ArrayLike) -> None: ...
    def with_pairs(self, pairs: ArrayLike) -> PairDistances:
        """The same bodies with other pairs."""
    def distances(self, poses: ArrayLike, bound: ArrayLike, threads: int = 0) -> NDArray[np.float64]:
        """Distances (n, pairs), m, exact below `bound` (a number, (pairs,) or (n, pairs), m) and equal to it otherwise.

        `poses` (n, bodies, 4, 4) are ``world_from_body``. The distance is 0 where surfaces intersect.
        """
    def closest_points(
        self, poses: ArrayLike, bound: ArrayLike, threads: int = 0
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Distances as above, and the closest points (n, pairs, 2, 3) in the world, m.

        NaN where the distance is 0 or not below `bound`.
        """
    def collisions(self, poses: ArrayLike, threads: int = 0) -> NDArray[np.bool_]:
        """Whether surfaces intersect, (n, pairs)."""
