"""Coverage-driven choice of views: greedy by newly seen area per time, until a share of the measurable surface is seen.

Candidates are sweeps of the table at many elevations and offsets, and straight legs in all directions over what is not
seen yet. Each is scored by `Sight`: range, incidence, occlusion of the laser and of the cameras, of which one suffices.
What further sensors see meanwhile counts, too.
A candidate is chosen only if the arm can make it without collision and get there from its home position.

The seen area is a submodular function of the set of views: a view adds less the more is seen already. Greedy choice
therefore takes at most ``1 + ln(Q / (Q - f))`` times the least time to see the area Q, f being what is seen before the
last view (Wolsey, Combinatorica 2 (1982) 385), and sees with a number of views at least 1 - 1/e of the most that as
many views of equal time see (Nemhauser, Wolsey & Fisher, Mathematical Programming 14 (1978) 265). `least_time` is a
bound for the instance at hand, usually much closer: any set of candidates added to those
chosen so far adds no more than the sum of what each would add alone (Leskovec et al., KDD 2007, section 4).
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from scancell.arrays import Array, Flags, Indices
from scancell.config.description import si_value
from scancell.config.sensor import SensorDescription
from scancell.errors import PlanningError
from scancell.geometry import pose
from scancell.geometry.cad import CadMesh
from scancell.geometry.tree import WORLD
from scancell.nominal.cell import NominalCell
from scancell.planning.model import SIGHT, PlanningCell, Work, WorkLimitError
from scancell.planning.motion import trajectory
from scancell.planning.motion.connection import Stand, Stands
from scancell.planning.options import ScanOptions
from scancell.planning.views.features import FeatureGoals, FeatureOutlook, Goal, PointNoise, SeenShare
from scancell.planning.views.paths import sweeps, sweeps_beside_axis
from scancell.planning.views.placement import PATH_ACCELERATION, Infeasible, Placed, sweep_run
from scancell.planning.views.views import Pass, Shift, Surface, Sweep, Turn, View, exposure_counts
from scancell.values import Value
from scancell.visibility import (
    ANGLE_STEP,
    INCIDENCE_LIMIT,
    MeasurableSurface,
    SensorField,
    SensorOptics,
    SurfaceSearch,
    Tracer,
    measurable_surface,
    orientations,
)

Judgements = NDArray[np.int8]

# Why a view does not measure a sample, in the order of the checks.
OUT_OF_RANGE, GRAZING, OCCLUDED, SEEN = range(4)

_MOST_SAMPLES = 6000  # of the measurable surface
_LIFT = 2e-5  # m by which rays start above the surface
_MIN_COSINE = float(np.cos(INCIDENCE_LIMIT))

_TRIED = 1500  # poses of the sensor that are tried for each target
_HALF_LENGTH = 0.15  # m: longest leg to either side of its target
_GAP = 0.008  # m along a leg without unseen surface that ends it
_LEG_MARGIN = 1.5e-3  # m
_RANGES = (0.1, 0.35, 0.6)  # of the depth of field: where in the range targets are put

_ELEVATIONS = tuple(np.radians((0.0, 15.0, 30.0, 45.0, 60.0, 75.0)))
_TARGETS, _LEGS_EACH = 60, 8
_ROUNDS = 12  # of legs for what is not seen
_FRUITLESS = 3  # rounds without a gain after which the rest counts as invisible
_MOST_REFUSED = 60  # infeasible candidates in a row after which the others of a round are not tried
TRANSIT = 0.8  # s, about the time from one view to the next
_SEED = 0
CHOICE_SHARE = 0.7  # of the limit of work, after which no further views are chosen


class Sight:
    """Determines which samples of the measurable surface of a part views measure.

    Occluders are the part and all bodies that rest on the table; what stands beside the table, the arm and the housing
    of the sensor are not, as in the geometric engine the housing is not.

    Parameters
    ----------
    nominal
        Cell with the part, axes beside joints and table where they start.
    sensor
        Its sensor.
    measurable
        Finds the measurable surface; asked for once.
    threads
        0: all cores. Results do not depend on it.
    work
        Counts the judgements.
    most_samples
        Number of measurable samples that are judged at most.
    elsewhere
        The cell with these axes at other positions. What is measurable at any of them counts.
    beside
        The further sensors of the cell; None for one that does not expose at all triggers.
    noise
        Noise of points, for views that are chosen by deviations of features.
    """

    def __init__(
        self,
        nominal: NominalCell,
        sensor: SensorDescription,
        measurable: Callable[[NominalCell, SensorDescription], MeasurableSurface] = measurable_surface,
        threads: int = 0,
        work: Work | None = None,
        most_samples: int = _MOST_SAMPLES,
        elsewhere: Sequence[NominalCell] = (),
        beside: Sequence[SensorDescription | None] = (),
        noise: PointNoise | None = None,
    ) -> None:
        self.noise = noise
        self._most_samples, self._elsewhere, self._beside = most_samples, elsewhere, beside
        self._nominal, self._description, self._measurable = nominal, sensor, measurable
        self._threads, self._work = threads, work or Work()

    @cached_property
    def surface(self) -> MeasurableSurface:
        """The measurable surface."""
        found = [self._measurable(one, self._description) for one in (self._nominal, *self._elsewhere)]
        return found[0] if len(found) == 1 else found[0].together(found[1:])

    @cached_property
    def search(self) -> SurfaceSearch:
        """Search for poses that measure samples of the surface, with further axes where they start."""
        return self._search(self._nominal)

    def _search(self, nominal: NominalCell) -> SurfaceSearch:
        return SurfaceSearch(nominal, SensorField.of(self._description), len(self.surface.samples), self._threads)

    def with_axes_at(self, elsewhere: Sequence[NominalCell]) -> Sight:
        """The same with further axes at other positions, too."""
        cell, sensor, find = self._nominal, self._description, self._measurable
        limits = (self._threads, self._work, self._most_samples)
        return Sight(cell, sensor, find, *limits, elsewhere, self._beside, self.noise)

    def poses_of(self, judged: Indices, each: int) -> Array:
        """Poses (k, 4, 4) that measure some of the judged samples (n,), at most `each` of each, see `SurfaceSearch`.

        Where further axes start, and elsewhere for those that none there measures.
        """
        left, poses = self.rows[judged], [np.zeros((0, 4, 4))]
        for nominal in (self._nominal, *self._elsewhere):
            if len(left) or nominal is self._nominal:
                found, at = (self.search if nominal is self._nominal else self._search(nominal)).poses(left, each)
                poses.append(at)
                left = left[~np.isin(left, found)]
        return np.concatenate(poses)

    @cached_property
    def rows(self) -> Indices:
        """(n,) those of the samples of the surface that are judged: measurable ones, evenly chosen."""
        measurable = np.flatnonzero(self.surface.measurable)
        return measurable[:: max(1, -(-len(measurable) // self._most_samples))]

    @cached_property
    def points(self) -> Array:
        """(n, 3) judged samples in the frame of the table at angle 0, m, of equal area each."""
        return pose.transform_points(self._nominal.table_from_part, self.search.samples[self.rows])

    @cached_property
    def normals(self) -> Array:
        """(n, 3) their unit normals; of a mesh that is not closed either side counts."""
        return np.asarray(self.search.normals[self.rows] @ self._nominal.table_from_part[:3, :3].T)

    @cached_property
    def optics(self) -> SensorOptics:
        """Optics of the sensor."""
        return SensorOptics.of(self._description)

    @cached_property
    def _tracer(self) -> Tracer:
        return Tracer(self.search.obstacles, self._threads)

    def judge(self, view: View) -> Judgements:
        """(n,) result of each sample in the view: `SEEN`, or the last check that it passes at no crossing."""
        return self._judge(view, self.optics)

    def judge_beside(self, view: Sweep | Pass) -> Judgements:
        """(n,) the same by the further sensors meanwhile.

        Those that move as the sensor does, which may be rolled by half a turn: what they see either way counts. In
        sweeps also those in the world, past which the table turns the part.
        """
        best = np.full(len(self.points), OUT_OF_RANGE, np.int8)
        for optics, sensor_from_other in self._riding:
            ways: list[Judgements] = []
            for roll in (0.0, np.pi):
                moved = pose.from_rotation(pose.rotation_about(2, roll)) @ sensor_from_other
                along: Turn | Shift = (
                    Turn(view.at_azimuth_zero @ moved)
                    if isinstance(view, Sweep)
                    else Shift(view.start @ moved, view.end @ moved)
                )
                ways.append(self._judge(along, optics))
            best = np.maximum(best, np.minimum(*ways))
        return np.maximum(best, self._past_others) if isinstance(view, Sweep) else best

    @cached_property
    def _riding(self) -> list[tuple[SensorOptics, Array]]:
        """Optics of the further sensors that move as the sensor does, and their poses (4, 4) in its frame."""
        tree, described = self._nominal.tree, zip(self._nominal.further_sensors, self._beside, strict=False)
        moving, placed = tree.axes_of("sensor"), tree.place(self._nominal.start)
        return [
            (SensorOptics.of(sensor), pose.inverse(placed["sensor"]) @ placed[joint.frame])
            for joint, sensor in described
            if sensor is not None and tree.axes_of(joint.frame) == moving
        ]

    @cached_property
    def _past_others(self) -> Judgements:
        """(n,) what sensors in the world see of a part that the table turns, wherever further axes may rest."""
        best = np.full(len(self.points), OUT_OF_RANGE, np.int8)
        if self._nominal.support != "table" or not self._nominal.table_turns:
            return best
        for number, sensor in enumerate(self._beside):
            if sensor is None or self._nominal.further_sensors[number].parent != WORLD:
                continue
            cells = (self._nominal, *self._elsewhere)
            from_table = [
                pose.inverse(one.world_from_table) @ one.further_sensors[number].parent_from_joint for one in cells
            ]
            if np.allclose(from_table, from_table[0], atol=1e-9):
                best = np.maximum(best, self._judge(Turn(from_table[0]), SensorOptics.of(sensor)))
        return best

    def _judge(self, view: View | Turn | Shift, optics: SensorOptics) -> Judgements:
        best = np.full(len(self.points), OUT_OF_RANGE, np.int8)
        for table_from_sensor in view.crossings(self.points):
            rows = np.flatnonzero(np.isfinite(table_from_sensor[:, 0, 3]) & (best < SEEN))
            best[rows] = np.maximum(best[rows], self.judge_at(table_from_sensor[rows], rows, optics))
        return best

    def judge_at(self, table_from_sensor: Array, rows: Indices, optics: SensorOptics | None = None) -> Judgements:
        """(k,) the same for the samples `rows` (k,), each from a pose (k, 4, 4) with the sample in the laser sheet.

        `optics` are those of the sensor unless stated.
        """
        self._work.spend(SIGHT * len(rows))
        optics = optics or self.optics
        points, normals = self.points[rows], self.normals[rows]
        result = np.full(len(rows), OUT_OF_RANGE, np.int8)
        in_view = optics.contains(pose.transform_each(pose.inverse(table_from_sensor), points))
        places = np.concatenate([[[0.0, 0.0, optics.source_z]], optics.cameras])
        ends = np.einsum("nij,kj->nki", table_from_sensor[:, :3, :3], places) + table_from_sensor[:, None, :3, 3]
        rays = ends - points[:, None]
        if not self._nominal.part.is_closed:
            normals = np.where((rays[:, 0] * normals).sum(-1, keepdims=True) < 0, -normals, normals)
        cosine = np.einsum("nki,ni->nk", rays, normals) / np.linalg.norm(rays, axis=-1)
        facing = in_view & (cosine[:, :1] > _MIN_COSINE) & (cosine[:, 1:] > _MIN_COSINE)
        result[in_view.any(1)] = GRAZING
        result[facing.any(1)] = OCCLUDED
        lit = np.flatnonzero(facing.any(1))
        lifted = points + _LIFT * normals
        lit = lit[~self._tracer.blocked(lifted[lit], ends[lit, 0])]
        for camera in range(facing.shape[1]):
            asked = lit[facing[lit, camera] & (result[lit] < SEEN)]
            result[asked[~self._tracer.blocked(lifted[asked], ends[asked, 1 + camera])]] = SEEN
        return result


@dataclass(frozen=True)
class Leg:
    """A pass, and its result for each sample of the `Sight` (n,)."""

    view: Pass
    judged: Judgements


def legs(
    sight: Sight,
    wanted: Indices,
    targets: int,
    legs_each: int,
    rng: np.random.Generator,
    is_searched: bool = True,
) -> list[Leg]:
    """Passes over samples `wanted`, from poses that see randomly drawn targets among them.

    The poses are drawn at random from the orientations of the grid of the measurable surface, in steps of 15 degrees;
    for targets that none of them sees, the grid is searched. A pass extends to both sides of its target as long as it
    sees wanted samples.

    Parameters
    ----------
    targets
        Number of samples that are drawn.
    legs_each
        Largest number of passes for each.
    rng
        Random numbers.
    is_searched
        Whether the grid is searched, for poses that the arm reaches.
    """
    poses, hard = [np.zeros((0, 4, 4))], []
    for target in rng.choice(wanted, min(targets, len(wanted)), replace=False):
        tried = _poses_above(sight, target, rng)
        good = np.flatnonzero(sight.judge_at(tried, np.full(len(tried), target)) == SEEN)
        poses.append(tried[rng.choice(good, min(legs_each, len(good)), replace=False)])
        if not len(good):
            hard.append(target)
    if is_searched:
        poses.append(sight.poses_of(np.array(hard, np.int64), legs_each))
    made = (_leg(sight, at, wanted) for at in np.concatenate(poses))
    return [leg for leg in made if leg is not None]


def _poses_above(sight: Sight, target: int, rng: np.random.Generator) -> Array:
    """Random poses (k, 4, 4), k <= `_TRIED`, that have the target on the sensor's Z axis, above the table."""
    grid = orientations()
    turns = pose.rotation_about(2, ANGLE_STEP * rng.integers(round(2 * np.pi / ANGLE_STEP), size=_TRIED))
    rotation = turns @ grid[rng.integers(len(grid), size=_TRIED)]
    near, far = sight.optics.sensor.range
    distance = near + rng.choice(_RANGES, _TRIED) * (far - near)
    origin = sight.points[target] - distance[:, None] * rotation[:, :, 2]
    return np.asarray(pose.from_rotation(rotation, origin)[origin[:, 2] > 0])


def _leg(sight: Sight, at: Array, wanted: Indices) -> Leg | None:
    """The pass through a pose (4, 4) as long as it sees wanted samples."""
    reach = _pass(at, -_HALF_LENGTH, _HALF_LENGTH)
    judged = sight.judge(reach)
    along = (sight.points - at[:3, 3]) @ at[:3, 0]
    useful = np.sort(along[wanted[judged[wanted] == SEEN]])
    if not len(useful):
        return None
    # The target itself lies at 0; the run of neighbours without a large gap around it.
    gaps = np.flatnonzero(np.diff(useful) > _GAP)
    low = useful[gaps[useful[gaps + 1] <= 0] + 1].max(initial=useful[0])
    high = useful[gaps[useful[gaps] >= 0]].min(initial=useful[-1])
    low, high = float(low) - _LEG_MARGIN, float(high) + _LEG_MARGIN
    return Leg(_pass(at, low, high), np.where((along >= low) & (along <= high), judged, 0).astype(np.int8))


def _pass(at: Array, low: float, high: float) -> Pass:
    ends = [at @ pose.translation((x, 0.0, 0.0)) for x in (low, high)]
    x, y, z = 1e3 * (ends[0][:3, 3] + ends[1][:3, 3]) / 2
    elevation = float(np.degrees(np.arcsin(-at[2, 2].clip(-1, 1))))
    return Pass(
        f"leg at {elevation:.0f} deg, {1e3 * (high - low):.0f} mm, sensor at ({x:.0f}, {y:.0f}, {z:.0f}) mm", *ends
    )


@dataclass(frozen=True, eq=False, repr=False)
class CoverageReport(Value):
    """Share of the measurable surface that the chosen views see, and bounds on the quality of the choice.

    Attributes
    ----------
    share
        Seen share of the measurable surface, 0 … 1.
    measurable_area
        m²
    views, candidates
        Number of chosen views and of candidates.
    time
        Duration of the chosen views, s, with an estimate of the motions in between.
    least_time
        No choice of the candidates sees the same share in less, s.
    greedy_factor
        Bound of the chosen views' time over the least time (Wolsey).
    unseen
        Share of the measurable surface that is not seen, by the reason.
    features
        Predictions for the features that the scan names.
    """

    share: float
    measurable_area: float
    views: int
    candidates: int
    time: float
    least_time: float
    greedy_factor: float
    unseen: dict[str, float]
    features: tuple[FeatureOutlook, ...] = ()


@dataclass(frozen=True)
class Candidate:
    """A view, the samples of the `Sight` that it sees (n,), its time, s, and its number of exposures."""

    view: Sweep | Pass
    seen: Flags
    time: float
    count: int


@dataclass
class _Pool:
    """Candidates: what they see (c, n), their time (c,), and why they are infeasible ("": not known to be)."""

    views: list[Sweep | Pass] = field(default_factory=list)
    seen: list[Flags] = field(default_factory=list)
    time: list[float] = field(default_factory=list)
    obstacle: list[str] = field(default_factory=list)

    def add(self, one: Candidate) -> None:
        self.views.append(one.view)
        self.seen.append(one.seen)
        self.time.append(one.time)
        self.obstacle.append("")

    @property
    def has_legs(self) -> bool:
        """Whether there is any pass."""
        return any(isinstance(view, Pass) for view in self.views)

    @property
    def feasible(self) -> Indices:
        """Numbers of the candidates that are not known to be infeasible."""
        return np.flatnonzero([not reason for reason in self.obstacle])


class CoveragePlanner:
    """Chooses views of a part.

    Parameters
    ----------
    cell
        Nominal cell, or the stands at which axes beside joints and table may rest in it.
    sight
        Judges what views see.
    options
        Options of the scan; `sweep` and `raster` state which kinds of views are allowed, and their speeds.
    given
        Candidates that are chosen from in place of those of a search; see `candidates`.
    """

    def __init__(
        self, cell: PlanningCell | Stands, sight: Sight, options: ScanOptions, given: Sequence[Candidate] = ()
    ) -> None:
        self._stands = cell if isinstance(cell, Stands) else Stands(cell, options)
        self._order = [*self._stands.candidates]  # those that views were placed at come first
        if len(self._order) > 1:
            sight = sight.with_axes_at([stand.cell.nominal for stand in self._order[1:]])
        self._cell, self._sight, self._options = self._stands.cell, sight, options
        self._wish, self._sweep, self._raster = options.scan.coverage, options.scan.sweep, options.scan.raster
        self._best = np.full(len(sight.points), OUT_OF_RANGE, np.int8)
        self._given, self._pool = given, _Pool()
        self._chosen: dict[int, Placed] = {}  # by the number of the candidate
        self._branch: int | None = None  # that of the first view, which others prefer
        self.covered = np.zeros(len(sight.points), bool)
        self._goal: Goal = SeenShare(self._wish.share, len(sight.points))
        if self._wish.feature:
            part, rows, search = self._cell.nominal.part, sight.rows, sight.search
            assert isinstance(part, CadMesh) and sight.noise is not None  # as the pipeline checks
            own = (search.samples[rows], search.normals[rows], sight.points)
            self._goal = FeatureGoals(part, *own, self._wish.feature, sight.noise)

    def choose(self, part: Surface, max_profiles: int) -> tuple[list[tuple[Placed, int]], CoverageReport]:
        """Placed views with their numbers of exposures, at most `max_profiles` in total; see `select`.

        Raises `PlanningError` if there are too few exposures.
        """
        report = self.select(part)
        views = [self._pool.views[i] for i in self._chosen]
        counts = exposure_counts(views, self._options.spacing, max_profiles)
        result = []
        for number, view, count in zip(self._chosen, views, counts, strict=True):
            placed = self._chosen[number] if count == self._count(view) else self._place(view, count)
            if isinstance(placed, Infeasible):
                raise PlanningError(f"{placed.reason}, with {count} exposures")
            result.append((placed, count))
        return result, report

    def select(self, part: Surface) -> CoverageReport:
        """Choose views of the part, which lies on the table; `covered` (n,) are the samples of `Sight` that they see.

        Raises `PlanningError` if nothing of the part is measurable, or no view of it is feasible.
        """
        if not len(self._sight.points):
            raise PlanningError("nothing of the part is measurable: no pose that the arm reaches sees its surface")
        for candidate in self._given:
            self._take(candidate)
        if not self._given:
            self._search(part)
        self._extend()
        if not self._chosen:
            reasons = sorted({reason for reason in self._pool.obstacle if reason})
            unseen = "none sees its surface; see scan.sweep.standoff_mm"
            raise PlanningError(f"no feasible view of the part: {reasons[0] if reasons else unseen}")
        self._drop_redundant()
        return self._report()

    def _search(self, part: Surface) -> None:
        """Add sweeps and rounds of legs, and choose views as soon as these together are enough."""
        self._cell.work.doing = self._reached("judging sweeps")
        self._add_sweeps(part)
        fruitless, rng = 0, np.random.default_rng(_SEED)
        for _ in range(_ROUNDS if self._raster.enabled else 1):
            # Greedy choice is better from candidates that together see enough.
            is_enough = self._is_possible()
            wanted = ~self.covered if is_enough or not self._pool.has_legs else ~self._possible()
            before = int(self._possible().sum() + self.covered.sum())
            self._cell.work.doing = self._reached("judging passes")
            if self._raster.enabled and wanted.any():
                for leg in legs(self._sight, np.flatnonzero(wanted), _TARGETS, _LEGS_EACH, rng):
                    self._add(leg.view, leg.judged)
            if self._is_possible():
                self._extend()
            fruitless = fruitless + 1 if self._possible().sum() + self.covered.sum() == before else 0
            if self._is_done() or fruitless == _FRUITLESS:
                return

    def candidates(self, part: Surface, rounds: int, is_searched: bool) -> list[Candidate]:
        """Views of the part whether or not the arm reaches them: those that `select` searches.

        Legs come from at most some `rounds`; `is_searched` is that of `legs`.
        """
        self._add_sweeps(part)
        rng = np.random.default_rng(_SEED)
        for _ in range(rounds if self._raster.enabled else 0):
            wanted = np.flatnonzero(~self._possible() if self._pool.has_legs else ~self.covered)
            for leg in legs(self._sight, wanted, _TARGETS, _LEGS_EACH, rng, is_searched):
                self._add(leg.view, leg.judged)
            if self._is_possible():
                break
        found = zip(self._pool.views, self._pool.seen, self._pool.time, strict=True)
        return [Candidate(view, seen, time, self._count(view)) for view, seen, time in found]

    def _add_sweeps(self, part: Surface) -> None:
        if self._sweep.enabled:
            range_, nothing = self._cell.range, np.zeros(len(part.points), bool)
            beside = sweeps_beside_axis(part, range_, self._options, _ELEVATIONS, nothing, self._cell.work)
            for view in (*sweeps(part, range_, self._options, _ELEVATIONS), *beside):
                self._add(view, self._sight.judge(view))

    def _possible(self) -> Flags:
        """(n,) samples that some candidate sees that is not known to be infeasible."""
        feasible = [seen for seen, reason in zip(self._pool.seen, self._pool.obstacle, strict=True) if not reason]
        return np.asarray(np.any(feasible, axis=0)) if feasible else np.zeros(len(self.covered), bool)

    def _is_possible(self) -> bool:
        """Whether all candidates that are not known to be infeasible meet the goal together."""
        return self._goal.shortfall(self._pool.feasible) == 0

    def _drop_redundant(self) -> None:
        """Drop views without which the goal is met as well, those that take longest first."""
        before, chosen = self._goal.shortfall(self._chosen), list(self._chosen)
        for number in sorted(chosen, key=lambda i: -self._pool.time[i]):
            rest = [i for i in self._chosen if i != number]
            if rest and self._goal.shortfall(rest) <= before:
                del self._chosen[number]
        self.covered = np.any([self._pool.seen[i] for i in self._chosen], axis=0)

    def _add(self, view: Sweep | Pass, judged: Judgements) -> None:
        judged = np.maximum(judged, self._sight.judge_beside(view))
        self._best = np.maximum(self._best, judged)
        if (judged == SEEN).any():
            self._take(Candidate(view, judged == SEEN, self._time(view), self._count(view)))

    def _take(self, one: Candidate) -> None:
        self._pool.add(one)
        self._goal.add(one.view, one.seen, one.count)

    def _time(self, view: Sweep | Pass) -> float:
        count = self._count(view)
        if isinstance(view, Sweep):
            run = sweep_run(self._cell, count, si_value(self._sweep, "speed_deg_s"))
        else:
            step, speed = view.length / (count - 1), si_value(self._raster, "speed_mm_s")
            run = trajectory.run(count, step, speed, PATH_ACCELERATION, self._cell.cycle)
        return TRANSIT + run.duration

    def _count(self, view: Sweep | Pass) -> int:
        return exposure_counts([view], self._options.spacing, sys.maxsize)[0]

    def _is_done(self) -> bool:
        # The rest of the work is for the motions between views.
        is_work_spent = self._cell.work.spent > CHOICE_SHARE * self._cell.work.limit
        return bool(
            self._goal.shortfall(self._chosen) == 0
            or len(self._chosen) >= self._wish.max_views
            or self._spent() >= self._wish.max_time_s
            or (self._chosen and is_work_spent)
        )

    def _spent(self) -> float:
        return float(sum(self._pool.time[i] for i in self._chosen))

    def _extend(self) -> None:
        """Choose candidates until the goal is met, the budget is used, or none adds anything."""
        time, refused = np.array(self._pool.time), 0
        while self._pool.views and not self._is_done() and refused < _MOST_REFUSED:
            gain = self._goal.gains(self._chosen)
            gain[[bool(reason) for reason in self._pool.obstacle]] = 0
            gain[list(self._chosen)] = 0
            gain[time > self._wish.max_time_s - self._spent()] = 0
            best = int(np.argmax(gain / time))
            if gain[best] < min(self._goal.least_gain, self._goal.shortfall(self._chosen)):
                return
            view = self._pool.views[best]
            self._cell.work.doing = self._reached(f"trying {view.name}")
            placed = self._place(view, self._count(view))
            if isinstance(placed, Infeasible):
                self._pool.obstacle[best] = placed.reason
                refused += 1
                continue
            refused = 0
            self._branch = placed.branch if self._branch is None else self._branch
            self._chosen[best] = placed
            self.covered |= self._pool.seen[best]

    def _place(self, view: Sweep | Pass, count: int) -> Placed | Infeasible:
        """The view at the first stand where it is feasible, those in use first; else why it is not at the first."""
        found: list[Placed | Infeasible] = []
        for number, stand in enumerate(self._order):
            found.append(self._place_at(stand, view, count))
            if not isinstance(found[-1], Infeasible):
                used = len({placed.further for placed in self._chosen.values()} | {self._order[0].positions})
                if number >= used:
                    self._order.insert(used, self._order.pop(number))
                return found[-1]
        return found[0]

    def _place_at(self, stand: Stand, view: Sweep | Pass, count: int) -> Placed | Infeasible:
        """The placed view, if the arm also gets there from its home position, and back."""
        placed: Placed | Infeasible
        if isinstance(view, Sweep):
            (placed,) = stand.placer.sweeps([view])
        else:
            (placed,) = stand.placer.passes([view], [count], si_value(self._raster, "speed_mm_s"), self._branch)
        if isinstance(placed, Infeasible):
            return placed
        (start, end), home = placed.ends, self._cell.nominal.home
        try:
            stand.connector.connect(np.append(home, start[-1]), start, view.name)
            stand.connector.connect(end, np.append(home, end[-1]), view.name)
        except WorkLimitError:
            raise
        except PlanningError as error:
            return Infeasible(str(error))
        return replace(placed, further=stand.positions)

    def _reached(self, doing: str) -> str:
        seen = 100 * float(self.covered.mean())
        return f"{doing}; {len(self._chosen)} views that see {seen:.1f} % of the measurable surface were chosen"

    def _report(self) -> CoverageReport:
        seen, time = np.array(self._pool.seen), np.array(self._pool.time)
        possible = np.array([not reason for reason in self._pool.obstacle])
        goal = int(self.covered.sum())
        covered = np.zeros(len(self.covered), bool)
        least, before = 0.0, 0
        for i in (*self._chosen, None):
            least = max(
                least, _least_time((seen & ~covered).sum(1)[possible], time[possible], goal - int(covered.sum()))
            )
            if i is None:
                break
            before = int(covered.sum())
            covered |= seen[i]
        rest = ~self.covered
        by_others = (seen & ~possible[:, None]).any(0)
        reasons = {
            "share reached, budget used, or a view would add too little": rest & (seen & possible[:, None]).any(0),
            "only from views that collide or are out of reach": rest & by_others,
            "occluded": rest & (self._best == OCCLUDED),
            "at grazing incidence": rest & (self._best == GRAZING),
            "out of range": rest & (self._best == OUT_OF_RANGE),
        }
        unseen, explained = {}, ~rest
        for reason, where in reasons.items():
            if (where & ~explained).any():
                unseen[reason] = float((where & ~explained).mean())
            explained = explained | where
        surface = self._sight.surface
        return CoverageReport(
            share=float(self.covered.mean()),
            measurable_area=surface.area * surface.measurable_fraction,
            views=len(self._chosen),
            candidates=len(self._pool.views),
            time=self._spent(),
            least_time=least,
            greedy_factor=float(1 + np.log(goal / max(goal - before, 1))),
            unseen=unseen,
            features=self._outlooks(),
        )

    def _outlooks(self) -> tuple[FeatureOutlook, ...]:
        if not isinstance(self._goal, FeatureGoals):
            return ()
        return self._goal.outlooks(self._chosen, self._pool.feasible)


def _least_time(gain: Indices, time: Array, goal: int) -> float:
    """Least time in which candidates add `goal` samples if none sees what another does: a fractional knapsack."""
    order = np.argsort(-gain / time)
    total, spent = np.cumsum(gain[order]), np.cumsum(time[order])
    if goal <= 0 or not len(total) or total[-1] < goal:
        return 0.0
    last = int(np.searchsorted(total, goal))
    excess = (total[last] - goal) / max(gain[order][last], 1)
    return float(spent[last] - excess * time[order][last])
