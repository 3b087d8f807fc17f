"""Commands of robot programs.

A program is a Python file with a function `main`::

    from scancell import Robot, deg, location, mm


    def main(robot: Robot) -> None:
        over = location(450 * mm, 0, 230 * mm, rx=180 * deg)
        robot.set_speed(0.5)
        robot.move_tool(over)
        cloud = robot.scan_line(over @ location(20 * mm, 0, 0), spacing=0.5 * mm)
        robot.save(cloud, "pass.ply")

Everything is in metres, radians and seconds: a number with a unit is multiplied by `mm` or `deg`. Poses are (4, 4)
``world_from_tool``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from scancell.arguments import Length, Share, checked_arguments
from scancell.arrays import Array
from scancell.cell.driver import Tool, WorldFromTool
from scancell.config.choices import Engine
from scancell.errors import CommandError
from scancell.geometry import pose
from scancell.reconstruction.cloud import Cloud
from scancell.reconstruction.cloud_files import write_cloud
from scancell.scanning.session import Profile, ScanSession

mm = 1e-3
deg = float(np.pi / 180)

_TIMEOUT = 60.0  # s


@dataclass(frozen=True)
class Step:
    """An executed command: its name, its subject, and simulated times of start and end, s."""

    command: str
    about: str
    begin: float
    end: float


@checked_arguments
def location(x: float, y: float, z: float, *, rx: float = 0.0, ry: float = 0.0, rz: float = 0.0) -> Array:
    """Pose (4, 4) at a position, with a rotation by Euler angles.

    Parameters
    ----------
    x, y, z
        Position, m.
    rx, ry, rz
        Intrinsic rotations about x, then y, then z, rad.

    Raises
    ------
    DescriptionError
        If one of them is no finite number.

    Examples
    --------
    The constants `mm` and `deg` convert to metres and radians. Poses are joined by ``@``:

    >>> from scancell import deg, location, mm
    >>> over = location(450 * mm, 0, 230 * mm, rx=180 * deg)
    >>> print((over @ location(20 * mm, 10 * mm, 50 * mm))[:3, 3].round(3))
    [ 0.47 -0.01  0.18]
    """
    return pose.from_euler_xyz((x, y, z), (rx, ry, rz))


class Robot:
    """The robot of a running cell, with its devices, as robot programs see it.

    Every command returns when it is done, and raises `CommandError` where the controller refuses it or the guard stops
    it. Lengths are in metres, angles in radians, times in simulated seconds; poses (4, 4) are ``world_from_tool``.
    Devices are numbered from 1; `CellError` where the cell has no such device.

    Parameters
    ----------
    session
        Session of the running cell.
    engine
        How profiles are measured: ``ray-traced`` renders images, ``geometric`` intersects rays with surfaces.
    folder
        Where `save` writes; the working folder if not given.
    on_step
        Receives each command that was carried out: its name ``command``, its subject (``about``), and times
        ``begin`` and ``end``, s.
    before_step
        Receives the name of each command before it is carried out; the program continues when it returns.

    Attributes
    ----------
    files
        Files that `save` has written.

    Examples
    --------
    >>> from scancell import deg, location, mm
    >>> start = location(450 * mm, 0, 230 * mm, rx=180 * deg)
    >>> with scancell.Scanner() as scanner, scanner.session("part.stl", guarded=True) as session:
    ...     robot = scancell.Robot(session, "geometric")
    ...     robot.move_tool(start)
    ...     cloud = robot.scan_line(start @ location(20 * mm, 0, 0), spacing=1 * mm)
    ...     robot.save(cloud, "pass.ply")
    >>> cloud, robot.files
    (Cloud(... points of 21 profiles), [PosixPath('pass.ply')])
    """

    @checked_arguments
    def __init__(
        self,
        session: ScanSession,
        engine: Engine = "ray-traced",
        folder: str | Path | None = None,
        on_step: Callable[[Step], None] = lambda _: None,
        before_step: Callable[[str], None] = lambda _: None,
    ) -> None:
        self._session, self._engine, self._folder = session, engine, Path(folder or ".")
        self._on_step, self._before_step = on_step, before_step
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
        return self._now.table_angle

    @property
    def further_axes(self) -> Array:
        """Measured positions (k,) of the axes beyond joints and table, rad or m."""
        return self._now.further_axes

    @property
    def axis_speeds(self) -> Array:
        """Full speeds (axes,) of joints, table and further axes, rad/s or m/s."""
        return self._session.axis_speeds

    @property
    def line_speed(self) -> float:
        """Full speed of the tool in straight lines, m/s."""
        return self._session.line_speed

    def world_from_tool(self, tool: Tool | None = None) -> Array:
        """Pose (4, 4) of `tool`, by default that of `set_tool`, by the measured joints and the nominal geometry."""
        return self._now.world_from_tool(tool or self._tool)

    def flange_from_tools(self) -> dict[str, Array]:
        """Poses (4, 4) on the flange of all tools of the cell, by their names."""
        return self._session.flange_from_tools()

    def world_from_frame(self, frame: str) -> Array:
        """Pose (4, 4) of ``base``, ``table`` at the measured table angle, or a user frame of the description.

        A pose in the frame is ``robot.world_from_frame("fixture") @ location(...)``.
        """
        return self._now.world_from_frame(frame)

    @property
    def _now(self) -> ScanSession:
        """The session; a program that only reads, and never lets time pass, can be ended here."""
        self._session.progress.advance(0.0)
        return self._session

    # How motions are made

    @checked_arguments
    def set_speed(self, share: Share) -> None:
        """Set the speed of the following motions to `share`, above 0 to 1, of the full speed."""
        self._speed = share

    def set_monitor_speed(self, share: float) -> None:
        """Scale the speed of all motions by `share`, 0 to 1; a guard limits it to what it allows."""
        self._session.set_monitor_speed(share)

    def set_tool(self, tool: Tool) -> None:
        """Set the `tool` of the following poses: ``sensor``, as at the start, ``gripper``, or a described tool."""
        self._session.flange_from_tool(tool)
        self._tool = tool

    # Motion

    def move_home(self) -> None:
        """Move all joints to the home position of the description; the table does not turn."""
        with self._step("move_home"):
            self._session.move_joints(self._session.home, **self._pace)

    def move_joints(self, joints: ArrayLike, table_angle: float | None = None) -> None:
        """Move all joints to `joints` (joints,), rad, and the table to `table_angle`, rad, where given, together."""
        with self._step("move_joints", f"({_numbers(np.asarray(joints, float) / deg)}) deg"):
            self._session.move_joints(joints, table_angle, **self._pace)

    @checked_arguments
    def move_tool(self, world_from_tool: WorldFromTool) -> None:
        """Move the tool to the pose `world_from_tool` (4, 4), all joints together: not on a straight line."""
        with self._step("move_tool", _position(world_from_tool)):
            self._session.move_tool(world_from_tool, self._tool, **self._pace)

    @checked_arguments
    def move_line(self, world_from_tool: WorldFromTool) -> None:
        """Move the tool to the pose `world_from_tool` (4, 4) on a straight line."""
        with self._step("move_line", _position(world_from_tool)):
            self._session.move_line(world_from_tool, self._tool, **self._pace)

    @checked_arguments
    def approach(self, world_from_tool: WorldFromTool, distance: float) -> None:
        """Move as `move_tool` to `distance` (m) in front of `world_from_tool` (4, 4), against the tool's z."""
        with self._step("approach", f"{_position(world_from_tool)}, {distance / mm:.1f} mm in front"):
            before = np.asarray(world_from_tool, float) @ pose.translation((0.0, 0.0, -distance))
            self._session.move_tool(before, self._tool, **self._pace)

    def depart(self, distance: float) -> None:
        """Move straight back by `distance`, m, against the tool's z."""
        with self._step("depart", f"{distance / mm:.1f} mm"):
            back = self.world_from_tool() @ pose.translation((0.0, 0.0, -distance))
            self._session.move_line(back, self._tool, **self._pace)

    def turn_table(self, table_angle: float) -> None:
        """Turn the table to `table_angle` (not wrapped), rad."""
        with self._step("turn_table", f"{table_angle / deg:.2f} deg"):
            self._session.turn_table(table_angle, **self._pace)

    def move_axis(self, name: str, position: float) -> None:
        """Move the axis `name` beyond joints and table, such as a track, to `position`, rad or m."""
        about = next((axis.in_words(position) for axis in self._session.nominal.further_axes if axis.name == name), "")
        with self._step("move_axis", f"{name}: {about}"):
            self._session.move_axis(name, position, **self._pace)

    # Gripper and conveyors

    def open_gripper(self, width: float) -> None:
        """Bring the pads of the gripper `width` apart, m."""
        with self._step("open_gripper", f"{width / mm:.1f} mm"):
            self._session.open_gripper(width)

    def close_gripper(self, force: float) -> None:
        """Close the gripper with `force` (N, each finger) on something."""
        with self._step("close_gripper", f"{force:g} N"):
            self._session.close_gripper(force)

    def run_conveyor(self, conveyor: int, speed: float) -> None:
        """Give conveyor number `conveyor` (from 1) the `speed`, m/s; it accelerates while the program goes on."""
        with self._step("run_conveyor", f"{conveyor}: {speed / mm:.1f} mm/s"):
            self._session.run_conveyor(conveyor, speed)

    def follow_conveyor(
        self,
        conveyor: int,
        poses: Sequence[WorldFromTool],
        *,
        dwell: float = 0.0,
        grip_at: int | None = None,
        force: float = 20.0,
    ) -> None:
        """Move the tool relative to the running belt of conveyor number `conveyor` (from 1), and come to rest.

        Parameters
        ----------
        poses
            ``world_from_tool`` (4, 4) each, where the belt has them now; they move on with it. The tool moves straight
            in its frame from one to the next.
        dwell
            Time at each, s.
        grip_at
            Number of the pose, from 0, at which the gripper begins to close; None: it does not.
        force
            Of each finger, N.

        Raises
        ------
        CommandError
            If the arm cannot follow the belt, see `ScanSession.follow_conveyor`.
        """
        if grip_at is not None and grip_at not in range(len(poses)):
            raise CommandError(f"follow_conveyor: grip_at = {grip_at}: expected 0 to {len(poses) - 1}")

        def close(number: int) -> None:
            if number == grip_at:
                self._session.start_close_gripper(force)

        with self._step("follow_conveyor", f"{conveyor}: {len(poses)} poses"):
            self._session.follow_conveyor(
                conveyor, poses, dwell=dwell, tool=self._tool, speed=self._speed, on_pose=close
            )

    def conveyor_travel(self, conveyor: int) -> float:
        """Signed distance that the belt of conveyor number `conveyor` (from 1) has travelled, m."""
        return self._now.conveyor_travel(conveyor)

    # Sensors and time

    def presence(self, sensor: int) -> bool:
        """Whether presence sensor number `sensor` (from 1) detects a body."""
        return self._now.presence(sensor)

    def distance(self, sensor: int) -> float | None:
        """Reading of distance sensor number `sensor` (from 1), m; None where its measurement was discarded."""
        return self._now.distance(sensor)

    def wait_for_presence(self, sensor: int, detected: bool = True, *, timeout: float = _TIMEOUT) -> None:
        """Wait until presence sensor number `sensor` (from 1) detects a body, or none (`detected` False).

        Raises
        ------
        CommandError
            If it does not within `timeout`, s.
        """
        expected = "something" if detected else "nothing"
        with self._step("wait_for_presence", f"{sensor}: {expected}"):
            what = f"{expected} at presence sensor {sensor}"
            self._session.wait_until(lambda: self.presence(sensor) == detected, what, timeout)

    def wait_until(self, condition: Callable[[], bool], what: str, timeout: float = _TIMEOUT) -> None:
        """Wait until `condition`, evaluated in every controller cycle, holds; `what` names it in messages.

        Raises
        ------
        CommandError
            If it does not hold within `timeout`, s.
        """
        with self._step("wait_until", what):
            self._session.wait_until(condition, what, timeout)

    def wait(self, duration: float) -> None:
        """Wait for `duration`, s, at least one controller cycle."""
        with self._step("wait", f"{duration:g} s"):
            self._session.wait(duration)

    # Measurement

    def profile(self) -> Profile:
        """Measure a profile at the present pose."""
        with self._step("profile"):
            return self._session.profile(self._engine)

    @checked_arguments
    def scan_line(self, world_from_sensor: WorldFromTool, spacing: Length) -> Cloud:
        """Move the sensor straight to `world_from_sensor` (4, 4) and measure a profile every `spacing` (m) of its path.

        The cloud is in the frame of the part, m.
        """
        with self._step("scan_line", f"{_position(world_from_sensor)}, every {spacing / mm:g} mm"):
            return self._session.scan_line(world_from_sensor, spacing, speed=self._speed, engine=self._engine)

    @checked_arguments
    def scan_table(self, table_angle: float, spacing: Length) -> Cloud:
        """Turn the table to `table_angle` (not wrapped), rad, and measure a profile every `spacing` (rad) of its turn.

        The cloud is in the frame of the part, m.
        """
        with self._step("scan_table", f"{table_angle / deg:.2f} deg, every {spacing / deg:g} deg"):
            return self._session.scan_table(table_angle, spacing, speed=self._speed, engine=self._engine)

    def save(self, cloud: Cloud, name: str) -> None:
        """Write `cloud`, in mm, to the file `name` in the folder of results; its ending gives the format.

        Raises
        ------
        OutputError
            If the file cannot be written.
        """
        with self._step("save", f"{name}: {len(cloud)} points"):
            write_cloud(self._folder / name, cloud)
            self.files.append(self._folder / name)

    @property
    def _pace(self) -> dict[str, float]:
        """Speed of a motion and its longest duration, s."""
        return {"speed": self._speed, "timeout": _TIMEOUT / self._speed}

    @contextmanager
    def _step(self, command: str, about: str = "") -> Iterator[None]:
        self._before_step(command)
        begin = self.time
        yield
        self._on_step(Step(command, about, begin, self.time))


def _numbers(values: Array) -> str:
    return ", ".join(f"{value:.1f}" for value in values)


def _position(world_from_tool: ArrayLike) -> str:
    return f"({_numbers(np.asarray(world_from_tool, float)[:3, 3] / mm)}) mm"
