"""The control script of ur-rtde, which the Python package uploads, emulated by its protocol of registers.

The client writes a command into input register 0 and its arguments into others; the script answers 1 (ready) or 2
(done) in output register 0. Its text is not run: it is recognised by its name and its mark.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from scancell.arrays import Array
from scancell.errors import CommandError, ProgramError
from scancell.wire.ur import program as moves
from scancell.wire.ur.program import Task
from scancell.wire.ur.script import PoseLiteral, Statement, statements
from scancell.wire.ur.variables import pose_of, pose_vector

if TYPE_CHECKING:
    from scancell.wire.ur.controller import UrController

_READY, _DONE = 1, 2
_STREAMS = frozenset({9, 10, 11, 24})  # speeds and set-points, which end an asynchronous motion
_STOP = 255

_MARK = re.compile(r"^\s*def rtde_control\(\):")
_OFFSETS = re.compile(r"reg_offset_(float|int) = # (?:float|int) register offset\n\s*(\d+)")
_PATH = re.compile(r"# inject move path\n((?:[ \t]*(?:movej|movel|movep|movec|signal_async_progress)\(.*\n)*)")

# A word of the progress of asynchronous motions: from bit 24 its number, from bit 16 a count of changes, bit 15 while
# it runs, below that its progress.
_MOST = 127
_RUNS, _CHANGE, _OPERATION = 1 << 15, 1 << 16, 1 << 24

_ACCELERATION = 0.5  # rad/s² of speeds, by default
_STEADY = 1e-6  # rad/s


@dataclass(frozen=True)
class ControlScript:
    """What an uploaded control script states: the first registers that it uses, and the path put into it."""

    first_float: int
    first_int: int
    path: tuple[Statement, ...] = field(default=())

    @classmethod
    def of(cls, text: str) -> ControlScript | None:
        """The control script of a program; None if it is another program.

        Raises
        ------
        ProgramError
            If its path is not of the subset of `statements`.
        """
        if not _MARK.match(text) or "RTDE Control Script" not in text:
            return None
        offsets = {kind: int(number) for kind, number in _OFFSETS.findall(text)}
        lines = _PATH.search(text)
        path = statements(lines.group(1).rstrip("\n")) if lines and lines.group(1).strip() else []
        return cls(offsets.get("float", 0), offsets.get("int", 0), tuple(path))


class ControlProgram:
    """Runs an emulated control script."""

    def __init__(self, controller: UrController, script: ControlScript) -> None:
        self._controller, self._robot, self._script = controller, controller.robot, script
        self._background: Task | None = None  # an asynchronous motion
        self._operation = self._changes = 0
        self._immediate: dict[int, Callable[[], None]] = {
            9: self._speed_joints,
            10: self._speed_line,
            11: self._servo_joints,
            24: self._servo_line,
            26: lambda: self._write_floats([self._robot.cycle]),
            58: lambda: self._write_pose(self._robot.base_from_flange(self._robot.joints)),
        }
        self._answers: dict[int, Callable[[], None]] = {
            17: lambda: self._controller.log("set_payload: without effect, the drives of the cell have no load"),
            28: lambda: self._write_pose(self._robot.base_from_tcp(self._robot.targets)),
            29: self._set_tcp,
            30: self._inverse_kinematics,
            31: self._robot.stop,
            35: self._set_watchdog,
            36: lambda: self._write_int(1, self._reaches(self._pose(0))),
            37: lambda: self._write_int(1, self._robot.is_within_limits(self._floats(0))),
            39: lambda: self._write_pose(self._pose(0) @ self._pose(6)),
            40: lambda: self._write_pose(self._robot.flange_from_tcp),
            41: self._start_jog,
            43: lambda: self._write_pose(self._robot.base_from_tcp(self._robot.joints)),
            44: self._forward_kinematics,
            46: self._inverse_kinematics,
            47: lambda: self._write_int(1, bool(np.abs(self._robot.target_rates).max() < _STEADY)),
            60: lambda: self._write_int(1, self._reaches(self._pose(0))),
            61: lambda: self._write_int(1, self._reaches(self._pose(0))),
        }
        self._motions: dict[int, Callable[[], Task]] = {
            1: lambda: self._move(moves.move_joints, self._six(0)),
            2: lambda: self._move(moves.move_joints, PoseLiteral(self._six(0))),
            3: lambda: self._move(moves.move_line, PoseLiteral(self._six(0))),
            4: lambda: self._move(moves.move_line, self._six(0)),
            15: self._stop,
            16: self._stop,
            33: self._stop,
            34: self._stop,
            42: self._stop,
            45: self._move_path,
        }

    def run(self) -> Task:
        """Carry out commands until the one that ends the script.

        Raises
        ------
        ProgramError
            If a command is not emulated, or a motion is refused.
        """
        self._write_progress(0)
        self._write_int(0, _READY)
        is_done = False
        while True:
            command = self._int(0)
            if command in self._immediate:
                if command in _STREAMS:
                    self._end_background()
                self._immediate[command]()
                self._write_int(0, _READY)
            elif command == 0:
                is_done = False
                self._write_int(0, _READY)
            elif command == _STOP:
                self._controller.log("control script of ur-rtde: ended by its client")
                return
            elif not is_done:
                yield from self._perform(command)
                self._write_int(0, _DONE)
                is_done = True
            self._continue()
            yield

    def _perform(self, command: int) -> Task:
        if command in self._answers:
            self._answers[command]()
        elif command in self._motions:
            self._end_background()
            yield from self._motions[command]()
        else:
            raise ProgramError(f"command {command} of ur-rtde is not emulated")

    # Motions

    def _move(self, move: Callable[..., Task], target: Sequence[float] | PoseLiteral) -> Task:
        yield from self._run(move(self._controller, target, self._float(6)))

    def _move_path(self) -> Task:
        path = self._script.path
        if not path:
            raise ProgramError("move_path: the script has no path")
        yield from self._run(moves.run(self._controller, path))

    def _run(self, motion: Task) -> Task:
        """Run a motion to its end, or beside further commands where the client wants it."""
        if self._int(1) != 1:
            yield from motion
            return
        self._background = motion
        self._operation = (self._operation + 1) % (_MOST + 1)
        self._write_progress(_RUNS)

    def _continue(self) -> None:
        if self._background is None:
            if self._robot.fault:
                moves.check(self._controller)
            return
        try:
            next(self._background)
        except StopIteration:
            self._end_background()

    def _end_background(self) -> None:
        if self._background is not None:
            self._background = None
            self._write_progress(0)

    def _write_progress(self, running: int) -> None:
        self._changes = (self._changes + 1) % (_MOST + 1)
        self._write_int(2, self._operation * _OPERATION + self._changes * _CHANGE + running)

    def _stop(self) -> Task:
        yield from moves.stop(self._controller)

    def _speed_joints(self) -> None:
        rates = self._floats(0)
        self._robot.move_at_rates(lambda: rates, self._float(6) or _ACCELERATION)

    def _speed_line(self) -> None:
        velocity = self._floats(0)
        self._at_velocity(lambda: velocity, self._float(6))

    def _at_velocity(self, velocity: Callable[[], Array], acceleration: float) -> None:
        """Move the TCP at a velocity (6,); the acceleration, m/s², becomes one of the joints by the arm's reach."""
        reach = max(float(np.linalg.norm(self._robot.base_from_tcp(self._robot.targets)[:3, 3])), 0.1)
        joints = (acceleration or _ACCELERATION) / reach
        self._robot.move_at_rates(lambda: self._robot.rates_for(velocity()), joints)

    def _servo_joints(self) -> None:
        self._robot.servo(self._floats(0))

    def _servo_line(self) -> None:
        joints = self._robot.joints_nearby(self._pose(0))
        if joints is None:
            raise ProgramError("servol: the arm does not reach the pose")
        self._robot.servo(joints)

    def _start_jog(self) -> None:
        feature, velocity = int(self._float(6)), self._floats(0)
        axes = np.eye(3)
        if feature == 1:
            axes = self._robot.base_from_tcp(self._robot.joints)[:3, :3]
        elif feature == 2:
            axes = self._pose(8)[:3, :3]
        turned = np.concatenate([axes @ velocity[:3], axes @ velocity[3:]])
        self._at_velocity(lambda: turned, self._float(7))

    # Answers

    def _set_watchdog(self) -> None:
        self._controller.set_watchdog(f"input_int_register_{self._script.first_int}", self._float(0), "stop")

    def _set_tcp(self) -> None:
        self._robot.flange_from_tcp = self._pose(0)

    def _inverse_kinematics(self) -> None:
        try:
            joints = self._robot.joints_for(self._pose(0), self._floats(6) if self._int(0) == 30 else None)
        except CommandError as error:
            raise ProgramError(f"get_inverse_kin: {error}") from None
        self._write_floats(joints)

    def _forward_kinematics(self) -> None:
        self._write_pose(self._robot.base_from_flange(self._floats(0)) @ self._pose(6))

    def _reaches(self, base_from_tcp: Array) -> bool:
        try:
            self._robot.joints_for(base_from_tcp)
        except CommandError:
            return False
        return True

    # Registers

    def _int(self, number: int) -> int:
        return int(self._controller.registers.get(f"input_int_register_{self._script.first_int + number}", 0))

    def _float(self, number: int) -> float:
        name = f"input_double_register_{self._script.first_float + number}"
        return float(self._controller.registers.get(name, 0.0))

    def _floats(self, first: int) -> Array:
        return np.array([self._float(first + i) for i in range(6)])

    def _six(self, first: int) -> tuple[float, ...]:
        return tuple(self._floats(first).tolist())

    def _pose(self, first: int) -> Array:
        return pose_of(self._floats(first))

    def _write_int(self, number: int, value: int) -> None:
        self._controller.registers[f"output_int_register_{self._script.first_int + number}"] = int(value)

    def _write_floats(self, values: Sequence[float] | Array) -> None:
        for i, value in enumerate(values):
            self._controller.registers[f"output_double_register_{self._script.first_float + i}"] = float(value)

    def _write_pose(self, base_from_frame: Array) -> None:
        self._write_floats(pose_vector(base_from_frame))
