"""The ports of scripts and of the dashboard as the server of one client each: bytes in, bytes out."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from scancell.errors import ProgramError
from scancell.wire.serve import Peer
from scancell.wire.ur.rtde import RtdeServer
from scancell.wire.ur.script import ScriptBuffer

if TYPE_CHECKING:
    from scancell.wire.ur.controller import UrController

_MAX_LINE = 1_000  # bytes of the dashboard
_MODEL, _SERIAL = "UR5", "20250000000"


class ScriptServer:
    """Takes programs in URScript; it sends nothing, where a robot sends its state.

    Attributes
    ----------
    is_open
        False after a program that is too large.
    is_started
        False: a client of this port receives no data.
    """

    is_started = False

    def __init__(self, controller: UrController) -> None:
        self._controller, self._buffer, self.is_open = controller, ScriptBuffer(), True

    def receive(self, received: bytes) -> bytes:
        """Run the programs that are complete."""
        try:
            for program in self._buffer.programs(received):
                self._controller.run_script(program)
        except ProgramError as error:
            self._controller.refuse("script", str(error))
            self.is_open = False
        return b""

    def cycle(self) -> bytes:
        """Nothing."""
        return b""

    def close(self) -> None:
        """End; a program goes on."""


class DashboardServer:
    """Answers lines of the dashboard.

    Attributes
    ----------
    is_open
        False after ``quit``, or a line that is too long.
    is_started
        False: a client of this port receives no data.
    """

    is_started = False

    def __init__(self, controller: UrController) -> None:
        self._controller, self._rest, self.is_open = controller, b"", True
        self._greeted = False
        self._commands: dict[str, Callable[[], str]] = {
            "polyscopeversion": lambda: "URSoftware {}.{}.{}.{} (scancell)".format(*controller.version),
            "get robot model": lambda: _MODEL,
            "get serial number": lambda: _SERIAL,
            "is in remote control": lambda: "true",
            "robotmode": lambda: "Robotmode: RUNNING",
            "safetymode": lambda: f"Safetymode: {self._safety}",
            "safetystatus": lambda: f"Safetystatus: {self._safety}",
            "running": lambda: f"Program running: {str(controller.is_running and not controller.is_paused).lower()}",
            "programstate": lambda: f"{self._state} scancell",
            "get loaded program": lambda: "No program loaded",
            "stop": self._stop,
            "pause": lambda: "Pausing program" if controller.pause() else "Failed to execute: pause",
            "play": lambda: "Starting program" if controller.play() else "Failed to execute: play",
            "unlock protective stop": lambda: (
                "Protective stop releasing" if controller.unlock() else "Cannot unlock: no protective stop is in force"
            ),
            "power on": lambda: "Powering on",
            "brake release": lambda: "Brake releasing",
            "close safety popup": lambda: "closing safety popup",
            "close popup": lambda: "closing popup",
        }

    def receive(self, received: bytes) -> bytes:
        """Answers to the lines that are complete."""
        *lines, self._rest = (self._rest + received).split(b"\n")
        answers = []
        for line in lines:
            answers.append(self._answer(line.decode(errors="replace").strip()) + "\n")
            if not self.is_open:
                break
        if len(self._rest) > _MAX_LINE:
            self._controller.refuse("dashboard", f"a line of more than {_MAX_LINE} bytes")
            self.is_open = False
        return "".join(answers).encode()

    def cycle(self) -> bytes:
        """The greeting, once."""
        if self._greeted:
            return b""
        self._greeted = True
        return b"Connected: Universal Robots Dashboard Server\n"

    def close(self) -> None:
        """End; a program goes on."""

    def _answer(self, line: str) -> str:
        if line.lower() == "quit":
            self.is_open = False
            return "Disconnected"
        command = self._commands.get(line.lower())
        if command is None:
            self._controller.refuse("dashboard", f"{line[:80]!r}")
            return f"could not understand: {line[:80]!r}"
        return command()

    def _stop(self) -> str:
        self._controller.stop_program()
        return "Stopped"

    @property
    def _safety(self) -> str:
        return "PROTECTIVE_STOP" if self._controller.robot.is_stopped else "NORMAL"

    @property
    def _state(self) -> str:
        if not self._controller.is_running:
            return "STOPPED"
        return "PAUSED" if self._controller.is_paused else "PLAYING"


def servers(controller: UrController) -> dict[int, Callable[[], Peer]]:
    """What makes the connection of a client, by the ports of a robot."""
    made: dict[int, Callable[[], Peer]] = {port: lambda: ScriptServer(controller) for port in (30001, 30002, 30003)}
    return made | {29999: lambda: DashboardServer(controller), 30004: lambda: RtdeServer(controller)}
