"""Readings of the sensors and encoders of a running cell."""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scancell.cell.instance import CellInstance
from scancell.errors import CommandError
from scancell.geometry import pose
from scancell.nominal.cell import NominalCell

Array = NDArray[np.float64]
Tool = Literal["sensor", "gripper"]


class CellReadings:
    """Reads a running cell; SI units and radians, truth excluded."""

    def __init__(self, cell: CellInstance, nominal: NominalCell) -> None:
        self._cell, self._nominal = cell, nominal
        self._position = cell.real_group(cell.axis_names("measured."))
        self._commanded = cell.real_group(cell.axis_names("controller.ahead[1]."))
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
        return self._cell.get(self._position)[:-1].copy()

    @property
    def table_angle(self) -> float:
        """Measured angle of the table, rad."""
        return float(self._cell.get(self._position)[-1])

    @property
    def commanded(self) -> Array:
        """Joints and table angle (joints + 1,) that the controller commands while the robot rests, rad."""
        return self._cell.get(self._commanded).copy()

    @property
    def destination(self) -> Array:
        """Joints and table angle (joints + 1,) to which the motion in force, or the last one, leads, rad."""
        return self._cell.get(self._destination).copy()

    def world_from_tool(self, tool: Tool = "sensor") -> Array:
        """Pose (4, 4) of `tool` (``sensor`` or ``gripper``) by the measured joints and the nominal geometry."""
        return np.asarray(self._nominal.arm.fk(self.joints) @ self.flange_from_tool(tool))

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
        """Signed distance that the belt of conveyor number `conveyor` (from 1) has travelled since the start, m."""
        return self.value(f"conveyor[{conveyor}].travel")

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

    def joints_for(
        self,
        world_from_tool: ArrayLike,
        tool: Tool = "sensor",
        near: ArrayLike | None = None,
        configuration: str | None = None,
    ) -> Array:
        """Joint angles (joints,), rad, that bring a tool to a pose.

        Parameters
        ----------
        world_from_tool
            Pose (4, 4).
        tool
            ``sensor`` or ``gripper``, whose origin lies between the pads.
        near
            Angles (joints,), rad: of all branches the one counts whose largest difference from them is smallest. None:
            the present joints.
        configuration
            Name of the only branch that counts (``NominalCell.arm.branch_names``); None: all of them.

        Raises
        ------
        CommandError
            If no branch, or not that of the configuration, reaches the pose within the joint limits.
        """
        reference = self.joints if near is None else np.asarray(near, float)
        target = self._world_from_flange(world_from_tool, tool)
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

    def flange_from_tool(self, tool: Tool) -> Array:
        """Pose (4, 4) of `tool` on the flange: ``sensor``, or ``gripper``, whose origin lies between the pads.

        Raises
        ------
        CommandError
            If the cell has no such tool.
        """
        if tool not in get_args(Tool):
            raise CommandError(f"tool = {tool!r}: expected {' or '.join(get_args(Tool))}")
        if tool == "sensor":
            return self._nominal.flange_from_sensor
        fingers = self._nominal.flange_from_finger
        if fingers is None:
            raise CommandError("the cell has no gripper")
        flange_from_gripper = fingers[0].copy()
        flange_from_gripper[:3, 3] = fingers[:, :3, 3].mean(0)
        return np.asarray(flange_from_gripper)

    def _world_from_flange(self, world_from_tool: ArrayLike, tool: Tool) -> Array:
        target = np.asarray(world_from_tool, float)
        if target.shape != (4, 4) or not np.isfinite(target).all():
            raise CommandError(f"world_from_tool = {world_from_tool!r}: expected a pose (4, 4)")
        return np.asarray(target @ pose.inverse(self.flange_from_tool(tool)))
