"""A batch: a folder of meshes in, a folder of clouds with their ground truth out.

OUT/description.json   what all scans share, after defaults; another batch is refused in the same folder
OUT/scans/             one folder per scan, which appears whole or not at all
OUT/index.parquet      a row per scan: part, variant, seed, what varied, figures, files (equal for equal seeds)
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from orchestrator.config.batch import BatchDescription
from orchestrator.config.loading import Setup
from orchestrator.errors import DescriptionError
from orchestrator.evaluation.manifest import named_files, sha256
from orchestrator.geometry.mesh import FORMATS, box_mesh
from orchestrator.progress import Progress
from orchestrator.studies.batch_worker import ROW, open_batch_worker
from orchestrator.studies.designs import trial_seed
from orchestrator.studies.engine import Announce, RunOutcome, run_tasks
from orchestrator.studies.factors import SETUP_KEYS, Factors, nominal_setup
from orchestrator.studies.results import INDEX_KEYS, index_table, write_table
from orchestrator.studies.run_record import (
    DESCRIPTION,
    FILES,
    Comparison,
    checksums,
    compare_with_record,
    plain_terms,
    recorded_terms,
    write_record,
)
from orchestrator.studies.scan_worker import ScanWorker, sweep_temporary
from orchestrator.studies.task import Job, Task, Where, request_digest

SCANS = "scans"
INDEX = "index.parquet"


@dataclass(frozen=True)
class Part:
    """A mesh file under the name that its results bear; an unreadable one has no checksum."""

    name: str
    mesh: Path
    sha256: str


@dataclass(frozen=True)
class Batch:
    """A checked batch with the descriptions that it names; `source` is what messages call it."""

    source: str
    description: BatchDescription
    setup: Setup
    parts: tuple[Part, ...]

    @cached_property
    def factors(self) -> Factors:
        """What varies."""
        return Factors(self.description, self.setup, self.source)

    @cached_property
    def asked(self) -> dict[str, Any]:
        """Everything that decides the scans, but which there are."""
        files = checksums([*named_files(self.setup), *self.factors.files])
        return {"batch": self.description, "setup": vars(self.setup), FILES: files}

    @property
    def apart(self) -> frozenset[str]:
        """Keys of `asked` that leave the scans as they are: all but one took effect in the other descriptions."""
        keys = [*SETUP_KEYS]
        if self.description.design.kind == "monte_carlo":
            keys.append("design.trials")  # more of them leave the first ones as they are
        return frozenset(f"batch.{key}" for key in keys)

    @cached_property
    def spec(self) -> dict[str, Any]:
        """Plain data from which a worker on any node prepares itself."""
        return plain_terms(self.asked, self.apart)

    def job(self, out: Path) -> Job:
        """The batch as work for the engine, in the folder `out` that it has claimed."""
        request = request_digest(open_batch_worker, recorded_terms(out))
        return Job(out.absolute() / SCANS, open_batch_worker, self.spec, request)

    @cached_property
    def tasks(self) -> list[Task]:
        """The scans, part by part; those of a part do not depend on which other parts there are."""
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
    """A batch of the meshes `given` (files, or folders that are searched), without those that lie in `out`.

    Parameters
    ----------
    file
        Where the description comes from; the paths in it are relative to its folder.

    Raises
    ------
    ScancellError
        Naming file, key, value and what was expected.
    """
    source = "batch" if file is None else str(file)
    setup = nominal_setup(description, Path() if file is None else file.parent, source)
    taken = [label for label in description.labels if label in INDEX_KEYS]
    if taken:
        raise DescriptionError(f"{source}: factor {taken[0]}: the index has a column of this name; give it another")
    return Batch(source, description, setup, find_parts(given, out))


def find_parts(given: Sequence[Path], out: Path) -> tuple[Part, ...]:
    """Meshes by name: that of the file, after those of the folders between it and the one that was given.

    Raises
    ------
    DescriptionError
        If a path does not exist, a folder holds no mesh, or two meshes would bear one name.
    """
    meshes: dict[str, Path] = {}
    for path in given:
        for name, mesh in _meshes(path, out.resolve()):
            other = meshes.setdefault(name, mesh)
            if other != mesh:
                raise DescriptionError(f"{mesh}: would bear the name '{name}' as does {other}; rename one of the two")
    return tuple(Part(name, mesh, _checksum(mesh)) for name, mesh in meshes.items())


def _meshes(path: Path, out: Path) -> list[tuple[str, Path]]:
    if path.is_file():
        return [(_name(path.name), path.resolve())]
    if not path.is_dir():
        raise DescriptionError(f"{path}: no such file or folder")
    files = [file for file in sorted(path.rglob("*")) if file.suffix.lower() in FORMATS and file.is_file()]
    inside = [(file.relative_to(path), file.resolve()) for file in files]
    wanted = [
        (_name(str(short)), file)
        for short, file in inside
        if out not in file.parents and not any(piece.startswith(".") for piece in short.parts)
    ]
    if not wanted:
        raise DescriptionError(f"{path}: holds no mesh ({', '.join(FORMATS)})")
    return wanted


def _name(relative: str) -> str:
    """A mesh's path without its suffix, fit to be the name of a folder."""
    return re.sub(r"[^\w.+-]+", "-", relative.rpartition(".")[0] or relative).strip(".-") or "part"


def _checksum(mesh: Path) -> str:
    try:
        return sha256(mesh)
    except OSError:  # it will be told again where the mesh is read
        return ""


def _part_seed(seed: int, name: str) -> int:
    """31 bits that depend on nothing but the batch's seed and the part's name."""
    return int.from_bytes(hashlib.sha256(f"scancell {seed} part {name}".encode()).digest()[:8], "big") >> 33


def check_batch(batch: Batch) -> None:
    """Refuse factors and deviations that the cell does not have, before anything runs.

    Raises
    ------
    ScancellError
        Naming file, factor, value and what was expected.
    """
    if not (batch.description.labels or batch.description.as_built):
        return
    some_part = box_mesh((0.05, 0.05, 0.05))
    with closing(ScanWorker(batch.description, batch.setup, some_part, batch.source)) as worker:
        batch.factors.check(worker.units())


def claim(batch: Batch, out: Path) -> Comparison:
    """Begin a batch in `out`, or go on with the one that is there.

    Raises
    ------
    DescriptionError
        If the folder holds scans made otherwise, naming the keys that differ.
    OutputError
        If it cannot be written.
    """
    if not (out / DESCRIPTION).exists():
        write_record(batch.spec, out)
    found = compare_with_record(batch.asked, batch.apart, out)
    if found.differences:
        raise DescriptionError(f"{out}: holds a batch that was made otherwise: {found}; --out names another folder")
    return found


def run_batch(batch: Batch, out: Path, where: Where, progress: Progress, announce: Announce = None) -> RunOutcome:
    """Make all scans that are not there yet, see `run_tasks`."""
    try:
        return run_tasks(batch.job(out), batch.tasks, where, progress, "scan", announce)
    finally:
        sweep_temporary()


@dataclass(frozen=True)
class Gathered:
    """Rows of the scans that are there, or that failed for good, and names of those that are missing."""

    rows: list[dict[str, Any]]
    missing: list[str]

    @property
    def failed(self) -> list[dict[str, Any]]:
        """Rows of the scans that could not be made."""
        return [row for row in self.rows if row["status"] != "ok"]


def gather(batch: Batch, out: Path, died: Mapping[str, str]) -> Gathered:
    """Read what the workers left and write the index; scans whose workers `died` (with a message) become rows, too.

    Raises
    ------
    OutputError
        If the index cannot be written.
    """
    job = batch.job(out)
    rows: list[dict[str, Any]] = []
    missing: list[str] = []
    for task in batch.tasks:
        if job.store.holds(task.name, job.digest_of_task(task)):
            row = json.loads((job.store.path(task.name) / ROW).read_text())
            rows.append({**row, "scan": task.name, "mesh": task.payload["mesh"]})
        elif task.name in died:
            said = {"status": "failed", "message": died[task.name], "as_built": [], "figures": {}, "files": []}
            rows.append({**task.payload, **said, "scan": task.name, "scancell": None})
        else:
            missing.append(task.name)
    write_table(index_table(rows, batch.description.labels, SCANS), out / INDEX)
    return Gathered(rows, missing)
