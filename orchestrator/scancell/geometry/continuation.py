"""All solutions of the inverse kinematics of any six-joint arm, by coefficient-parameter homotopy continuation.

For a pose in general position (complex rotations and positions included) an arm has a fixed number of isolated complex
solutions, at most 16. From the solutions at one such start pose, paths of solutions are followed while the pose moves
on to the target: their ends contain every isolated solution there (Morgan & Sommese, "Coefficient-parameter polynomial
continuation", 1989; Wampler & Sommese, "Numerical algebraic geometry and algebraic kinematics", 2011). The start pose
is complex, which keeps the paths away from singular poses on the way with probability one.

The solutions at the start pose are found by monodromy: moving the pose around closed loops permutes them, and since all
poses are reached by joints in one connected space, loops lead from one solution to all others.

Arrays have the paths along their last axis. Lengths in metres, angles in radians.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from scancell.arrays import Array
from scancell.errors import DescriptionError

Complex = NDArray[np.complex128]

STARTS = 3  # poses from which paths may begin
MOST_SOLUTIONS = 16  # of any arm with six revolute joints (Primrose, 1986)
_SAME = 1e-4  # rad: ends of paths nearer than this may be one

_LOOPS = 8  # loops of each round of the monodromy
_ROUNDS = 20
_FIRST_STEP, _LONGEST_STEP, _SHORTEST_STEP = 0.05, 0.25, 1e-10  # of the path from 0 to 1
_PREDICTION = 1e-2  # rad: error of a prediction up to which a step is accepted
_NEWTON_STEPS = 2
_CONTRACTION = 0.1  # by which each Newton step must shrink the error
_FAR = 12.0  # imaginary part of an angle beyond which a path is given up: it runs to infinity
# Imaginary parts up to which the real part of a path's end may lie near a real solution: of paths that arrived, and of
# those that stopped before a singular pose, where solutions meet.
_REAL, _NEARLY_REAL = 1e-2, 0.3


@dataclass(frozen=True)
class SixJoints:
    """Denavit-Hartenberg rows (six each) ``Rz(theta) T(a, 0, d) Rx(alpha) Ry(beta)``."""

    a: tuple[float, ...]
    d: tuple[float, ...]
    alpha: tuple[float, ...]
    beta: tuple[float, ...]

    def flange(self, theta: Complex) -> tuple[Complex, Complex, Complex]:
        """Position (3, m), rotation (3, 3, m) and geometric Jacobian (m, 6, 6) at angles theta (6, m)."""
        forward = np.exp(1j * theta)
        backward = 1.0 / forward
        cosine, sine = (forward + backward) / 2, (forward - backward) / 2j
        x, y, z = (np.zeros((3, theta.shape[1]), complex) for _ in range(3))
        x[0] = y[1] = z[2] = 1.0
        position = np.zeros_like(x)
        origins, axes = np.empty((2, 6, *x.shape), complex)
        for i in range(6):
            origins[i], axes[i] = position, z
            x, y = cosine[i] * x + sine[i] * y, cosine[i] * y - sine[i] * x
            position = position + self.a[i] * x + self.d[i] * z
            c, s = np.cos(self.alpha[i]), np.sin(self.alpha[i])
            y, z = c * y + s * z, c * z - s * y
            if self.beta[i] != 0.0:
                c, s = np.cos(self.beta[i]), np.sin(self.beta[i])
                x, z = c * x - s * z, s * x + c * z
        jacobian = np.empty((theta.shape[1], 6, 6), complex)
        jacobian[:, :3] = _cross(axes.swapaxes(0, 1), (position - origins).swapaxes(0, 1)).transpose(2, 0, 1)
        jacobian[:, 3:] = axes.transpose(2, 1, 0)
        return position, np.stack([x, y, z], 1), jacobian


@dataclass(frozen=True)
class Start:
    """A pose in general position, position (3, 1) and rotation (3, 3, 1), and all angles (6, k) that reach it."""

    position: Complex
    rotation: Complex
    theta: Complex


@lru_cache(maxsize=256)
def start(arm: SixJoints, number: int) -> Start:
    """One of the `STARTS` independent start poses, from 0, with all of its solutions; the same for every call.

    Raises `DescriptionError` if the joints are dependent at every pose, as those of four parallel axes are.
    """
    rng = np.random.default_rng(number)
    if number:
        first = start(arm, 0)
        count = first.theta.shape[1]
        while True:
            position, rotation, _ = arm.flange(_random_angles(rng, 1))
            line = _Line.between(first.position, first.rotation, position, rotation, count)
            theta, done = _follow(arm, first.theta, line)
            if done.all() and len(_distinct(theta)) == count:
                return Start(position, rotation, theta)
    singular_values = np.linalg.svd(arm.flange(_random_angles(rng, 1))[2][0], compute_uv=False)
    if singular_values[-1] < 1e-9 * singular_values[0]:
        raise DescriptionError("inverse kinematics needs joints that are independent at some pose", key="robot.joint")
    return _monodromy(arm, rng)


def solve(arm: SixJoints, start: Start, targets: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Candidates theta (n, k, 6) for the real solutions at `targets` (n, 4, 4), and whether each set is complete (n,).

    Candidates lie by the ends of all paths that end near the real angles, NaN for the others. They are to be refined.
    A set counts as complete when every path arrived, no two ended in one place, the conjugate of every end is an end,
    and the number of real ones is even: the solutions at a real pose are those of equations with real coefficients,
    whose number is even.
    """
    n, k = len(targets), start.theta.shape[1]
    position = np.repeat(targets[:, :3, 3].T, k, axis=1).astype(complex)
    rotation = np.repeat(targets[:, :3, :3].transpose(1, 2, 0), k, axis=2).astype(complex)
    line = _Line.between(start.position, start.rotation, position, rotation, n * k)
    ends, done = _follow(arm, np.tile(start.theta, n), line)
    theta = ends.T.reshape(n, k, 6)
    gap = _distance(theta[:, :, None], theta[:, None])
    repeated = (gap + np.where(np.eye(k, dtype=bool), 1.0, 0.0) < _SAME).any((1, 2))
    paired = (_distance(theta[:, :, None], theta[:, None].conj()).min(2) < _SAME).all(1)
    done = done.reshape(n, k)
    candidate = np.abs(theta.imag).max(-1) < np.where(done, _REAL, _NEARLY_REAL)
    even = (np.abs(theta.imag).max(-1) < _REAL).sum(1) % 2 == 0
    # Where two real solutions are about to meet, the real part lies between them; conjugate ends lead to one each.
    real = np.where(candidate[..., None], theta.real + theta.imag, np.nan)
    return real, np.asarray(done.all(1) & ~repeated & paired & even)


@dataclass(frozen=True)
class _Line:
    """Poses at time 0 to 1 of m paths: constant velocity (3, m), rotation at the constant rate `turn` (3, m)."""

    position: Complex
    rotation: Complex
    velocity: Complex
    turn: Complex

    @classmethod
    def between(cls, position: Complex, rotation: Complex, end: Complex, end_rotation: Complex, m: int) -> _Line:
        position, rotation, end, end_rotation = (
            np.ascontiguousarray(np.broadcast_to(part, (*part.shape[:-1], m)))
            for part in (position, rotation, end, end_rotation)
        )
        turn = _logarithm(_times_transposed(end_rotation, rotation))
        return cls(position, rotation, end - position, turn)

    def rows(self, index: NDArray[np.int64]) -> _Line:
        return _Line(*(part[..., index] for part in (self.position, self.rotation, self.velocity, self.turn)))

    def at(self, time: Array) -> tuple[Complex, Complex]:
        return self.position + time * self.velocity, _turned(self.rotation, self.turn, time)

    @property
    def rate(self) -> Complex:
        """Twist (m, 6, 1) of all poses of a line in base axes."""
        return np.asarray(np.concatenate([self.velocity, self.turn]).T[..., None])


def _follow(arm: SixJoints, theta: Complex, line: _Line) -> tuple[Complex, NDArray[np.bool_]]:
    """Ends (6, m) of the paths of solutions from `theta` (6, m) along a line of poses, and which arrived (m,).

    Fourth-order Runge-Kutta predictor on ``d theta/dt = J^-1 twist``, Newton corrector, and a step of each path that
    follows the error of the prediction.
    """
    theta = theta.copy()
    time, step = np.zeros(theta.shape[1]), np.full(theta.shape[1], _FIRST_STEP)
    active = np.arange(theta.shape[1])
    with np.errstate(all="ignore"):  # predictions that run away are rejected
        while len(active):
            here, now = theta[:, active], line.rows(active)
            h = np.minimum(step[active], 1 - time[active])
            there = _bounded(_predict(arm, here, now.rate, h), here)
            there, error, good = _correct(arm, there, *now.at(time[active] + h))
            good &= np.abs(there - here).max(0) < 1.5
            theta[:, active[good]] = there[:, good]
            time[active[good]] += h[good]
            factor = np.clip(0.8 * (_PREDICTION / np.maximum(error, 1e-12)) ** 0.2, 0.3, 2.5)
            step[active] = np.minimum(h * np.where(good, factor, np.fmin(factor, 0.5)), _LONGEST_STEP)
            over = (time[active] >= 1) | (step[active] < _SHORTEST_STEP) | (np.abs(theta[:, active].imag).max(0) > _FAR)
            active = active[~over]
    return theta, time >= 1


def _predict(arm: SixJoints, theta: Complex, rate: Complex, h: Array) -> Complex:
    def slope(at: Complex) -> Complex:
        return _solved(arm.flange(_bounded(at, theta))[2], rate)

    k1 = slope(theta)
    k2 = slope(theta + h / 2 * k1)
    k3 = slope(theta + h / 2 * k2)
    k4 = slope(theta + h * k3)
    return np.asarray(theta + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4))


def _correct(
    arm: SixJoints, theta: Complex, position: Complex, rotation: Complex
) -> tuple[Complex, Array, NDArray[np.bool_]]:
    """Newton steps towards a pose: angles (6, m), size of the first step (m,), and whether they converge (m,)."""
    first = size = np.zeros(theta.shape[1])
    for k in range(_NEWTON_STEPS):
        reached, orientation, jacobian = arm.flange(theta)
        turn = _times_transposed(rotation, orientation)
        change = _solved(jacobian, np.concatenate([position - reached, _axial(turn)]).T[..., None])
        size = np.abs(change).max(0)
        first = size if k == 0 else first
        theta = theta + np.where(size < 0.5, change, 0.0)
    good = (first < _PREDICTION) & (size < np.maximum(1e-7, _CONTRACTION * first))
    return theta, np.where(np.isfinite(first), first, np.inf), good


def _monodromy(arm: SixJoints, rng: np.random.Generator) -> Start:
    """Loops over two random poses, all found solutions along every loop, until a round finds nothing new."""
    theta = _random_angles(rng, 1)
    position, rotation, _ = arm.flange(theta)
    for _ in range(_ROUNDS):
        count = theta.shape[1]
        via = [arm.flange(np.repeat(_random_angles(rng, _LOOPS), count, axis=1))[:2] for _ in range(2)]
        stations = [(position, rotation), *via, (position, rotation)]
        moved, arrived = np.tile(theta, _LOOPS), np.ones(_LOOPS * count, bool)
        for here, there in pairwise(stations):
            moved, done = _follow(arm, moved, _Line.between(*here, *there, _LOOPS * count))
            arrived &= done
        theta = _distinct(np.concatenate([theta, moved[:, arrived]], axis=1)).T
        # The number of all solutions is even.
        if theta.shape[1] == MOST_SOLUTIONS or (theta.shape[1] == count and count % 2 == 0):
            break
    return Start(position, rotation, theta)


def _random_angles(rng: np.random.Generator, count: int) -> Complex:
    return rng.uniform(-np.pi, np.pi, (6, count)) + 1j * rng.normal(0.0, 0.5, (6, count))


def _distinct(theta: Complex) -> Complex:
    """(k, 6) those of the angles (6, m) that differ from all before them by more than rounding."""
    kept: list[Complex] = []
    for angles in theta.T:
        if all(_distance(angles, other) > _SAME for other in kept):
            kept.append(angles)
    return np.array(kept)


def _distance(a: Complex, b: Complex) -> Array:
    """Largest difference (...,) of any of the angles (..., 6), multiples of 2 pi apart."""
    gap = a - b
    real = np.remainder(gap.real + np.pi, 2 * np.pi) - np.pi
    return np.asarray(np.hypot(real, gap.imag).max(-1))


def _bounded(theta: Complex, fallback: Complex) -> Complex:
    """`theta` (6, m), and `fallback` for paths that are no longer finite."""
    usable = (np.isfinite(theta) & (np.abs(theta.imag) < 2 * _FAR)).all(0)
    return np.where(usable, theta, fallback)


def _solved(jacobian: Complex, twist: Complex) -> Complex:
    """Angles (6, m) of ``jacobian @ angles = twist`` for (m, 6, 6) and (m, 6, 1); 0 where the matrix is singular."""
    angles: Complex = np.zeros((6, len(jacobian)), complex)
    try:
        angles[:] = np.linalg.solve(jacobian, twist)[..., 0].T
    except np.linalg.LinAlgError:  # one singular matrix is enough
        determinant = np.linalg.det(jacobian)
        usable = np.isfinite(determinant) & (determinant != 0)
        angles[:, usable] = np.linalg.solve(jacobian[usable], twist[usable])[..., 0].T
    return angles


def _cross(a: Complex, b: Complex) -> Complex:
    """Cross product without conjugation, along the first axis."""
    return np.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def _times_transposed(a: Complex, b: Complex) -> Complex:
    """``a @ b.T`` of (3, 3, m)."""
    columns = [a[:, 0] * b[j, 0] + a[:, 1] * b[j, 1] + a[:, 2] * b[j, 2] for j in range(3)]
    return np.stack(columns, 1)


def _axial(rotation: Complex) -> Complex:
    """Half of the antisymmetric part of (3, 3, m) as vectors (3, m): sin(angle) times the axis."""
    r = rotation
    return np.asarray(np.stack([r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]]) / 2)


def _logarithm(rotation: Complex) -> Complex:
    """Rotation vectors (3, m) of complex rotations (3, 3, m)."""
    angle = np.arccos((rotation[0, 0] + rotation[1, 1] + rotation[2, 2] - 1) / 2)
    return np.asarray(_axial(rotation) * (angle / np.sin(angle)))


def _turned(rotation: Complex, turn: Complex, time: Array) -> Complex:
    """``exp([turn] time) @ rotation`` by Rodrigues' formula, for (3, 3, m), (3, m) and (m,)."""
    angle = np.sqrt((turn * turn).sum(0))
    first, second = np.sin(angle * time) / angle, (1 - np.cos(angle * time)) / angle**2
    columns = []
    for k in range(3):
        once = _cross(turn, rotation[:, k])
        columns.append(rotation[:, k] + first * once + second * _cross(turn, once))
    return np.stack(columns, 1)
