"""Survey of the space around the table: bodies that the description of the cell does not contain.

The sensor looks down on a raster, the table at rest. It begins above the surveyed cylinder, in space that is taken as
free, and goes down by layers: arm and sensor only enter space that a layer before has shown to be free.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scancell.arguments import checked_arguments, checked_fields
from scancell.arrays import Array
from scancell.config.description import si_value
from scancell.errors import DescriptionError, PlanningError
from scancell.geometry import pose
from scancell.geometry.mesh import Mesh, joined
from scancell.geometry.voxels import MAX_VOXELS, VoxelGrid
from scancell.nominal.cell import NominalCell, with_table
from scancell.planning.model import PlanningCell, SensorRange, Work, WorkLimitError
from scancell.planning.motion.assembly import Assembly, check_part
from scancell.planning.options import scan_options
from scancell.planning.plan import Plan
from scancell.planning.space_map import Profiles, SpaceMap, occupied_bodies, write_voxels
from scancell.planning.views.placement import PlacedPose
from scancell.progress import Progress
from scancell.scanning.pipeline import ScanPipeline
from scancell.scanning.world import World
from scancell.values import Result

_CHOICES = 2  # of arm branches and orientations that are tried for a pose: the nearest ones


@dataclass(frozen=True)
class SurveyRegion:
    """The surveyed cylinder about the table's axis, from the plane of its top face upwards, m.

    Attributes
    ----------
    radius, height
        Of the cylinder. All space above it is taken as free: without it the sensor cannot begin. Space beside it is as
        the cell describes it.
    voxel
        Edge of the voxels.
    pitch
        Distance between exposures across the laser sheet: what is thinner than that can lie between two of them and not
        be seen. At most `voxel`.
    inflation
        Distance from measured voxels up to which space counts as occupied.
    """

    radius: float
    height: float
    voxel: float
    pitch: float
    inflation: float

    def __post_init__(self) -> None:
        """Refuse sizes that are not positive and finite, and more than 5e7 voxels.

        Raises `DescriptionError` naming the size and its value, m.
        """
        for name in ("radius", "height", "voxel", "pitch"):
            if not 0.0 < getattr(self, name) < np.inf:
                raise DescriptionError(
                    file="survey", key=name, value=getattr(self, name), expected="a positive number of metres"
                )
        if not 0.0 <= self.inflation < np.inf:
            raise DescriptionError(
                file="survey", key="inflation", value=self.inflation, expected="0 or a positive number of metres"
            )
        if self.pitch > self.voxel:
            raise DescriptionError(
                file="survey", key="pitch", value=self.pitch, expected=f"at most voxel ({self.voxel})"
            )
        count = 4 * self.radius**2 * self.height / self.voxel**3
        if count > MAX_VOXELS:
            raise DescriptionError(
                f"{count:.2g} voxels, at most {MAX_VOXELS:.0e} allowed", file="survey", key="voxel", value=self.voxel
            )


@checked_fields
@dataclass(frozen=True, eq=False, repr=False)
class SurveyResult(Result):
    """Result of a survey.

    Attributes
    ----------
    space
        Voxels in the frame of the table at angle 0.
    region
        The surveyed cylinder about the table's axis, m.
    table_radius
        Radius of the platter, m: what stands above it may turn with it.
    exposures, left_out
        Number of exposures, and of poses that the arm cannot reach through space known to be free.
    points
        Number of measured points.

    Examples
    --------
    The scan takes the occupied space into account:

    >>> found = scancell.survey("part.stl", radius=0.05, height=0.04, pitch=0.01)
    >>> print(found)
    40 exposures, ... points
      space      0.15 l free, 0.00 l occupied, 0.00 l unseen
    >>> file = found.save("survey.npz")
    >>> plan = scancell.plan("part.stl", settings=["scan.occupied=[{ file = 'survey.npz' }]"])
    """

    space: SpaceMap
    region: SurveyRegion
    table_radius: float
    exposures: int
    left_out: int
    points: int

    @property
    def volumes(self) -> dict[str, float]:
        """Volume (m³) of the surveyed space that is free, occupied by or below something unknown, and unseen."""
        space, voxel = self.space, self.region.voxel**3
        blocked, unseen = space.blocked(0.0).occupied, space.unseen
        found = {"free": space.region & ~blocked, "occupied": blocked & ~unseen, "unseen": unseen}
        return {name: float(flags.sum()) * voxel for name, flags in found.items()}

    @property
    def grids(self) -> dict[str, VoxelGrid]:
        """Space to keep clear of: at rest in the cell, and above the platter also as if it turned with the table."""
        blocked = self.space.blocked(self.region.inflation)
        over = np.linalg.norm(blocked.centres[..., :2], axis=-1) <= self.table_radius
        return {"fixed": blocked, "table": replace(blocked, occupied=blocked.occupied & over)}

    @checked_arguments
    def save(self, path: str | Path) -> Path:
        """Write the voxels to the file `path` (NPZ), for ``[[occupied]]`` of a scan.

        Raises
        ------
        OutputError
            If the file cannot be written.
        """
        space = self.space
        state = np.where(space.occupied, 2, np.where(space.free, 1, 0)).astype(np.uint8)
        write_voxels(Path(path), self.grids, state=state, state_names=np.array(["unseen", "free", "occupied"]))
        return Path(path)

    @property
    def figures(self) -> dict[str, Any]:
        """Counts of exposures and points, and the volumes of the space."""
        return {"exposures": self.exposures, "points": self.points, "volumes_m3": self.volumes}

    def summary(self) -> str:
        """Counts and volumes as lines of text."""
        litres = ", ".join(f"{1e3 * volume:.2f} l {name}" for name, volume in self.volumes.items())
        left_out = f", {self.left_out} poses left out" if self.left_out else ""
        return f"{self.exposures} exposures{left_out}, {self.points} points\n  space      {litres}"


class Survey:
    """A survey in progress.

    Raises `DescriptionError` if a voxel is larger than 0.9 times the measuring range, or the arm does not carry the
    sensor.

    Parameters
    ----------
    world, pipeline
        The cell with what stands in it, and what runs it.
    region
        Space to survey.
    """

    def __init__(
        self,
        world: World,
        pipeline: ScanPipeline,
        region: SurveyRegion,
    ) -> None:
        if not world.nominal.carries_sensor:
            raise DescriptionError(
                "a survey moves the sensor over the table", key="cell.tool.moves_with", expected='"flange"'
            )
        self._world, self._pipeline = world, pipeline
        self._region, self._range = region, SensorRange.of(world.sensor)
        # Layers and rows overlap by a voxel.
        largest = 0.9 * min(self._range.far - self._range.near, 2 * self._range.half_near)
        if region.voxel > largest:
            raise DescriptionError(
                file="survey",
                key="voxel",
                value=region.voxel,
                expected=f"at most {largest:.3g} m, by the measuring range",
            )
        nominal = world.nominal.with_axes_held()
        tolerance = max(region.inflation, 1e-3)
        at_home = nominal.frame_poses(nominal.home)
        around_table = _merged(nominal, at_home, ("world", "table", "part"))
        self.space = SpaceMap(region.radius, region.height, region.voxel, around_table, tolerance)
        self.space.take_as_free(_merged(nominal, at_home, ("link", "sensor", "finger")), self._clearance + region.voxel)

    @property
    def _clearance(self) -> float:
        return si_value(self._world.setup.scan, "clearance_mm")

    def run(self, progress: Progress) -> SurveyResult:
        """Survey all layers.

        Raises `PlanningError` if the home position is not free, no exposure is possible, or ``scan.max_planning_work``
        is used up; `CellError` if the FMU reports an error.
        """
        counts, work = np.zeros(3, np.int64), Work(self._world.setup.scan.max_planning_work, progress)
        layers = self._layers()
        for height in layers:
            progress.stage("planning a layer", 1, "plan")
            work.doing = f"planning the layer {1e3 * height:.0f} mm above the table"
            counts += self._survey_layer(self._poses(height), work, progress)
        if not counts[0]:
            raise PlanningError("no pose of the survey can be reached: reduce its radius or height")
        return SurveyResult(self.space, self._region, self._world.nominal.table_radius, *counts.tolist())

    def _layers(self) -> list[float]:
        """Heights of the sensor above the table: the range of each begins where free space ended before."""
        near, far, voxel = self._range.near, self._range.far, self._region.voxel
        heights = [self._region.height + near + voxel]
        while heights[-1] > far - voxel:
            heights.append(max(heights[-1] - (far - near - voxel), far - voxel))
        return heights

    def _poses(self, height: float) -> Array:
        """Sensor poses (n, 4, 4) that look down on the cylinder, in the frame of the table, row by row."""
        voxel, radius = self._region.voxel, self._region.radius
        width = 2 * self._range.half_near - voxel
        rows = int(np.ceil(2 * radius / width))
        along = np.arange(-radius + self._region.pitch / 2, radius, self._region.pitch)
        down = np.diag([1.0, -1.0, -1.0, 1.0])
        found = []
        for number, y in enumerate(np.linspace(-radius + width / 2, radius - width / 2, rows)):
            seen = along[np.hypot(along, max(abs(y) - width / 2, 0.0)) <= radius]
            found += [pose.translation((x, y, height)) @ down for x in seen[:: 1 if number % 2 else -1]]
        return np.array(found)

    def _survey_layer(self, poses: Array, work: Work, progress: Progress) -> NDArray[np.int64]:
        """Numbers of exposures, of poses left out, and of points; adds what is seen to the map."""
        plan, left_out = self._plan(poses, work)
        if plan is None:
            return np.array([0, left_out, 0])
        pipeline, nominal = self._pipeline, self._world.nominal
        recording = pipeline.drive(self._world, plan, progress)
        points = self._world.sense(recording, "geometric", progress, alone=True, threads=pipeline.threads).points
        placed = nominal.tree.place(recording.measured.axes, ["table", "sensor"])
        table_from_sensor = pose.inverse(placed["table"]) @ placed["sensor"]
        seen = Profiles(table_from_sensor, points.points_in_sensor, np.asarray(points.frame, np.int64))
        self.space.add(seen, self._range)
        return np.array([len(recording), left_out, len(points.points_in_sensor)])

    def _plan(self, poses: Array, work: Work) -> tuple[Plan | None, int]:
        """A motion through free space to those of the poses that it leads to, and the number of the others."""
        setup, nominal = self._world.setup, self._world.nominal.with_axes_held()
        blocked = {"fixed": self.space.blocked(self._region.inflation)}
        cell = PlanningCell(
            replace(nominal, bodies=(*nominal.bodies, *occupied_bodies(blocked, nominal))),
            self._range,
            setup.cell.world.controller_cycle,
            threads=self._pipeline.threads,
            work=work,
        )
        check_part(cell)
        choices = self._free_joints(cell, poses)
        options = scan_options(setup.scan, setup.sensor)
        options = replace(options, scan=options.scan.model_copy(update={"mode": "stop-and-look"}))
        assembly, left_out, at = Assembly(cell, options), 0, nominal.home
        for joints in choices:
            reached = self._add(assembly, joints, at)
            at = at if reached is None else reached
            left_out += reached is None
        if left_out == len(poses):
            return None, left_out
        return Plan(*assembly.finish(), None, ()), left_out

    def _free_joints(self, cell: PlanningCell, poses: Array) -> Array:
        """Joints (n, choices, joints), rad, nearest to home for sensor poses (n, 4, 4); NaN where they collide."""
        home = cell.nominal.home
        turned = np.stack([poses, poses @ np.diag([-1.0, -1.0, 1.0, 1.0])], 1)  # by half a turn about the sensor's Z
        q = cell.ik(turned.reshape(-1, 4, 4), reference=home).reshape(len(poses), -1, len(home))
        travel = np.nan_to_num(np.abs(q - home).max(-1), nan=np.inf)
        nearest = np.argsort(travel, axis=1)[:, :_CHOICES]
        q = np.take_along_axis(q, nearest[..., None], 1)
        exists = np.isfinite(q).all(-1)
        near = cell.clearance_violations(with_table(q[exists], 0.0), self._clearance)
        rows, columns = np.nonzero(exists)
        colliding = [clash.index for clash in near]
        q[rows[colliding], columns[colliding]] = np.nan
        return q

    def _add(self, assembly: Assembly, choices: Array, at: Array) -> Array | None:
        """Add an exposure at the nearest of the joints (n, joints) that a free motion leads to; the joints."""
        travel = np.nan_to_num(np.abs(choices - at).max(1), nan=np.inf)
        for choice in np.argsort(travel):
            if not np.isfinite(travel[choice]):
                return None
            try:
                assembly.add_pose(PlacedPose("survey", np.append(choices[choice], 0.0)))
            except WorkLimitError:
                raise
            except PlanningError:
                continue
            return np.asarray(choices[choice])
        return None


def _merged(nominal: NominalCell, frames: dict[str, Array], kinds: tuple[str, ...]) -> Mesh:
    """One mesh of the bodies whose frame is of one of the kinds, in the frame of the table."""
    table_from_world = pose.inverse(frames["table"])
    chosen = [body for body in nominal.bodies if nominal.carrier(body.moves_with).partition("[")[0] in kinds]
    placed = [body.mesh.transformed(table_from_world @ frames[body.moves_with]) for body in chosen]
    return joined(placed, "cell")
