"""A batch: many scans of every mesh of a folder, as clouds with their ground truth.

Besides the files of every `ScanSeries`, its folder holds:

OUT/index.parquet      a row per scan: part, variant, seed, values of the factors, figures, files
"""

from __future__ import annotations

import hashlib
import json
from collections import OrderedDict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from scancell.config.description import validate
from scancell.config.loading import Setup, as_built_sensor
from scancell.config.study import BatchDescription
from scancell.errors import DescriptionError, OutputError, require
from scancell.evaluation.ground_truth import TrueWorld
from scancell.files import CAD_FORMATS, name_for_file, read_json, split_solids
from scancell.geometry import pose
from scancell.geometry.mesh import FORMATS, box_mesh
from scancell.nominal.parts import load_part
from scancell.output.run_folder import build_version, resolved_toml, sha256
from scancell.output.tables import ImageStack, Truth, dataset_file, stripe_masks, write_measured, write_truth
from scancell.reconstruction.cloud_files import parse_formats, write_cloud
from scancell.results import ScanResult
from scancell.scanning.world import visible_bodies
from scancell.studies.engine import OpenWorker, ScanWorker, Task, Trial, disk_error, sweep_temporary, trial_of
from scancell.studies.factors import Factors, checked_sections, nominal_setup, trial_seed
from scancell.studies.report import INDEX_KEYS, index_table, write_table
from scancell.studies.run_record import DESCRIPTION
from scancell.studies.study import ScanSeries, deviation_figures
from scancell.values import Result

ROW = "scan.json"
MEASURED = "measured.h5"
TRUTH = "truth.h5"
RESOLVED = "resolved.toml"
# Scans come part by part, so that two suffice where one part ends and the next begins.
_KEPT_PARTS = 2

_SHOWN = 5  # failures in the summary

INDEX = "index.parquet"


class BatchWorker:
    """Makes scans of a batch in this process."""

    def __init__(self, batch: BatchDescription, spec: Mapping[str, Any]) -> None:
        self._batch = batch
        self._setup = Setup(**checked_sections(spec["setup"]))
        self._factors = Factors(batch, self._setup, "batch")
        self._parts: OrderedDict[tuple[str, str], ScanWorker] = OrderedDict()

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
        key = payload["mesh"], payload["mesh_sha256"]
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


@dataclass(frozen=True)
class Part:
    """A mesh file and the name of its results; an unreadable file has an empty checksum."""

    name: str
    mesh: Path
    sha256: str


@dataclass(frozen=True)
class Batch(ScanSeries):
    """A checked batch with the descriptions that it names, of these parts."""

    description: BatchDescription
    parts: tuple[Part, ...]

    kind = "batch"
    unit = "scan"
    folder = "scans"

    @property
    def open_worker(self) -> OpenWorker:
        """Prepares a worker process from `spec`."""
        return open_batch_worker

    def worker(self) -> ScanWorker:
        """A worker for a small box, which is enough for checks."""
        return ScanWorker(self.description, self.setup, box_mesh((0.05, 0.05, 0.05)), self.source)

    def check(self) -> None:
        """Also requires the packages that write the files, before hours of scans."""
        require("h5py", "formats")
        parse_formats(",".join(self.description.formats), "formats", self.source)
        for key in ("truth", "images"):
            if self.setup.cell.further_sensor and getattr(self.description, key):
                raise DescriptionError(
                    "is of one sensor; the cell has several", file=self.source, key=key, value=True, expected="false"
                )
        if self.description.labels or self.description.as_built:
            super().check()

    @cached_property
    def tasks(self) -> list[Task]:
        """The scans, part by part; those of a part do not depend on the other parts."""
        return [task for part in self.parts for task in self._tasks_of(part)]

    def _tasks_of(self, part: Part) -> list[Task]:
        seed = _part_seed(self.description.seed, part.name)
        varying = self.description.model_copy(update={"seed": seed})
        shared = {"part": part.name, "mesh_sha256": part.sha256, "engine": self.description.engine}
        tasks = []
        for number, values in enumerate(Factors(varying, self.setup, self.source).draw(), 1):
            own = {"number": number, "seed": trial_seed(seed, number), "values": list(values)}
            request = {**shared, **own}
            tasks.append(Task(f"{part.name}-{number:06d}", {**request, "mesh": str(part.mesh)}, request))
        return tasks


def open_batch(description: BatchDescription, file: Path | None, given: Sequence[Path], out: Path) -> Batch:
    """A batch of the meshes `given` (files, or folders that are searched), without those in `out`.

    Parameters
    ----------
    file
        File of the description; the paths in it are relative to its folder.

    Raises
    ------
    ScancellError
        Naming file, key, value and what was expected.
    """
    source = "batch" if file is None else str(file)
    setup = nominal_setup(description, Path() if file is None else file.parent, source)
    taken = [label for label in description.labels if label in INDEX_KEYS]
    if taken:
        raise DescriptionError(
            "the index has a column of this name; set another name", file=source, key=f"factor {taken[0]}"
        )
    return Batch(source, description, setup, find_parts(given, out))


def find_parts(given: Sequence[Path], out: Path) -> tuple[Part, ...]:
    """Meshes by name: the path from the given folder, without suffix.

    Raises
    ------
    DescriptionError
        If a path does not exist, a folder holds no mesh, or two meshes would have the same name.
    """
    meshes: dict[str, Path] = {}
    for path in given:
        for name, mesh in _meshes(path, out.resolve()):
            other = meshes.setdefault(name, mesh)
            if other != mesh:
                raise DescriptionError(f"has the same name '{name}' as {other}; rename one of the two", file=mesh)
    return tuple(Part(name, mesh, _checksum(mesh)) for name, mesh in meshes.items())


def _meshes(path: Path, out: Path) -> list[tuple[str, Path]]:
    file, solids = split_solids(path)
    if file.is_file():
        return [("_".join([_name(file.name), *map(name_for_file, solids)]), path.resolve())]
    if not path.is_dir():
        raise DescriptionError("no such file or folder", file=path)
    files = [
        file for file in sorted(path.rglob("*")) if file.suffix.lower() in (*FORMATS, *CAD_FORMATS) and file.is_file()
    ]
    inside = [(file.relative_to(path), file.resolve()) for file in files]
    wanted = [
        (_name(str(short)), file)
        for short, file in inside
        if out not in file.parents and not any(piece.startswith(".") for piece in short.parts)
    ]
    if not wanted:
        raise DescriptionError(f"holds no part ({', '.join((*FORMATS, *CAD_FORMATS))})", file=path)
    return wanted


def _name(relative: str) -> str:
    """Name of the results of a mesh, by its path without the suffix."""
    return name_for_file(relative.rpartition(".")[0] or relative) or "part"


def _checksum(mesh: Path) -> str:
    try:
        return sha256(mesh)
    except OSError:  # reported where the mesh is read
        return ""


def _part_seed(seed: int, name: str) -> int:
    """31 bits that depend only on the batch's seed and the part's name."""
    return int.from_bytes(hashlib.sha256(f"scancell {seed} part {name}".encode()).digest()[:8], "big") >> 33


@dataclass(frozen=True, eq=False, repr=False)
class BatchResult(Result):
    """Scans of a batch that are finished.

    Attributes
    ----------
    rows
        One mapping for each scan that is finished, or failed for good, as the index holds it.
    missing
        Names of the scans that are neither.
    folder
        Folder of the batch, with its index and the folders of the scans.

    Examples
    --------
    See the example of `batch`.
    """

    rows: list[dict[str, Any]]
    missing: list[str]
    folder: Path

    @property
    def failed(self) -> list[dict[str, Any]]:
        """Rows of the scans that failed."""
        return [row for row in self.rows if row["status"] != "ok"]

    @property
    def figures(self) -> dict[str, Any]:
        """Numbers of parts, scans, failures and points."""
        return {
            "parts": len({row["mesh"] for row in self.rows}),
            "scans": len(self.rows),
            "failed": len(self.failed),
            "points": sum(row["figures"].get("points", 0) for row in self.rows),
        }

    def summary(self) -> str:
        """The number of scans and the first failures as lines of text."""
        made = self.figures
        lines = [f"{made['scans'] - made['failed']} scans of {made['parts']} parts in {self.folder}"]
        return "\n".join([*lines, *(f"  failed     {row['scan']}: {row['message']}" for row in self.failed[:_SHOWN])])


def write_index(batch: Batch, out: Path, failed: Mapping[str, str]) -> BatchResult:
    """Collect the finished scans in the index. Those of `failed` tasks (by name, with message) get rows that say so.

    Raises
    ------
    OutputError
        If the index cannot be written.
    """
    rows: list[dict[str, Any]] = []
    missing: list[str] = []
    for task, folder in batch.results(out):
        if folder is not None:
            row = read_json(folder / ROW)
            rows.append({**row, "scan": task.name, "mesh": task.payload["mesh"]})
        elif task.name in failed:
            outcome = {"status": "failed", "message": failed[task.name], "as_built": [], "figures": {}, "files": []}
            rows.append({**task.payload, **outcome, "scan": task.name, "scancell": None})
        else:
            missing.append(task.name)
    write_table(index_table(rows, batch.description.labels, batch.folder), out / INDEX)
    collected = BatchResult(rows, missing, out)
    if rows and not missing and len(collected.failed) == len(rows):
        # Nothing is finished that another request could spoil: a mended one may begin here.
        (out / DESCRIPTION).unlink(missing_ok=True)
    return collected
