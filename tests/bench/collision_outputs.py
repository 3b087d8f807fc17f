"""Collision outputs of the FMU against python-fcl: ``PYTHONPATH=tests:tests/fmu python -m bench.collision_outputs``.

In each of the four cells, the axes stream through random positions of their whole ranges, without regard to bodies in
their way. After every controller cycle the number of colliding pairs and the smallest clearance are compared with
python-fcl. Poses are those of the Python kinematics of the nominal cell, and of parts and fingers, which contacts move,
the true ones of the FMU. Pairs whose surfaces do not meet collide, too, where a corner of one is inside the other
(generalised winding number).
"""

from __future__ import annotations

import argparse
import tempfile
from collections import Counter
from pathlib import Path

import fcl
import numpy as np
from cell_fixture import CellFmu, write_fmu
from numpy.typing import NDArray

from mesh_json import read_mesh_json
from scancell.cell.fmu_file import cell_json
from scancell.config.loading import load_setup
from scancell.nominal.cell import nominal_cell
from scancell.nominal.parts import load_part
from scancell.proximity.judge import fcl_model

Array = NDArray[np.float64]

ASSETS = Path(__file__).resolve().parents[2] / "assets"
CELLS = ("default", "offset_wrist", "pick_and_place", "seven_axis")
_SPEED = 0.5  # of the axes' limits
_TOUCHING = 2e-6  # m: distances of surfaces that may count as contact


class Judge:
    """Bodies and pairs of a description of the cell for python-fcl."""

    def __init__(self, description: dict) -> None:
        meshes = {body["name"]: read_mesh_json(body["mesh"]) for body in description["bodies"]}
        self.names = list(meshes)
        self.pairs = [(self.names.index(a), self.names.index(b)) for a, b in description["collision"]["pairs"]]
        self._meshes, self._range = list(meshes.values()), description["collision"]["range"]
        self._objects = [fcl.CollisionObject(fcl_model(*mesh)) for mesh in self._meshes]
        frames = [body["frame"] for body in description["bodies"]]
        self.loose = [(row, frame) for row, frame in enumerate(frames) if frame.startswith(("part", "finger"))]
        self._centres = [vertices.mean(0) for vertices, _ in self._meshes]
        self._radii = [
            float(np.linalg.norm(vertices - centre, axis=1).max())
            for (vertices, _), centre in zip(self._meshes, self._centres, strict=True)
        ]

    def distances(self, poses: list[Array]) -> Array:
        """Distances (pairs,), m; 0 where surfaces meet or one body is inside the other, infinite beyond the range."""
        centres = [pose[:3, :3] @ one + pose[:3, 3] for pose, one in zip(poses, self._centres, strict=True)]
        for one, pose in zip(self._objects, poses, strict=True):
            one.setTransform(fcl.Transform(pose[:3, :3], pose[:3, 3]))
        found = np.zeros(len(self.pairs))
        for k, (a, b) in enumerate(self.pairs):
            pair = self._objects[a], self._objects[b]
            if np.linalg.norm(centres[a] - centres[b]) - self._radii[a] - self._radii[b] > self._range:
                found[k] = np.inf
                continue
            if not fcl.collide(*pair, fcl.CollisionRequest(), fcl.CollisionResult()):
                away = fcl.distance(*pair, fcl.DistanceRequest(), fcl.DistanceResult())
                inside = self._is_inside(a, b, poses) or self._is_inside(b, a, poses)
                found[k] = 0.0 if inside else max(away, 1e-12)
        return found

    def _is_inside(self, inner: int, outer: int, poses: list[Array]) -> bool:
        """Whether a corner of one body is inside the other, by the solid angles of its faces."""
        point = poses[inner][:3, :3] @ self._meshes[inner][0][0] + poses[inner][:3, 3]
        vertices, faces = self._meshes[outer]
        a, b, c = np.moveaxis((vertices @ poses[outer][:3, :3].T + poses[outer][:3, 3] - point)[faces], 1, 0)
        la, lb, lc = (np.linalg.norm(one, axis=1) for one in (a, b, c))
        volume = np.einsum("ni,ni->n", a, np.cross(b, c))
        around = la * lb * lc + lc * np.sum(a * b, 1) + la * np.sum(b * c, 1) + lb * np.sum(c * a, 1)
        return bool(np.sum(np.arctan2(volume, around)) / (2 * np.pi) > 0.5)


def run(name: str, part: Path, cycles: int, seed: int, folder: Path) -> tuple[Counter[str], list[str]]:
    """Counts of cycles of one cell, and what disagrees."""
    setup = load_setup(
        cell=ASSETS / "cells" / f"{name}.toml",
        settings={"cell.collision.outputs": True, "cell.collision.swept": False, "cell.collision.stops_arm": False},
    )
    nominal = nominal_cell(setup.cell, load_part(part))
    description = cell_json(setup.cell, nominal, seed)
    judge, rng = Judge(description), np.random.default_rng(seed)
    number = {body.name: i for i, body in enumerate(nominal.bodies)}
    rows = [number[body] for body in judge.names]
    lower, upper = nominal.arm.limits
    cycle = setup.cell.world.controller_cycle_us
    at, step = np.append(nominal.home, 0.0), _SPEED * nominal.axis_max_speed * cycle * 1e-6
    fmu = CellFmu(write_fmu(description, 3, folder))
    counts, wrong = Counter[str](), []
    try:
        target = at
        for _ in range(cycles):
            if np.array_equal(at, target):
                target = np.append(rng.uniform(lower, upper), rng.uniform(-np.pi, np.pi))
            at = at + np.clip(target - at, -step, step)
            fmu.command(at[:-1], at[-1])
            fmu.step(cycle)
            true = np.append(fmu.vector("truth.q", len(at) - 1), fmu.get("truth.table"))
            poses = list(nominal.body_poses(true)[rows])
            for row, frame in judge.loose:
                poses[row] = fmu.body(frame)
            distance = judge.distances(poses)
            colliding, nearest = fmu.get_int("truth.collision.pairs"), float(fmu.get("truth.clearance.distance")[0])
            counts["cycles"] += 1
            counts["with a collision"] += bool((distance == 0).any())
            least, most = int((distance == 0).sum()), int((distance < _TOUCHING).sum())
            reach = min(float(distance.min()), description["collision"]["range"])
            if not least <= colliding <= most or abs(nearest - reach) > _TOUCHING:
                counts["disagree"] += 1
                wrong.append(
                    f"{name} {true.tolist()}: {colliding} pairs and {nearest} m, python-fcl {least} and {reach}"
                )
    finally:
        fmu.close()
    return counts, wrong


def main() -> None:
    """Print a row for each cell."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cycles", type=int, default=12_000, help="in all")
    given = parser.parse_args()
    for seed, name in enumerate(CELLS):
        with tempfile.TemporaryDirectory() as folder:
            part = ASSETS / "parts" / ("free_form.stl", "machined.stl", "step_block.stl", "sphere_on_foot.stl")[seed]
            counts, wrong = run(name, part, given.cycles // len(CELLS), seed, Path(folder) / "fmu")
        print(f"{name}: {dict(counts)}", flush=True)
        for line in wrong[:5]:
            print(" ", line)


if __name__ == "__main__":
    main()
