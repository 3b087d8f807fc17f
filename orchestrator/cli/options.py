"""Options that commands share, as tables that a command takes as one."""

from __future__ import annotations

import functools
import inspect
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from orchestrator.cli.common import (
    AsBuiltOption,
    CellOption,
    JsonOption,
    SeedOption,
    SensorOption,
    SetOption,
    ThreadsOption,
    UnitOption,
)
from orchestrator.config.scan import Engine

if TYPE_CHECKING:
    from orchestrator.config.loading import Setup
    from orchestrator.evaluation.request import ScanRequest


@dataclass(frozen=True)
class CellOptions:
    """Options of commands that expose the sensor in the cell."""

    cell: CellOption = None
    sensor: SensorOption = None
    engine: Annotated[Engine, typer.Option("--engine", help="light and images, or the fast mode by rays alone")] = (
        "ray-traced"
    )
    set_: SetOption = None
    as_built: AsBuiltOption = None
    ideal: Annotated[bool, typer.Option("--ideal", help="switch off all noise")] = False
    seed: SeedOption = 0
    unit: UnitOption = "mm"
    threads: ThreadsOption = 0
    as_json: JsonOption = False

    def setup(self, scan: Path | None = None, overrides: list[str] | None = None) -> Setup:
        """The descriptions that the options name."""
        from orchestrator.config.loading import load_setup  # noqa: PLC0415

        return load_setup(self.cell, self.sensor, scan, [*(self.set_ or []), *(overrides or [])], self.ideal)


@dataclass(frozen=True)
class CloudOptions(CellOptions):
    """Options of commands that make a cloud in a run folder."""

    images: Annotated[bool, typer.Option("--images", help="keep the camera images of every exposure")] = False
    format_: Annotated[
        str, typer.Option("--format", help="of the cloud, several with commas: ply, npz, laz, e57, pcd, xyz")
    ] = "ply"

    def request(self, part: Path, setup: Setup) -> ScanRequest:
        """What the options ask for."""
        from orchestrator.evaluation.request import ScanRequest  # noqa: PLC0415
        from orchestrator.reconstruction.cloud_files import parse_formats  # noqa: PLC0415

        return ScanRequest(
            part=part,
            unit=self.unit,
            setup=setup,
            engine=self.engine,
            as_built=tuple(self.as_built or ()),
            seed=self.seed,
            images=self.images,
            threads=self.threads,
            command_line=tuple(sys.argv[1:]),
            formats=parse_formats(self.format_, "--format"),
        )


def with_options(options: type) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Decorator: the fields of the dataclass `options` become options of the command, which gets them as `options`."""
    shared = list(inspect.signature(options, eval_str=True).parameters.values())
    keyword = [item.replace(kind=inspect.Parameter.KEYWORD_ONLY) for item in shared]

    def decorate(command: Callable[..., None]) -> Callable[..., None]:
        @functools.wraps(command)
        def called(**given: Any) -> None:
            command(options=options(**{item.name: given.pop(item.name) for item in shared}), **given)

        own = [
            item.replace(kind=inspect.Parameter.KEYWORD_ONLY)
            for name, item in inspect.signature(command, eval_str=True).parameters.items()
            if name != "options"
        ]
        everything = [*own, *keyword]
        # Typer reads both.
        called.__signature__ = inspect.Signature(everything)  # type: ignore[attr-defined]
        called.__annotations__ = {item.name: item.annotation for item in everything}
        return called

    return decorate
