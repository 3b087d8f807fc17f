"""Set-ups of a free part: resting pose, position on the table and height for the best scan."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations, product
from typing import Any

import numpy as np

from scancell.arrays import Flags
from scancell.config.cell import CellDescription, PartDescription
from scancell.config.devices import FurtherPartDescription
from scancell.config.scan import CoverageDescription
from scancell.config.sensor import SensorDescription
from scancell.errors import DescriptionError, PlanningError
from scancell.geometry import pose
from scancell.geometry.mesh import Mesh, RestingPose, box_mesh, resting_poses
from scancell.nominal.cell import NominalCell, nominal_cell
from scancell.nominal.parts import Body
from scancell.planning.model import PlanningCell, SensorRange, Work, WorkLimitError, join_reasons
from scancell.planning.motion.assembly import check_part
from scancell.planning.options import ScanOptions
from scancell.planning.views.coverage import CoveragePlanner, Sight
from scancell.planning.views.views import sample_part
from scancell.progress import Progress
from scancell.values import Result, Value
from scancell.visibility import MeasurableSurface, measurable_surface

_SAMPLES = 2500
_MOST_RESTS = 10  # resting poses that are examined, the hardest to tip over first
_HEIGHTS_MM = (0.0, 30.0, 60.0, 90.0)
_OFFSETS = (0.0, 0.35)  # of the part's radius, along x of the table
_WORTH = 0.005  # share of the surface that a riser or an offset must add
_FOOT = 2e-4  # m: height over the lowest point up to which the part is supported


@dataclass(frozen=True, eq=False, repr=False)
class SetUp(Value):
    """A placement of the part and the surface that is scanned there.

    Attributes
    ----------
    part
        The cell's ``[part]``.
    riser
        Block below the part, frame of the table at angle 0, m; None where the part rests on the table.
    tip_angle
        Tilt of the table at which the part would tip over, rad.
    measurable
        Share of the whole surface that the sensor can measure in this set-up.
    scanned
        Share of the whole surface that views without collision see.
    time
        Estimated duration of these views, s.
    """

    part: PartDescription
    riser: Mesh | None
    tip_angle: float
    measurable: float
    scanned: float
    time: float

    @property
    def toml(self) -> str:
        """The cell's ``[part]`` in TOML, with the keys that place the part."""
        keys = ("x_mm", "y_mm", "z_mm", "rx_deg", "ry_deg", "rz_deg")
        numbers = "".join(f"{key} = {getattr(self.part, key) + 0.0!r}\n" for key in keys)
        return f'[part]\nfixture = "{self.part.fixture}"\n{numbers}'

    def in_cell(self, cell: CellDescription, riser_file: str) -> CellDescription:
        """The cell with the part in this set-up, and with the riser, if there is one, from an STL file in mm."""
        if self.riser is None:
            return cell.replace(part=self.part)
        riser = FurtherPartDescription(name="riser", mesh=riser_file, stands_on="table", fixture="clamped")
        return cell.replace(part=self.part, further_part=(*cell.further_part, riser))


@dataclass(frozen=True, eq=False, repr=False)
class SetUps(Result):
    """One set-up, or two if one does not reach the requested share.

    Attributes
    ----------
    chosen
        The set-ups.
    asked
        Share of the accessible surface that was asked for: of what is measurable in any resting pose.
    reached
        Share of the accessible surface that the chosen set-ups scan together.
    best_single
        Largest share that a single set-up scans.
    accessible
        Accessible share of the whole surface.
    rests
        Number of stable resting poses.

    Examples
    --------
    >>> found = scancell.place(scancell.box_mesh((0.03, 0.02, 0.01)), 0.3)
    >>> found.rests, len(found.chosen), found.reached > 0.3
    (6, 1, True)
    >>> print(found.chosen[0].toml)
    [part]
    fixture = "free"
    x_mm = 0.0
    ...
    """

    chosen: tuple[SetUp, ...]
    asked: float
    reached: float
    best_single: float
    accessible: float
    rests: int

    @property
    def figures(self) -> dict[str, Any]:
        """Shares, the number of resting poses, and the set-ups with their sections for the cell (TOML)."""
        return {
            "accessible": self.accessible,
            "reached": self.reached,
            "best_single": self.best_single,
            "resting_poses": self.rests,
            "set_ups": [
                {"scanned": one.scanned, "measurable": one.measurable, "time_s": one.time, "toml": one.toml}
                for one in self.chosen
            ],
        }

    def summary(self) -> str:
        """Resting poses, and what one set-up or two scan, as lines of text."""
        reached, short = f"{100 * self.reached:.1f} %", f", less than the {100 * self.asked:g} % asked for"
        short = short if self.reached < self.asked else ""
        if len(self.chosen) > 1:
            verdict = (
                f"two set-ups are needed: the best single one scans {100 * self.best_single:.1f} % of that,"
                f" these two together {reached}{short}"
            )
        else:
            verdict = f"{'the best' if short else 'one'} set-up scans {reached} of that{short}"
        return (
            f"{self.rests} stable resting poses; {100 * self.accessible:.1f} % of the surface is measurable in one of"
            f" them\n  {verdict}"
        )


class SetUpPlanner:
    """Proposes set-ups of a part on the table.

    Raises `DescriptionError` if the description puts it on the flange.

    Parameters
    ----------
    cell
        Description of the cell; its part's pose and fixture are replaced.
    sensor, sensor_range
        Description and measuring range of the sensor.
    options
        Options of the scan; coverage options are replaced.
    threads
        0: all cores.
    work
        Counts and limits the work of all set-ups together.
    """

    def __init__(
        self,
        cell: CellDescription,
        sensor: SensorDescription,
        sensor_range: SensorRange,
        options: ScanOptions,
        threads: int = 0,
        work: Work | None = None,
    ) -> None:
        if cell.part.moves_with != "table":
            raise DescriptionError(
                "set-ups are those of a part on the table",
                key="cell.part.moves_with",
                value=cell.part.moves_with,
                expected='"table"',
            )
        self._cell, self._sensor, self._range, self._options = cell, sensor, sensor_range, options
        self._threads, self._work = threads, work or Work()

    def propose(self, part: Mesh, share: float, progress: Progress) -> SetUps:
        """Set-ups that scan `share` of the surface that is measurable in any stable resting pose.

        Raises `PlanningError` if the part has no stable resting pose, fits on the table in none, or is measurable in
        none.
        """
        # More in each set-up than is asked of both together.
        coverage = CoverageDescription(share=(1 + share) / 2)
        scan = self._options.scan.model_copy(update={"coverage": coverage})
        self._options = replace(self._options, scan=scan)
        all_rests = resting_poses(part)
        if not all_rests:
            raise PlanningError('has no stable resting pose; clamp it (part.fixture = "clamped")', file=part.source)
        progress.stage("resting poses", min(len(all_rests), _MOST_RESTS), "poses")
        rests, seen, reasons = [], [], []
        for number, rest in enumerate(all_rests[:_MOST_RESTS], start=1):
            self._work.doing = f"looking at resting pose {number} of {min(len(all_rests), _MOST_RESTS)}"
            try:
                nominal = self._nominal(part, self._placed(rest, 0.0, 0.0))
                seen.append(self._measurable(nominal).measurable)
                rests.append(rest)
            except WorkLimitError:
                raise
            except PlanningError as error:
                reasons.append(str(error))
            progress.advance(1)
        if not rests:
            raise PlanningError(join_reasons("no resting pose of the part is feasible", sorted(set(reasons))))
        accessible = np.any(seen, axis=0)
        if not accessible.any():
            raise PlanningError("nothing of its surface is measurable in any resting pose", file=part.source)
        best = int(np.argmax([flags.sum() for flags in seen]))
        made = [self._best_placement(part, rests[best], progress)]
        alone = _share(made[0][1], accessible)
        if alone < share and len(rests) > 1:
            pair = _best_pair(seen)
            made = [made[0] if k == best else self._best_placement(part, rests[k], progress) for k in pair]
            alone = max(alone, *(_share(flags, accessible) for _, flags in made))
        together = _share(np.any([flags for _, flags in made], axis=0), accessible)
        chosen = tuple(one for one, _ in made)
        return SetUps(chosen, share, together, alone, float(accessible.mean()), len(all_rests))

    def _best_placement(self, part: Mesh, rest: RestingPose, progress: Progress) -> tuple[SetUp, Flags]:
        """The placement of a resting pose in which most is scanned, and (n,) which samples are.

        On the table and at its centre, unless a riser or an offset adds more than `_WORTH` of the surface.
        """
        progress.stage("placements", len(_HEIGHTS_MM) * len(_OFFSETS), "placements")
        found = []
        radius = float(np.linalg.norm(np.ptp((part.vertices @ rest.rotation.T)[:, :2], axis=0)) / 2)
        for height, offset in product(_HEIGHTS_MM, _OFFSETS):
            placed = self._placed(rest, height, 1e3 * offset * radius)
            try:
                nominal = self._nominal(part, placed)
            except WorkLimitError:
                raise
            except PlanningError:  # beyond the edge of the table
                continue
            finally:
                progress.advance(1)
            found.append((placed, nominal, self._measurable(nominal)))
        central, best = found[0], max(found, key=lambda item: item[2].measurable_fraction)
        gains = best[2].measurable_fraction > central[2].measurable_fraction + _WORTH
        made, reasons = [], []
        for placement in (central, best) if gains else (central,):
            try:
                made.append(self._set_up(rest, *placement))
            except WorkLimitError:
                raise
            except PlanningError as error:
                reasons.append(str(error))
        if not made:
            raise PlanningError(join_reasons("no placement of the part can be scanned", reasons))
        return made[-1] if made[-1][0].scanned > made[0][0].scanned + _WORTH else made[0]

    def _set_up(
        self, rest: RestingPose, placed: PartDescription, nominal: NominalCell, found: MeasurableSurface
    ) -> tuple[SetUp, Flags]:
        """A set-up, and (n,) which samples feasible views see in it."""
        sight = Sight(nominal, self._sensor, lambda *_: found, self._threads, self._work)
        planner = CoveragePlanner(self._planning_cell(nominal), sight, self._options)
        report = planner.select(sample_part(nominal.part, nominal.table_from_part))
        scanned = np.zeros(len(found.samples), bool)
        scanned[sight.rows[planner.covered]] = True
        share, riser = float(scanned.mean()), riser_for(nominal)
        return SetUp(placed, riser, rest.tip_angle, found.measurable_fraction, share, report.time), scanned

    def _placed(self, rest: RestingPose, height_mm: float, x_mm: float) -> PartDescription:
        angles = np.degrees(pose.euler_xyz_from_rotation(rest.rotation)).round(6)
        rx, ry, rz = (float(angle) for angle in angles)
        # A part on a riser does not stand on the table, whose contact would carry it.
        return self._cell.part.replace(
            fixture="clamped" if height_mm else "free", x_mm=round(x_mm, 3), y_mm=0.0, z_mm=height_mm,
            rx_deg=rx, ry_deg=ry, rz_deg=rz,
        )  # fmt: skip

    def _nominal(self, part: Mesh, placed: PartDescription) -> NominalCell:
        nominal = nominal_cell(self._cell.replace(part=placed), part)
        riser = riser_for(nominal)
        if riser is not None:
            body = Body("riser", "table", riser, nominal.bodies[0].material)
            nominal = replace(nominal, bodies=(*nominal.bodies, body))
        check_part(self._planning_cell(nominal))
        return nominal

    def _planning_cell(self, nominal: NominalCell) -> PlanningCell:
        return PlanningCell(
            nominal, self._range, self._cell.world.controller_cycle, threads=self._threads, work=self._work
        )

    def _measurable(self, nominal: NominalCell) -> MeasurableSurface:
        return measurable_surface(nominal, self._sensor, _SAMPLES, self._work, threads=self._threads)


def _best_pair(seen: list[Flags]) -> tuple[int, int]:
    """The two resting poses that see most together; of nearly equal pairs those that are hardest to tip over."""
    pairs = list(combinations(range(len(seen)), 2))
    together = [float((seen[i] | seen[j]).mean()) for i, j in pairs]
    good = [pair for pair, share in zip(pairs, together, strict=True) if share > max(together) - _WORTH]
    return min(good, key=sum)


def _share(flags: Flags, of: Flags) -> float:
    return float((flags & of).sum() / of.sum())


def riser_for(nominal: NominalCell) -> Mesh | None:
    """Block (frame of the table at angle 0, m) below the feet of a part above the table; None for one on the table.

    It is as wide as the feet, that is the part within 0.2 mm of its lowest point, and ends at their height.
    """
    on_table = pose.transform_points(nominal.table_from_part, nominal.part.vertices)
    height = float(on_table[:, 2].min())
    if height < 1e-6:
        return None
    feet = on_table[on_table[:, 2] < height + _FOOT]
    low, high = feet[:, :2].min(0), feet[:, :2].max(0)
    size = np.maximum(high - low, 1e-3)
    centre = (low + high) / 2
    return box_mesh((*size, height), "riser").transformed(pose.translation((*centre, height / 2)))
