"""Cases of the benchmark of path planning: sensor paths over the sample parts, with boxes in the way.

Each belongs to a class by what dynamic programming finds on the whole maps of all arm branches:

- ordinary: a motion exists, and a table at rest at some angle would do
- moving: a motion exists, and the table must turn along the path
- blocked: none exists, by construction: out of reach, or a plate over the path
"""

from __future__ import annotations

import tomllib
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w
from numpy.typing import NDArray

from scancell.config.files import assets_dir
from scancell.config.loading import load_setup
from scancell.config.scan import PathDescription
from scancell.errors import PlanningError
from scancell.geometry import pose
from scancell.geometry.mesh import box_mesh, load_mesh
from scancell.nominal.cell import NominalCell, nominal_cell
from scancell.nominal.parts import Body
from scancell.planning.model import PlanningCell, SensorRange
from scancell.planning.motion.assembly import check_part
from scancell.planning.path_map.path_planner import PathPlanner
from scancell.planning.path_map.ray_shooting import best_motion, shoot
from scancell.planning.path_map.table_motion import Lattice
from scancell.planning.views.sensor_paths import SensorPath, sensor_paths
from scancell.proximity.judge import Judge
from scancell.scanning.world import make_sensor

Array = NDArray[np.float64]

CASES = assets_dir() / "benchmarks/planning/cases.toml"
PARTS = ("free_form", "machined", "step_block", "sphere_on_foot")
WANTED = {"ordinary": 136, "moving": 40, "blocked": 24}
CLEARANCE = 0.005  # m
_MOST_TRIES = 2000
_STILL_ANGLES = 72
_CHUNK = 5000  # poses at a time: their arrays take memory


def read_cases(file: Path = CASES) -> list[dict[str, Any]]:
    with file.open("rb") as stream:
        return list(tomllib.load(stream)["case"])


@cache
def _nominal(part: str) -> NominalCell:
    setup = load_setup()
    return nominal_cell(setup.cell, load_mesh(assets_dir() / "parts" / f"{part}.stl", "mm"))


def planning_cell(case: dict[str, Any]) -> PlanningCell:
    """The default cell with the part and the boxes of a case."""
    nominal = _nominal(case["part"])
    boxes = []
    for number, box in enumerate(case.get("box", []), start=1):
        size, centre = (1e-3 * np.array(box[key], float) for key in ("size_mm", "centre_mm"))
        name = f"box {number}"
        mesh = box_mesh(tuple(float(x) for x in size), name).transformed(pose.translation(centre))
        boxes.append(Body(name, box.get("moves_with", "world"), mesh, nominal.bodies[0].material))
    range_ = SensorRange.of(make_sensor(load_setup().sensor, 0))
    return PlanningCell(replace(nominal, bodies=(*nominal.bodies, *boxes)), range_, 0.016, threads=1)


def path_poses(table: dict[str, Array]) -> Array:
    """Poses (n, 4, 4) of the sensor on the table, m, of an input `path`, for entries in Python."""
    poses = np.zeros((len(table["x_mm"]), 4, 4))
    poses[:, 3, 3] = 1.0
    for row in range(3):
        poses[:, row, 3] = 1e-3 * table[("x_mm", "y_mm", "z_mm")[row]]
        for column in range(3):
            poses[:, row, column] = table[f"r{row + 1}{column + 1}"]
    return poses


def path_of(case: dict[str, Any], cell: PlanningCell) -> SensorPath:
    description = PathDescription(name=case["name"], **case["path"])
    (path,) = sensor_paths(description, cell.nominal.part, cell.nominal.table_from_part)
    return path


def dense_poses(axes: Array, step: float) -> Array:
    """Axes on the straight lines between axes (n, joints + 1), rad, with a pose at least every `step` of each."""
    pieces = [axes[:1]]
    for a, b in pairwise(axes):
        count = max(1, int(np.ceil(np.abs(b - a).max() / step)))
        pieces.append(a + np.arange(1, count + 1)[:, None] / count * (b - a))
    return np.concatenate(pieces)


def judge_of(cell: PlanningCell) -> Judge:
    """The collision queries of python-fcl for the bodies of a cell."""
    meshes = {body.name: body.mesh for body in cell.nominal.bodies}
    home = cell.nominal.body_poses([*cell.nominal.home, cell.table_start])
    return Judge(meshes, tuple(meshes), home)


def first_contact(cell: PlanningCell, judge: Judge, axes: Array) -> str:
    """Bodies that python-fcl finds to hit each other at one of axes (n, joints + 1), rad; "" for none."""
    for at in np.array_split(axes, -(-len(axes) // _CHUNK)):
        bodies = cell.nominal.body_poses(at)
        clash = judge.first_collision(bodies)
        if clash is not None:
            return f"{clash.body_a} hits {clash.body_b}"
    return ""


def _box(rng: np.random.Generator) -> dict[str, Any]:
    azimuth, radius = rng.uniform(0, 2 * np.pi), rng.uniform(200, 350)
    centre = [450 + radius * np.cos(azimuth), radius * np.sin(azimuth), rng.uniform(50, 300)]
    return {"size_mm": rng.uniform(30, 120, 3).round(1).tolist(), "centre_mm": np.round(centre, 1).tolist()}


def _leg(rng: np.random.Generator, part: str) -> dict[str, Any]:
    low, high = 1e3 * _nominal(part).part.bounds
    middle = (low + high) / 2
    azimuth, elevation = rng.uniform(0, 360), rng.uniform(25, 90)
    turned = rng.uniform(-90, 90) if rng.random() < 0.5 else 0.0
    ends = []
    along = rng.normal(size=3)
    along *= rng.uniform(15, 50) / np.linalg.norm(along)
    for side in (-1, 1):
        at = middle + side * along * [1, 1, 0.3]
        ends.append({
            "x_mm": round(float(at[0]), 1), "y_mm": round(float(at[1]), 1), "z_mm": round(float(at[2]), 1),
            "azimuth_deg": round(azimuth + side * turned / 2, 1), "elevation_deg": round(elevation, 1),
        })  # fmt: skip
    return {"waypoint": ends, "speed_mm_s": 100.0, "standoff_mm": 110.0}


def _arc(rng: np.random.Generator) -> dict[str, Any]:
    low = rng.random() < 0.5  # the robot's side of the part is out of reach
    elevation = sorted(
        rng.uniform(*((12, 25) if low else (20, 85)), 2).round(1).tolist(), reverse=bool(rng.random() < 0.5)
    )
    turns = round(float(rng.choice([-1, 1]) * rng.uniform(*((0.8, 1.3) if low else (0.3, 1.2)))), 2)
    spiral = {"turns": turns, "start_deg": round(float(rng.uniform(0, 360)), 1), "elevation_deg": elevation}
    return {"spiral": spiral, "speed_mm_s": 200.0}


def _drawn(seed: int) -> dict[str, Any]:
    rng = np.random.default_rng(seed)
    part = str(rng.choice(PARTS))
    case: dict[str, Any] = {"name": f"case {seed}", "part": part}
    case["path"] = _leg(rng, part) if rng.random() < 0.5 else _arc(rng)
    case["box"] = [_box(rng) for _ in range(int(rng.integers(0, 4)))]
    return case


def _blocked(number: int) -> dict[str, Any]:
    """Beyond the arm's reach, or with a plate, which turns with the table, at the height of the sensor."""
    rng = np.random.default_rng(10_000 + number)
    part = str(rng.choice(PARTS))
    case: dict[str, Any] = {"name": f"blocked {number}", "kind": "blocked", "part": part, "box": []}
    case["path"] = _leg(rng, part)
    if number % 2:
        for end in case["path"]["waypoint"]:
            end["z_mm"] += 800.0
        return {**case, "cause": "reach"}
    for end in case["path"]["waypoint"]:
        end["elevation_deg"] = 80.0
    height = 1e3 * float(_nominal(part).table_from_part[2, 3]) + case["path"]["waypoint"][0]["z_mm"] + 115.0
    plate = {"size_mm": [400.0, 400.0, 2.0], "centre_mm": [0.0, 0.0, round(height, 1)], "moves_with": "table"}
    return {**case, "box": [plate], "cause": "clearance"}


def _kind(seed: int) -> tuple[dict[str, Any], str]:
    """The case of a seed and its class; "" where the cell itself collides or the path is not usable."""
    case = _drawn(seed)
    try:
        cell = planning_cell(case)
        check_part(cell)
        path = path_of(case, cell)
    except PlanningError:
        return case, ""
    planner = PathPlanner(cell, CLEARANCE)
    if any(_any_still(lattice) for lattice in planner.lattices(path)):
        return case, "ordinary"
    # What Ray Shooting finds the optimum finds, too, but later.
    solved = any(shoot(lattice) is not None for lattice in planner.lattices(path))
    solved = solved or any(best_motion(lattice) is not None for lattice in planner.lattices(path))
    return case, "moving" if solved else ""


def _any_still(lattice: Lattice) -> bool:
    """Whether a table at rest at one of 72 angles would do."""
    map_ = lattice.map
    for row in range(0, map_.rows, map_.rows // _STILL_ANGLES):
        columns = np.arange(map_.columns)
        # Most angles fail at one of a few columns.
        map_.require(columns[:: map_.columns // 8], row)
        known = np.isfinite(map_.quality[:, row])
        if (map_.quality[known, row] > 0).all():
            map_.require(columns, row)
            free = (map_.quality > 0) & (map_.lowest_rate <= 0) & (map_.highest_rate >= 0)
            if free[:, row].all():
                return True
    return False


def make(workers: int) -> None:
    """Draw cases until there are enough of each class, and write them."""
    kept: dict[str, list[dict[str, Any]]] = {"ordinary": [], "moving": []}
    with ProcessPoolExecutor(workers) as pool:
        for first in range(1, _MOST_TRIES, 40):
            for case, kind in pool.map(_kind, range(first, first + 40)):
                if kind and len(kept[kind]) < WANTED[kind]:
                    kept[kind].append({**case, "kind": kind})
            print({kind: len(cases) for kind, cases in kept.items()}, flush=True)
            if all(len(kept[kind]) == WANTED[kind] for kind in kept):
                break
    blocked = [_blocked(number) for number in range(1, WANTED["blocked"] + 1)]
    CASES.parent.mkdir(parents=True, exist_ok=True)
    CASES.write_text(tomli_w.dumps({"case": [*kept["ordinary"], *kept["moving"], *blocked]}))
