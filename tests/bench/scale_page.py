"""docs/scale.md from what `bench.studies` measured."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from .studies import ENGINES, Measured
from .table import cpu_model

_MILLION = 1_000_000
_PER_TASK = 20


def page(kept: Mapping[str, Mapping[str, Any]]) -> str:
    """The page; `kept` are the runs by name, as `bench.studies` keeps them."""
    runs = {
        name: Measured.read({key: value for key, value in run.items() if key not in {"load", "settings"}})
        for name, run in kept.items()
    }
    loads = ", ".join(f"{run['load']:.0f}" for run in kept.values())
    settings = kept["two"]["settings"]
    return "\n".join([_head(runs, loads, settings), _study(runs), _memory(runs["two"]), _engine(runs), _plan(runs)])


def _head(runs: Mapping[str, Measured], loads: str, settings: list[str]) -> str:
    two = runs["two"]
    count = f"--trials {two.trials['geometric']} --ray-traced {two.trials['ray-traced']}"
    words = "".join(f" --set {word}" for word in settings)
    return f"""# Cost and scaling of studies

Written by

```sh
PYTHONPATH=tests python -m bench.studies {count} --no-ops {runs["nothing"].tasks}{words}
```

on {cpu_model()}. Load of the machine by other processes at the start of the four runs: {loads}.
Processor time depends little on the load, except for the periodic work of Dask; wall time includes the effect of this
load."""


def efficiency(runs: Mapping[str, Measured]) -> float:
    """Processor time that two workers' trials would take at the median cost of one worker, over all that was taken."""
    alone, two = runs["one"].by_engine or {}, runs["two"]
    return sum(count * alone[name]["processor"] for name, count in two.trials.items()) / two.processor_s


def _medians(run: Measured) -> str:
    return " + ".join(f"{1e3 * found['processor']:.0f}" for found in (run.by_engine or {}).values()) + " ms"


def _study(runs: Mapping[str, Measured]) -> str:
    one, two = runs["one"], runs["two"]
    rows = "\n".join(
        f"| {run.workers} | {run.trials['geometric']} + {run.trials['ray-traced']} | {_medians(run)}"
        f" | {run.processor_s:.0f} s | {run.overhead:.1%} | {run.seconds:.0f} s | {run.rate:.2f} | {run.idle:.1%} |"
        for run in (one, two)
    )
    by_processor = efficiency(runs)
    by_wall = two.rate / (2 * one.rate)
    return f"""
## One study on one machine

Geometric + ray-traced scans of at most {two.profiles} profiles of the sphere on its foot, three factors, one trial per
task.

| workers | trials | processor time of a trial (median) | total | outside trials | wall time | tasks/s | idle |
|---|---|---|---|---|---|---|---|
{rows}

- **Parallel efficiency of two workers: {by_processor:.1%}** (target: 90 % or more): processor time of the
  trials at the median cost of one worker, divided by the total processor time with two workers, which includes the
  command, the scheduler, and the start and end of the workers. Rates of wall time give {by_wall:.0%}, which is
  meaningful only on an idle machine.
- **Overhead: {two.overhead:.1%}** (target: less than 5 %): the share of processor time that is not spent in trials.
  The two workers were idle for {two.idle:.1%} of their wall time, waiting for the next task or for
  the last one.
- Gathering {two.tasks} rows, statistics and the report take another {two.report_s:.1f} s of processor time."""


def _memory(two: Measured) -> str:
    rows = "\n".join(
        f"| {m.worker} | {m.engine} | {m.trials} | {m.first_mb:.1f} | {m.last_mb:.1f}"
        f" | {m.last_mb / m.first_mb - 1:+.1%} |"
        for m in two.memory
    )
    return f"""
Memory of each worker process, median over the first and the last quarter of its trials:

| worker | engine | trials | first quarter, MB | last quarter, MB | change |
|---|---|---|---|---|---|
{rows}"""


def _engine(runs: Mapping[str, Measured]) -> str:
    nothing, cost = runs["nothing"], runs["cost"]
    named = cost.by_engine or {}
    stations = [name for name in named["geometric"] if name not in {"processor", "all"}]
    shares = [" | ".join(f"{named[e][name] / named[e]['all']:.0%}" for e in ENGINES) for name in stations]
    lines = [f"| {name} | {share} |" for name, share in zip(stations, shares, strict=True)]
    spent = " | ".join(f"{1e3 * named[engine]['processor']:.0f}" for engine in ENGINES)
    rate = f"{nothing.rate:.0f}"
    in_workers = 1e3 * nothing.children_s / nothing.tasks
    return f"""
## Cost of a scan and of a task

A scan of at most {cost.profiles} profiles in one process, medians; shares are of wall time:

| | geometric | ray-traced |
|---|---|---|
{chr(10).join(lines)}
| **processor time, ms** | {spent} |

{nothing.tasks} tasks that only write one small file, on {nothing.workers} workers: {rate} tasks/s
of wall time. A task costs **{_own_ms(nothing):.2f} ms** of processor time in the command and its scheduler, and
{in_workers:.2f} ms in the workers (two small files, a rename, checksums; the start of the workers included)."""


def _own_ms(nothing: Measured) -> float:
    return 1e3 * nothing.own_s / nothing.tasks


def _plan(runs: Mapping[str, Measured]) -> str:
    two, seconds = runs["two"], {name: (runs["cost"].by_engine or {})[name]["processor"] for name in ENGINES}
    hours = {name: _MILLION * value / 3600 for name, value in seconds.items()}
    limit = 1e3 / _own_ms(runs["nothing"])
    rows = "\n".join(
        f"| {name} | {seconds[name]:.2f} | {hours[name]:.0f} | {hours[name] / 256:.1f} | {hours[name] / 1024:.1f}"
        f" | {limit * seconds[name]:.0f} | {_PER_TASK * limit * seconds[name]:.0f} |"
        for name in ENGINES
    )
    size, scans = two.bytes_per_task, 256 / seconds["geometric"]
    report = two.report_s / two.tasks
    return f"""
## A million scans

| engine | s per scan | core hours | hours on 256 cores | on 1024 | cores per scheduler | {_PER_TASK} a task |
|---|---|---|---|---|---|---|
{rows}

Limits:

- **The scheduler** is one process that distributes at most {limit:.0f} tasks/s: the right-hand columns are the number
  of cores that this keeps busy. `trials_per_task = {_PER_TASK}` divides its work by {_PER_TASK}. At most 20 tasks
  per worker (and at least 200) are submitted at a time, so its memory does not grow with the study.
- **The disk.** A trial writes {size / 1024:.1f} kB in three files, so a million write {_MILLION * size / 1e9:.1f} GB;
  images and clouds are not kept. 256 cores with geometric scans write {scans * size / 1e6:.1f} MB/s,
  but {3 * scans:.0f} files/s with one trial per task, which is a load for a shared file system. With {_PER_TASK} trials
  per task it is {3 * scans / _PER_TASK:.0f} files/s, and {3 * _MILLION // _PER_TASK} files in the end.
- **Reading the results.** Collection and report take {1e3 * report:.1f} ms per trial, {_MILLION * report / 60:.0f}
  minutes of one core for a million if this scales linearly, with all rows in memory.
- **A failed scheduler** loses the running tasks; `resume` continues. Job arrays (`--shard i/n`) need none: each job
  runs every n-th task, and the report is written once at the end.
"""
