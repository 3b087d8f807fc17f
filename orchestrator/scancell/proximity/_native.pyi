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

class CellMotion:
    """Kinematics of bodies on a tree of joints.

    Parameters
    ----------
    joints
        (joints, 35) kind of each joint (0 fixed, 1 revolute, 2 prismatic), number of the joint whose frame carries it
        (-1: the world; a lower one), number of its axis (-1: none), and the constant poses before and behind its motion
        about or along z: ``parent_from_joint`` and ``joint_from_frame`` (4, 4), m.
    axes
        Number of axes, rad or m.
    bodies
        (bodies, 22) number of the frame that carries the body (-1: the world), bounding sphere (centre and radius) in
        it, largest distance of the body from the axis of the last joint that moves it, and pose (4, 4) in the frame.
    pairs
        (pairs, 2) numbers of bodies.
    """

    def __init__(self, joints: ArrayLike, axes: int, bodies: ArrayLike, pairs: ArrayLike) -> None: ...
    def bounds(self, at: ArrayLike, half: ArrayLike, slack: ArrayLike) -> NDArray[np.float64]:
        """Bounds (n, pairs), m, on the relative motion of pairs from axes `at` (n, axes).

        Axes follow straight lines by `half` (n, axes) times -1 to 1 and deviate from them by up to `slack` (n, axes).
        """
    def tool_poses(
        self, axes: ArrayLike, frame: int, frame_from_tool: ArrayLike
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """``world_from_tool`` (n, 4, 4) at axes (n, axes), and the geometric Jacobian (n, 6, axes) of its origin."""

class MotionProof:
    """Proofs that motions from `start` to `end`, straight in the axes, keep the clearances of pairs.

    `start`, `end` and `deviation` from the straight motion are (n, axes), rad, `required` clearances (n, pairs), m, or
    -inf for pairs that are not checked. What is not proved on intervals of `finest` (rad, to either side) or with
    `budget` comparisons violates the clearance.

    Parameters
    ----------
    scene, motion
        With the same bodies and pairs.
    """

    def __init__(self, scene: PairDistances, motion: CellMotion) -> None: ...
    def first_clashes(
        self,
        start: ArrayLike,
        end: ArrayLike,
        deviation: ArrayLike,
        required: ArrayLike,
        finest: float,
        threads: int = 0,
    ) -> tuple[tuple[int, float, float] | None, ...]:
        """Pair, distance, m, and fraction of each motion where it violates a clearance; None: it keeps all."""
    def violations(
        self, start: ArrayLike, end: ArrayLike, deviation: ArrayLike, required: ArrayLike, finest: float, budget: int
    ) -> tuple[NDArray[np.bool_], int]:
        """Pairs (pairs,) that violate their clearance on any of the motions, and the comparisons made."""
    def first_violations(
        self,
        start: ArrayLike,
        end: ArrayLike,
        deviation: ArrayLike,
        required: ArrayLike,
        finest: float,
        parts: int,
        budget: int,
    ) -> tuple[NDArray[np.float64], int]:
        """Number of the motion and part of it, of `parts`, at which the first pairs violate, and the comparisons.

        (pairs,), infinite for those that do not, or later.
        """
    def distances(self, axes: ArrayLike, pairs: NDArray[np.bool_]) -> tuple[NDArray[np.float64], int]:
        """Distances (n, pairs), m, at `axes` (n, axes), rad, of some `pairs` (pairs,), NaN of the others; the work."""
