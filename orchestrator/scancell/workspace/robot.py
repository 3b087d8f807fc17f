"""The words of robot programs.

A program is a Python file with a function `main`::

    from scancell.workspace.robot import Robot, deg, location, mm


    def main(robot: Robot) -> None:
        over = location(450 * mm, 0, 230 * mm, rx=180 * deg)
        robot.speed(0.5)
        robot.move(over)
        cloud = robot.scan(over @ location(20 * mm, 0, 0), spacing=0.5 * mm)
        robot.save(cloud, "pass.ply")

Everything is in metres, radians and seconds: a number with a unit is multiplied by `mm` or `deg`. Poses are (4, 4)
``world_from_tool``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scancell.arguments import checked_arguments
from scancell.cell.readings import Tool
from scancell.config.choices import Engine
from scancell.errors import CommandError
from scancell.geometry import pose
from scancell.reconstruction.cloud import Cloud
from scancell.reconstruction.cloud_files import write_cloud
from scancell.scanning.profile import Profile
from scancell.scanning.session import ScanSession

Array = NDArray[np.float64]

mm = 1e-3
deg = float(np.pi / 180)

_PATIENCE = 60.0  # s, for signals


@dataclass(frozen=True)
class Step:
    """A command that was carried out: its name, what it was about, and simulated times of start and end, s."""

    command: str
    about: str
    begin: float
    end: float


@checked_arguments
def location(x: float, y: float, z: float, *, rx: float = 0.0, ry: float = 0.0, rz: float = 0.0) -> Array:
    """Pose (4, 4) at a position, m, with XYZ' Euler angles (intrinsic X, then Y, then Z'), rad."""
    return pose.from_euler_xyz((x, y, z), (rx, ry, rz))


class Robot:
    """The robot of a running cell, with its devices.

    Every command returns when it is done, and raises `CommandError` where the controller refuses it or the guard stops
    it.

    Parameters
    ----------
    session
        Of the running cell.
    engine
        How profiles are measured.
    folder
        Where `save` writes.
    on_step
        Receives each command that was carried out.

    Attributes
    ----------
    files
        That `save` has written.
    """

    @checked_arguments
    def __init__(
        self,
        session: ScanSession,
        engine: Engine = "ray-traced",
        folder: Path | None = None,
        on_step: Callable[[Step], None] = lambda _: None,
    ) -> None:
        self._session, self._engine, self._folder = session, engine, folder or Path()
        self._on_step = on_step
        self._speed = 1.0
        self._tool: Tool = "sensor"
        self.files: list[Path] = []

    # State

    @property
    def time(self) -> float:
        """Simulated time, s."""
        return self._now.time

    @property
    def joints(self) -> Array:
        """Measured joint angles (joints,), rad."""
        return self._now.joints

    @property
    def table_angle(self) -> float:
        """Measured angle of the table, rad."""
        return self._now.table

    @property
    def here(self) -> Array:
        """Pose (4, 4) of the tool by the measured joints and the nominal geometry."""
        return self._now.world_from_tool(self._tool)

    @property
    def _now(self) -> ScanSession:
        """The session; a program that only looks, and never lets time pass, can be ended here."""
        self._session.progress.advance(0.0)
        return self._session

    # How motions are made

    def speed(self, share: float) -> None:
        """Speed of the following motions: a share, above 0 to 1, of the full one."""
        if not 0.0 < share <= 1.0:
            raise CommandError(f"speed: share = {share:g}: expected above 0, at most 1")
        self._speed = share

    def tool(self, name: Tool) -> None:
        """What the following poses are of: ``sensor`` or ``gripper``."""
        self._session.flange_from(name)
        self._tool = name

    # Motion

    def home(self) -> None:
        """Move all joints to the home position of the description; the table does not turn."""
        with self._step("home"):
            self._session.move_joints(self._session.home, speed=self._speed)

    def move_joints(self, q: ArrayLike, table: float | None = None) -> None:
        """Move all joints to `q` (joints,) and the table to `table`, where given, together."""
        with self._step("move_joints", f"({_numbers(np.asarray(q, float) / deg)}) deg"):
            self._session.move_joints(q, table, speed=self._speed)

    def move(self, target: ArrayLike) -> None:
        """Move the tool to a pose (4, 4), all joints together: not on a straight line."""
        with self._step("move", _place(target)):
            self._session.move_joints(self._session.joints_for(target, self._tool), speed=self._speed)

    def move_line(self, target: ArrayLike) -> None:
        """Move the tool to a pose (4, 4) on a straight line."""
        with self._step("move_line", _place(target)):
            self._session.move_line(target, self._tool, speed=self._speed)

    def approach(self, target: ArrayLike, distance: float) -> None:
        """Move as `move` to `distance` in front of a pose (4, 4), against the tool's z."""
        with self._step("approach", f"{_place(target)}, {distance / mm:.1f} mm in front"):
            before = np.asarray(target, float) @ pose.translation((0.0, 0.0, -distance))
            self._session.move_joints(self._session.joints_for(before, self._tool), speed=self._speed)

    def depart(self, distance: float) -> None:
        """Move straight back by `distance`, against the tool's z."""
        with self._step("depart", f"{distance / mm:.1f} mm"):
            back = self.here @ pose.translation((0.0, 0.0, -distance))
            self._session.move_line(back, self._tool, speed=self._speed)

    def turn_table(self, angle: float) -> None:
        """Turn the table to `angle` (not wrapped)."""
        with self._step("turn_table", f"{angle / deg:.2f} deg"):
            self._session.move_table(angle, speed=self._speed)

    # Gripper and belts

    def open(self, width: float) -> None:
        """Bring the pads of the gripper `width` apart."""
        with self._step("open", f"{width / mm:.1f} mm"):
            self._session.open_gripper(width)

    def close(self, force: float) -> None:
        """Close the gripper with `force` (N, each finger) on something."""
        with self._step("close", f"{force:g} N"):
            self._session.grip(force)

    def run_belt(self, speed: float, number: int = 1) -> None:
        """Give a conveyor, numbered from 1, another speed, m/s; it accelerates while the program goes on."""
        with self._step("run_belt", f"{number}: {speed / mm:.1f} mm/s"):
            self._session.run_belt(number, speed)

    def belt_travel(self, number: int = 1) -> float:
        """Distance that a belt has travelled, m."""
        return self._now.value(f"conveyor[{number}].travel")

    # Signals and time

    def signal(self, number: int = 1) -> bool:
        """Whether a presence sensor, numbered from 1, sees a body."""
        return self._now.present(number)

    def distance(self, number: int = 1) -> float | None:
        """What a distance sensor, numbered from 1, reads, m; None where it measures nothing."""
        return self._now.distance(number)

    def wait_signal(self, number: int = 1, *, state: bool = True, timeout: float = _PATIENCE) -> None:
        """Wait until a presence sensor, numbered from 1, sees a body, or none (`state` False)."""
        with self._step("wait_signal", f"{number} {'on' if state else 'off'}"):
            what = f"signal {number} to be {'on' if state else 'off'}"
            self._session.wait_until(lambda: self.signal(number) == state, what, timeout)

    def wait_until(self, condition: Callable[[], bool], what: str, timeout: float = _PATIENCE) -> None:
        """Wait until `condition`, looked at in every controller cycle, holds; `what` names it."""
        with self._step("wait_until", what):
            self._session.wait_until(condition, what, timeout)

    def wait(self, duration: float) -> None:
        """Wait for `duration`, s."""
        with self._step("wait", f"{duration:g} s"):
            self._session.wait(duration)

    # Measurement

    def profile(self) -> Profile:
        """The profile that the sensor measures now."""
        with self._step("profile"):
            return self._session.profile(self._engine)

    def scan(self, target: ArrayLike, spacing: float) -> Cloud:
        """Move the sensor straight to a pose (4, 4) and measure a profile every `spacing` of its path.

        The cloud is in the frame of the part.
        """
        with self._step("scan", f"{_place(target)}, every {spacing / mm:g} mm"):
            return self._session.scan_line(target, spacing, speed=self._speed, engine=self._engine)

    def save(self, cloud: Cloud, name: str) -> None:
        """Write a cloud, in mm, to the folder of results; the ending of the name gives the format."""
        with self._step("save", f"{name}: {len(cloud)} points"):
            write_cloud(self._folder / name, cloud)
            self.files.append(self._folder / name)

    @contextmanager
    def _step(self, command: str, about: str = "") -> Iterator[None]:
        begin = self.time
        yield
        self._on_step(Step(command, about, begin, self.time))


def _numbers(values: Array) -> str:
    return ", ".join(f"{value:.1f}" for value in values)


def _place(target: ArrayLike) -> str:
    return f"({_numbers(np.asarray(target, float)[:3, 3] / mm)}) mm"
