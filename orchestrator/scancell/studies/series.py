"""Many scans of one description in one folder: common base of studies and batches.

OUT/description.json   everything that decides the results, after defaults; other results are refused in the folder
OUT/tasks or scans     one folder per finished task, which appears whole or not at all
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

from scancell.config.loading import Setup
from scancell.config.variation import VaryingScansDescription
from scancell.errors import DescriptionError
from scancell.output.manifest import named_files
from scancell.progress import Progress
from scancell.studies.engine import (
    Announce,
    ExecutionTarget,
    Job,
    OpenWorker,
    RunOutcome,
    Task,
    request_digest,
    run_tasks,
)
from scancell.studies.factors import SETUP_KEYS, Factors
from scancell.studies.run_record import (
    DESCRIPTION,
    FILES,
    Comparison,
    checksums,
    compare_with_record,
    plain_terms,
    recorded_terms,
    write_record,
)
from scancell.studies.scan_worker import ScanWorker, sweep_temporary

# Designs whose first trials stay the same when `design.trials` grows.
EXTENDABLE = ("monte_carlo", "sobol")


@dataclass(frozen=True)
class ScanSeries(ABC):
    """A checked description with the nominal setup that it names; messages call the description `source`."""

    source: str
    description: VaryingScansDescription
    setup: Setup

    kind: ClassVar[str]
    unit: ClassVar[str]  # of progress
    folder: ClassVar[str]  # of the finished tasks, in the folder of the results

    @property
    @abstractmethod
    def open_worker(self) -> OpenWorker:
        """Prepares a worker process from `spec`."""

    @property
    @abstractmethod
    def tasks(self) -> list[Task]:
        """All scans, in tasks."""

    @abstractmethod
    def worker(self) -> ScanWorker:
        """A worker in this process."""

    def _inputs(self) -> dict[str, str]:
        """Paths of input files besides those that the setup and the factors name, by what they are."""
        return {}

    @property
    def ignored_keys(self) -> frozenset[str]:
        """Keys of `request` that leave finished results valid; input files are compared by content, not by path."""
        return self._unrecorded | {f"{self.kind}.{name}" for name in self._inputs()}

    @property
    def _unrecorded(self) -> frozenset[str]:
        """Keys that took effect in the setup, and the number of trials where more of them can follow."""
        keys = [*SETUP_KEYS, *(["design.trials"] if self.description.design.kind in EXTENDABLE else [])]
        return frozenset(f"{self.kind}.{key}" for key in keys)

    @cached_property
    def factors(self) -> Factors:
        """Factors of the description."""
        return Factors(self.description, self.setup, self.source)

    @cached_property
    def request(self) -> dict[str, Any]:
        """Everything that decides the results."""
        inputs = self._inputs()
        files = checksums([*inputs.values(), *named_files(self.setup), *self.factors.files])
        return {self.kind: self.description, "setup": vars(self.setup), **inputs, FILES: files}

    @cached_property
    def spec(self) -> dict[str, Any]:
        """Plain data from which a worker on any node prepares itself (the files are on a disk that all nodes see)."""
        return plain_terms(self.request, frozenset(f"{self.kind}.{key}" for key in SETUP_KEYS))

    def job(self, out: Path) -> Job:
        """The work for the engine, in the folder `out` that it was begun in."""
        request = request_digest(self.open_worker, recorded_terms(out))
        return Job(out.absolute() / self.folder, self.open_worker, self.spec, request)

    def check(self) -> None:
        """Refuse factors and deviations that the cell does not have; loads the cell's FMU, which takes a second.

        Raises
        ------
        ScancellError
            Naming file, factor, value and what was expected.
        """
        with closing(self.worker()) as worker:
            self.factors.check(worker.units())

    def begin(self, out: Path) -> None:
        """Claim the folder `out`, unless it was begun already.

        Raises
        ------
        OutputError
            If the folder cannot be written.
        """
        if not (out / DESCRIPTION).exists():
            write_record(plain_terms(self.request, self._unrecorded), out)

    def check_same(self, out: Path) -> Comparison:
        """Compare with what the folder was begun for.

        Raises
        ------
        DescriptionError
            If nothing was begun there, or naming the keys that differ.
        """
        try:
            found = compare_with_record(self.request, self.ignored_keys, out)
        except FileNotFoundError:
            raise DescriptionError(f"no {self.kind} was begun in this folder", file=out) from None
        if found.differences:
            raise DescriptionError(
                f"differs from the {self.kind} in {found.record}: {found}{self._hint(found)};"
                " `out` names another folder",
                file=self.source,
            )
        return found

    def _hint(self, found: Comparison) -> str:
        design = self.description.design.kind
        if any(text.startswith(f"{self.kind}.design.trials ") for text in found.differences):
            return f" (only {' and '.join(EXTENDABLE)} designs can be extended; {design} would have other points)"
        return ""

    def run(self, out: Path, target: ExecutionTarget, progress: Progress, announce: Announce = None) -> RunOutcome:
        """Run all tasks that are not finished, see `run_tasks`."""
        try:
            return run_tasks(self.job(out), self.tasks, target, progress, self.unit, announce)
        finally:
            sweep_temporary()

    def complete(self, out: Path, workers: int, progress: Progress) -> dict[str, str]:
        """Check the series and run all tasks that `out` does not hold; returns messages of failed tasks by name.

        Raises
        ------
        ScancellError
            If the series cannot run, or the folder was begun for another one.
        """
        self.check()
        self.begin(out)
        self.check_same(out)
        return self.run(out, ExecutionTarget(workers=workers), progress).failed

    def results(self, out: Path) -> Iterator[tuple[Task, Path | None]]:
        """Every task, with the folder of its files; None where it is not finished."""
        job = self.job(out)
        for task in self.tasks:
            finished = job.store.holds(task.name, job.digest_of_task(task))
            yield task, job.store.path(task.name) if finished else None
