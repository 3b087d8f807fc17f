"""One scan of a batch: its cloud in all formats, the measured data and the ground truth, as files in a folder."""

from __future__ import annotations

import json
from collections import OrderedDict
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from scancell.config.batch import BatchDescription
from scancell.config.description import validate
from scancell.config.loading import Setup, as_built_sensor
from scancell.errors import OutputError
from scancell.evaluation.ground_truth import TrueWorld
from scancell.geometry import pose
from scancell.nominal.parts import load_part
from scancell.output.dataset_files import ImageStack, Truth, dataset_file, stripe_masks, write_measured, write_truth
from scancell.output.manifest import build_version, resolved_toml
from scancell.reconstruction.cloud_files import write_cloud
from scancell.results import ScanResult
from scancell.scanning.exposures import visible_bodies
from scancell.studies.factors import Factors, checked_sections
from scancell.studies.scan_worker import ScanWorker, Trial, sweep_temporary, trial_of
from scancell.studies.task_store import disk_error
from scancell.studies.trial import deviation_figures

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
        self._setup = Setup(**checked_sections(spec["setup"]))
        self._factors = Factors(batch, self._setup, "batch")
        self._parts: OrderedDict[str, ScanWorker] = OrderedDict()

    def __call__(self, payload: Mapping[str, Any], folder: Path) -> None:
        """Make a scan and write its files into `folder`; of a scan that fails, only a row with the reason."""
        row = {key: payload[key] for key in ("part", "mesh_sha256", "number", "seed", "engine", "values")}
        try:
            row["as_built"] = list(self._factors.inputs(payload["values"]).as_built)
            row["figures"] = self._make(payload, folder)
            outcome = {"status": "ok", "message": ""}
        except Exception as error:  # a scan that fails is a result, too; the others go on
            if isinstance(error, OutputError) or disk_error(error):
                raise
            for file in folder.iterdir():
                file.unlink()
            outcome = {"status": "failed", "message": f"{type(error).__name__}: {error}"}
        files = sorted(file.name for file in folder.iterdir())
        row = {"as_built": [], "figures": {}, **row, **outcome, "files": files, "scancell": build_version()}
        (folder / ROW).write_text(json.dumps(row, indent=1, allow_nan=False) + "\n")

    def _make(self, payload: Mapping[str, Any], folder: Path) -> dict[str, Any]:
        trial = trial_of(payload)
        with dataset_file(folder / MEASURED) as file:
            stack = ImageStack(file) if self._batch.images else None
            scan = self._part(payload).scan(trial, None if stack is None else stack.add, normals=True)
            write_measured(file, scan)
        for suffix in self._batch.formats:
            comment = f"scancell batch: {payload['part']}, variant {trial.number}"
            write_cloud(folder / f"cloud.{suffix}", scan.cloud, (comment,))
        if self._batch.truth:
            self._write_truth(scan, trial, folder)
        run = {key: payload[key] for key in ("mesh", "mesh_sha256", "seed", "engine")}
        run |= {"unit": self._batch.unit, "as_built": list(scan.as_built)}
        (folder / RESOLVED).write_text(resolved_toml(scan.setup, run))
        return deviation_figures(scan)

    def _write_truth(self, scan: ScanResult, trial: Trial, folder: Path) -> None:
        sensor, measured = as_built_sensor(scan.setup.sensor, scan.as_built), scan.recording.measured
        bodies = visible_bodies(scan.nominal)
        world = TrueWorld(scan.recording, bodies, sensor, trial.seed, threads=1)
        geometric = trial.engine == "geometric"
        stripe = world.stripe() if sensor.render.noise or not geometric else None
        sensor_from_part_nominal = pose.inverse(scan.nominal.part_from_sensor(measured.axes))
        cloud = world.of_cloud(
            scan.cloud, sensor_from_part_nominal, scan.world.sensor, stripe, between_columns=geometric
        )
        truth = Truth(world, cloud)
        if self._batch.images:
            masks = stripe_masks(scan.recording, bodies, sensor, trial.seed, threads=1)
            truth = Truth(world, cloud, stripe, masks)
        write_truth(folder / TRUTH, truth, sensor, trial.seed)

    def _part(self, payload: Mapping[str, Any]) -> ScanWorker:
        key = payload["mesh_sha256"]
        if key not in self._parts:
            mesh = load_part(payload["mesh"], self._batch.unit)
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
