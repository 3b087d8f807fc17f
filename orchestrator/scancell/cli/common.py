"""Options of all commands, and how their outcome or error is printed."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from scancell.cli.interrupts import EXIT_INTERRUPTED, InterruptibleProgress
from scancell.errors import ScancellError, named_by
from scancell.progress import NullProgress, Progress

if TYPE_CHECKING:
    from scancell.output.run_folder import RunReport

EXIT_ERROR = 1
# Arguments of Python functions whose options have other names.
_RENAMED = {"settings": "set_", "targets": "target", "formats": "format_", "is_size_known": "unknown_size"}

CellOption = Annotated[Path | None, typer.Option("--cell", help="cell description (TOML)")]
SensorOption = Annotated[Path | None, typer.Option("--sensor", help="sensor description (TOML)")]
ScanOption = Annotated[Path | None, typer.Option("--scan", help="scan description (TOML)")]
PathOption = Annotated[
    Path | None, typer.Option("--path", help="sensor path (TOML) instead of the views of the scan description")
]
SetOption = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="change the nominal description: cell.part.x_mm=20; repeatable"),
]
AsBuiltOption = Annotated[
    list[str] | None,
    typer.Option(
        "--as-built",
        metavar="KEY=VALUE",
        help="perturb the true cell: tool.x_mm=0.1, sensor.laser.turn_y_deg=0.1; repeatable",
    ),
]
SeedOption = Annotated[int, typer.Option("--seed", min=0, max=2**31 - 1, help="random seed")]
UnitOption = Annotated[str, typer.Option("--unit", help="unit of the mesh file: mm, m or inch")]
ThreadsOption = Annotated[int, typer.Option("--threads", min=0, help="number of threads; 0 for one per core")]
JsonOption = Annotated[bool, typer.Option("--json", help="print one JSON object as the last line")]


@dataclass
class Outcome:
    """What a command has to say; `text` is for people, the rest goes into the JSON object."""

    text: list[str] = field(default_factory=list)
    figures: Mapping[str, Any] = field(default_factory=dict)
    files: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    timings: Mapping[str, float] = field(default_factory=dict)

    @classmethod
    def of(cls, report: RunReport) -> Outcome:
        """What a job reports."""
        return cls(report.lines, report.figures, report.files, report.warnings, report.timings)


def run(command: str, as_json: bool, work: Callable[[], Outcome]) -> None:
    """Do the work, print what came of it, and turn errors into messages and exit codes."""
    try:
        outcome = work()
    except ScancellError as error:
        _fail(command, as_json, error.in_options(options_by_argument(command)), type(error).__name__, EXIT_ERROR)
    except KeyboardInterrupt:
        _fail(command, as_json, "interrupted", "KeyboardInterrupt", EXIT_INTERRUPTED)
    else:
        for line in outcome.text:
            print(line, file=sys.stderr if as_json else sys.stdout)
        if outcome.warnings:
            options = options_by_argument(command)
            outcome = replace(outcome, warnings=[named_by(warning, options) for warning in outcome.warnings])
        for warning in outcome.warnings:
            print(f"warning: {warning}", file=sys.stderr)
        if as_json:
            fields = {name: getattr(outcome, name) for name in ("figures", "files", "warnings", "timings")}
            print(json.dumps({"command": command, "ok": True, **fields}))


def options_by_argument(command: str) -> dict[str, str]:
    """Options of a command by the arguments of the Python functions that they give."""
    from scancell.cli import app  # noqa: PLC0415  (it imports this module)

    found: Any = typer.main.get_command(app)
    for word in command.split():
        found = found.commands[word]
    options = {item.name: item.opts[-1] for item in found.params if item.param_type_name == "option"}
    renamed = {argument: options[name] for argument, name in _RENAMED.items() if name in options}
    return {name.removesuffix("_"): option for name, option in options.items()} | renamed


def _fail(command: str, as_json: bool, message: str, kind: str, code: int) -> None:
    print(f"scancell: {message}", file=sys.stderr)
    if as_json:
        print(json.dumps({"command": command, "ok": False, "error": {"kind": kind, "message": message}}))
    sys.stdout.flush()
    raise typer.Exit(code)


def show_progress(as_json: bool) -> AbstractContextManager[Progress]:
    """Bars on a terminal; silence where nobody looks.  Every report of progress is a place where Ctrl-C acts."""
    if as_json or not sys.stderr.isatty():
        return InterruptibleProgress(NullProgress())
    from scancell.cli.terminal import TerminalProgress  # noqa: PLC0415  (rich takes 0.1 s to import)

    return InterruptibleProgress(TerminalProgress())
