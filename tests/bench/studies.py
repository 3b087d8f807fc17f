"""`python -m bench.studies` (in tests/): throughput of studies, what distributing costs, and what a million scans take.

Writes docs/scale.md. Four runs, each of which is kept in a JSON file so that it can be made alone (`--only`): tasks
that do nothing; a few scans of 200 profiles, in this process, for their cost; a tenth of the study on one worker; all
of it on two. `--set` makes the study's scans shorter, which makes distributing them harder. Processor time is that of
all processes together, which other work on the machine hardly touches; wall time says little on a busy machine.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet
from numpy.typing import NDArray

from scancell.config.loading import assets_dir
from scancell.progress import NullProgress
from scancell.studies.engine import ExecutionTarget, Job, RunOutcome, Task, close_workers, run_tasks
from scancell.studies.report import write_report
from scancell.studies.study import open_study

TESTS = Path(__file__).resolve().parents[1]
sys.path.append(str(TESTS))  # the workers import this module by its name

STUDY = f"""
name = "speed"
part = "{assets_dir() / "parts" / "sphere_on_foot.stl"}"
engine = "geometric"
[design]
kind = "monte_carlo"
[[factor]]
path = "as_built.tool.x_mm"
distribution = {{ kind = "normal", std = 0.05 }}
[[factor]]
path = "as_built.table.x_mm"
distribution = {{ kind = "normal", std = 0.05 }}
[[factor]]
path = "as_built.trigger.latency_ms"
distribution = {{ kind = "uniform", low = 0, high = 0.5 }}
"""
ENGINES = ("geometric", "ray-traced")
PRESET = ("scan.max_profiles=200",)


@dataclass(frozen=True)
class Memory:
    """Median memory of a worker process over the first and the last quarter of its trials with an engine, MB."""

    worker: int
    engine: str
    trials: int
    first_mb: float
    last_mb: float


@dataclass(frozen=True)
class Measured:
    """A run.

    Attributes
    ----------
    seconds
        Wall time from the moment when the workers were there.
    busy_s
        Wall time that the workers spent in tasks, added up.
    own_s, children_s
        Processor time of the command (with client and scheduler) and of the workers from their start to their end.
    trial_s
        Processor time of the trials themselves, added up: the work that the rest is held against.
    report_s
        Processor time of gathering all rows and writing tables and report.
    by_engine
        Median seconds of a trial by engine: processor time, and wall time by station.
    """

    workers: int
    trials: dict[str, int]
    tasks: int
    seconds: float
    busy_s: float
    own_s: float
    children_s: float
    bytes_per_task: float
    trial_s: float = 0.0
    report_s: float = 0.0
    profiles: int = 0
    by_engine: dict[str, dict[str, float]] | None = None
    memory: Sequence[Memory] = ()

    @property
    def rate(self) -> float:
        """Tasks per second of wall time."""
        return self.tasks / self.seconds

    @property
    def idle(self) -> float:
        """Share of the workers' wall time that was not spent in tasks."""
        return 1 - self.busy_s / (self.workers * self.seconds)

    @property
    def processor_s(self) -> float:
        """Processor time of everything."""
        return self.own_s + self.children_s

    @property
    def overhead(self) -> float:
        """Share of all processor time that was not spent in trials."""
        return 1 - self.trial_s / self.processor_s

    @classmethod
    def read(cls, plain: Mapping[str, Any]) -> Measured:
        """From plain data."""
        return cls(**{**plain, "memory": [Memory(**row) for row in plain["memory"]]})


class _Processor:
    """Processor time of this process and of its ended children since it was made."""

    def __init__(self) -> None:
        self._start = self._now()

    @staticmethod
    def _now() -> tuple[float, float]:
        used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
        return used[0].ru_utime + used[0].ru_stime, used[1].ru_utime + used[1].ru_stime

    def spent(self) -> tuple[float, float]:
        """Seconds of this process, of the children."""
        own, children = self._now()
        return own - self._start[0], children - self._start[1]


def run_scans(target: ExecutionTarget, trials: int, ray_traced: int, settings: Sequence[str]) -> Measured:
    """The study in a temporary folder, one trial per task."""
    with tempfile.TemporaryDirectory(prefix="scancell-bench-") as name:
        folder = Path(name)
        (folder / "speed.toml").write_text(STUDY)
        nominal = json.dumps(["cell.part.x_mm=20", *settings])
        words = [f"design.trials={trials}", f"ray_traced_trials={ray_traced}", f"set={nominal}"]
        study = open_study(folder / "speed.toml", words)
        study.begin(folder / "out")
        processor = _Processor()
        outcome = study.run(folder / "out", target, NullProgress())
        spent, processor = processor.spent(), _Processor()
        close_workers()
        write_report(study, folder / "out")
        counts = {"geometric": trials, "ray-traced": ray_traced}
        measured = _measured(target.workers or 1, counts, len(study.tasks), outcome, spent, folder / "out" / "tasks")
        rows = pyarrow.parquet.read_table(folder / "out" / "results.parquet").to_pydict()
        if set(rows["status"]) != {"ok"}:
            raise RuntimeError(f"failed: {next(filter(None, rows['message']))}")
        timings = pyarrow.parquet.read_table(folder / "out" / "timings.parquet").to_pydict()
        engine = np.array(rows["engine"])
        return replace(
            measured,
            trial_s=sum(timings["processor_s"]),
            report_s=sum(processor.spent()),
            profiles=max(rows["profiles"]),
            by_engine={name: _seconds(timings, engine == name) for name in ENGINES if counts[name]},
            memory=_memory(timings, engine),
        )


def open_nothing(spec: Mapping[str, Any]) -> Any:
    """A worker whose tasks leave one small file and do nothing else."""
    return lambda payload, folder: (folder / "n").write_text(str(payload))


def run_nothing(workers: int, count: int) -> Measured:
    """Tasks that do nothing."""
    with tempfile.TemporaryDirectory(prefix="scancell-bench-") as name:
        job = Job(Path(name) / "tasks", open_nothing, {})
        tasks = [Task(f"t{n:07d}", n) for n in range(count)]
        processor = _Processor()
        outcome = run_tasks(job, tasks, ExecutionTarget(workers=workers), NullProgress())
        return _measured(workers, {}, count, outcome, processor.spent(), job.folder)


def _measured(
    workers: int, counts: dict[str, int], tasks: int, outcome: RunOutcome, spent: tuple[float, float], folder: Path
) -> Measured:
    if len(outcome.done) != tasks:
        raise RuntimeError(f"{tasks - len(outcome.done)} of {tasks} tasks are not done")
    seconds = outcome.seconds - outcome.start_seconds
    size = sum(file.stat().st_size for file in folder.rglob("*") if file.is_file())
    return Measured(workers, counts, tasks, seconds, outcome.busy_seconds, *spent, size / tasks)


def _seconds(timings: Mapping[str, list[Any]], chosen: NDArray[np.bool_]) -> dict[str, float]:
    """Median of every column of seconds over the chosen trials."""
    names = [name for name in timings if name.endswith("_s")]
    columns = {name: np.array([value or 0.0 for value in timings[name]], float)[chosen] for name in names}
    return {name.removesuffix("_s"): float(np.median(column)) for name, column in columns.items()}


def _memory(timings: Mapping[str, list[Any]], engine: NDArray[Any]) -> list[Memory]:
    """By worker and engine; a worker's first trial of each engine is left out, for it loads what the others use."""
    worker, memory = np.array(timings["worker"]), np.array(timings["memory_mb"], float)
    found = []
    for name in ENGINES:
        for k, pid in enumerate(dict.fromkeys(timings["worker"]), 1):
            own = memory[(worker == pid) & (engine == name)][1:]
            quarter = len(own) // 4
            if quarter:
                ends = float(np.median(own[:quarter])), float(np.median(own[-quarter:]))
                found.append(Memory(k, name, len(own) + 1, *ends))
    return found


def main() -> None:
    """Measure and write."""
    from .scale_page import page  # noqa: PLC0415  (it reads what is measured here)

    parser = argparse.ArgumentParser(prog="python -m bench.studies", description=__doc__)
    parser.add_argument("--trials", type=int, default=1000)
    parser.add_argument("--ray-traced", type=int, default=200)
    parser.add_argument("--set", action="append", help="of the study's scans, as `scancell scan --set`")
    parser.add_argument("--no-ops", type=int, default=10_000)
    parser.add_argument("--only", action="append", choices=("nothing", "cost", "one", "two"))
    parser.add_argument("--measured", type=Path, default=Path("out/scale.json"))
    parser.add_argument("--out", type=Path, default=Path("docs/scale.md"))
    options = parser.parse_args()
    settings = options.set or PRESET
    tenth = max(8, options.trials // 10), max(4, options.ray_traced // 10)
    runs = {
        "nothing": lambda: run_nothing(2, options.no_ops),
        "cost": lambda: run_scans(ExecutionTarget(shard=(1, 1)), 8, 4, PRESET),
        "one": lambda: run_scans(ExecutionTarget(workers=1), *tenth, settings),
        "two": lambda: run_scans(ExecutionTarget(workers=2), options.trials, options.ray_traced, settings),
    }
    file: Path = options.measured
    kept = json.loads(file.read_text()) if options.only and file.exists() else {}
    for name in options.only or runs:
        load, start = os.getloadavg()[0], time.perf_counter()
        made = runs[name]()
        kept[name] = {"load": load, "settings": list(settings), **asdict(made)}
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(json.dumps(kept, indent=1) + "\n")
        print(f"{name}: {made.tasks} tasks, {made.rate:.2f}/s, {time.perf_counter() - start:.0f} s", flush=True)
    if set(kept) == set(runs):
        options.out.write_text(page(kept))
        print(f"written to {options.out}")


if __name__ == "__main__":
    main()
