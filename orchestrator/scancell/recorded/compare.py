"""Comparison of real measurements of a part with the simulation at the same poses."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from scancell.arguments import Seed, Threads, checked_arguments
from scancell.arrays import Array
from scancell.calibration.cell.kinematics import AxisReadings
from scancell.config.loading import Setup, load_resolved
from scancell.errors import DescriptionError, EmptyScanError
from scancell.geometry import pose
from scancell.geometry.mesh import Mesh, sharp_edges
from scancell.geometry.shapes import PartSurface
from scancell.nominal.parts import load_part
from scancell.output.run_folder import RunFolder, SavedResult, manifest, write_json
from scancell.output.sheet import COLOURS, SOFT, Axes, Sheet
from scancell.progress import Progress, ProgressCallback, as_progress
from scancell.reconstruction.reconstruct import ProfilePoints
from scancell.recorded.measurements import Measurements
from scancell.recorded.reconstruct import MeasuredCell, ReconstructedData, reconstruct_measurements
from scancell.recorded.runs import read_run
from scancell.scanning.sense import expose
from scancell.scanning.world import build_scene, make_sensor, still_exposures, visible_bodies

_BATCH = 16  # exposures at a time

SHARES = np.array([0.005, 0.025, 0.05, 0.1, 0.25, 0.5, 0.75, 0.9, 0.95, 0.975, 0.995])
_ANGLES = np.arange(0.0, 91.0, 15.0)  # deg
_RANGES = 5
_POSITIONS = 20  # along the profile
_FROM_EDGE = 1e-3 * np.array([0.0, 0.25, 0.5, 1.0, 2.0, 4.0])  # m
_LEAST = 50  # points of a bin
_NEIGHBOURS = 2  # columns between points whose difference is noise
_SAME_POSITION, _SAME_TURN = 50e-6, np.radians(0.01)  # of poses that repeat
_PANEL = 470  # px, width of a plot of the picture
_SERIES = {"real": COLOURS[1], "simulated": COLOURS[0]}
_NORMAL = 1.4826  # standard deviation by the median of absolute values


def simulate(
    found: Measurements,
    readings: AxisReadings,
    measured: MeasuredCell,
    setup: Setup,
    seed: int,
    threads: int,
    progress: Progress,
) -> Measurements:
    """Simulate the described sensor at rest at the poses of measurements.

    Without the arm, whose joints poses of the flange do not state, and without a gripper and further parts.

    Raises `SensorError` if the sensor library reports an error.
    """
    sensor = make_sensor(setup.sensor, seed)
    cell = measured.cell
    count = len(readings)
    frames = {
        "world": np.broadcast_to(np.eye(4), (count, 4, 4)),
        "table": measured.world_from("table", readings),
        "part": measured.world_from("part", readings),
        "sensor": measured.world_from("sensor", readings),
        **{axis.name: measured.world_from(axis.name, readings) for axis in cell.further_axes},
    }
    bodies = [body for body in visible_bodies(cell) if body.moves_with in frames]
    scene = build_scene(bodies)
    progress.stage("simulating", count, "exposures")
    made: list[ProfilePoints] = []
    covariance: list[NDArray[np.float64]] = []
    for first in range(0, count, _BATCH):
        rows = slice(first, min(first + _BATCH, count))
        index = np.arange(first + 1, rows.stop + 1, dtype=np.int64)
        placed = {name: poses[rows] for name, poses in frames.items()}
        exposures = still_exposures(placed, bodies, index, np.array([sensor.exposure]))
        sensed = expose(scene, sensor, sensor, exposures, index, "ray-traced", covariance=True, threads=threads)
        points, frame = sensed.points, (sensed.points.frame + first).astype(np.int32)
        # At rest all rows are seen from the same pose.
        made.append(replace(points, frame=frame, time_offset=np.zeros_like(points.time_offset)))
        assert sensed.covariance is not None
        covariance.append(sensed.covariance)
        progress.advance(rows.stop - first)
    return replace(
        found, readings=readings, profiles=ProfilePoints.concatenate(made), covariance=np.concatenate(covariance)
    )


@dataclass(frozen=True, eq=False)
class Residuals:
    """Points of the part: distance (n,) from it, m, range, position along the profile, m, angle of incidence, rad.

    `exposure` (n,) is the row of the exposure, `camera` and `column` (n,) where in the image, `from_edge` (n,) the
    distance from the nearest sharp edge, m.
    """

    distance: Array
    range: Array
    along: Array
    angle: Array
    exposure: NDArray[np.intp]
    camera: NDArray[np.int32]
    column: NDArray[np.int32]
    from_edge: Array

    @classmethod
    def of(cls, data: ReconstructedData, part: Mesh, surface: PartSurface, threads: int) -> Residuals:
        """Distances of the points of a cloud; the angle is that between the sensor's z and the nearest face."""
        made, profiles = data.made, data.found.profiles
        distance, face = surface.distances(made.cloud.points_in_part, threads)
        exposure = np.asarray(profiles.frame, np.intp)[made.rows]
        points = np.asarray(profiles.points_in_sensor, float)[made.rows]
        laser = made.part_from_sensor[exposure, :3, 2]
        cosine = np.abs((part.normals[face] * laser).sum(1))
        angle = np.arccos(np.clip(cosine, 0.0, 1.0))
        cloud = made.cloud
        from_edge = _from_edges(cloud.points_in_part, part, threads)
        return cls(distance, points[:, 2], points[:, 1], angle, exposure, cloud.camera, cloud.column, from_edge)

    def noise(self, chosen: NDArray[np.bool_]) -> tuple[float, int]:
        """Standard deviation from point to neighbouring point, m, robustly, and the number of differences."""
        order = np.lexsort((self.column, self.camera, self.exposure))
        order = order[chosen[order]]
        first, second = order[:-1], order[1:]
        pairs = (
            (self.exposure[first] == self.exposure[second])
            & (self.camera[first] == self.camera[second])
            & (self.column[second] - self.column[first] <= _NEIGHBOURS)
        )
        steps = (self.distance[second] - self.distance[first])[pairs]
        if len(steps) < _LEAST:
            return float("nan"), len(steps)
        return float(_NORMAL * np.median(np.abs(steps - np.median(steps))) / np.sqrt(2)), len(steps)


@dataclass(frozen=True)
class Pair:
    """A figure of real and simulated measurements, µm, in a range from `low` to `high` of what it depends on."""

    low: float
    high: float
    real: float | None
    simulated: float | None
    real_count: int
    simulated_count: int

    @property
    def ratio(self) -> float | None:
        """Simulated over real."""
        return None if not self.real or self.simulated is None else self.simulated / self.real


@dataclass(frozen=True, eq=False, repr=False)
class ComparisonResult(SavedResult):
    """Comparison of real and simulated measurements of a part.

    Attributes
    ----------
    real, simulated
        Points on the part.
    poses
        Poses (n, 4, 4) of the sensor in the frame of the part.
    setup, inputs, run
        Descriptions, files and settings for the manifest.
    fitted
        Names of the parameters that a calibration has estimated.
    is_simulated
        Whether the run itself is a simulated one.

    Examples
    --------
    >>> try:
    ...     print(scancell.compare("run_of_measurements"))
    ... except scancell.DescriptionError as error:
    ...     print(error)
    run_of_measurements: expected a run folder
    """

    real: Residuals
    simulated: Residuals
    poses: Array
    setup: Setup
    inputs: Sequence[Path]
    run: dict[str, Any]
    fitted: tuple[str, ...]
    is_simulated: bool

    def _noise_by(self, name: str, edges: Array) -> list[Pair]:
        found = []
        for low, high in pairwise(edges.tolist()):
            inside = [(getattr(one, name) >= low) & (getattr(one, name) < high) for one in (self.real, self.simulated)]
            (real, n), (simulated, k) = self.real.noise(inside[0]), self.simulated.noise(inside[1])
            found.append(Pair(float(low), float(high), _um(real), _um(simulated), n, k))
        return found

    @property
    def noise_by_angle(self) -> list[Pair]:
        """Noise from point to point by angle of incidence, rad."""
        return self._noise_by("angle", np.radians(_ANGLES))

    @property
    def noise_by_range(self) -> list[Pair]:
        """Noise from point to point by range, m; a fifth of the real points in each."""
        edges = np.quantile(self.real.range, np.linspace(0, 1, _RANGES + 1))
        edges[-1] = np.nextafter(edges[-1], np.inf)
        return self._noise_by("range", edges)

    def _distance_by(self, name: str, edges: Array, statistic: Callable[[Array], float]) -> list[Pair]:
        both, found = (self.real, self.simulated), []
        for low, high in pairwise(edges.tolist()):
            parts = [one.distance[(getattr(one, name) >= low) & (getattr(one, name) < high)] for one in both]
            real, simulated = (statistic(part) if len(part) >= _LEAST else float("nan") for part in parts)
            found.append(Pair(float(low), float(high), _um(real), _um(simulated), *map(len, parts)))
        return found

    @property
    def shape(self) -> list[Pair]:
        """Mean distance from the part by position along the profile, m."""
        edges = np.linspace(float(self.real.along.min()), float(self.real.along.max()), _POSITIONS + 1)
        return self._distance_by("along", edges, lambda distance: float(np.mean(distance)))

    @property
    def edges(self) -> list[Pair]:
        """RMS distance from the part by distance from its nearest sharp edge, m."""
        return self._distance_by("from_edge", _FROM_EDGE, _rms)

    @property
    def quantiles(self) -> Array:
        """Quantiles (k, 2) of the distances of real and simulated points at the shares `SHARES`, m."""
        return np.column_stack([np.quantile(one.distance, SHARES) for one in (self.real, self.simulated)])

    @cached_property
    def repeatability(self) -> Pair | None:
        """Standard deviation of the mean distance of a profile where poses repeat; None where none does."""
        groups = _repeated(self.poses)
        if not groups:
            return None
        found = [_scatter_of_means(one, groups) for one in (self.real, self.simulated)]
        return Pair(0.0, 0.0, _um(found[0][0]), _um(found[1][0]), found[0][1], found[1][1])

    @property
    def figures(self) -> dict[str, Any]:
        """Plain figures, in the units that their names state."""
        counts = [len(one.distance) for one in (self.real, self.simulated)]
        rms = [1e6 * _rms(one.distance) for one in (self.real, self.simulated)]
        repeated = self.repeatability
        return {
            "is_simulated": self.is_simulated,
            "exposures": len(self.poses),
            "points": {"real": counts[0], "simulated": counts[1]},
            "rms_um": {"real": rms[0], "simulated": rms[1]},
            "noise_by_angle_um": [_plain(one, "deg", 180 / np.pi) for one in self.noise_by_angle],
            "noise_by_range_um": [_plain(one, "mm", 1e3) for one in self.noise_by_range],
            "shape_along_profile_um": [_plain(one, "mm", 1e3) for one in self.shape],
            "rms_by_distance_from_edge_um": [_plain(one, "mm", 1e3) for one in self.edges],
            "quantiles_um": [
                {"share": float(share), "real": 1e6 * float(real), "simulated": 1e6 * float(simulated)}
                for share, (real, simulated) in zip(SHARES, self.quantiles, strict=True)
            ],
            "repeatability_um": None if repeated is None else asdict(repeated),
            "fitted": list(self.fitted),
            "predicted": ["points", "noise", "quantiles", "shape", "edges", "repeatability"],
        }

    def summary(self) -> str:
        """The figures as lines of text."""
        figures = self.figures
        first = "simulated run" if self.is_simulated else "real"
        points, rms = figures["points"], figures["rms_um"]
        lines = [
            f"{figures['exposures']} exposures: {first} / simulated at the same poses",
            f"  points     {points['real']} / {points['simulated']}",
            f"  RMS        {rms['real']:.2f} / {rms['simulated']:.2f} um",
            *_lines("noise by angle, deg", self.noise_by_angle, 180 / np.pi),
            *_lines("noise by range, mm", self.noise_by_range, 1e3),
            *_lines("RMS by distance from a sharp edge, mm", self.edges, 1e3, "points"),
        ]
        if (repeated := self.repeatability) is not None and repeated.real is not None:
            lines.append(f"  repeatability of profiles {repeated.real:.2f} / {_text(repeated.simulated)} um")
        fitted = ", ".join(self.fitted) or "none: all parameters are those of the descriptions"
        return "\n".join(
            [*lines, f"  fitted     {fitted}", "  predicted  points, noise, quantiles, shape, edges, repeatability"]
        )

    def picture(self) -> bytes:
        """Quantiles, noise by angle and shape along the profile, as PNG."""
        return self._sheet().png()

    def _sheet(self) -> Sheet:
        sheet, quantiles = Sheet(3 * _PANEL, 470), 1e6 * self.quantiles
        limits = _padded(quantiles.ravel())
        axes = Axes(sheet, _box(0), limits, limits, ("real (um)", "simulated (um)"), "Quantiles of the distances")
        axes.line([(end, end) for end in limits], SOFT, 1)
        axes.dots(quantiles.tolist(), COLOURS[0])
        for number, (title, label, pairs, scale, least) in enumerate(
            [
                ("Noise from point to point", "angle of incidence (deg)", self.noise_by_angle, 180 / np.pi, [0.0]),
                ("Mean distance along the profile", "y (mm)", self.shape, 1e3, []),
            ],
            1,
        ):
            middles = [scale * (one.low + one.high) / 2 for one in pairs]
            known = [value for one in pairs for value in (one.real, one.simulated) if value is not None]
            limits = _padded([*known, *least] or [0.0])
            axes = Axes(sheet, _box(number), _padded(middles), limits, (label, "um"), title, _SERIES.items())
            for name, colour in _SERIES.items():
                values = [getattr(one, name) for one in pairs]
                points = [(x, y) for x, y in zip(middles, values, strict=True) if y is not None]
                axes.line(points, colour)
                axes.dots(points, colour)
        return sheet

    def _write(self, folder: RunFolder, command_line: list[str]) -> None:
        write_json(folder.path("comparison.json"), self.figures)
        self._sheet().write(folder.path("comparison.png"))
        entries = {**self.run, "command_line": command_line}
        write_json(folder.path("comparison_manifest.json"), manifest(self.setup, self.inputs, entries))


def _box(number: int) -> tuple[int, int, int, int]:
    """Rectangle of a plot of the picture, px."""
    return number * _PANEL + 84, 84, (number + 1) * _PANEL - 20, 400


def _padded(values: Sequence[float] | Array) -> tuple[float, float]:
    """Limits of an axis for values (n,)."""
    low, high = float(min(values)), float(max(values))
    room = 0.06 * (high - low) + 1e-6
    return low - room, high + room


@checked_arguments
def compare(
    run: str | Path,
    *,
    part: str | Path | Mesh | None = None,
    unit: str = "mm",
    out: str | Path | None = None,
    seed: Seed = 0,
    threads: Threads = 0,
    progress: Progress | ProgressCallback | None = None,
) -> ComparisonResult:
    """Compare real measurements of a part by the main sensor with those of the ray-traced one at the same poses.

    The other parameters are those of `Scanner` and `Scanner.scan`.

    Parameters
    ----------
    run
        Run folder of `reconstruct`, or of a scan.
    part
        What was measured, a mesh or an artefact; by default the part of the run.
    out
        Folder for figures (JSON) and a picture, which may be that of the run.

    Raises
    ------
    ScancellError
        Naming what is wrong and what was expected.

    Examples
    --------
    >>> try:
    ...     print(scancell.compare("measured"))
    ... except scancell.DescriptionError as error:
    ...     print(error)
    measured: expected a run folder
    """
    folder = Path(run)
    resolved = folder / "resolved.toml"
    if not resolved.is_file():
        raise DescriptionError(file=folder, expected="a run folder")
    setup, made = load_resolved(resolved)
    chosen = made["part"] if part is None else part
    if not chosen:
        raise DescriptionError(
            "has no part: nothing of known shape was measured", file=folder, key="part", expected="its mesh or artefact"
        )
    mesh = chosen.usable if isinstance(chosen, Mesh) else load_part(chosen, unit if part is not None else made["unit"])
    is_simulated, keep_all = "measured" not in made, bool(made.get("keep_all", False))
    measurements = read_run(folder, setup, is_simulated)
    latency = None if is_simulated else 1e-3 * float(made["latency_ms"])
    measurements = measurements.of_main_sensor()
    if not len(measurements.profiles.frame):
        raise EmptyScanError(f"the main sensor, '{setup.sensor.name}', measured nothing", file=measurements.files[0])
    real = reconstruct_measurements(measurements, setup, mesh, latency, keep_all, threads)
    simulated = simulate(measurements, real.readings, real.measured_cell, setup, seed, threads, as_progress(progress))
    if not len(simulated.profiles.frame):
        raise EmptyScanError("the simulated sensor sees nothing from these poses", file=folder)
    again = reconstruct_measurements(simulated, setup, mesh, 0.0, keep_all, threads)
    surface = PartSurface(mesh)
    estimated = {} if setup.cell.estimated is None else setup.cell.estimated.deviations()
    files = [resolved, measurements.files[0], *([] if isinstance(chosen, Mesh) else [Path(chosen)])]
    found = ComparisonResult(
        Residuals.of(real, mesh, surface, threads),
        Residuals.of(again, mesh, surface, threads),
        real.made.part_from_sensor,
        setup,
        tuple(files),
        {"run": str(folder.absolute()), "seed": seed},
        tuple(name for name, value in estimated.items() if value),
        is_simulated,
    )
    if out is not None:
        found.save(out)
    return found


def _from_edges(points: Array, part: Mesh, threads: int) -> Array:
    """Distances (n,) of points (n, 3) from the nearest sharp edge of a part, m; inf: it has none."""
    ends = sharp_edges(part)
    if not len(ends):
        return np.full(len(points), np.inf)
    as_faces = np.arange(2 * len(ends)).reshape(-1, 2)[:, [0, 1, 1]]  # without area: the edges themselves
    return np.abs(PartSurface(Mesh(ends.reshape(-1, 3), as_faces)).distances(points, threads)[0])


def _repeated(poses: Array) -> list[list[int]]:
    """Rows of poses that repeat, two or more each."""
    # Matrices of rotations differ by at most 1.42 times their angle.
    scaled = np.hstack([poses[:, :3, 3] / _SAME_POSITION, poses[:, :3, :3].reshape(-1, 9) / (1.42 * _SAME_TURN)])
    tree, grouped, groups = KDTree(scaled), np.zeros(len(poses), bool), []
    for first, own in enumerate(poses):
        if grouped[first]:
            continue
        near = np.array(sorted(tree.query_ball_point(scaled[first], np.sqrt(2.0))), np.int64)
        near = near[~grouped[near]]
        moved = np.linalg.norm(poses[near, :3, 3] - own[:3, 3], axis=1)
        turned = np.linalg.norm(pose.log_rotation(own[:3, :3].T @ poses[near, :3, :3]), axis=1)
        group = near[(moved < _SAME_POSITION) & (turned < _SAME_TURN)]
        grouped[group] = True
        if len(group) > 1:
            groups.append(group.tolist())
    return groups


def _scatter_of_means(one: Residuals, groups: list[list[int]]) -> tuple[float, int]:
    """Standard deviation of the mean distances of profiles about that of their group, m, and degrees of freedom."""
    squares, degrees = 0.0, 0
    for group in groups:
        means = [float(np.mean(part)) for row in group if len(part := one.distance[one.exposure == row])]
        if len(means) > 1:
            squares += float(np.var(means)) * len(means)
            degrees += len(means) - 1
    return (float(np.sqrt(squares / degrees)) if degrees else float("nan")), degrees


def _rms(distance: Array) -> float:
    return float(np.sqrt(np.mean(distance**2)))


def _um(value: float) -> float | None:
    return None if np.isnan(value) else 1e6 * value


def _text(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"


def _plain(one: Pair, unit: str, scale: float) -> dict[str, Any]:
    plain = asdict(one)
    low, high = scale * plain.pop("low"), scale * plain.pop("high")
    return {f"from_{unit}": low, f"to_{unit}": high, **plain, "simulated_over_real": one.ratio}


def _lines(title: str, pairs: Sequence[Pair], scale: float, counted: str = "differences") -> list[str]:
    lines = [
        f"    {scale * one.low:8.2f} to {scale * one.high:8.2f}   {_text(one.real)} / {_text(one.simulated)} um"
        f"   ({one.real_count}, {one.simulated_count} {counted})"
        for one in pairs
        if one.real is not None or one.simulated is not None
    ]
    return [f"  {title}", *lines] if lines else []
