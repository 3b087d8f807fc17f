"""The `scancell` command."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import Annotated, Any, cast

import typer

# Each module registers its commands.
from scancell.cli import (  # noqa: F401
    calibrate,
    controller,
    evaluate,
    fmu,
    guard,
    real,
    scan,
    series,
    workspace,
)
from scancell.cli.common import EXIT_ERROR, Outcome, app, command
from scancell.cli.interrupts import INTERRUPTS

# Typer brings a copy of click along; its error for a wrong command line is the base of one that typer exports.
_UsageError = cast(type[Any], typer.BadParameter.__base__)


@command("schema")
def schema(
    out: Annotated[Path, "folder for the schemas"] = Path("docs/schemas"),
) -> Outcome:
    """Write the JSON Schemas of the description files, for editors."""
    from scancell.config.schema import json_schemas  # noqa: PLC0415
    from scancell.files import atomic_write  # noqa: PLC0415

    files = []
    for kind, content in json_schemas().items():
        path = out / f"{kind}.schema.json"
        with atomic_write(path) as temporary:
            temporary.write_text(json.dumps(content, indent=1) + "\n")
        files.append(str(path))
    return Outcome(files, files=files)


@command("version")
def version() -> Outcome:
    """Show the versions of scancell and its dependencies."""
    from scancell.output.run_folder import versions  # noqa: PLC0415

    found = versions()
    return Outcome([f"{name} {number}" for name, number in found.items()], {"versions": found})


def main() -> None:
    """Entry point of the command line."""
    INTERRUPTS.install()
    for argument in sys.argv[1:]:
        if any("\ud800" <= letter <= "\udfff" for letter in argument):
            # Results name their files in text, which would fail after the work.
            print(f"scancell: {argument!r} is not UTF-8: rename the file or folder", file=sys.stderr)
            sys.exit(EXIT_ERROR)
    try:
        code = _run_app()
        sys.stdout.flush()
    except OSError as error:
        if error.filename is not None:
            raise
        # Standard output is full or closed; what it still holds is written to nowhere at the end.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        print(f"scancell: the output cannot be written: {error.strerror}", file=sys.stderr)
        code = EXIT_ERROR
    sys.exit(code)


def _run_app() -> Any:
    try:
        return app(standalone_mode=False)
    except _UsageError as error:
        error.show()
        if "--json" in sys.argv:
            context = error.ctx
            name = context.command_path.removeprefix(context.find_root().command_path).strip() if context else ""
            fault = {"kind": "UsageError", "message": error.format_message()}
            print(json.dumps({"command": name, "ok": False, "error": fault}))
        return error.exit_code
