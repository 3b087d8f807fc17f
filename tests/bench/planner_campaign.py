"""Campaign of the planner: ``PYTHONPATH=tests python -m bench.planner_campaign --out rows.csv`` plans 200 random cells.

Each cell holds a concave part without symmetry (bracket, ring with a gap, fin, hooked bar) off the table's axis, a hook
in or before its opening, posts near what sticks out, and sometimes a post that turns with the table. python-fcl judges
the plans: it compares every two bodies whose relative poses change, at samples between which no two points approach by
more than 0.2 mm, with all obstacles displaced by their stated errors. A plain RRT-Connect on python-fcl searches the
motions that the planner did not find. Rows are written as they are made; a second call makes those that are missing.
"""

from __future__ import annotations

import argparse
import csv
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, fields, replace
from itertools import combinations
from pathlib import Path

import fcl
import numpy as np
import trimesh
from numpy.typing import NDArray

from benchmarks.planning_cases import dense_poses
from scancell.config.loading import load_setup
from scancell.errors import PlanningError
from scancell.geometry import pose
from scancell.geometry.mesh import Mesh
from scancell.nominal.cell import Body, NominalCell, nominal_cell
from scancell.planning.model import MOTION_SHARE, PlanningCell, SensorRange
from scancell.planning.motion.connection import Connector
from scancell.planning.options import scan_options
from scancell.planning.plan import Plan
from scancell.planning.planner import plan
from scancell.planning.work import Work
from scancell.progress import NullProgress
from scancell.proximity.judge import Judge, fcl_model
from scancell.scanning.sense import make_sensors

Array = NDArray[np.float64]

KINDS = ("bracket", "ring", "fin", "hooked bar")
CLEARANCES = (0.0, 0.001, 0.005)  # m
ERROR_SHARE = 0.5 * MOTION_SHARE  # of the clearance: stated error of the pose of an obstacle
FREE_AT_START = 0.001  # m beyond the clearance
LONGEST_STEP = np.radians(1.0)  # of the plain planner
_BLOCK = 2000


@dataclass(frozen=True)
class Row:
    """Outcome of one cell.

    Attributes
    ----------
    seconds, longest_gap
        Until the answer, and between two chances to cancel, s of the clock.
    contact
        What python-fcl finds at one of the judged `poses`.
    refused, contradicted
        Motions that the planner refused, and those of them that the plain planner found.
    """

    seed: int
    kind: str
    clearance_mm: float
    obstacles: int
    outcome: str
    reason: str
    seconds: float
    processor_seconds: float
    longest_gap: float
    coverage: float
    segments: int
    omitted: int
    poses: int
    contact: str
    refused: int
    contradicted: int


def _box(x: tuple[float, float], y: tuple[float, float], z: tuple[float, float]) -> trimesh.Trimesh:
    return trimesh.creation.box(bounds=np.array([x, y, z]).T)


def _bars(kind: str, rng: np.random.Generator) -> tuple[list[trimesh.Trimesh], Array]:
    """Pieces of a part, which overlap, and a point in its opening or beside it, m."""
    high, wall = rng.uniform(0.02, 0.06), rng.uniform(0.004, 0.012)
    if kind == "bracket":
        long, wide = rng.uniform(0.04, 0.09, 2), rng.uniform(0.03, 0.06)
        back = _box((-wide / 2 - wall, -wide / 2), (-wide / 2 - wall, wide / 2 + wall), (0, high))
        arms = [
            _box((-wide / 2 - wall, length), (y, y + wall), (0, h))
            for length, y, h in ((long[0], -wide / 2 - wall, high), (long[1], wide / 2, high * rng.uniform(0.4, 1.0)))
        ]
        return [back, *arms], np.array([0.6 * long.min(), rng.uniform(-0.2, 0.2) * wide, high])
    if kind == "ring":
        inner, gap = float(rng.uniform(0.025, 0.05)), float(rng.uniform(0.5, 1.5))
        pieces, half = [], 0.19 * (inner + wall)
        for angle in np.arange(gap, 2 * np.pi - gap, 0.35):
            piece = _box((inner, inner + wall), (-half, half), (0, high))
            pieces.append(piece.apply_transform(pose.from_rotation(pose.rotation_about(2, angle))))
        return pieces, np.array([rng.uniform(0.3, 1.3) * inner, 0.0, high])
    if kind == "fin":
        thick, across, tall = rng.uniform(0.001, 0.003), rng.uniform(0.05, 0.12), rng.uniform(0.06, 0.18)
        foot = _box((-0.02, 0.02), (-0.03, 0.03), (0, 0.008))
        return [foot, _box((-thick / 2, thick / 2), (-0.4 * across, 0.6 * across), (0, tall))], np.array(
            [0.04, 0.03, tall]
        )
    bar = _box((-0.03, 0.08), (-wall, wall), (0, 0.02))
    stand = _box((0.08 - wall, 0.08), (-wall, wall), (0, high + 0.03))
    nose = _box((0.03, 0.08), (-wall, wall), (high + 0.02, high + 0.03))
    return [bar, stand, nose], np.array([0.0, 0.0, high])


def _joined(pieces: list[trimesh.Trimesh], name: str) -> Mesh:
    made = trimesh.util.concatenate(pieces)
    return Mesh(np.asarray(made.vertices, float), np.asarray(made.faces, np.int64), name)


def make_cell(seed: int) -> tuple[str, float, PlanningCell]:
    """Kind of part, clearance (m) and the cell, which keeps the clearance where it starts."""
    kind, clearance = KINDS[seed % len(KINDS)], CLEARANCES[seed // len(KINDS) % len(CLEARANCES)]
    for attempt in range(1000):
        rng = np.random.default_rng([seed, attempt])
        pieces, opening = _bars(kind, rng)
        part = _joined(pieces, "part")
        words = [f"cell.part.{key}={rng.uniform(-25, 25):.1f}" for key in ("x_mm", "y_mm")]
        setup = load_setup(settings=[*words, f"cell.part.rz_deg={rng.uniform(0, 360):.1f}"])
        nominal = nominal_cell(setup.cell, part)
        bodies = _obstacles(nominal, opening, rng)
        found = replace(nominal, bodies=(*nominal.bodies, *bodies))
        cell = PlanningCell(
            found, SensorRange.of(make_sensors(setup.sensor, (), 0).nominal), 0.016, work=Work(300.0, _Gaps())
        )
        if _is_free_at_start(found, clearance + FREE_AT_START):
            return kind, clearance, cell
    raise RuntimeError(f"seed {seed}: no cell is free where it starts")


def _obstacles(nominal: NominalCell, opening: Array, rng: np.random.Generator) -> list[Body]:
    """A hook that hangs into the opening, one or two posts beside the part, sometimes a post on the table."""
    world_from_part, material = nominal.world_from_part(0.0), nominal.bodies[0].material
    made, side = [], rng.uniform(0.004, 0.012)
    (at,) = pose.transform_points(world_from_part, opening[None])
    low = world_from_part[2, 3] + rng.uniform(0.002, 0.8) * opening[2] + 0.004
    hook = [_box((at[0] - side, at[0] + side), (at[1] - side, at[1] + side), (low, low + 0.15))]
    if rng.random() < 0.3:
        hook.append(_box((at[0] - side, at[0] + 0.03), (at[1] - side, at[1] + side), (low, low + 0.006)))
    made.append(("hook", "world", _joined(hook, "hook")))
    axis, part = nominal.world_from_table[:3, 3], nominal.part.vertices
    reach = np.hypot(*(pose.transform_points(nominal.table_from_part, part)[:, :2].T)).max()
    for number in range(int(rng.integers(1, 3))):
        angle, radius = rng.uniform(0, 2 * np.pi), reach * rng.uniform(0.85, 1.25) + side
        x, y = axis[:2] + radius * np.array([np.cos(angle), np.sin(angle)])
        top = axis[2] + rng.uniform(0.01, 0.12)
        post = _box((x - side, x + side), (y - side, y + side), (axis[2] + 0.008, top + 0.01))
        made.append((f"post{number + 1}", "world", _joined([post], "post")))
    if rng.random() < 0.4:
        angle = rng.uniform(0, 2 * np.pi)
        x, y = 0.09 * np.cos(angle), 0.09 * np.sin(angle)
        turning = _box((x - side, x + side), (y - side, y + side), (0.0, rng.uniform(0.01, 0.08)))
        made.append(("turning", "table", _joined([turning], "turning")))
    return [Body(name, frame, mesh, material) for name, frame, mesh in made]


def _is_free_at_start(nominal: NominalCell, margin: float) -> bool:
    """Whether obstacles and part keep the margin, by python-fcl."""
    poses, own = nominal.body_poses(nominal.home, 0.0), {"part", "hook", "post1", "post2", "turning"}
    objects = {b.name: _placed(b.mesh, poses[i]) for i, b in enumerate(nominal.bodies)}
    frame = {b.name: b.moves_with for b in nominal.bodies}
    return all(
        fcl.distance(objects[a], objects[b], fcl.DistanceRequest(), fcl.DistanceResult()) > margin
        for a, b in combinations(objects, 2)
        if (a in own or b in own)
        and frame[a] != frame[b]
        and {a, b} not in ({"part", "table"}, {"turning", "table"}, {"part", "table_base"})
    )


def _placed(mesh: Mesh, at: Array) -> fcl.CollisionObject:
    return fcl.CollisionObject(fcl_model(mesh.vertices, mesh.faces), fcl.Transform(at[:3, :3], at[:3, 3]))


class _Gaps(NullProgress):
    """The longest time between two chances to cancel, s."""

    def __init__(self) -> None:
        self.last, self.longest = time.monotonic(), 0.0

    def advance(self, steps: float) -> None:
        now = time.monotonic()
        self.longest, self.last = max(self.longest, now - self.last), now


def displaced(nominal: NominalCell, error: float, seed: int) -> NominalCell:
    """The cell with obstacles off by `error` (m) in random directions."""
    rng, bodies = np.random.default_rng([seed, 7]), []
    for body in nominal.bodies:
        away = rng.normal(size=3)
        is_obstacle = body.name.startswith(("hook", "post", "turning"))
        offset = error * away / np.linalg.norm(away) if is_obstacle else np.zeros(3)
        bodies.append(replace(body, mesh=body.mesh.transformed(pose.translation(offset))) if is_obstacle else body)
    return replace(nominal, bodies=tuple(bodies))


def judged(nominal: NominalCell, made: Plan, step: float) -> tuple[int, str]:
    """Number of judged poses, no two points nearing by more than `step` (m) between them, and what is in contact."""
    meshes = {body.name: body.mesh for body in nominal.bodies}
    judge = Judge(meshes, tuple(meshes), nominal.body_poses(nominal.home, made.program.segments[0].table[0]))
    corners = [
        body.mesh.bounds[np.indices((2, 2, 2)).reshape(3, 8), np.arange(3)[:, None]].T for body in nominal.bodies
    ]
    count = 0
    for segment in made.program.segments:
        axes = np.column_stack([segment.q, segment.table])
        poses = nominal.body_poses(axes[:, :-1], axes[:, -1])
        at = np.stack([pose.transform_points(poses[:, i], corner[None]) for i, corner in enumerate(corners)], 1)
        moved = np.linalg.norm(np.diff(at, axis=0), axis=-1).max((1, 2), initial=0.0)
        # Two bodies may move towards each other.
        parts = np.maximum(1, np.ceil(2 * moved / step).astype(int))
        pieces = [
            a + np.linspace(0, 1, n, endpoint=False)[:, None] * (b - a)
            for a, b, n in zip(axes, axes[1:], parts, strict=False)
        ]
        dense = np.concatenate([*pieces, axes[-1:]])
        for first in range(0, len(dense), _BLOCK):
            block = dense[first : first + _BLOCK]
            clash = judge.first_collision(nominal.body_poses(block[:, :-1], block[:, -1]))
            if clash is not None:
                return count + clash.index, f"{clash.body_a} hits {clash.body_b} in {segment.name}"
            count += len(block)
    return count, ""


class PlainPlanner:
    """RRT-Connect whose edges are sampled and whose distances are those of python-fcl."""

    def __init__(self, nominal: NominalCell, clearance: float) -> None:
        self._nominal, self._clearance = nominal, max(clearance, 1e-6)
        self._models = [fcl_model(body.mesh.vertices, body.mesh.faces) for body in nominal.bodies]
        self._radius = np.array([np.linalg.norm(np.ptp(body.mesh.bounds, axis=0)) / 2 for body in nominal.bodies])
        self._middle = np.array([body.mesh.bounds.mean(0) for body in nominal.bodies])
        names = [body.name for body in nominal.bodies]
        meshes = {body.name: body.mesh for body in nominal.bodies}
        home = nominal.body_poses(nominal.home, 0.0)
        number = {name: i for i, name in enumerate(names)}
        arm = ("base", "link")
        self._pairs = [
            (number[a], number[b], 0.002 if a.startswith(arm) and b.startswith((*arm, "sensor")) else np.inf)
            for a, b in Judge(meshes, names, home).pairs
            if nominal.bodies[number[a]].moves_with != nominal.bodies[number[b]].moves_with
        ]

    def is_free(self, axes: Array) -> bool:
        poses = self._nominal.body_poses(axes[:-1], axes[-1])
        centre = poses[:, :3, 3] + (poses[:, :3, :3] @ self._middle[..., None])[..., 0]
        for a, b, most in self._pairs:
            required = min(self._clearance, most)
            if np.linalg.norm(centre[a] - centre[b]) > self._radius[a] + self._radius[b] + required:
                continue
            objects = [
                fcl.CollisionObject(self._models[k], fcl.Transform(poses[k, :3, :3], poses[k, :3, 3])) for k in (a, b)
            ]
            if fcl.distance(*objects, fcl.DistanceRequest(), fcl.DistanceResult()) < required:
                return False
        return True

    def finds(self, start: Array, goal: Array, seconds: float) -> bool:
        """Whether a path is found in a processor time."""
        if not (self.is_free(start) and self.is_free(goal)):
            return False
        rng, until = np.random.default_rng(0), time.process_time() + seconds
        lower, upper = self._nominal.arm.limits
        low, high = (
            np.append(limit, end)
            for limit, end in ((lower, min(start[-1], goal[-1])), (upper, max(start[-1], goal[-1])))
        )
        trees, other = [start[None], goal[None]], 1
        while time.process_time() < until:
            tree, other = 1 - other, 1 - (1 - other)
            target = rng.uniform(low, high)
            for growing in (tree, 1 - tree):
                nodes = trees[growing]
                near = nodes[np.argmin(np.linalg.norm(nodes - target, axis=1))]
                ways = dense_poses(np.stack([near, target]), LONGEST_STEP)[1:]
                free = next((i for i, at in enumerate(ways) if not self.is_free(at)), len(ways))
                if free == 0:
                    break
                trees[growing] = np.vstack([nodes, ways[:free][[*range(9, free, 10), free - 1]]])
                if growing != tree and free == len(ways):
                    return True
                target = ways[free - 1]
            other = tree
        return False


@contextmanager
def _refusals(found: list[tuple[Array, Array]]) -> Iterator[None]:
    """Notes the start and the goal of every motion that the planner does not find."""
    connect = Connector.connect

    def noting(self: Connector, start: Array, end: Array, purpose: str) -> list[Array]:
        try:
            return connect(self, start, end, purpose)
        except PlanningError:
            found.append((start, end))
            raise

    Connector.connect = noting  # type: ignore[method-assign]
    try:
        yield
    finally:
        Connector.connect = connect  # type: ignore[method-assign]


def run_cell(seed: int, step: float = 2e-4, plain_seconds: float = 30.0, profiles: int = 120) -> Row:
    """Plan one cell and judge the plan at samples `step` (m) apart."""
    kind, clearance, cell = make_cell(seed)
    settings = [f"scan.clearance_mm={1e3 * clearance}", f"scan.max_profiles={profiles}", "scan.max_lost_share=1.0"]
    setup = load_setup(settings=settings)
    refused: list[tuple[Array, Array]] = []
    gaps = cell.work._progress
    assert isinstance(gaps, _Gaps)
    made, reason = None, ""
    gaps.last = start = time.monotonic()
    processor = time.process_time()
    try:
        with _refusals(refused):
            made = plan(cell, scan_options(setup.scan, setup.sensor))
        reason = next((warning for warning in made.warnings if warning.startswith("omitted")), "")
    except PlanningError as error:
        reason = str(error)
    seconds, processor = time.monotonic() - start, time.process_time() - processor
    gaps.advance(0.0)
    poses, contact = (
        (0, "") if made is None else judged(displaced(cell.nominal, ERROR_SHARE * clearance, seed), made, step)
    )
    plain = PlainPlanner(cell.nominal, MOTION_SHARE * clearance)
    return Row(
        seed=seed,
        kind=kind,
        clearance_mm=1e3 * clearance,
        obstacles=sum(body.name.startswith(("hook", "post", "turning")) for body in cell.nominal.bodies),
        outcome="refused" if made is None else "planned",
        reason=reason,
        seconds=round(seconds, 2),
        processor_seconds=round(processor, 2),
        longest_gap=round(gaps.longest, 2),
        coverage=np.nan if made is None or made.coverage is None else round(made.coverage, 4),
        segments=0 if made is None else len(made.program.segments),
        omitted=0 if made is None else sum(warning.startswith("omitted") for warning in made.warnings),
        poses=poses,
        contact=contact,
        refused=len(refused),
        contradicted=sum(plain.finds(*ends, plain_seconds) for ends in refused),
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cells", type=int, default=200)
    parser.add_argument("--first", type=int, default=0, help="number of the first cell")
    parser.add_argument("--step-mm", type=float, default=0.2, help="largest motion between two judged poses")
    parser.add_argument("--out", type=Path, default=Path("out/planner_campaign.csv"))
    asked = parser.parse_args()
    asked.out.parent.mkdir(parents=True, exist_ok=True)
    done: list[dict[str, str]] = []
    if asked.out.exists():
        with asked.out.open(newline="") as file:
            done = list(csv.DictReader(file))
    with asked.out.open("a", newline="") as file:
        writer = csv.DictWriter(file, [field.name for field in fields(Row)])
        if not done:
            writer.writeheader()
        for seed in range(asked.first, asked.first + asked.cells):
            if any(int(row["seed"]) == seed for row in done):
                continue
            row = asdict(run_cell(seed, 1e-3 * asked.step_mm))
            writer.writerow(row)
            file.flush()
            done.append({key: str(value) for key, value in row.items()})
            print(", ".join(f"{key} {value}" for key, value in row.items()), flush=True)
    planned = [row for row in done if row["outcome"] == "planned"]
    print(
        f"{len(done)} cells, {len(planned)} planned, {sum(row['contact'] != '' for row in planned)} contacts at"
        f" {sum(int(row['poses']) for row in planned)} poses;"
        f" {sum(int(row['refused']) for row in done)} motions refused,"
        f" {sum(int(row['contradicted']) for row in done)} of them found by the plain planner;"
        f" longest answer {max(float(row['seconds']) for row in done):.1f} s,"
        f" longest time to a cancel {max(float(row['longest_gap']) for row in done):.1f} s"
    )


if __name__ == "__main__":
    main()
