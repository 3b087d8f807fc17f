"""The controller of a simulated robot of Universal Robots: registers, programs, safety; its protocols share it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from scancell.errors import ProgramError
from scancell.wire.robot import RobotController, VirtualRobot
from scancell.wire.ur import program as programs
from scancell.wire.ur.control import ControlProgram, ControlScript
from scancell.wire.ur.program import Task
from scancell.wire.ur.script import is_secondary, statements
from scancell.wire.ur.variables import INPUTS, REGISTERS

_STOPPED, _PLAYING, _PAUSED = 1, 2, 4  # runtime_state
_ACTIONS = ("pause", "stop", "ignore")  # of a watchdog


@dataclass(frozen=True)
class _Watchdog:
    """A register that must be written within `longest`, s, or else the action is taken."""

    register: str
    longest: float
    action: str


class UrController(RobotController):
    """Runs one program at a time, and steps the robot; parameters and errors are those of `RobotController`.

    Attributes
    ----------
    registers
        Values of registers by their RTDE names; those that are missing are 0.
    """

    version = (5, 12, 0, 0)  # of PolyScope, whose interfaces are emulated
    speed_slider: float

    def __init__(self, robot: VirtualRobot, show: Callable[[str], None] = lambda _: None) -> None:
        super().__init__(robot, show)
        self.registers: dict[str, float] = {}
        self.speed_slider = 1.0
        self._program: Task | None = None
        self._is_paused = False
        self._reserved: dict[object, set[str]] = {}
        self._watchdog: _Watchdog | None = None
        self._written: dict[str, float] = {}  # times of the last writing

    # Inputs

    def write_register(self, name: str, value: float) -> None:
        """Write a register."""
        self.registers[name] = value
        self._written[name] = self.robot.time

    def inputs_of_others(self, client: object) -> set[str]:
        """Registers that other clients write."""
        return set().union(*(names for other, names in self._reserved.items() if other is not client))

    def reserve_inputs(self, client: object, names: Sequence[str]) -> None:
        """Reserve registers for a client."""
        self._reserved.setdefault(client, set()).update(name for name in names if name in REGISTERS)

    def release_inputs(self, client: object) -> None:
        """Release the registers of a client."""
        self._reserved.pop(client, None)

    def set_speed_slider(self, share: float) -> None:
        """Set the speed of all motions, clipped to 0 to 1."""
        self.speed_slider = float(np.clip(share, 0.0, 1.0))
        self._apply_speed()

    def set_watchdog(self, register: str, frequency: float, action: str) -> None:
        """Stop or pause the program if an input register is written less often than at `frequency`, Hz; 0: never.

        Raises
        ------
        ProgramError
            If there is no such register or action.
        """
        if register not in INPUTS or register not in REGISTERS:
            raise ProgramError(f"rtde_set_watchdog: {register[:40]!r}: expected an input register of RTDE")
        if action not in _ACTIONS:
            raise ProgramError(f"rtde_set_watchdog: {action[:40]!r}: expected one of {', '.join(_ACTIONS)}")
        if frequency <= 0.0 or action == "ignore":
            self._watchdog = None
            return
        self._watchdog = _Watchdog(register, 1.0 / frequency, action)
        self._written[register] = self.robot.time

    # Programs

    @property
    def is_running(self) -> bool:
        """Whether a program runs or is paused."""
        return self._program is not None

    @property
    def is_paused(self) -> bool:
        """Whether a program is paused."""
        return self.is_running and self._is_paused

    @property
    def runtime_state(self) -> int:
        """State of the program as RTDE numbers it."""
        if not self.is_running:
            return _STOPPED
        return _PAUSED if self._is_paused else _PLAYING

    def run_script(self, text: str) -> None:
        """Run a program, which ends the one before; a secondary one runs beside it, at once.

        A program that is not of the subset is refused as a whole, with its line.
        """
        try:
            control = ControlScript.of(text)
            parsed = statements(text) if control is None else []
            if is_secondary(text):
                self._run_at_once(programs.run(self, parsed))
                return
        except ProgramError as error:
            self.refuse("script", str(error))
            return
        if self.robot.is_stopped:
            self.refuse("script", "a protective stop is in force: release it first")
            return
        self.stop_program()
        self.log("control script of ur-rtde" if control else f"program of {len(parsed)} statements")
        self._program = programs.run(self, parsed) if control is None else ControlProgram(self, control).run()

    def stop_program(self) -> bool:
        """End the program and its motions; whether one was running."""
        was_running, self._program, self._watchdog = self.is_running, None, None
        self._is_paused = False
        self._apply_speed()
        if was_running:
            self.robot.hold()
        return was_running

    def pause(self) -> bool:
        """Pause the program on its path; whether one is running."""
        self._is_paused = self.is_running
        self._apply_speed()
        return self.is_running

    def play(self) -> bool:
        """Continue a paused program; whether there is one."""
        was_paused, self._is_paused = self.is_paused, False
        self._apply_speed()
        return was_paused

    def unlock(self) -> bool:
        """Release a protective stop; whether there was one."""
        if not self.robot.is_stopped:
            return False
        self.robot.reset()
        return True

    def step(self) -> None:
        """Let a cycle of the controller pass."""
        self._check_watchdog()
        if self.robot.is_stopped and self.is_running:
            self.log(f"protective stop: {self.robot.text}")
            self.stop_program()
        if self._program is not None and not self._is_paused:
            self._advance(self._program)
        self.robot.step()

    def _advance(self, program: Task) -> None:
        try:
            next(program)
        except StopIteration:
            self.log("program ended")
            self.stop_program()
        except ProgramError as error:
            self.refuse("program", str(error))
            self.stop_program()

    def _run_at_once(self, program: Task) -> None:
        """Run a secondary program, which takes no time."""
        for _ in program:
            raise ProgramError("a secondary program takes no time: no motion, no sleep")

    def _check_watchdog(self) -> None:
        watchdog = self._watchdog
        if watchdog is None or self._is_paused:
            return
        if self.robot.time - self._written[watchdog.register] > watchdog.longest + self.robot.cycle:
            self.log(f"watchdog: {watchdog.register} was not written for {watchdog.longest:g} s")
            if watchdog.action == "pause":
                self.pause()
            else:
                self.stop_program()

    def _apply_speed(self) -> None:
        self.robot.speed_fraction = 0.0 if self._is_paused else self.speed_slider
