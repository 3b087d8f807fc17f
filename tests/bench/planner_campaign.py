"""Campaign of the planner: ``PYTHONPATH=tests:. python -m bench.planner_campaign --out rows.csv``, 200 random cells.

The cells are those of the four shipped descriptions. Each holds a concave part without symmetry (bracket, ring with a
gap, fin, hooked bar), a hook in or above its opening, posts near what sticks out, sometimes a post that turns with the
table, and sometimes a tall post, a wall or a beam in the way of the arm; in three fifths of the cells the table is free
to turn. `bench.plain_planner` judges the plans on python-fcl at samples between which no two points approach by more
than 0.2 mm, with part and obstacles displaced by their stated errors towards each other body, and searches what the
planner refused. Rows are written as they are made; a second call makes those that are missing.
"""

from __future__ import annotations

import argparse
import csv
import time
import traceback
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, fields, replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

from bench.plain_planner import Cell, PlainPlanner, judged
from scancell.config.files import assets_dir
from scancell.config.loading import Setup, load_setup
from scancell.errors import CellError, PlanningError
from scancell.geometry import pose
from scancell.geometry.mesh import Mesh
from scancell.nominal.cell import NominalCell, nominal_cell
from scancell.nominal.parts import Body
from scancell.planning import planner
from scancell.planning.model import MOTION_SHARE, PlanningCell, SensorRange, Work
from scancell.planning.motion.connection import Connector
from scancell.planning.options import scan_options
from scancell.planning.planner import plan
from scancell.planning.views.placement import Infeasible, Placer
from scancell.planning.views.views import Pass, Sweep
from scancell.progress import NullProgress
from scancell.scanning.world import make_sensor

Array = NDArray[np.float64]

KINDS = ("bracket", "ring", "fin", "hooked bar")
CELLS = ("default", "offset_wrist", "seven_axis", "pick_and_place")
CLEARANCES = (0.005, 0.0, 0.001, 0.0001)  # m
ERROR_SHARE = 0.49 * MOTION_SHARE  # of the clearance: stated error of the pose of the part and of each obstacle
FREE_AT_START = 0.001  # m beyond the clearance
_OBSTACLES = ("hook", "post", "turning", "tall", "wall", "beam")
_MOST_CHECKED = 2  # refusals of each kind that the plain planner checks in a cell
_CANCEL_S, _ANSWER_S = 5.0, 60.0


@dataclass(frozen=True)
class Row:
    """Outcome of one cell.

    Attributes
    ----------
    seconds, processor_seconds
        Until the answer.
    longest_gap, processor_gap, gap
        Longest time between two chances to cancel, s of the clock and of the processor, and the functions at its ends.
    lost
        Share of the surface of the requested views that the placed ones do not see; the shipped
        ``scan.max_lost_share`` refuses more than a fifth.
    contact, margin_mm
        What is in contact at one of the judged `poses`, and the smallest distance beyond the stated errors.
    turn, sweeps, passes, motions
        Refused: the full turn of the table, sweeps and passes without placement, motions between views.
    checked, contradicted
        Refusals that the plain planner tried, and those that it contradicts.
    """

    seed: int
    cell: str
    kind: str
    clearance_mm: float
    obstacles: str
    outcome: str
    reason: str
    seconds: float
    processor_seconds: float
    work: float
    longest_gap: float
    processor_gap: float
    gap: str
    coverage: float
    lost: float
    segments: int
    poses: int
    contact: str
    margin_mm: float
    turn: int
    sweeps: int
    passes: int
    motions: int
    checked: int
    contradicted: str


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


def make_cell(seed: int) -> tuple[str, str, float, Setup, PlanningCell]:
    """Kind of part, name of the shipped cell, clearance (m), descriptions and the cell, free where it starts."""
    kind, name = KINDS[seed % 4], CELLS[(seed // 4 + seed) % 4]
    clearance = CLEARANCES[(seed // 16 + seed // 4) % 4]
    wants_turn = seed % 5 < 3
    for attempt in range(3000):
        rng = np.random.default_rng([seed, attempt])
        pieces, opening = _bars(kind, rng)
        part = _joined(pieces, "part")
        offset = 25 if rng.random() < 0.5 else 5
        words = [f"cell.part.{key}={rng.uniform(-offset, offset):.1f}" for key in ("x_mm", "y_mm")]
        words += [f"cell.part.rz_deg={rng.uniform(0, 360):.1f}", f"scan.clearance_mm={1e3 * clearance}"]
        setup = load_setup(assets_dir() / "cells" / f"{name}.toml", settings=words)
        try:
            nominal = nominal_cell(setup.cell, part)
        except CellError:  # a free part that would tip over
            continue
        found = replace(nominal, bodies=(*nominal.bodies, *_obstacles(nominal, opening, rng)))
        if not _keeps(found, clearance + FREE_AT_START, [0.0]):
            continue
        if _keeps(found, clearance + FREE_AT_START, np.radians(np.arange(0, 360, 5))) != wants_turn:
            continue
        sensor_range = SensorRange.of(make_sensor(setup.sensor, 0))
        cell = PlanningCell(found, sensor_range, setup.cell.world.controller_cycle, work=Work(300.0, Gaps()))
        return kind, name, clearance, setup, cell
    raise RuntimeError(f"seed {seed}: no cell is free where it starts")


def _obstacles(nominal: NominalCell, opening: Array, rng: np.random.Generator) -> list[Body]:
    """A hook that hangs into or above the opening, posts beside the part, things on the table and in the arm's way."""
    world_from_part, material = nominal.world_from("part"), nominal.bodies[0].material
    made, side = [], float(rng.choice([0.0005, 0.002, 0.005, 0.012]))
    axis, part = nominal.world_from_table[:3, 3], nominal.part.vertices
    on_table = pose.transform_points(nominal.table_from_part, part)
    reach, top = float(np.hypot(*on_table[:, :2].T).max()), float(on_table[:, 2].max())
    (at,) = pose.transform_points(world_from_part, opening[None])
    if rng.random() < 0.3:  # on the axis: what turns around it may be concave
        at[:2] = axis[:2] + rng.uniform(-0.01, 0.01, 2)
    low = axis[2] + (rng.uniform(0.01, 0.9) * top if rng.random() < 0.6 else top + rng.uniform(0.001, 0.04))
    hook = [_box((at[0] - side, at[0] + side), (at[1] - side, at[1] + side), (low, low + 0.15))]
    if rng.random() < 0.3:
        hook.append(_box((at[0] - side, at[0] + 0.03), (at[1] - side, at[1] + side), (low, low + 0.006)))
    if rng.random() < 0.8:
        made.append(("hook", "world", _joined(hook, "hook")))
    for number in range(int(rng.integers(0, 3))):
        x, y = _around(axis, reach * rng.uniform(0.85, 1.6) + side, rng)
        post = _box((x - side, x + side), (y - side, y + side), (axis[2] + 0.008, axis[2] + rng.uniform(0.02, 0.13)))
        made.append((f"post{number + 1}", "world", _joined([post], "post")))
    if rng.random() < 0.4:
        x, y = _around(np.zeros(3), 0.09, rng)
        turning = _box((x - side, x + side), (y - side, y + side), (0.0, rng.uniform(0.01, 0.12)))
        made.append(("turning", "table", _joined([turning], "turning")))
    if rng.random() < 0.4:
        x, y = _around(axis, rng.uniform(0.14, 0.3), rng)
        tall = _box((x - 0.01, x + 0.01), (y - 0.01, y + 0.01), (0.0, axis[2] + rng.uniform(0.1, 0.5)))
        made.append(("tall", "world", _joined([tall], "tall")))
    if rng.random() < 0.25:
        wall = _box((-0.004, 0.004), (-rng.uniform(0.05, 0.2), rng.uniform(0.05, 0.2)), (0.0, rng.uniform(0.15, 0.4)))
        angle, distance = rng.uniform(0, 2 * np.pi), rng.uniform(0.14, 0.28)
        turn = pose.from_rotation(pose.rotation_about(2, angle), np.array([axis[0], axis[1], 0.0]))
        wall.apply_transform(turn @ pose.translation((distance, 0.0, 0.0)))
        made.append(("wall", "world", _joined([wall], "wall")))
    if rng.random() < 0.25:
        beam = _box((-0.3, 0.3), (-0.008, 0.008), (0.0, 0.016))
        turn = pose.from_rotation(pose.rotation_about(2, rng.uniform(0, np.pi)), axis)
        beam.apply_transform(turn @ pose.translation((0.0, rng.uniform(-0.15, 0.15), top + rng.uniform(0.03, 0.3))))
        made.append(("beam", "world", _joined([beam], "beam")))
    return [Body(name, frame, mesh, material) for name, frame, mesh in made]


def _around(axis: Array, radius: float, rng: np.random.Generator) -> Array:
    angle = rng.uniform(0, 2 * np.pi)
    return np.asarray(axis[:2] + radius * np.array([np.cos(angle), np.sin(angle)]))


def _is_obstacle(body: Body) -> bool:
    return body.name.startswith(_OBSTACLES)


def _keeps(nominal: NominalCell, margin: float, angles: Any) -> bool:
    """Whether obstacles and part keep the margin at all table angles (rad) of the home position, by python-fcl."""
    cell, bodies = Cell(nominal), nominal.bodies
    pairs = [
        (a, b)
        for a, b in combinations(range(len(bodies)), 2)
        if (_is_obstacle(bodies[a]) or _is_obstacle(bodies[b]))
        and bodies[a].moves_with != bodies[b].moves_with
        and {bodies[a].moves_with, bodies[b].moves_with} != {"part", "table"}
    ]
    index = np.array(pairs, np.int64).reshape(-1, 2)
    for angle in angles:
        poses = nominal.body_poses([*nominal.home, angle])
        for a, b in index[cell.near(poses[None], index, margin)[0]]:
            if cell.distance(poses, a, b) <= margin:
                return False
    return True


@dataclass
class Gaps(NullProgress):
    """The longest times between two chances to cancel, s, of the clock and of the processor, and where they are."""

    last: tuple[float, float] = (0.0, 0.0)
    longest: tuple[float, float] = (0.0, 0.0)
    place: str = ""
    _before: str = field(default="the beginning")

    def start(self) -> None:
        self.last, self.longest = (time.monotonic(), time.process_time()), (0.0, 0.0)

    def advance(self, steps: float) -> None:
        now = (time.monotonic(), time.process_time())
        here = " < ".join(
            f"{Path(f.filename).stem}.{f.name}:{f.lineno}"
            for f in traceback.StackSummary.extract(traceback.walk_stack(None), limit=5, lookup_lines=False)
            if Path(f.filename).stem not in ("work", "planner_campaign")
        )
        taken = (now[0] - self.last[0], now[1] - self.last[1])
        if taken[1] > self.longest[1]:
            self.place = f"{self._before} -> {here}"
        self.longest = (max(self.longest[0], taken[0]), max(self.longest[1], taken[1]))
        self.last, self._before = (time.monotonic(), time.process_time()), here


@dataclass
class Refusals:
    """Record of the views and motions that the planner refuses in one plan."""

    views: dict[str, tuple[Sweep | Pass, str]] = field(default_factory=dict)
    motions: list[tuple[Array, Array]] = field(default_factory=list)
    lost: float = 0.0

    @contextmanager
    def noted(self) -> Iterator[None]:
        """Note all refusals of the placement, motions that are not found, and the lost share."""
        connect, sweeps, passes, check = (
            Connector.connect, Placer.sweeps, Placer.passes, planner._check_loss,
        )  # fmt: skip

        def connecting(connector: Connector, start: Array, end: Array, purpose: str) -> list[Array]:
            try:
                return connect(connector, start, end, purpose)
            except PlanningError:
                self.motions.append((start, end))
                raise

        def sweeping(placer: Placer, views: Any) -> Any:
            return self._placed(views, sweeps(placer, views))

        def passing(placer: Placer, views: Any, *rest: Any) -> Any:
            return self._placed(views, passes(placer, views, *rest))

        def checking(wanted: Any, seen: Any, most: float, warnings: list[str]) -> None:
            self.lost = float((wanted & ~seen).mean() / max(wanted.mean(), 1e-12))
            check(wanted, seen, most, warnings)

        changed: Any = (Connector, Placer, planner)
        changed[0].connect, changed[1].sweeps, changed[1].passes = connecting, sweeping, passing
        changed[2]._check_loss = checking
        try:
            yield
        finally:
            changed[0].connect, changed[1].sweeps, changed[1].passes = connect, sweeps, passes
            changed[2]._check_loss = check

    def _placed(self, views: Any, found: Any) -> Any:
        for view, item in zip(views, found, strict=True):
            if isinstance(item, Infeasible):
                self.views[view.name] = (view, item.reason)
        return found

    def of_kind(self, kind: type) -> dict[str, tuple[Any, str]]:
        """Refused views of a kind whose reason is not the turn of the table, by name."""
        return {
            name: (view, reason)
            for name, (view, reason) in self.views.items()
            if isinstance(view, kind) and "cannot turn" not in reason
        }

    @property
    def turn(self) -> str:
        """Why the table cannot turn; empty if it can."""
        return next((reason for _, reason in self.views.values() if "cannot turn" in reason), "")

    def contradicted(self, plain: PlainPlanner, view_seconds: float, motion_seconds: float) -> tuple[int, list[str]]:
        """Number of refusals that were checked, and those that the plain planner contradicts."""
        checked, found = 0, []
        if self.turn:
            checked += 1
            found += [self.turn] if plain.turns() else []
        for kind, finds in ((Sweep, plain.finds_sweep), (Pass, plain.finds_pass)):
            for view, reason in list(self.of_kind(kind).values())[:_MOST_CHECKED]:
                checked += 1
                found += [reason] if finds(view, view_seconds) else []
        for start, end in self.motions[:_MOST_CHECKED]:
            checked += 1
            path = plain.finds_motion(start, end, motion_seconds)
            if path is not None:
                ends = [np.round(at, 4).tolist() for at in (start, end)]
                found.append(f"motion from {ends[0]} to {ends[1]} in {len(path)} pieces")
        return checked, found


def run_cell(
    seed: int, step: float = 2e-4, view_seconds: float = 2.0, motion_seconds: float = 8.0, profiles: int = 120
) -> Row:
    """Plan one cell and judge the plan at samples `step` (m) apart; the plain planner has its times for each refusal.

    All views may be lost, so that all are tried.
    """
    kind, name, clearance, setup, cell = make_cell(seed)
    options = scan_options(setup.scan.replace(max_profiles=profiles, max_lost_share=1.0), setup.sensor)
    refusals, gaps = Refusals(), cell.work._progress
    assert isinstance(gaps, Gaps)
    made, reason = None, ""
    gaps.start()
    start, processor = gaps.last
    try:
        with refusals.noted():
            made = plan(cell, options)
        reason = next((warning for warning in made.warnings if warning.startswith("omitted")), "")
    except PlanningError as error:
        reason = str(error)
    seconds, processor = time.monotonic() - start, time.process_time() - processor
    gaps.advance(0.0)
    errors = {
        body.name: ERROR_SHARE * clearance for body in cell.nominal.bodies if _is_obstacle(body) or body.name == "part"
    }
    judgement = None if made is None else judged(cell.nominal, made, step, errors)
    plain = PlainPlanner(cell.nominal, cell.range, clearance, MOTION_SHARE * clearance)
    checked, contradicted = refusals.contradicted(plain, view_seconds, motion_seconds)
    return Row(
        seed=seed,
        cell=name,
        kind=kind,
        clearance_mm=round(1e3 * clearance, 3),
        obstacles=" ".join(body.name for body in cell.nominal.bodies if _is_obstacle(body)),
        outcome="refused" if made is None else "planned",
        reason=reason,
        seconds=round(seconds, 2),
        processor_seconds=round(processor, 2),
        work=round(cell.work.spent, 2),
        longest_gap=round(gaps.longest[0], 2),
        processor_gap=round(gaps.longest[1], 2),
        gap=gaps.place,
        coverage=np.nan if made is None or made.coverage is None else round(made.coverage, 4),
        lost=round(refusals.lost, 3),
        segments=0 if made is None else len(made.program.segments),
        poses=0 if judgement is None else judgement.poses,
        contact="" if judgement is None else judgement.contact,
        margin_mm=np.nan if judgement is None else round(1e3 * judgement.margin, 5),
        turn=int(bool(refusals.turn)),
        sweeps=len(refusals.of_kind(Sweep)),
        passes=len(refusals.of_kind(Pass)),
        motions=len(refusals.motions),
        checked=checked,
        contradicted=" | ".join(contradicted),
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
    print(summary(done))


def summary(rows: list[dict[str, str]]) -> str:
    """Figures of all rows."""

    def total(key: str) -> int:
        return sum(int(row[key]) for row in rows)

    def most(key: str) -> float:
        return max(float(row[key]) for row in rows)

    planned = [row for row in rows if row["outcome"] == "planned"]
    turns = sum(row["turn"] == "0" for row in rows)
    late = sum(float(row["processor_seconds"]) > _ANSWER_S for row in rows)
    stuck = sum(float(row["processor_gap"]) > _CANCEL_S for row in rows)
    cells = ", ".join(f"{name} {count}" for name, count in sorted(Counter(row["cell"] for row in rows).items()))
    contradicted = [text for row in rows for text in row["contradicted"].split(" | ") if text]
    return (
        f"{len(rows)} cells ({cells}), the table turns in {turns}; {len(planned)} planned,"
        f" {sum(float(row['lost']) > 0.2 for row in rows)} of all lose more than a fifth of the surface\n"
        f"{total('poses')} poses judged, {sum(row['contact'] != '' for row in planned)} contacts, smallest margin"
        f" {min(float(row['margin_mm']) for row in planned):.5f} mm\n"
        f"refused: {total('turn')} turns, {total('sweeps')} sweeps, {total('passes')} passes, {total('motions')}"
        f" motions; {total('checked')} checked by the plain planner, {len(contradicted)} contradicted\n"
        f"longest answer {most('seconds'):.1f} s, {most('processor_seconds'):.1f} s of the processor ({late} over"
        f" {_ANSWER_S:.0f} s); longest time to a cancel {most('longest_gap'):.1f} s, {most('processor_gap'):.1f} s of"
        f" the processor ({stuck} over {_CANCEL_S:.0f} s)"
    )


if __name__ == "__main__":
    main()
