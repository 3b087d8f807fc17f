"""Options that commands share, as tables that a command takes as one."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from scancell.cli.common import (
    AsBuiltOption,
    CellOption,
    JsonOption,
    Outcome,
    SeedOption,
    SensorOption,
    SetOption,
    ThreadsOption,
    UnitOption,
)
from scancell.config.choices import CloudFrame, Engine
from scancell.errors import DescriptionError

if TYPE_CHECKING:
    from scancell.config.loading import Setup
    from scancell.progress import Progress
    from scancell.results import ScanResult


@dataclass(frozen=True)
class CellOptions:
    """Options of commands that expose the sensor in the cell."""

    cell: CellOption = None
    sensor: SensorOption = None
    engine: Annotated[Engine, typer.Option("--engine", help="rendered camera images, or ideal ray intersection")] = (
        "ray-traced"
    )
    set_: SetOption = None
    as_built: AsBuiltOption = None
    ideal: Annotated[bool, typer.Option("--ideal", help="switch off all noise")] = False
    seed: SeedOption = 0
    unit: UnitOption = "mm"
    threads: ThreadsOption = 0
    as_json: JsonOption = False

    def setup(self, scan: Path | None = None, settings: list[str] | None = None) -> Setup:
        """The descriptions that the options name."""
        from scancell.config.loading import load_setup  # noqa: PLC0415

        return load_setup(self.cell, self.sensor, scan, [*(self.set_ or []), *(settings or [])], self.ideal)


@dataclass(frozen=True)
class CloudOptions(CellOptions):
    """Options of commands that make a cloud in a run folder."""

    images: Annotated[bool, typer.Option("--images", help="keep the camera images of every exposure")] = False
    format_: Annotated[
        str, typer.Option("--format", help="formats of the cloud, separated by commas: ply, npz, laz, e57, pcd, xyz")
    ] = "ply"
    estimated_sensor: Annotated[
        Path | None,
        typer.Option(
            "--estimated-sensor", help="calibrated sensor (TOML) that interprets the images of the sensor as built"
        ),
    ] = None
    frame: Annotated[
        CloudFrame,
        typer.Option("--frame", help="frame of the points in the cloud files; table, base and world: table at 0"),
    ] = "part"

    def run_into(
        self, out: Path, setup: Setup, progress: Progress, scan: Callable[[dict[str, Any]], ScanResult]
    ) -> Outcome:
        """Make a scan with the options and leave its files in `out`, whole or not at all."""
        from scancell.config.sensor import SensorDescription  # noqa: PLC0415
        from scancell.output.frames import ImageWriter  # noqa: PLC0415
        from scancell.output.run_folder import RunFolder  # noqa: PLC0415
        from scancell.reconstruction.cloud_files import parse_formats  # noqa: PLC0415

        formats = parse_formats(self.format_, "format")
        given: dict[str, Any] = {
            "unit": self.unit,
            "engine": self.engine,
            "as_built": self.as_built or (),
            "seed": self.seed,
        }
        if self.estimated_sensor is not None:
            given["estimated_sensor"] = SensorDescription.from_toml(self.estimated_sensor)
        with RunFolder(out) as folder:
            if self.images and self.engine == "geometric":
                raise DescriptionError(
                    "the geometric engine makes no images", key="images", expected="--engine ray-traced"
                )
            cameras = [camera.name for camera in setup.sensor.camera]
            images = ImageWriter(folder, cameras) if self.images else None
            result = scan({**given, "on_images": images, "progress": progress}).evaluate(progress)
            if images is not None:
                images.finish()
            result.save_into(folder, formats, frame=self.frame)
        lines = [result.summary(), f"  results    {out}"]
        files = [str(path) for path in folder.paths]
        return Outcome(lines, result.figures, files, list(result.warnings), result.timings)


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
