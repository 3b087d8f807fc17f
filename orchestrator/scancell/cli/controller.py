"""`scancell controller`: the interfaces of makers' controllers to the simulated robot."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Callable, Iterator
from ipaddress import ip_address
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

import scancell
from scancell.cli.common import Outcome, SetOption, TablePartOption, UnitOption, command
from scancell.config.choices import LOOPBACK

if TYPE_CHECKING:
    from scancell.wire.abb.controller import EgmController
    from scancell.wire.kuka.controller import RsiController
    from scancell.wire.robot import RobotController, VirtualRobot
    from scancell.wire.serve import Peer, Timing

CellArgument = Annotated[Path, "cell description (TOML) with an arm of six joints, such as assets/cells/ur5e.toml"]
SimulatedOption = Annotated[
    bool, typer.Option("--simulated/--real-time", help="as fast as the clients read, or by the clock")
]
ProgramOption = Annotated[str, "address of the program that guides the robot"]
PortOption = Annotated[int, typer.Option(min=1, max=65535, help="port of this program")]


@command("controller ur")
def controller_ur(
    cell: CellArgument,
    part: TablePartOption = None,
    unit: UnitOption = "mm",
    settings: SetOption = None,
    host: Annotated[str, "address to listen on"] = LOOPBACK,
    simulated: SimulatedOption = False,
    guard: Annotated[bool, typer.Option("--guard", help="with the collision guard, which permits moves alone")] = False,
    as_json: bool = False,
) -> Outcome:
    """Serve RTDE (port 30004), scripts (30003) and dashboard (29999) of a UR until Ctrl-C (docs/wire.md)."""
    from scancell.wire.serve import serve_controller  # noqa: PLC0415
    from scancell.wire.ur.controller import UrController  # noqa: PLC0415
    from scancell.wire.ur.ports import servers  # noqa: PLC0415

    show = _show(as_json)

    def started(address: str) -> None:
        show(f"controller: ur {address}")
        if not ip_address(address).is_loopback:
            print(
                "warning: other machines can reach the controller, and requests are not authenticated", file=sys.stderr
            )

    with _robot(cell, settings, part, unit, guard) as robot:
        controller = UrController(robot, show)
        return _outcome(controller, serve_controller(controller, servers(controller), host, not simulated, started))


@command("controller abb")
def controller_abb(
    cell: CellArgument,
    part: TablePartOption = None,
    unit: UnitOption = "mm",
    settings: SetOption = None,
    host: ProgramOption = LOOPBACK,
    port: PortOption = 6510,
    simulated: SimulatedOption = False,
    as_json: bool = False,
) -> Outcome:
    """Send states by EGM of ABB to a program, which guides the robot, until Ctrl-C (docs/wire.md)."""
    from scancell.wire.abb.controller import EgmController, EgmServer  # noqa: PLC0415

    show = _show(as_json)
    with _robot(cell, settings, part, unit) as robot:
        controller = EgmController(robot, show)
        return _guided("abb", controller, EgmServer(controller), (host, port), simulated, show)


@command("controller kuka")
def controller_kuka(
    cell: CellArgument,
    part: TablePartOption = None,
    unit: UnitOption = "mm",
    settings: SetOption = None,
    host: ProgramOption = LOOPBACK,
    port: PortOption = 49152,
    absolute: Annotated[
        bool,
        typer.Option("--absolute/--relative", help="corrections count from the start, or from the cycle before"),
    ] = False,
    simulated: SimulatedOption = False,
    as_json: bool = False,
) -> Outcome:
    """Send states by RSI of KUKA to a program, which corrects the robot, until Ctrl-C (docs/wire.md)."""
    from scancell.wire.kuka.controller import RsiController, RsiServer  # noqa: PLC0415

    show = _show(as_json)
    with _robot(cell, settings, part, unit) as robot:
        controller = RsiController(robot, show, absolute)
        return _guided("kuka", controller, RsiServer(controller), (host, port), simulated, show)


def _guided(
    maker: str,
    controller: EgmController | RsiController,
    sensor: Peer,
    address: tuple[str, int],
    simulated: bool,
    show: Callable[[str], None],
) -> Outcome:
    """Serve a controller that sends to a sensor."""
    from scancell.wire.serve import serve_controller  # noqa: PLC0415

    def started(_: str) -> None:
        show(f"controller: {maker} {address[0]} {address[1]}")

    sensors = {address: sensor}
    return _outcome(controller, serve_controller(controller, {}, LOOPBACK, not simulated, started, sensors))


def _show(as_json: bool) -> Callable[[str], None]:
    return lambda line: print(line, file=sys.stderr if as_json else sys.stdout, flush=True)


@contextlib.contextmanager
def _robot(
    cell: Path, settings: list[str] | None, part: Path | None, unit: str, guard: bool = False
) -> Iterator[VirtualRobot]:
    from scancell.wire.robot import VirtualRobot  # noqa: PLC0415

    setup = scancell.load_setup(cell, settings=settings or [])
    with scancell.Scanner(setup=setup) as scanner, scanner.session(part, unit=unit, guarded=guard) as session:
        yield VirtualRobot(session)


def _outcome(controller: RobotController, timing: Timing) -> Outcome:
    figures = {
        "cycles": timing.cycles,
        "late": timing.late,
        "dropped_bytes": timing.dropped,
        "refused": dict(controller.refusals),
    }
    lines = [f"  {timing.cycles} cycles, {timing.late} of them late by more than a cycle"]
    lines += [f"  {number} requests refused: {port}" for port, number in sorted(controller.refusals.items())]
    return Outcome(lines, figures)
