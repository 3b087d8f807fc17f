"""The cell of a scanner: descriptions, and the meshes, scenes, plans and FMU that are kept between calls."""

from __future__ import annotations

from functools import cached_property
from pathlib import Path
from typing import Self

from scancell.arguments import Threads, checked_arguments
from scancell.closing import Closing
from scancell.config.cell import CellDescription
from scancell.config.keys import Assignments, assignments
from scancell.config.loading import Setup, load_setup
from scancell.config.scan import ScanDescription
from scancell.config.sensor import SensorDescription
from scancell.errors import DescriptionError, ScancellError
from scancell.geometry.mesh import Mesh
from scancell.nominal.parts import PartCache
from scancell.nominal.plausibility import setup_warnings
from scancell.scanning.job import Job
from scancell.scanning.pipeline import ScanPipeline
from scancell.scanning.sense import make_sensors


class PreparedCell(Closing):
    """Makes jobs for parts; see `Scanner` for the parameters."""

    @checked_arguments
    def __init__(
        self,
        cell: str | Path | CellDescription | None = None,
        sensor: str | Path | SensorDescription | None = None,
        scan: str | Path | ScanDescription | None = None,
        *,
        settings: Assignments = (),
        ideal: bool = False,
        threads: Threads = 0,
        setup: Setup | None = None,
    ) -> None:
        if setup is not None and not (cell is sensor is scan is None and not settings and not ideal):
            raise DescriptionError("setup: expected no cell, sensor, scan, settings or ideal beside it")
        self.setup = setup or load_setup(cell, sensor, scan, assignments(settings), ideal)
        self._pipeline: ScanPipeline | None = ScanPipeline(threads)
        self._parts = PartCache()

    @classmethod
    @checked_arguments
    def from_setup(cls, setup: Setup, threads: Threads = 0) -> Self:
        """A scanner for checked descriptions, a `setup`; `threads` as of `Scanner`."""
        return cls(threads=threads, setup=setup)

    @property
    def pipeline(self) -> ScanPipeline:
        """The steps of scans and what they keep; `ScancellError` after `close`."""
        if self._pipeline is None:
            raise ScancellError(
                "the scanner is closed", expected="a new one, or calls before the end of its `with` block"
            )
        return self._pipeline

    def __enter__(self) -> Self:
        _ = self.pipeline
        return self

    @checked_arguments
    def load_part(self, part: str | Path | Mesh, unit: str = "mm") -> Mesh:
        """The mesh of a part in metres, see `load_part`: a file in `unit` is read again only when it has changed.

        Raises
        ------
        ScancellError
            If the file is missing, unreadable, empty or broken.
        """
        _ = self.pipeline
        return self._parts.part(part, unit)

    def _job(
        self,
        part: str | Path | Mesh | None,
        unit: str,
        as_built: Assignments = (),
        seed: int = 0,
        setup: Setup | None = None,
        estimated_sensor: SensorDescription | None = None,
    ) -> Job:
        """The part, or an empty table, in the scanner's cell or in that of `setup`."""
        setup, words = setup or self.setup, tuple(assignments(as_built))
        if part is None and setup.cell.part.fixture == "free":
            raise DescriptionError(
                "there is no part", key="part.fixture", value="free", expected='its mesh, or "clamped"'
            )
        loaded = self.pipeline.load(setup.cell, None if part is None else self.load_part(part, unit))
        sensors = make_sensors(setup.sensor, words, seed, estimated_sensor)
        file = Path(part) if isinstance(part, str | Path) else None
        return Job(setup, loaded, sensors, words, seed, file, unit, estimated_sensor=estimated_sensor)

    @cached_property
    def setup_warnings(self) -> tuple[str, ...]:
        """What is doubtful about the descriptions, in sentences."""
        return tuple(setup_warnings(self.setup))

    def close(self) -> None:
        """Free the FMU, its files and the scenes; the scanner refuses further calls."""
        if self._pipeline is not None:
            self._pipeline.close()
        self._pipeline = None
        self._parts.clear()
