"""Motions of a robot that is near something: which the guard permits, against dense samples of the distances.

A motion that brings no pair within its clearance nearer, and keeps the room of all others, has to be permitted; one
that brings such a pair nearer has to be refused.  `python -m bench.guard_retreat --poses 10000` prints the counts.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass

import numpy as np
from guard_walls import behind_wall, distances, near_home

from guard_motions import NOISE, unit
from scancell.cell.driver import Mode, Operation
from scancell.config.loading import load_setup
from scancell.guard.guard import Guard, GuardSettings
from scancell.guard.messages import CellState
from scancell.guard.parts import Tool
from scancell.guard.stopping import Hypothesis, MeasuredState, Path, Predictor
from scancell.nominal.cell import NominalCell

SETTINGS = GuardSettings(noise=NOISE, angle_error=5 * NOISE)
CYCLE, ROWS = 0.016, 64
_CLEARANCE = 2 * SETTINGS.position_error  # the meshes of the boxes are exact
_ROOM = 0.004  # m: pairs with more than their clearance and this have room for every stop at these speeds
_FASTEST = 0.02  # m/s
_NEARER = 1e-7  # m
_ROUNDING = 20e-6  # m: of the proofs, and of a measured path between its rows


@dataclass
class Counts:
    """Motions by what the samples say, and by what the guard does."""

    away: int = 0  # no pair within its clearance comes nearer
    away_refused: int = 0
    nearer: int = 0  # by more than what errors of the measured angles make of a distance
    nearer_permitted: int = 0


def run(poses: int, seed: int) -> Counts:
    """Judge one motion by hand and one in automatic operation from each of `poses` random poses near a wall."""
    rng, counts, robot = np.random.default_rng(seed), Counts(), load_setup().cell.robot
    while counts.away < 2 * poses:
        axes, direction = near_home(rng), unit(rng)
        cell, scene = behind_wall(axes, direction, float(rng.uniform(0.0002, _CLEARANCE)))
        others = [k for k, pair in enumerate(scene.pairs) if pair != ("sensor", "wall")]
        if distances(cell, scene, axes[None])[0, others].min() < _CLEARANCE + _ROOM:
            continue
        guard = Guard(cell, robot, SETTINGS)
        for operation in Operation:
            ahead = _ahead(Predictor(cell), Tool(cell), axes, -direction, rng)
            begin = distances(cell, scene, axes[None], np.inf)[0]
            later = distances(cell, scene, np.vstack([ahead, _tangents(axes, ahead)]), np.inf)
            near = begin <= _CLEARANCE
            lost = float((begin - later)[:, near].max())
            # A later answer can still stop what comes nearer only afterwards.
            reached = round(SETTINGS.reaction / CYCLE)
            lost_at_once = float((begin - later[:reached])[:, near].max())
            free = (later[:, ~near] > _CLEARANCE + _ROOM / 2).all()
            mode = Mode.CARTESIAN_JOG if operation is Operation.MANUAL else Mode.JOINT_MOVE
            guard.reset()
            answer = guard.answer(CellState(1, 1.0, operation, mode, False, axes, 0.0, ahead, CYCLE, 0.5))
            permitted = not answer.emergency_stop and answer.monitor_speed == 1
            if lost <= _NEARER and free:
                counts.away += 1
                counts.away_refused += not permitted
            elif lost_at_once > _feigned(cell, axes) + _ROUNDING:
                counts.nearer += 1
                counts.nearer_permitted += permitted
    return counts


def _feigned(cell: NominalCell, axes: np.ndarray) -> float:
    """How far, m, the error of each measured angle moves the sensor, at most; the errors are independent."""
    ((number, mesh),) = ((k, body.mesh) for k, body in enumerate(cell.bodies) if body.name == "sensor")
    off = np.vstack([axes, axes + np.diag(np.broadcast_to(SETTINGS.angle_error, len(axes)))])
    poses = cell.body_poses(off)[:, number]
    points = np.einsum("nij,mj->nmi", poses[:, :3, :3], mesh.vertices) + poses[:, None, :3, 3]
    moved = np.linalg.norm(points[1:] - points[0], axis=-1).max(1)
    return float(np.sqrt((moved**2).sum()))


def _ahead(
    predictor: Predictor, tool: Tool, axes: np.ndarray, away: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """Rows ahead (ROWS, joints + 1), rad, of a jog of the sensor, mostly away from the wall, or of joints."""
    speed = _FASTEST * 10.0 ** rng.uniform(-3, 0)
    line = away + rng.uniform(0.0, 1.5) * unit(rng)
    twist = np.concatenate([line / np.linalg.norm(line), rng.choice([0.0, 2.0]) * unit(rng)])
    _, jacobian = tool.poses(axes[None, :-1])
    rates = np.append(tool.rates(jacobian, speed * twist[None])[0], 0.0)
    path = list(Path)[rng.integers(3)]
    state = MeasuredState(0.0, axes)
    hypothesis = Hypothesis(path, state, rng.choice([1.0, 1.0, -1.0]) * rates, np.zeros(len(rates)), 0.0)
    return predictor.axes([hypothesis], CYCLE * np.arange(ROWS)[None])[0]


def _tangents(axes: np.ndarray, ahead: np.ndarray) -> np.ndarray:
    """Ends (n, joints + 1), rad, of stops along the tangents of the path."""
    steps = np.diff(np.vstack([axes, ahead]), axis=0)
    return ahead + steps


def main() -> None:
    """Print the counts."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--poses", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=1)
    counts = run(**vars(parser.parse_args()))
    print("| motion | drawn | wrongly judged |\n| --- | --- | --- |")
    print(f"| brings no near pair nearer | {counts.away} | {counts.away_refused} refused |")
    print(f"| brings one nearer before a stop | {counts.nearer} | {counts.nearer_permitted} permitted |")


if __name__ == "__main__":
    main()
