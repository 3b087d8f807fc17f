"""One trial: a whole scan with the drawn values, as one row of figures.

A worker keeps what trials have in common: the running FMU instance (reset for each), the nominal cell and its ray
tracing scene while the cell's description stays the same, and the plan while nothing changes that planning looks at.
"""

from __future__ import annotations

import json
import os
import shutil
import socket
import tempfile
from collections import OrderedDict
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

import sensor_rt
from orchestrator.cell.as_built import parse_as_built
from orchestrator.cell.driver import DriveOptions, Driver
from orchestrator.cell.fmu_file import build_fmu, cell_json
from orchestrator.cell.instance import CellInstance
from orchestrator.cell.nominal import Body, Lamp, NominalCell, nominal_cell
from orchestrator.cell.program import Program
from orchestrator.cell.recording import Recording
from orchestrator.config.cell import CellDescription
from orchestrator.config.description import validate
from orchestrator.config.loading import Setup, as_built_sensor, sensor_words
from orchestrator.config.resolved import sensor_json
from orchestrator.config.scan import Engine, ScanDescription
from orchestrator.config.sensor import SensorDescription
from orchestrator.config.study import SphereDescription, StudyDescription
from orchestrator.config.units import to_si
from orchestrator.evaluation.coverage import SensorView
from orchestrator.evaluation.deviation import deviation_from_mesh
from orchestrator.evaluation.job import cloud_of
from orchestrator.evaluation.report import surface_coverage
from orchestrator.evaluation.sphere_fit import Sphere, fit_sphere
from orchestrator.evaluation.stopwatch import Stopwatch
from orchestrator.geometry.mesh import load_mesh
from orchestrator.progress import Silent
from orchestrator.reconstruction.cloud import Cloud
from orchestrator.scanning.exposures import build_scene, visible_bodies
from orchestrator.scanning.prepare import make_plan, sensor_range
from orchestrator.scanning.sense import make_sensor, sense
from orchestrator.studies.factors import Factors, Inputs, Units, Value
from orchestrator.studies.task_store import digest_of, disk_error, is_running

ROWS = "rows.json"
TIMINGS = "timings.json"
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
class Scan:
    """What a trial's scan gave, for those who want more than its figures; the cloud has no normals."""

    inputs: Inputs
    nominal: NominalCell
    recording: Recording
    cloud: Cloud


@dataclass(frozen=True)
class _Stage:
    """A nominal cell with what light can meet in it."""

    nominal: NominalCell
    bodies: tuple[Body | Lamp, ...]
    scene: sensor_rt.Scene


class TrialWorker:
    """Runs trials of one study in this process."""

    def __init__(self, study: StudyDescription, setup: Setup, part: Path) -> None:
        self._study = study
        self._part = load_mesh(part, study.unit)
        self._baseline = setup
        self._factors = Factors(study, setup, study.name)
        self._stages: OrderedDict[str, _Stage] = OrderedDict()
        self._plans: OrderedDict[str, Program] = OrderedDict()
        self._folder = Path(tempfile.mkdtemp(prefix=f"{_FOLDER}{os.getpid()}-"))
        self._cell: CellInstance | None = None
        self.fmu = self._folder / "RobotCell2.fmu"
        build_fmu(cell_json(setup.cell, nominal_cell(setup.cell, self._part), study.seed), self.fmu, 2)

    def __call__(self, payload: Sequence[Mapping[str, Any]], folder: Path) -> None:
        """Make the trials of a task and leave their rows, and beside them what took how long, in `folder`."""
        rows, timings = [], []
        for plain in payload:
            watch = Stopwatch()
            rows.append(self.row(trial_of(plain), watch))
            timings.append({"trial": plain["number"], **_process(), "seconds": watch.seconds})
        (folder / ROWS).write_text(json.dumps(rows, indent=1, allow_nan=False) + "\n")
        (folder / TIMINGS).write_text(json.dumps(timings, indent=1) + "\n")

    def row(self, trial: Trial, watch: Stopwatch) -> dict[str, Any]:
        """Figures of a trial; one that cannot be done has a message instead."""
        plain = {**asdict(trial), "values": list(trial.values)}
        try:
            with watch.measure("all"):
                scan = self.scan(trial, watch)
                with watch.measure("evaluate"):
                    figures = self._figures(scan, trial)
        except Exception as error:  # a trial that fails is a result, too; the others go on
            self._drop_cell()
            if disk_error(error):
                raise
            return {**plain, "status": "failed", "message": f"{type(error).__name__}: {error}", "figures": {}}
        return {**plain, "status": "ok", "message": "", "figures": figures}

    def scan(self, trial: Trial, watch: Stopwatch) -> Scan:
        """Plan, drive, sense and reconstruct with the values of the trial.

        Raises
        ------
        ScancellError
            If any of it cannot be done.
        """
        inputs = self._factors.inputs(trial.values)
        setup = inputs.setup
        with watch.measure("prepare"):
            stage = self._stage(setup)
            sensor = make_sensor(setup.sensor, trial.seed)
            true_sensor = self._true_sensor(inputs, trial.seed)
        with watch.measure("plan"):
            program = self._program(setup, stage.nominal, sensor)
        with watch.measure("drive"):
            recording = self._drive(inputs, stage.nominal, program, trial.seed)
        with watch.measure("sense"):
            points = sense(
                recording, stage.bodies, sensor, trial.engine, 1, Silent(), as_built=true_sensor, scene=stage.scene
            ).points
        with watch.measure("reconstruct"):
            return Scan(
                inputs, stage.nominal, recording, cloud_of(stage.nominal, recording, points, setup, normals=False)
            )

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
            return _Stage(nominal, bodies, build_scene(bodies))

        return _kept(self._stages, digest_of(setup.cell.model_dump()), _KEPT_CELLS, make)

    def _program(self, setup: Setup, nominal: NominalCell, sensor: sensor_rt.Sensor) -> Program:
        seen = sensor_range(sensor)
        looked_at = (
            setup.cell.model_dump(),
            setup.scan.model_dump(),
            [seen.near, seen.far, seen.half_near, seen.half_far, seen.cameras.tolist()],
        )
        key = digest_of(_without_light(looked_at))
        return _kept(self._plans, key, _KEPT_PLANS, lambda: make_plan(nominal, sensor, setup).program)

    def _drive(self, inputs: Inputs, nominal: NominalCell, program: Program, seed: int) -> Recording:
        file = self._folder / "cell.json"
        file.write_text(json.dumps(cell_json(inputs.setup.cell, nominal, seed)))
        cell = self._instance()
        cell.reset(file, parse_as_built(inputs.as_built, cell.units()))
        options = DriveOptions(
            cycle_us=inputs.setup.cell.world.controller_cycle_us,
            exposure=float(to_si({"t_ms": inputs.setup.sensor.detector.exposure_ms})["t"]),
        )
        return Driver(cell, options).run(program)

    def _instance(self) -> CellInstance:
        if self._cell is None:
            self._cell = CellInstance(self.fmu, folder=self._folder)
        return self._cell

    def _drop_cell(self) -> None:
        """After an error the instance may be good for nothing."""
        cell, self._cell = self._cell, None
        if cell is not None:
            with suppress(Exception):
                cell.close()

    def _figures(self, scan: Scan, trial: Trial) -> dict[str, Any]:
        deviation = deviation_from_mesh(scan.cloud, scan.nominal.part, sensor_rt.closest_points)
        figures: dict[str, Any] = {"profiles": len(scan.recording), "points": len(scan.cloud)}
        figures.update({name: value for name, value in deviation.figures.as_um().items() if name != "count"})
        if self._study.coverage_samples:
            view = SensorView.from_resolved(sensor_json(scan.inputs.setup.sensor, trial.seed))
            covered = surface_coverage(
                scan.nominal, scan.recording, scan.cloud, view, samples=self._study.coverage_samples, threads=1
            ).fraction
            figures["coverage"] = None if np.isnan(covered) else covered
        for sphere in self._study.sphere:
            figures.update(_sphere_figures(sphere, scan.cloud))
        return figures

    def close(self) -> None:
        """Free the FMU and the files of this worker."""
        self._drop_cell()
        shutil.rmtree(self._folder, ignore_errors=True)


def open_trials(spec: Mapping[str, Any]) -> TrialWorker:
    """A worker from plain data, see `spec_of`."""
    sweep_temporary()
    raw = spec["setup"]
    setup = Setup(
        cell=validate(CellDescription, raw["cell"], "cell"),
        sensor=validate(SensorDescription, raw["sensor"], "sensor"),
        scan=validate(ScanDescription, raw["scan"], "scan"),
    )
    return TrialWorker(validate(StudyDescription, spec["study"], "study"), setup, Path(spec["part"]))


def sweep_temporary() -> None:
    """Remove the temporary files of workers of this machine that were killed."""
    for folder in Path(tempfile.gettempdir()).glob(f"{_FOLDER}*"):
        pid = folder.name.removeprefix(_FOLDER).split("-")[0]
        if pid.isdigit() and not is_running(int(pid)):
            shutil.rmtree(folder, ignore_errors=True)


def trial_of(plain: Mapping[str, Any]) -> Trial:
    """A trial from plain data."""
    return Trial(plain["number"], plain["seed"], plain["engine"], tuple(plain["values"]))


def _kept(store: OrderedDict[str, Kept], key: str, limit: int, make: Callable[[], Kept]) -> Kept:
    """What was made for `key`; the least recently used gives way."""
    if key not in store:
        store[key] = make()
    store.move_to_end(key)
    while len(store) > limit:
        store.popitem(last=False)
    return store[key]


def _without_light(node: Any) -> Any:
    """Descriptions without what planning cannot see: how surfaces reflect."""
    if isinstance(node, Mapping):
        return {
            key: _without_light(value) for key, value in node.items() if not key.endswith(("reflectance", "material"))
        }
    return [_without_light(item) for item in node] if isinstance(node, list | tuple) else node


def _sphere_figures(description: SphereDescription, cloud: Cloud) -> dict[str, Any]:
    si = to_si(description.model_dump(exclude={"name"}))
    lowest = -np.inf if si["above"] is None else si["above"]
    found = fit_sphere(cloud.points_in_part, Sphere(np.array(si["centre"]), si["radius"], si["reach"], lowest))
    named = {
        "points": found.points,
        **{f"{axis}_um": 1e6 * shift for axis, shift in zip("xyz", found.shift.tolist(), strict=True)},
        "diameter_error_um": 1e6 * found.diameter_error,
        "form_um": 1e6 * found.form,
        "rms_um": 1e6 * found.rms,
    }
    return {f"{description.name}.{key}": None if np.isnan(value) else value for key, value in named.items()}


def _process() -> dict[str, Any]:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return {"host": socket.gethostname(), "worker": os.getpid(), "memory_mb": pages * os.sysconf("SC_PAGE_SIZE") / 1e6}
