"""Track `hand_eye`: pose of a camera on a robot's flange and of a board in its base, from views of the board."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.board_views import draw_truth, moved, observe, pose_of
from benchmarks.track import Array, Case, Outcome, Table, Track, coverage, median_error, named_values

FRAMES = ("flange_from_camera", "base_from_board")
NAMES = tuple(f"{frame}.{key}" for frame in FRAMES for key in ("x_mm", "y_mm", "z_mm", "rx_deg", "ry_deg", "rz_deg"))
# Corners of a cube of 60 mm about a point 300 mm before the camera.
_WORK = 0.03 * np.stack(np.meshgrid([-1, 1], [-1, 1], [-1, 1]), -1).reshape(-1, 3) + [0.0, 0.0, 0.3]


def values_of(poses: Sequence[Array]) -> Array:
    """Values (12,) of two poses: position, mm, and rotation vector, degrees."""
    return np.concatenate(
        [np.r_[1e3 * one[:3, 3], np.degrees(Rotation.from_matrix(one[:3, :3]).as_rotvec())] for one in poses]
    )


def poses_of(values: Array) -> list[Array]:
    """The poses (4, 4) of values (12,)."""
    return [pose_of(Rotation.from_rotvec(np.radians(one[3:])), 1e-3 * one[:3]) for one in values.reshape(2, 6)]


def cases(seed: int, number: int) -> list[Case]:
    """A random camera, mounting and board in each case."""
    found = []
    for index in range(number):
        rng = np.random.default_rng([seed, index])
        truth = draw_truth(rng)
        values = values_of([truth.flange_from_camera, truth.base_from_board])
        found.append(Case(f"{index:04d}", observe(rng, truth), {"values": values}))
    return found


def check(case: Case, table: Table) -> None:
    """All values are there."""
    named_values(table, NAMES, "value")


def summary(outcomes: Sequence[Outcome]) -> dict[str, float]:
    """Medians of errors; a failed case counts as infinite. Coverage of the stated intervals, per cent."""
    points, camera, turn, board, inside = [], [], [], [], []
    for case, table in outcomes:
        if table is None:
            for errors in (points, camera, turn, board):
                errors.append(np.inf)
            continue
        found, true = (poses_of(values) for values in (named_values(table, NAMES, "value"), case.truth["values"]))
        away = moved(found[0], _WORK) - moved(true[0], _WORK)
        points.append(1e6 * float(np.sqrt(np.mean(np.sum(away**2, axis=1)))))
        camera.append(1e6 * float(np.linalg.norm((found[0] - true[0])[:3, 3])))
        turned = Rotation.from_matrix(true[0][:3, :3].T @ found[0][:3, :3])
        turn.append(float(np.degrees(turned.magnitude())))
        board.append(1e6 * float(np.linalg.norm((found[1] - true[1])[:3, 3])))
        if "half_width" in table:
            error = named_values(table, NAMES, "value") - case.truth["values"]
            inside.append(np.abs(error) <= named_values(table, NAMES, "half_width"))
    return {
        "points µm": median_error(points),
        "camera µm": median_error(camera),
        "camera deg": median_error(turn),
        "board µm": median_error(board),
        "in 95 % intervals, %": coverage(inside),
    }


TRACK = Track("hand_eye", ("name", "value"), ("half_width",), cases, check, summary, default_cases=20)
