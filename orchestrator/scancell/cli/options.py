"""Options that commands share, one by one and as dataclasses for `command`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from scancell.cli.common import KEY_VALUE, JsonOption, Outcome
from scancell.config.description import CloudFrame, Engine, LengthUnit
from scancell.errors import DescriptionError

if TYPE_CHECKING:
    from scancell.config.loading import Setup
    from scancell.progress import Progress
    from scancell.results import ScanResult

PartArgument = Annotated[Path, typer.Argument(help="mesh (STL, OBJ, PLY) or artefact (TOML)")]
CellOption = Annotated[Path | None, typer.Option("--cell", help="cell description (TOML)")]
SensorOption = Annotated[Path | None, typer.Option("--sensor", help="sensor description (TOML)")]
ScanOption = Annotated[Path | None, typer.Option("--scan", help="scan description (TOML)")]
PathOption = Annotated[
    Path | None, typer.Option("--path", help="sensor path (TOML) instead of the views of the scan description")
]
SetOption = Annotated[
    list[str] | None,
    typer.Option("--set", metavar=KEY_VALUE, help="change the nominal description: cell.part.x_mm=20; repeatable"),
]
AsBuiltOption = Annotated[
    list[str] | None,
    typer.Option(
        "--as-built",
        metavar=KEY_VALUE,
        help="perturb the true cell: tool.x_mm=0.1, sensor.laser.turn_y_deg=0.1; repeatable",
    ),
]
EngineOption = Annotated[Engine, typer.Option("--engine", help="rendered camera images, or ideal ray intersection")]
IdealOption = Annotated[bool, typer.Option("--ideal", help="switch off all noise")]
SeedOption = Annotated[int, typer.Option("--seed", min=0, max=2**31 - 1, help="random seed")]
UnitOption = Annotated[str, typer.Option("--unit", help="unit of the mesh file: mm, m or inch")]
CloudUnitOption = Annotated[
    LengthUnit | None,
    typer.Option("--cloud-unit", help="unit of the cloud file; by default what the file states, or else mm"),
]
ThreadsOption = Annotated[int, typer.Option("--threads", min=0, help="number of threads; 0 for one per core")]
WorkersOption = Annotated[int, typer.Option("--workers", min=0, help="processes on this machine; 0: one per core")]
OutOption = Annotated[Path, typer.Option("--out", help="folder for the results")]
TablePartOption = Annotated[
    Path | None, typer.Option("--part", help="mesh of the part; the table is empty without this option")
]
NoGuardOption = Annotated[bool, typer.Option("--no-guard", help="run without the collision guard")]


@dataclass(frozen=True)
class PartOptions:
    """Options of commands that load a cell with a part."""

    cell: CellOption = None
    sensor: SensorOption = None
    set_: SetOption = None
    unit: UnitOption = "mm"
    threads: ThreadsOption = 0
    as_json: JsonOption = False

    def setup(self, scan: Path | None = None, path: Path | None = None, settings: Sequence[str] = ()) -> Setup:
        """The descriptions that the options name."""
        from scancell.config.loading import load_setup, with_path  # noqa: PLC0415

        words = [*(self.set_ or []), *settings]
        return with_path(load_setup(self.cell, self.sensor, scan, words, self._is_ideal), path)

    @property
    def _is_ideal(self) -> bool:
        return False


@dataclass(frozen=True)
class SimulationOptions(PartOptions):
    """Options of commands that simulate measurements in the cell."""

    as_built: AsBuiltOption = None
    ideal: IdealOption = False
    seed: SeedOption = 0

    @property
    def _is_ideal(self) -> bool:
        return self.ideal


@dataclass(frozen=True)
class CellOptions(SimulationOptions):
    """Options of commands that expose the sensor with a choice of the engine."""

    engine: EngineOption = "ray-traced"


@dataclass(frozen=True)
class CloudOptions(CellOptions):
    """Options of commands that write a cloud into a run folder."""

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
        typer.Option(
            "--frame",
            help="frame of the points in the cloud files; table, base and world: table at 0; belt: of a scan on a belt",
        ),
    ] = "part"

    def run_into(
        self, out: Path, setup: Setup, progress: Progress, scan: Callable[[dict[str, Any]], ScanResult]
    ) -> Outcome:
        """Make a scan with the options and write its files into `out`, all or none."""
        from scancell.config.sensor import SensorDescription  # noqa: PLC0415
        from scancell.output.image_files import ImageWriter  # noqa: PLC0415
        from scancell.output.run_files import OPTIONAL_FILES  # noqa: PLC0415
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
        with RunFolder(out, OPTIONAL_FILES) as folder:
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
