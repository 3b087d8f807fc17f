"""`scancell guard`: protect a robot from collisions."""

from __future__ import annotations

import select
import sys
from ipaddress import ip_address
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

import scancell
from scancell.cli.common import EXIT_ERROR, Outcome, ScanOption, TablePartOption, UnitOption, WorkersOption, command
from scancell.config.choices import LOOPBACK, TransportProtocol

if TYPE_CHECKING:
    from scancell.studies.guard.campaign import RunRow


@command("guard serve")
def guard_serve(
    cell: Annotated[Path | None, typer.Argument(help="cell description (TOML)")] = None,
    part: TablePartOption = None,
    unit: UnitOption = "mm",
    scan: ScanOption = None,
    host: Annotated[str, "address to listen on"] = LOOPBACK,
    port: Annotated[int, typer.Option(min=0, max=65535, help="port to listen on; 0: any free port")] = 0,
    max_age: Annotated[
        float, typer.Option(min=0.03, max=5.0, help="largest age of an answered state, s; the same as in the cell")
    ] = 0.12,
    transport: Annotated[TransportProtocol, "protocol that carries the packets"] = "udp",
    as_json: bool = False,
) -> Outcome:
    """Answer the states of a cell (docs/guard_protocol.md) until Ctrl-C; not a rated safety function."""

    def started(host: str, port: int) -> None:
        print(f"guard: {transport} {host} {port}", file=sys.stderr if as_json else sys.stdout, flush=True)
        if not ip_address(host).is_loopback:
            print("warning: other machines can reach the guard, and packets are not authenticated", file=sys.stderr)

    guard = scancell.guard_of(cell, part, scan, unit=unit, max_age=max_age)
    counts = scancell.serve_guard(guard, host, port, transport, started)
    lines = [f"  {number:>10} packets {outcome}" for outcome, number in sorted(counts.items())]
    return Outcome(lines or ["  no packets"], {"packets": dict(counts)})


@command("guard watch")
def guard_watch(
    maker: Annotated[Literal["ur", "abb", "kuka"], typer.Argument(help="maker of the robot")],
    cell: Annotated[Path, "cell description (TOML) of the robot and what is around it"],
    host: Annotated[str, typer.Option(help="address of the robot")],
    part: TablePartOption = None,
    unit: UnitOption = "mm",
    scan: ScanOption = None,
    max_age: Annotated[
        float,
        typer.Option(min=0.05, max=2.0, help="time from a state of the robot to the effect of a stop, at most, s"),
    ] = 0.2,
    register: Annotated[
        int | None,
        typer.Option(min=0, max=47, help="ur: integer input register that is written with every order; default: 24"),
    ] = None,
    slow: Annotated[
        bool, typer.Option("--slow/--no-slow", help="ur: move the speed slider, or warn and stop alone")
    ] = True,
    port: Annotated[
        int | None,
        typer.Option(min=1, max=65535, help="abb, kuka: port to which the robot sends; default: 6510, 49152"),
    ] = None,
    program_port: Annotated[
        int | None,
        typer.Option(
            min=1, max=65535, help="abb, kuka: port of this machine at which the program listens; default: one more"
        ),
    ] = None,
    absolute: Annotated[bool, typer.Option("--absolute", help="kuka: corrections count from the start")] = False,
    as_json: bool = False,
) -> Outcome:
    """Warn of contacts of a real robot, slow it down and stop it, until Ctrl-C; no safety function (docs/wire.md)."""
    from scancell.guard.server import stop_signals  # noqa: PLC0415
    from scancell.nominal.cell import nominal_cell  # noqa: PLC0415
    from scancell.wire.abb.watch import EgmInterface  # noqa: PLC0415
    from scancell.wire.kuka.watch import RsiInterface  # noqa: PLC0415
    from scancell.wire.relay import GuardedLink, watch_link  # noqa: PLC0415
    from scancell.wire.robot import check_joints  # noqa: PLC0415
    from scancell.wire.ur.watch import UrWatch, watch_ur  # noqa: PLC0415
    from scancell.wire.watch import Watch  # noqa: PLC0415

    if maker == "ur":
        _refuse_options(maker, {"--port": port, "--program-port": program_port, "--absolute": absolute})
    else:
        relative_only = absolute and maker != "kuka"
        _refuse_options(maker, {"--register": register, "--no-slow": not slow, "--absolute": relative_only})
    stream = sys.stderr if as_json else sys.stdout

    def show(text: str, beep: bool) -> None:
        print(f"{text}{chr(7) if beep and stream.isatty() else ''}", file=stream, flush=True)

    guard = scancell.guard_of(cell, part, scan, unit=unit, max_age=max_age)
    nominal = nominal_cell(scancell.load_setup(cell).cell, None)
    check_joints(len(nominal.home))
    watch = Watch(guard, nominal.start)
    with stop_signals() as stop:

        def ended() -> bool:
            return bool(select.select([stop], [], [], 0.0)[0])

        if maker == "ur":
            register = 24 if register is None else register
            counts = watch_ur(UrWatch(watch, max_age, register, slow), host, show=show, ended=ended)
        else:
            interface = EgmInterface() if maker == "abb" else RsiInterface(absolute)
            own = port or interface.port
            link = GuardedLink(watch, interface, max_age)
            counts = watch_link(link, host, (own, program_port or own + 1), show, ended)
    lines = [
        f"  {counts.states} states, slowed down in {counts.slowed}, {counts.stops} stops",
        f"  largest age of an order {counts.longest_age:.3f} s, permitted {max_age:g} s",
    ]
    return Outcome(lines, {"maker": maker, **vars(counts)})


def _refuse_options(maker: str, options: dict[str, int | bool | None]) -> None:
    for option, value in options.items():
        if value is not None and value is not False:
            raise typer.BadParameter(f"{option} has no meaning for {maker}")


@command("guard check")
def guard_check(
    part: Annotated[Path, "mesh of a part on the table; alternates with parts larger than the table"],
    cell: Annotated[Path | None, "cell description (TOML); default: all shipped cells in turn"] = None,
    unit: UnitOption = "mm",
    seed: Annotated[int, typer.Option(min=0, help="seed of all runs")] = 1,
    runs: Annotated[int, typer.Option(min=1, help="number of scenarios, each run with and without the guard")] = 180,
    out: Annotated[Path, "folder for the rows and tables"] = Path("out/guard"),
    workers: WorkersOption = 0,
    as_json: bool = False,
) -> Outcome:
    """Run a guarded cell over bad networks, and the same scenarios without the guard; resumes an earlier campaign.

    The exit status is 1 if a guarded robot collided.
    """
    from scancell.studies.guard.run import CampaignOptions, run_campaign  # noqa: PLC0415

    options = CampaignOptions(str(cell) if cell else None, str(part), unit, seed)
    figures = run_campaign(options, runs, out, workers, None if as_json else _show)
    lines = [f"  {name:<26} {value}" for name, value in figures.items()]
    files = [str(out / "rows.csv"), str(out / "tables.md")]
    return Outcome(lines, figures, files, code=EXIT_ERROR if figures["collisions"] else 0)


def _show(row: RunRow) -> None:
    if row.collided:
        what = f"{row.contact or 'bodies'} ({row.cell}, {row.contact_kind} at {row.speed:.2%}, network: {row.fault})"
        print(f"run {row.number}: COLLISION of {what}")
    elif row.number % 100 == 99:
        print(f"{row.number + 1} runs", flush=True)
