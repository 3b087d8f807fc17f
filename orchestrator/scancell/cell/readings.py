"""Readings of a running cell for scripts: sensors, encoders and controller, but no true values."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from scancell.arguments import checked_arguments
from scancell.arrays import Array
from scancell.cell.driver import JointAngles, Tool, WorldFromTool
from scancell.cell.instance import CellInstance
from scancell.errors import CommandError
from scancell.geometry import pose
from scancell.nominal.cell import NominalCell, flange_from_tool, tool_names, world_from_frame


class CellReadings:
    """Readings of a running cell, and poses of its tools by them and the nominal geometry; see `CellSession`."""

    def __init__(self, cell: CellInstance, nominal: NominalCell) -> None:
        self._cell, self._nominal = cell, nominal
        self._position = cell.real_group(cell.axis_names("measured."))
        self._destination = cell.real_group(cell.axis_names("controller.destination."))

    @property
    def cell(self) -> CellInstance:
        """The running instance."""
        return self._cell

    @property
    def time(self) -> float:
        """Simulated time, s."""
        return self._cell.time_us * 1e-6

    @property
    def home(self) -> Array:
        """Joint angles (joints,) of the home position, rad."""
        return self._nominal.home.copy()

    @property
    def joints(self) -> Array:
        """Measured joint angles (joints,), rad."""
        return self._cell.get(self._position)[: len(self.home)].copy()

    @property
    def table_angle(self) -> float:
        """Measured angle of the table, rad."""
        return float(self._cell.get(self._position)[len(self.home)])

    @property
    def further_axes(self) -> Array:
        """Measured positions (k,) of the axes beside joints and table, rad or m."""
        return self._cell.get(self._position)[len(self.home) + 1 :].copy()

    @property
    def axis_speeds(self) -> Array:
        """Full speeds (axes,) of joints, table and further axes, rad/s or m/s."""
        return self._nominal.axis_max_speed.copy()

    @property
    def commanded(self) -> Array:
        """Positions (axes,) that the controller commands while the robot rests, rad or m."""
        return self._cell.get(self._cell.path_ahead(1))[: self._position.count].copy()

    @property
    def destination(self) -> Array:
        """Target of the running or last motion: positions (axes,), rad or m."""
        return self._cell.get(self._destination).copy()

    def world_from_tool(self, tool: Tool = "sensor") -> Array:
        """Pose (4, 4) of a `tool` (see `flange_from_tool`) by the measured joints and the nominal geometry."""
        world_from_flange = self._nominal.world_from(self._nominal.arm.flange, self._cell.get(self._position))
        return np.asarray(world_from_flange @ self.flange_from_tool(tool))

    @checked_arguments
    def world_from_frame(self, frame: str) -> Array:
        """Pose (4, 4) of a `frame` in which poses can be given, by nominal geometry and the measured table angle.

        It is ``base``, ``table``, or a user frame of the description (``[[frame]]``).

        Raises
        ------
        DescriptionError
            If the cell has no such frame.
        """
        return world_from_frame(self._nominal, frame, self._cell.get(self._position))

    def presence(self, sensor: int) -> bool:
        """Whether presence sensor number `sensor` (from 1) detects a body."""
        return self._cell.get_boolean(f"presence[{sensor}].detected")

    def distance(self, sensor: int) -> float | None:
        """Reading of distance sensor number `sensor` (from 1), m; None where its measurement was discarded."""
        if not self._cell.get_boolean(f"distance[{sensor}].valid"):
            return None
        return self.value(f"distance[{sensor}].value")

    @property
    def gripper_width(self) -> float:
        """Distance between the pads, m."""
        return self.value("measured.gripper.width")

    def conveyor_travel(self, conveyor: int) -> float:
        """Signed distance that the belt of conveyor number `conveyor` (from 1) has travelled since the start by its
        encoder, m."""
        return self.value(f"measured.conveyor[{conveyor}].travel")

    def value(self, name: str) -> float:
        """Value of the real variable `name` of the FMU, SI.

        Raises
        ------
        CommandError
            If it is a true value (``truth.*``, ``trigger.truth.*``), which no real cell provides.
        CellError
            If there is no such variable.
        """
        if "truth" in name.split("."):
            raise CommandError(
                f"{name}: a session reads measured values only; true values are in the recording (Recording.truth)"
            )
        return float(self._cell.get(self._cell.real_group([name]))[0])

    @checked_arguments
    def joints_for(
        self,
        world_from_tool: WorldFromTool,
        tool: Tool = "sensor",
        near: JointAngles | None = None,
        configuration: str | None = None,
        axes: ArrayLike | None = None,
    ) -> Array:
        """Joint angles (joints,), rad, that bring a tool to a pose.

        Parameters
        ----------
        world_from_tool
            Pose (4, 4).
        tool
            See `flange_from_tool`.
        near
            Angles (joints,), rad: of all branches the one counts whose largest difference from them is smallest. None:
            the present joints.
        configuration
            Name of the only branch that counts (``NominalCell.arm.branch_names``); None: all of them.
        axes
            Positions (axes,) of all axes, rad or m, from which it is brought there; None: the measured ones.

        Raises
        ------
        CommandError
            If no branch, or not that of the configuration, reaches the pose within the joint limits, or there is no
            such configuration.
        DescriptionError
            If `world_from_tool` is no pose, or there is no such tool.
        """
        start = self._cell.get(self._position) if axes is None else np.asarray(axes, float)
        reference = start[: len(self.home)].copy() if near is None else np.asarray(near, float)
        carrier = self._nominal.world_from(self._nominal.arm_on, start)
        target = pose.inverse(carrier) @ np.asarray(world_from_tool, float) @ pose.inverse(self.flange_from_tool(tool))
        branches, names = self._nominal.arm.ik(target, reference)[0], self._nominal.arm.branch_names
        if configuration is not None:
            if configuration not in names:
                raise CommandError(f"configuration {configuration}: expected one of {', '.join(names)}")
            branches = branches[[names.index(configuration)]]
        found = branches[np.isfinite(branches).all(-1)]
        if not len(found):
            place = ", ".join(f"{x * 1e3:.1f}" for x in np.asarray(world_from_tool, float)[:3, 3])
            how = "" if configuration is None else f", configuration {configuration}"
            raise CommandError(
                f"the {tool} cannot be brought to ({place}) mm in this orientation within joint limits{how}"
            )
        return np.asarray(found[np.argmin(np.abs(found - reference).max(-1))])

    @checked_arguments
    def flange_from_tool(self, tool: Tool) -> Array:
        """Pose (4, 4) of `tool` on the flange.

        It is ``sensor``, ``gripper``, whose origin lies between the pads, or a tool of the description (``[[tcp]]``).

        Raises
        ------
        CommandError
            If `tool` is ``gripper`` and the cell has none.
        DescriptionError
            If the cell has no such tool.
        """
        return flange_from_tool(self._nominal, tool)

    def flange_from_tools(self) -> dict[str, Array]:
        """Poses (4, 4) on the flange of all tools of the cell, by their names."""
        return {name: self.flange_from_tool(name) for name in tool_names(self._nominal)}
