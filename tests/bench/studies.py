"""`python -m bench.studies` (in tests/): throughput of studies, what distributing costs, and what a million scans take.

Writes docs/scale.md. The study has geometric and ray-traced scans of at most 200 profiles each; a fifth of it is run
on one worker, all of it on two. Tasks that do nothing and very short scans show what the engine itself costs.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet

from orchestrator.config.loading import assets_dir
from orchestrator.progress import Silent
from orchestrator.studies.engine import RunOutcome, run_tasks
from orchestrator.studies.report import write_report
from orchestrator.studies.study import begin, open_study, run_study
from orchestrator.studies.task import Job, Task, Where

from .table import cpu_model

TESTS = Path(__file__).resolve().parents[1]
sys.path.append(str(TESTS))

STUDY = f"""
name = "speed"
part = "{assets_dir() / "parts" / "sphere_on_foot.stl"}"
set = ["cell.part.x_mm=20", "scan.max_profiles=200"]
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


def open_nothing(spec: Mapping[str, Any]) -> Any:
    """A worker whose tasks leave one small file and do nothing else."""
    return lambda payload, folder: (folder / "n").write_text(str(payload))


@dataclass(frozen=True)
class Measured:
    """A run: tasks, workers, what the engine says, and the timings of its trials where it had any."""

    tasks: int
    workers: int
    outcome: RunOutcome
    timings: dict[str, list[Any]]
    bytes_per_task: float

    @property
    def seconds(self) -> float:
        """From the moment when the workers were there."""
        return self.outcome.seconds - self.outcome.start_seconds

    @property
    def rate(self) -> float:
        """Tasks per second."""
        return self.tasks / self.seconds

    @property
    def overhead(self) -> float:
        """Share of the workers' time that was not spent in tasks."""
        return 1 - self.outcome.busy_seconds / (self.workers * self.seconds)


SHORT = ("set=['scan.max_profiles=20', 'scan.raster.enabled=false']", "coverage_samples=0")


def run_scans(workers: int, trials: int, ray_traced: int, more: Sequence[str] = ()) -> Measured:
    """The study in a temporary folder."""
    with tempfile.TemporaryDirectory(prefix="scancell-bench-") as name:
        folder = Path(name)
        (folder / "speed.toml").write_text(STUDY)
        words = [f"design.trials={trials}", f"ray_traced_trials={ray_traced}", *more]
        study = open_study(folder / "speed.toml", words)
        begin(study, folder / "out")
        outcome = run_study(study, folder / "out", Where(workers=workers), Silent())
        write_report(study, folder / "out")
        timings = pyarrow.parquet.read_table(folder / "out" / "timings.parquet").to_pydict()
        return Measured(len(study.tasks), workers, outcome, timings, _bytes(folder / "out" / "tasks", len(study.tasks)))


def run_nothing(workers: int, count: int) -> Measured:
    """Tasks that do nothing."""
    with tempfile.TemporaryDirectory(prefix="scancell-bench-") as name:
        job = Job(Path(name) / "tasks", open_nothing, {})
        tasks = [Task(f"t{n:07d}", n) for n in range(count)]
        outcome = run_tasks(job, tasks, Where(workers=workers), Silent())
        return Measured(count, workers, outcome, {}, _bytes(job.folder, count))


def _bytes(folder: Path, count: int) -> float:
    return sum(file.stat().st_size for file in folder.rglob("*") if file.is_file()) / count


def memory_lines(timings: dict[str, list[Any]]) -> list[str]:
    """Memory of each worker after a tenth of its trials and at the end, and the slope between, MB per 1000 trials."""
    worker, memory = np.array(timings["worker"]), np.array(timings["memory_mb"], float)
    lines = []
    for k, pid in enumerate(dict.fromkeys(timings["worker"]), 1):
        own = memory[worker == pid]
        settled = own[max(1, len(own) // 10) :]
        if len(settled) < 2:
            continue
        slope = 1000 * np.polyfit(np.arange(len(settled)), settled, 1)[0]
        lines.append(f"| {k} | {len(own)} | {settled[0]:.0f} | {settled[-1]:.0f} | {own.max():.0f} | {slope:+.1f} |")
    return lines


def station_lines(timings: dict[str, list[Any]], split: int) -> list[str]:
    """Median milliseconds by station: trials up to `split` are geometric, the others ray-traced."""
    names = [name for name in timings if name.endswith("_s")]
    trial = np.array(timings["trial"])
    columns = {name: np.array([value or 0.0 for value in timings[name]], float) for name in names}
    lines = []
    for name in names:
        cells = [
            np.median(columns[name][chosen]) * 1e3 if chosen.any() else 0.0
            for chosen in (trial <= split, trial > split)
        ]
        lines.append(f"| {name.removesuffix('_s')} | {cells[0]:.0f} | {cells[1]:.0f} |")
    return lines


def page(one: Measured, two: Measured, short: Measured, nothing: Measured, load: float, trials: int) -> str:
    """docs/scale.md."""
    efficiency = two.rate / (2 * one.rate)
    geometric = float(
        np.median([t for t, n in zip(two.timings["all_s"], two.timings["trial"], strict=True) if n <= trials])
    )
    cost = 1e3 * nothing.seconds / nothing.tasks
    busiest = geometric / (cost * 1e-3)
    busy = "\nOthers used the machine meanwhile: times are longer than on an idle one." if load > 0.5 else ""
    return f"""# What many scans take

Written by `PYTHONPATH=tests python -m bench.studies --trials {trials} --ray-traced {two.tasks - trials}`.
CPU: {cpu_model()}; load of the machine by others when it began: {load:.1f}.{busy}

## One study on one machine

{trials} geometric and {two.tasks - trials} ray-traced scans of at most 200 profiles of the sphere on its foot, three factors.

| workers | tasks | s | tasks/s | time of workers outside tasks |
|---|---|---|---|---|
| 1 | {one.tasks} | {one.seconds:.1f} | {one.rate:.3f} | {one.overhead:.1%} |
| 2 | {two.tasks} | {two.seconds:.1f} | {two.rate:.3f} | {two.overhead:.1%} |

Parallel efficiency of 2 workers: **{efficiency:.0%}** (wanted: at least 90 %). Time of the workers that is not spent
in tasks, and so scheduling, waiting and the uneven end: **{two.overhead:.1%}** (wanted: less than 5 %).

Median milliseconds of a trial by station, two workers:

| station | geometric | ray-traced |
|---|---|---|
{chr(10).join(station_lines(two.timings, trials))}

Memory of each worker process, MB, with the slope over its trials after the first tenth:

| worker | trials | after a tenth | at the end | largest | MB per 1000 trials |
|---|---|---|---|---|---|
{chr(10).join(memory_lines(two.timings))}

## The engine itself

| what | tasks | s | tasks/s | time of workers outside tasks |
|---|---|---|---|---|
| nothing but one small file | {nothing.tasks} | {nothing.seconds:.1f} | {nothing.rate:.0f} | {nothing.overhead:.0%} |
| scans of 20 profiles | {short.tasks} | {short.seconds:.1f} | {short.rate:.1f} | {short.overhead:.1%} |

So a task costs **{cost:.2f} ms** in all: scheduling, two small files, one rename. A trial leaves
{two.bytes_per_task / 1024:.1f} kB in three files.

## A million scans

A geometric scan takes {geometric:.2f} s of one core here, so a million take {1e6 * geometric / 3600:.0f} core hours:
{1e6 * geometric / 3600 / 256:.1f} hours on 256 cores.

What limits it:

- **The scheduler.** At {cost:.2f} ms per task one scheduler keeps about {busiest:.0f} workers busy with one trial per
  task. `trials_per_task = 20` makes that {20 * busiest:.0f}, and a million trials 50 000 tasks. Only a few hundred
  tasks (20 per worker) are known to the scheduler at a time, so its memory does not grow with the study.
- **The file system.** One trial per task would make 3 million files and a million folders; with 20 it is 150 000 files
  and {two.bytes_per_task * 1e6 / 1e9:.1f} GB of rows. Workers write only finished rows; images and clouds are not kept.
- **Reading it back.** `study report` and `study resume` check every file's checksum: a few minutes for 50 000 tasks on
  a shared disk, once.
- **A dead scheduler** costs the tasks that were running. With job arrays (`--shard i/n`) there is none: each job takes
  every n-th task, and the report is made once at the end.
"""


def main() -> None:
    """Measure and write."""
    parser = argparse.ArgumentParser(prog="python -m bench.studies", description=__doc__)
    parser.add_argument("--trials", type=int, default=1000)
    parser.add_argument("--ray-traced", type=int, default=200)
    parser.add_argument("--short", type=int, default=2000)
    parser.add_argument("--no-ops", type=int, default=10_000)
    parser.add_argument("--out", type=Path, default=Path("docs/scale.md"))
    options = parser.parse_args()
    load, start = os.getloadavg()[0], time.perf_counter()
    nothing = run_nothing(2, options.no_ops)
    print(f"{nothing.tasks} no-ops: {nothing.rate:.0f} tasks/s", flush=True)
    runs = []
    for workers, trials, ray_traced, more in (
        (1, max(10, options.trials // 5), max(2, options.ray_traced // 5), ()),
        (2, options.trials, options.ray_traced, ()),
        (2, options.short, 0, SHORT),
    ):
        runs.append(run_scans(workers, trials, ray_traced, more))
        print(f"{workers} workers: {runs[-1].rate:.3f} tasks/s, overhead {runs[-1].overhead:.1%}", flush=True)
    options.out.write_text(page(*runs, nothing, load, options.trials))
    print(f"{time.perf_counter() - start:.0f} s, written to {options.out}")


if __name__ == "__main__":
    main()
