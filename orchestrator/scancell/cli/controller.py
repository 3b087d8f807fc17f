"""`scancell controller`: the interfaces of makers' controllers to the simulated robot."""

from __future__ import annotations

import sys
from ipaddress import ip_address
from pathlib import Path
from typing import Annotated

import typer

import scancell
from scancell.cli.common import Outcome, SetOption, TablePartOption, UnitOption, command
from scancell.config.choices import LOOPBACK


@command("controller ur")
def controller_ur(
    cell: Annotated[Path, "cell description (TOML) with an arm of six joints, such as assets/cells/ur5e.toml"],
    part: TablePartOption = None,
    unit: UnitOption = "mm",
    settings: SetOption = None,
    host: Annotated[str, "address to listen on"] = LOOPBACK,
    simulated: Annotated[
        bool, typer.Option("--simulated/--real-time", help="as fast as the clients read, or by the clock")
    ] = False,
    guard: Annotated[bool, typer.Option("--guard", help="with the collision guard, which permits moves alone")] = False,
    as_json: bool = False,
) -> Outcome:
    """Serve RTDE (port 30004), scripts (30003) and dashboard (29999) of a UR until Ctrl-C (docs/wire.md)."""
    from scancell.wire.robot import VirtualRobot  # noqa: PLC0415
    from scancell.wire.serve import serve_controller  # noqa: PLC0415
    from scancell.wire.ur.controller import UrController  # noqa: PLC0415
    from scancell.wire.ur.ports import servers  # noqa: PLC0415

    stream = sys.stderr if as_json else sys.stdout

    def started(address: str) -> None:
        print(f"controller: ur {address}", file=stream, flush=True)
        if not ip_address(address).is_loopback:
            print(
                "warning: other machines can reach the controller, and requests are not authenticated", file=sys.stderr
            )

    setup = scancell.load_setup(cell, settings=settings or [])
    with scancell.Scanner(setup=setup) as scanner, scanner.session(part, unit=unit, guarded=guard) as session:
        controller = UrController(VirtualRobot(session), lambda line: print(line, file=stream, flush=True))
        timing = serve_controller(controller, servers(controller), host, not simulated, started)
    figures = {
        "cycles": timing.cycles,
        "late": timing.late,
        "dropped_bytes": timing.dropped,
        "refused": dict(controller.refusals),
    }
    lines = [f"  {timing.cycles} cycles, {timing.late} of them late by more than a cycle"]
    lines += [f"  {number} requests refused: {port}" for port, number in sorted(controller.refusals.items())]
    return Outcome(lines, figures)
