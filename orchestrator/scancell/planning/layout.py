"""Layouts of a cell: where table, base of the arm and sensor should stand for the shortest scan of given parts.

A layout is a cell description in which some numbers are varied between bounds. A low-discrepancy sample of them is
screened: planned from candidates of views that are searched once for all. The best few are planned in full.

Layouts are ranked by `ranking`: those that scan nearly as much as the best one by time, the others by what they scan.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from scancell.arguments import Within
from scancell.arrays import Array, Flags
from scancell.config.cell import CellDescription
from scancell.config.description import checked
from scancell.config.files import plain_data, set_value, split_path, toml_text
from scancell.config.sensor import SensorDescription
from scancell.errors import CellError, DescriptionError, PlanningError
from scancell.geometry import pose
from scancell.geometry.mesh import Mesh
from scancell.nominal.cell import NominalCell, nominal_cell
from scancell.planning.model import PlanningCell, SensorRange, Work, join_reasons
from scancell.planning.options import ScanOptions
from scancell.planning.path_map.configuration_map import arm_metric
from scancell.planning.plan import Plan
from scancell.planning.planner import plan
from scancell.planning.views.coverage import Candidate, CoveragePlanner, Sight
from scancell.planning.views.placement import MIN_METRIC
from scancell.planning.views.views import Pass, Sweep, sample_part
from scancell.progress import Progress
from scancell.values import Result, Value
from scancell.visibility import unknown_surface

Ranges = Mapping[str, tuple[float, float]] | Sequence[str]
"""Bounds by key of the cell description: ``{"table.pose.x_mm": (300, 700)}``, or words ``table.pose.x_mm=300:700``."""

# Keys that are varied by default, as far as the cell has them, and by how much below and above their present values.
# Table and arm need not both move for their relative position: the table moves, and the arm turns on its base.
DEFAULT_RANGES = {
    "table.pose.x_mm": (-150.0, 150.0),
    "table.pose.y_mm": (-200.0, 200.0),
    "table.pose.z_mm": (-100.0, 150.0),
    "robot.base.rz_deg": (-45.0, 45.0),
    "tool.fixture.reach_mm": (0.0, 60.0),
    "tool.fixture.tilt_deg": (-30.0, 30.0),
    "tool.flange_from_sensor.z_mm": (0.0, 60.0),
    "tool.flange_from_sensor.ry_deg": (-30.0, 30.0),
}

Samples = Annotated[int, Within(1, 100_000)]
Plans = Annotated[int, Within(1, 1000)]

WORTH = 0.01
"""Share of the surface by which layouts may differ to count as equal in coverage."""

MOST_CLEARANCE = 0.1  # m, up to which distances are stated
_DIGITS = 3  # of proposed values, in the units of their keys
_TRIES = 10  # layouts that are tried for each that is planned
_SAMPLES = 1500  # of the surface, for screening
_ROUNDS = 2  # of passes
_WORK = 30.0  # limit of the work of screening one part in a layout
# Views of a part for its reach, table angles of each, and poses along each, by closed form and by numerical solution.
_REACH = {True: (80, 24, 2), False: (24, 8, 1)}

PlanScan = Callable[[CellDescription, Mesh], tuple[Plan, float]]
"""Plan of a part in a cell, and the smallest distance between bodies in it, m; raises `ScancellError`."""


@dataclass(frozen=True, eq=False, repr=False)
class LayoutScan(Value):
    """The scan of one part in a layout.

    Attributes
    ----------
    part
        Name of the part.
    reach
        Share of the views for screening that the arm reaches.
    measurable, scanned
        Shares of the whole surface that the sensor can measure, and that the planned views see.
    clearance
        Smallest distance between bodies during the plan, m; links of the arm are not compared with one another.
    plan
        The plan.
    """

    part: str
    reach: float
    measurable: float
    scanned: float
    clearance: float
    plan: Plan

    @property
    def time(self) -> float:
        """Duration of the planned motions, s."""
        return self.plan.program.duration

    @property
    def middle(self) -> Array:
        """Joints and table angle (axes,) in the middle of the exposures, rad."""
        return np.asarray(self.plan.axes[len(self.plan.axes) // 2])

    @property
    def figures(self) -> dict[str, Any]:
        """Figures of the scan, plain data."""
        return {
            "part": self.part,
            "reach": self.reach,
            "measurable": self.measurable,
            "scanned": self.scanned,
            "clearance_mm": 1e3 * self.clearance,
            "time_s": self.time,
        }


@dataclass(frozen=True, eq=False, repr=False)
class Layout(Value):
    """A layout and the scans of all parts in it.

    Attributes
    ----------
    name
        ``layout_1`` … by rank, or ``present``.
    cell
        The whole cell.
    values
        Values of the varied keys, in their units.
    scans
        A scan of each part; empty where one cannot be planned.
    problem
        Why there are none.
    """

    name: str
    cell: CellDescription
    values: dict[str, float]
    scans: tuple[LayoutScan, ...]
    problem: str = ""

    @property
    def time(self) -> float:
        """Sum of the durations of all scans, s; infinite without scans."""
        return sum(scan.time for scan in self.scans) if self.scans else np.inf

    @property
    def scanned(self) -> float:
        """Least share of the surface of a part that is scanned."""
        return min((scan.scanned for scan in self.scans), default=0.0)

    @property
    def facts(self) -> list[str]:
        """Main figures as short texts, or that there are none."""
        if not self.scans:
            return ["cannot be planned"]
        clearance = min(scan.clearance for scan in self.scans)
        return [
            f"{100 * self.scanned:.1f} % scanned",
            f"{self.time:.1f} s",
            f"clearance {1e3 * clearance:.1f} mm" if clearance < MOST_CLEARANCE else "",
        ]

    @property
    def settings(self) -> dict[str, float]:
        """The varied values as settings of a `Scanner` with the present cell, or of ``--set``."""
        return {f"cell.{key}": value for key, value in self.values.items()}

    @property
    def toml(self) -> str:
        """The whole cell in TOML."""
        return toml_text(self.cell.model_dump(exclude_defaults=True))

    @property
    def figures(self) -> dict[str, Any]:
        """Values and figures, of the worst part but for the time, which is the sum; None without scans."""
        parts = [scan.figures for scan in self.scans]
        worst = {
            key: min((part[key] for part in parts), default=None)
            for key in ("reach", "measurable", "scanned", "clearance_mm")
        }
        return {
            "name": self.name,
            "values": dict(self.values),
            **worst,
            "time_s": self.time if parts else None,
            "parts": parts,
            **({"problem": self.problem} if self.problem else {}),
        }


@dataclass(frozen=True, eq=False, repr=False)
class Layouts(Result):
    """Proposed layouts beside the present one.

    Attributes
    ----------
    chosen
        Proposed layouts, the best one first.
    present
        The layout of the cell as described.
    bounds
        Lower and upper bound of each varied key.
    samples
        Number of layouts that were screened.
    refused
        Number of layouts that cannot be, or cannot scan the parts, by the reason.

    Examples
    --------
    >>> part = scancell.box_mesh((0.05, 0.03, 0.02))
    >>> found = scancell.layout(part, ["table.pose.x_mm=350:550"], samples=8, plans=1, settings={
    ...     "scan.raster.enabled": False, "scan.coverage.share": 0.5})
    >>> sorted(layout.name for layout in found.ranked), 350 <= found.chosen[0].values["table.pose.x_mm"] <= 550
    (['layout_1', 'present'], True)
    """

    chosen: tuple[Layout, ...]
    present: Layout
    bounds: dict[str, tuple[float, float]]
    samples: int
    refused: dict[str, int]

    @property
    def ranked(self) -> tuple[Layout, ...]:
        """All layouts, the present one among them, the best one first; see `ranking`."""
        return _ranked((*self.chosen, self.present))

    @property
    def figures(self) -> dict[str, Any]:
        """Bounds, and values and figures of all layouts by rank."""
        return {
            "bounds": {key: list(bounds) for key, bounds in self.bounds.items()},
            "screened": self.samples,
            "refused": dict(self.refused),
            "layouts": [layout.figures for layout in self.ranked],
        }

    def summary(self) -> str:
        """Table of the layouts by rank, as lines of text."""
        count = sum(self.refused.values())
        refused = f", {join_reasons(f'{count} cannot be planned', [*self.refused])}" if count else ""
        keys = [*self.bounds]
        rows = [["layout", "scanned", "measurable", "reach", "clearance", "time", *keys]]
        for layout in self.ranked:
            values = [f"{layout.values[key]:.6g}" if key in layout.values else "-" for key in keys]
            rows.append([layout.name, *_cells(layout.figures), *values])
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        table = ["  ".join(cell.rjust(width) for cell, width in zip(row, widths, strict=True)) for row in rows]
        problem = [f"present: {self.present.problem}"] if self.present.problem else []
        title = f"{self.samples} layouts screened, {len(self.chosen)} planned in full{refused}"
        return "\n".join([title, *(f"  {line}" for line in [*table, *problem])])


def _cells(figures: Mapping[str, Any]) -> list[str]:
    """Texts of the figures of a layout."""
    if figures["time_s"] is None:
        return ["-"] * 5
    shares = [f"{100 * figures[key]:.1f} %" for key in ("scanned", "measurable", "reach")]
    clearance = figures["clearance_mm"]
    shown = f"{clearance:.1f} mm" if clearance < 1e3 * MOST_CLEARANCE else f"> {1e3 * MOST_CLEARANCE:g} mm"
    return [*shares, shown, f"{figures['time_s']:.1f} s"]


def ranking(scanned: Sequence[float], time: Sequence[float]) -> list[int]:
    """Numbers of layouts, the best first: those that scan within `WORTH` of the most by time, others by what they scan.

    `scanned` are shares of the surface, `time` durations, s.
    """
    enough = max(scanned, default=0.0) - WORTH

    def key(number: int) -> tuple[bool, float]:
        is_less = scanned[number] < enough
        return is_less, -scanned[number] if is_less else time[number]

    return sorted(range(len(scanned)), key=key)


def _ranked(layouts: Sequence[Layout]) -> tuple[Layout, ...]:
    order = ranking([layout.scanned for layout in layouts], [layout.time for layout in layouts])
    return tuple(layouts[number] for number in order)


def layout_bounds(cell: CellDescription, vary: Ranges) -> dict[str, tuple[float, float]]:
    """Bounds of the varied keys, in the units of the keys; without any, those of `DEFAULT_RANGES`.

    Raises `DescriptionError` if a word is no range, a range is empty, or the cell is not valid with one of the keys at
    either bound.
    """
    if isinstance(vary, str):
        raise DescriptionError(repr(vary), key="vary", expected="a mapping or a list of KEY=LOW:HIGH words")
    words = [f"{key}={low}:{high}" for key, (low, high) in vary.items()] if isinstance(vary, Mapping) else [*vary]
    if not words:
        return _default_bounds(cell)
    bounds: dict[str, tuple[float, float]] = {}
    for word in words:
        key, low, high = _range(word)
        if key in bounds:
            raise DescriptionError(f"{key} is given twice", key="vary", value=word, expected="one range for each key")
        bounds[key] = low, high
        for value in bounds[key]:
            with_values(cell, {key: value}, f"`vary` {word}")
    return bounds


def _range(word: str) -> tuple[str, float, float]:
    key, _, text = (part.strip() for part in word.partition("="))
    try:
        low, high = map(float, text.split(":"))
    except ValueError:
        low, high = np.nan, np.nan
    if not key or not np.isfinite([low, high]).all():
        expected = "KEY=LOW:HIGH with two numbers, such as table.pose.x_mm=300:700"
        raise DescriptionError(key="vary", value=word, expected=expected)
    if not low < high:
        problem = f"the range of {key} is empty"
        raise DescriptionError(problem, key="vary", value=word, expected="LOW below HIGH; --set fixes a value")
    return key, low, high


def _default_bounds(cell: CellDescription) -> dict[str, tuple[float, float]]:
    bounds = {}
    for key, (below, above) in DEFAULT_RANGES.items():
        present = value_at(cell, key)
        if present is None:
            continue
        try:
            for offset in (below, above):
                with_values(cell, {key: present + offset}, key)
        except DescriptionError:  # such as an angle of XYZ' where the pose has yaw, pitch and roll
            continue
        bounds[key] = present + below, present + above
    return bounds


def value_at(cell: CellDescription, key: str) -> float | None:
    """Number at a key of the cell; None if the table of the key is not described, or has no such value."""
    node: Any = cell
    for part in split_path(key):
        if isinstance(part, int):
            node = node[part] if isinstance(node, tuple) and part < len(node) else None
        else:
            node = getattr(node, part, None)
    return float(node) if isinstance(node, int | float) else None


def with_values(cell: CellDescription, values: Mapping[str, float], source: str) -> CellDescription:
    """The cell with other numbers at some keys; `DescriptionError` naming `source` if it is not valid."""
    raw = plain_data(cell)
    for key, value in values.items():
        set_value(raw, split_path(key), value, source)
    return checked(CellDescription, raw, source)


@dataclass(frozen=True)
class Views:
    """Candidates of the views of a part, which are the same in all layouts.

    `targets` (c, a, k, 4, 4) are the poses ``table_from_sensor`` of some of them at several table angles or azimuths.
    """

    sight: Sight
    candidates: Sequence[Candidate]
    targets: Array


@dataclass(frozen=True)
class Screened:
    """Estimates for all parts in a layout: worst share `scanned`, sum of `time`, s, or the `problem` of a part."""

    scanned: float
    time: float
    problem: str = ""


class LayoutPlanner:
    """Proposes layouts.

    Parameters
    ----------
    cell
        The cell as described.
    sensor, sensor_range
        Description and measuring range of the sensor.
    options
        Options of the scan; its views are chosen by coverage.
    sight
        Judges what views of a part see in the cell as described.
    plan_scan
        Plans the scan of a part in another cell.
    parts
        Meshes of the parts.
    threads
        0: all cores. Results do not depend on it.
    """

    def __init__(
        self,
        cell: CellDescription,
        sensor: SensorDescription,
        sensor_range: SensorRange,
        options: ScanOptions,
        sight: Callable[[Mesh], Sight],
        plan_scan: PlanScan,
        parts: Sequence[Mesh],
        progress: Progress,
        threads: int = 0,
    ) -> None:
        self._cell, self._sensor, self._range, self._options = cell, sensor, sensor_range, options
        self._sight, self._plan, self._parts, self._threads = sight, plan_scan, parts, threads
        self._progress, self._work = progress, Work(progress=progress)
        # What is planned in full is verified.
        self._screening = replace(options, scan=options.scan.model_copy(update={"verify": False}))
        progress.stage("views", len(parts), "parts")
        self._views = [self._views_of(part) for part in parts]

    def propose(self, bounds: Mapping[str, tuple[float, float]], samples: int, plans: int, seed: int) -> Layouts:
        """The best `plans` of `samples` layouts within the bounds, beside the present one.

        Raises `PlanningError` if no layout can scan all parts, naming what limits it; `DescriptionError` if the cell is
        not valid at a sample.
        """
        values = sampled(bounds, samples, seed)
        self._progress.stage("screening", samples, "layouts")
        screened = []
        for at in values:
            screened.append(self.screen(at))
            self._progress.advance(1)
        order = ranking([one.scanned for one in screened], [one.time for one in screened])
        order = [number for number in order if not screened[number].problem]
        self._progress.stage("planning", 1 + plans, "layouts")
        here = {key: value_at(self._cell, key) for key in bounds}
        present = self.planned("present", {key: value for key, value in here.items() if value is not None})
        self._progress.advance(1)
        made: list[Layout] = []
        reasons: list[str] = []
        for number in order[: _TRIES * plans]:
            found = self.planned("", values[number])
            if found.problem:
                reasons.append(found.problem)
                continue
            made.append(found)
            self._progress.advance(1)
            if len(made) == plans:
                break
        if not made:
            left_out = [one.problem for one in screened if one.problem]
            title = f"no layout within the bounds can scan the parts: {len(left_out)} of {samples} by screening"
            tried = f", {len(reasons)} others when planned in full" if reasons else ""
            raise PlanningError(join_reasons(title + tried, sorted({*reasons, *left_out})))
        chosen = tuple(
            # Deviations that calibration found are those of the cell as it stands.
            replace(one, name=f"layout_{rank}", cell=one.cell.model_copy(update={"estimated": None}))
            for rank, one in enumerate(_ranked(made), 1)
        )
        return Layouts(chosen, present, dict(bounds), samples, dict(Counter(reasons)))

    def screen(self, values: Mapping[str, float]) -> Screened:
        """Estimates at values of keys: of plans from the views that are the same in all layouts.

        Raises `DescriptionError` if the cell is not valid there.
        """
        described, scanned, time = self._at(values), [], 0.0
        for part, views in zip(self._parts, self._views, strict=True):
            try:
                work = Work(min(_WORK, self._options.scan.max_planning_work), self._progress)
                cell = self._planning_cell(nominal_cell(described, part), work)
                if not reached(cell.held(), views.targets):  # faster than to place views one by one
                    raise PlanningError("no view is within reach of the arm", file=part.source)
                found = plan(cell, self._screening, views.sight, candidates=views.candidates)
            except (PlanningError, CellError) as error:
                return Screened(0.0, np.inf, str(error))
            assert found.report is not None  # views are chosen by coverage
            time += found.program.duration
            scanned.append(found.report.share * views.sight.surface.measurable_fraction)
        return Screened(min(scanned), time)

    def reach(self, values: Mapping[str, float]) -> tuple[float, ...]:
        """Share of the views of each part that the arm reaches, by inverse kinematics alone."""
        cell = self._planning_cell(nominal_cell(self._at(values), None).with_axes_held())
        return tuple(reached(cell, views.targets) for views in self._views)

    def planned(self, name: str, values: Mapping[str, float]) -> Layout:
        """The layout at values of keys with planned scans, or the reason why they cannot be planned."""
        cell, scans = self._at(values), []
        for part, reach in zip(self._parts, self.reach(values), strict=True):
            try:
                found, clearance = self._plan(cell, part)
            except (PlanningError, CellError) as error:
                return Layout(name, cell, dict(values), (), str(error))
            assert found.report is not None  # views are chosen by coverage
            measurable = found.report.measurable_area / float(part.areas.sum())
            scanned = found.report.share * measurable
            scans.append(LayoutScan(Path(part.source).name, reach, measurable, scanned, clearance, found))
        return Layout(name, cell, dict(values), tuple(scans))

    def _at(self, values: Mapping[str, float]) -> CellDescription:
        named = ", ".join(f"{key} = {value:g}" for key, value in values.items())
        return with_values(self._cell, values, f"the layout {named}" if named else "the present layout")

    def _views_of(self, part: Mesh) -> Views:
        """Views in range and sight of a part, which the arm may reach or not."""
        nominal = nominal_cell(self._cell, part)
        others = {
            "part.moves_with": (nominal.support != "table", self._cell.part.moves_with),
            "tool.moves_with": (not nominal.carries_sensor, nominal.sensor.parent),
            "table.turns": (not nominal.table_turns, False),
        }
        for key, (is_other, value) in others.items():
            if is_other:
                expected = "a sensor on the flange and a part on a table that turns: layouts of others are not proposed"
                raise DescriptionError(key=f"cell.{key}", value=value, expected=expected)
        cell, samples = self._planning_cell(nominal), sample_part(part, nominal.table_from_part)
        surface = unknown_surface(nominal.with_axes_held(), self._sensor, _SAMPLES, self._threads)

        def sight_of(measurable: Flags) -> Sight:
            found = replace(surface, measurable=measurable)
            held = nominal.with_axes_held()
            return Sight(held, self._sensor, lambda *_: found, self._threads, self._work, _SAMPLES)

        def searched(sight: Sight, is_searched: bool) -> list[Candidate]:
            return CoveragePlanner(cell, sight, self._options).candidates(samples, _ROUNDS, is_searched)

        every = searched(sight_of(np.ones(_SAMPLES, bool)), is_searched=False)
        if not every:
            raise PlanningError("nothing of its surface is in range and sight of the sensor", file=part.source)
        count, angles, poses = _REACH[nominal.arm.has_named_branches]
        some = every[:: -(-len(every) // count)]
        targets = np.array([_poses(one.view, self._options.azimuth, angles, poses) for one in some])
        visible = np.any([one.seen for one in every], axis=0)
        try:
            sight = self._sight(part)
            is_reached = sight.surface.measurable_fraction >= visible.mean() - WORTH
        except CellError:  # bodies of the cell as described intersect
            is_reached = False
        if is_reached:
            candidates = searched(sight, is_searched=True)
        else:  # other layouts may be better
            sight, candidates = sight_of(visible), [replace(one, seen=one.seen[visible]) for one in every]
        self._progress.advance(1)
        return Views(sight, candidates, targets)

    def _planning_cell(self, nominal: NominalCell, work: Work | None = None) -> PlanningCell:
        return PlanningCell(
            nominal, self._range, self._cell.world.controller_cycle, threads=self._threads, work=work or self._work
        )


def sampled(bounds: Mapping[str, tuple[float, float]], samples: int, seed: int) -> list[dict[str, float]]:
    """Values of the keys of some layouts: a scrambled Halton sequence within the bounds."""
    from scipy.stats import qmc  # noqa: PLC0415  (takes two seconds to import)

    unit = qmc.Halton(len(bounds), scramble=True, rng=np.random.default_rng(seed)).random(samples)
    low, high = np.array([*bounds.values()]).T
    values = np.clip(np.round(low + unit * (high - low), _DIGITS), low, high)
    return [dict(zip(bounds, row, strict=True)) for row in values.tolist()]


def _poses(view: Sweep | Pass, azimuth: float, count: int, poses: int) -> Array:
    """Poses (count, poses, 4, 4) of the sensor: with the table turned, or around it."""
    if isinstance(view, Sweep):
        around = azimuth + 2 * np.pi * np.arange(count // 2) / (count // 2)
        at = np.array([view.at(angle, roll) for angle in around for roll in (0.0, np.pi)])
        return np.repeat(at[:, None], poses, 1)
    angles = 2 * np.pi * np.arange(count) / count
    along = view.length * (np.linspace(0.0, 1.0, poses) if poses > 1 else np.array([0.5]))
    return np.asarray(pose.from_rotation(pose.rotation_about(2, angles))[:, None] @ view.at(along))


def reached(cell: PlanningCell, targets: Array) -> float:
    """Share of views that the arm reaches at some table angle, by their poses (c, a, k, 4, 4), see `Views`."""
    q = cell.ik(targets.reshape(-1, 4, 4))
    metric = arm_metric(cell.nominal.arm, q.reshape(*targets.shape[:3], *q.shape[1:])).min(2)
    return float((metric > MIN_METRIC).any((1, 2)).mean())
