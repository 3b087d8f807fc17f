"""One scan of a batch: its cloud in all formats, what was measured, and what truly was, as files in a folder."""

from __future__ import annotations

import json
from collections import OrderedDict
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from orchestrator.config.batch import BatchDescription
from orchestrator.config.description import validate
from orchestrator.config.loading import as_built_sensor
from orchestrator.errors import OutputError
from orchestrator.evaluation.build import build_version
from orchestrator.evaluation.dataset_files import Truth, measured_file, stripe_masks, write_truth
from orchestrator.evaluation.ground_truth import TrueWorld
from orchestrator.evaluation.manifest import resolved_toml
from orchestrator.evaluation.stopwatch import Stopwatch
from orchestrator.geometry import pose
from orchestrator.geometry.mesh import load_mesh
from orchestrator.reconstruction.cloud_files import write_cloud
from orchestrator.scanning.sense import OnImages
from orchestrator.studies.factors import Factors
from orchestrator.studies.scan_worker import Driven, Scan, ScanWorker, Trial, setup_of, sweep_temporary, trial_of
from orchestrator.studies.task_store import disk_error
from orchestrator.studies.trial import deviation_figures

ROW = "scan.json"
MEASURED = "measured.h5"
TRUTH = "truth.h5"
RESOLVED = "resolved.toml"
# Scans come part by part, so that two suffice where one part ends and the next begins.
_KEPT_PARTS = 2


class BatchWorker:
    """Makes scans of a batch in this process."""

    def __init__(self, batch: BatchDescription, spec: Mapping[str, Any]) -> None:
        self._batch = batch
        self._setup = setup_of(spec["setup"])
        self._factors = Factors(batch, self._setup, "batch")
        self._parts: OrderedDict[str, ScanWorker] = OrderedDict()

    def __call__(self, payload: Mapping[str, Any], folder: Path) -> None:
        """Make a scan and leave its files in `folder`; of one that cannot be made only a row that says why."""
        row = {key: payload[key] for key in ("part", "mesh_sha256", "number", "seed", "engine", "values")}
        try:
            row["as_built"] = list(self._factors.inputs(payload["values"]).as_built)
            row["figures"] = self._make(payload, folder)
            said = {"status": "ok", "message": ""}
        except Exception as error:  # a scan that fails is a result, too; the others go on
            if isinstance(error, OutputError) or disk_error(error):
                raise
            for file in folder.iterdir():
                file.unlink()
            said = {"status": "failed", "message": f"{type(error).__name__}: {error}"}
        files = sorted(file.name for file in folder.iterdir())
        row = {"as_built": [], "figures": {}, **row, **said, "files": files, "scancell": build_version()}
        (folder / ROW).write_text(json.dumps(row, indent=1, allow_nan=False) + "\n")

    def _make(self, payload: Mapping[str, Any], folder: Path) -> dict[str, Any]:
        trial = trial_of(payload)
        with ExitStack() as open_files:

            def keep(driven: Driven) -> OnImages | None:
                sensor, images = driven.inputs.setup.sensor, self._batch.images
                stack = open_files.enter_context(
                    measured_file(folder / MEASURED, driven.recording, driven.nominal, sensor, trial.seed, images)
                )
                return None if stack is None else stack.add

            scan = self._part(payload).scan(trial, Stopwatch(), keep)
        for suffix in self._batch.formats:
            comment = f"scancell batch: {payload['part']}, variant {trial.number}"
            write_cloud(folder / f"cloud.{suffix}", scan.cloud, (comment,))
        if self._batch.truth:
            self._write_truth(scan, trial, folder)
        run = {key: payload[key] for key in ("mesh", "mesh_sha256", "seed", "engine")}
        run |= {"unit": self._batch.unit, "as_built": list(scan.inputs.as_built)}
        (folder / RESOLVED).write_text(resolved_toml(scan.inputs.setup, run))
        return deviation_figures(scan)

    def _write_truth(self, scan: Scan, trial: Trial, folder: Path) -> None:
        sensor, measured = as_built_sensor(scan.inputs.setup.sensor, scan.inputs.as_built), scan.recording.measured
        world = TrueWorld(scan.recording, scan.bodies, sensor, trial.seed, threads=1)
        stripe = world.stripe() if trial.engine == "ray-traced" else None
        believed_from_part = pose.inverse(scan.nominal.part_from_sensor(measured.q, measured.table))
        cloud = world.of_cloud(scan.cloud, believed_from_part, scan.sensors.believed, stripe)
        truth = Truth(world, cloud)
        if self._batch.images:
            masks = stripe_masks(scan.recording, scan.bodies, sensor, trial.seed, threads=1)
            truth = Truth(world, cloud, stripe, masks)
        write_truth(folder / TRUTH, truth, sensor, trial.seed)

    def _part(self, payload: Mapping[str, Any]) -> ScanWorker:
        key = payload["mesh_sha256"]
        if key not in self._parts:
            mesh = load_mesh(payload["mesh"], self._batch.unit)
            self._parts[key] = ScanWorker(self._batch, self._setup, mesh, "batch")
        self._parts.move_to_end(key)
        while len(self._parts) > _KEPT_PARTS:
            self._parts.popitem(last=False)[1].close()
        return self._parts[key]

    def close(self) -> None:
        """Free what the parts hold."""
        while self._parts:
            self._parts.popitem()[1].close()


def open_batch_worker(spec: Mapping[str, Any]) -> BatchWorker:
    """A worker from plain data, see `Batch.spec`."""
    sweep_temporary()
    return BatchWorker(validate(BatchDescription, spec["batch"], "batch"), spec)
