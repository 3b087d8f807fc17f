"""One scan with drawn values, by a worker that keeps what many scans have in common.

A worker keeps the running FMU instance (reset for each scan), the nominal cell and its ray tracing scene while the
cell's description stays the same, and the plan while nothing changes that planning looks at.
"""

from __future__ import annotations

import json
import os
import shutil
import tempfile
from collections import OrderedDict
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import sensor_rt
from orchestrator.cell.as_built import parse_as_built
from orchestrator.cell.driver import DriveOptions, Driver
from orchestrator.cell.fmu_file import build_fmu, cell_json
from orchestrator.cell.fmu_package.contents import THROWN_AWAY
from orchestrator.cell.instance import CellInstance
from orchestrator.cell.nominal import Body, Lamp, NominalCell, nominal_cell
from orchestrator.cell.program import Program
from orchestrator.cell.recording import Recording
from orchestrator.config.cell import CellDescription
from orchestrator.config.description import validate
from orchestrator.config.loading import Setup, as_built_sensor, sensor_words
from orchestrator.config.scan import Engine, ScanDescription
from orchestrator.config.sensor import SensorDescription
from orchestrator.config.variation import VaryingScansDescription
from orchestrator.evaluation.job import cloud_of
from orchestrator.evaluation.stopwatch import Stopwatch
from orchestrator.geometry.mesh import Mesh
from orchestrator.progress import Silent
from orchestrator.reconstruction.cloud import Cloud
from orchestrator.scanning.exposures import build_scene, visible_bodies
from orchestrator.scanning.prepare import make_plan, sensor_range
from orchestrator.scanning.sense import OnImages, Sensors, make_sensor, sense
from orchestrator.studies.factors import Factors, Inputs, Units, Value
from orchestrator.studies.task_store import digest_of, is_running

_FOLDER = "scancell-study-"
_KEPT_CELLS = 2
_KEPT_PLANS = 16
Kept = TypeVar("Kept")


@dataclass(frozen=True)
class Trial:
    """A numbered scan: the seed of its random numbers, its engine, and the drawn value of each factor."""

    number: int
    seed: int
    engine: Engine
    values: tuple[Value, ...]


@dataclass(frozen=True)
class Driven:
    """A trial between driving and sensing."""

    inputs: Inputs
    nominal: NominalCell
    recording: Recording


# Says, once the cell has been driven, what is to be done with the images.
Keep = Callable[[Driven], OnImages | None]


@dataclass(frozen=True)
class Scan:
    """What a trial's scan gave, for those who want more than its figures."""

    inputs: Inputs
    nominal: NominalCell
    bodies: tuple[Body | Lamp, ...]
    sensors: Sensors
    recording: Recording
    cloud: Cloud


@dataclass(frozen=True)
class _Stage:
    """A nominal cell, and with what light can meet in it.

    `for_fmu` is the JSON text that the FMU reads, without the seed and the last brace: all the rest stays the same from
    scan to scan, and is long.
    """

    nominal: NominalCell
    for_fmu: str
    bodies: tuple[Body | Lamp, ...]
    scene: sensor_rt.Scene


class ScanWorker:
    """Scans one part in this process; `source` is what messages call the file that says what varies."""

    def __init__(self, scans: VaryingScansDescription, setup: Setup, part: Mesh, source: str) -> None:
        self._part = part
        self._factors = Factors(scans, setup, source)
        self._stages: OrderedDict[str, _Stage] = OrderedDict()
        self._plans: OrderedDict[str, Program] = OrderedDict()
        self._folder = Path(tempfile.mkdtemp(prefix=f"{_FOLDER}{os.getpid()}-"))
        self._cell: CellInstance | None = None
        self._fmu = self._folder / "RobotCell2.fmu"
        try:
            description = cell_json(setup.cell, nominal_cell(setup.cell, self._part), scans.seed)
            build_fmu(description, self._fmu, 2, THROWN_AWAY)
        except BaseException:
            self.close()
            raise

    def scan(self, trial: Trial, watch: Stopwatch, keep: Keep | None = None) -> Scan:
        """Plan, drive, sense and reconstruct with the values of the trial.

        Without `keep` the images are dropped and the cloud has no normals.

        Raises
        ------
        ScancellError
            If any of it cannot be done.
        """
        try:
            return self._scanned(trial, watch, keep)
        except Exception:
            self._drop_cell()
            raise

    def _scanned(self, trial: Trial, watch: Stopwatch, keep: Keep | None) -> Scan:
        inputs = self._factors.inputs(trial.values)
        setup = inputs.setup
        with watch.measure("prepare"):
            stage = self._stage(setup)
            sensor = make_sensor(setup.sensor, trial.seed)
            true_sensor = self._true_sensor(inputs, trial.seed)
        with watch.measure("plan"):
            program = self._program(setup, stage.nominal, sensor)
        with watch.measure("drive"):
            recording = self._drive(inputs, stage, program, trial.seed)
        with watch.measure("sense"):
            on_images = keep and keep(Driven(inputs, stage.nominal, recording))
            points = sense(
                recording, stage.bodies, sensor, trial.engine, 1, Silent(), on_images, true_sensor, stage.scene
            ).points
        with watch.measure("reconstruct"):
            cloud = cloud_of(stage.nominal, recording, points, setup, normals=keep is not None)
        return Scan(inputs, stage.nominal, stage.bodies, Sensors(sensor, true_sensor or sensor), recording, cloud)

    def units(self) -> Units:
        """Units of the deviations that the FMU knows."""
        return self._instance().units()

    def _true_sensor(self, inputs: Inputs, seed: int) -> sensor_rt.Sensor | None:
        if not sensor_words(inputs.as_built):
            return None
        return make_sensor(as_built_sensor(inputs.setup.sensor, inputs.as_built), seed)

    def _stage(self, setup: Setup) -> _Stage:
        def make() -> _Stage:
            nominal = nominal_cell(setup.cell, self._part)
            bodies = visible_bodies(nominal)
            cell = cell_json(setup.cell, nominal, 0)
            del cell["seed"]
            return _Stage(nominal, json.dumps(cell).removesuffix("}"), bodies, build_scene(bodies))

        return _kept(self._stages, digest_of(setup.cell.model_dump()), _KEPT_CELLS, make)

    def _program(self, setup: Setup, nominal: NominalCell, sensor: sensor_rt.Sensor) -> Program:
        seen = sensor_range(sensor)
        looked_at = (
            setup.cell.model_dump(),
            setup.scan.model_dump(),
            [seen.near, seen.far, seen.half_near, seen.half_far, seen.cameras.tolist()],
        )
        key = digest_of(_seen_by_planning(looked_at))
        return _kept(self._plans, key, _KEPT_PLANS, lambda: make_plan(nominal, sensor, setup).program)

    def _drive(self, inputs: Inputs, stage: _Stage, program: Program, seed: int) -> Recording:
        file = self._folder / "cell.json"
        file.write_text(f'{stage.for_fmu}, "seed": {seed}}}')
        cell = self._instance()
        cell.reset(file, parse_as_built(inputs.as_built, cell.units()))
        return Driver(cell, DriveOptions.of(inputs.setup)).run(program)

    def _instance(self) -> CellInstance:
        if self._cell is None:
            self._cell = CellInstance(self._fmu, folder=self._folder)
        return self._cell

    def _drop_cell(self) -> None:
        """After an error the instance may be good for nothing."""
        cell, self._cell = self._cell, None
        if cell is not None:
            with suppress(Exception):
                cell.close()

    def close(self) -> None:
        """Free the FMU and the files of this worker."""
        self._drop_cell()
        shutil.rmtree(self._folder, ignore_errors=True)


def trial_of(plain: Mapping[str, Any]) -> Trial:
    """A trial from plain data."""
    return Trial(plain["number"], plain["seed"], plain["engine"], tuple(plain["values"]))


def setup_of(plain: Mapping[str, Any]) -> Setup:
    """Checked descriptions from plain data."""
    return Setup(
        cell=validate(CellDescription, plain["cell"], "cell"),
        sensor=validate(SensorDescription, plain["sensor"], "sensor"),
        scan=validate(ScanDescription, plain["scan"], "scan"),
    )


def sweep_temporary() -> None:
    """Remove the temporary files of workers of this machine that were killed."""
    for folder in Path(tempfile.gettempdir()).glob(f"{_FOLDER}*"):
        pid = folder.name.removeprefix(_FOLDER).split("-")[0]
        if pid.isdigit() and not is_running(int(pid)):
            shutil.rmtree(folder, ignore_errors=True)


def _kept(store: OrderedDict[str, Kept], key: str, limit: int, make: Callable[[], Kept]) -> Kept:
    """What was made for `key`; the least recently used gives way."""
    if key not in store:
        store[key] = make()
    store.move_to_end(key)
    while len(store) > limit:
        store.popitem(last=False)
    return store[key]


def _seen_by_planning(node: Any) -> Any:
    """Descriptions without how surfaces reflect, what drives lack, and how encoders err."""
    if isinstance(node, Mapping):
        return {
            key: _seen_by_planning(value)
            for key, value in node.items()
            if not key.endswith(("reflectance", "material")) and not key.startswith(("encoder_", "drive"))
        }
    return [_seen_by_planning(item) for item in node] if isinstance(node, list | tuple) else node
