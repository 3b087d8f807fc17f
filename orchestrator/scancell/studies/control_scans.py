"""Control scans: whether a factor without detectable effect has any, by one trial again with another value of it.

The seed and all other values are those of the trial, so that only the factor can change a figure.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from scancell.progress import NullProgress
from scancell.studies.engine import run_tasks
from scancell.studies.study import Study
from scancell.studies.task import ExecutionTarget, Task
from scancell.studies.trial import ROWS

# More control scans than one per this many trials are not worth their time.
_TRIALS_PER_CONTROL = 10
_EQUAL = {"rel_tol": 1e-9, "abs_tol": 1e-6}  # last digits differ between kinds of processors


def factors_without_effect(
    study: Study,
    out: Path,
    rows: Sequence[dict[str, Any]],
    undetected: Sequence[str],
    target: ExecutionTarget | None = None,
) -> list[str]:
    """Those of the `undetected` factors that change no figure at all.

    Parameters
    ----------
    rows
        Finished trials.
    target
        Where to run control scans that are missing: its scheduler, else this process; None: run none.
    """
    base = next((row for row in rows if row["status"] == "ok"), None)
    if base is None or len(undetected) * _TRIALS_PER_CONTROL > len(rows):
        return []
    tasks = {label: _control(base, rows, study.factors.labels.index(label)) for label in undetected}
    job = study.job(out)
    if target is not None:
        chosen = target if target.scheduler is not None else ExecutionTarget(shard=(1, 1))
        run_tasks(job, [task for task in tasks.values() if task is not None], chosen, NullProgress())
    return [
        label
        for label, task in tasks.items()
        if task is None
        or (
            job.store.holds(task.name, job.digest_of_task(task))
            and _same_figures(base, *json.loads((job.store.path(task.name) / ROWS).read_text()))
        )
    ]


def _control(base: Mapping[str, Any], rows: Sequence[dict[str, Any]], factor: int) -> Task | None:
    """The trial `base` with the most distant value of a factor; None where the factor has one value in all trials."""
    own = base["values"][factor]
    others = [row["values"][factor] for row in rows if row["values"][factor] != own]
    if not others:
        return None
    numbers = all(isinstance(value, int | float) for value in (own, *others))
    values = list(base["values"])
    values[factor] = max(others, key=lambda value: abs(value - own)) if numbers else others[0]
    trial = {key: base[key] for key in ("number", "seed", "engine")}
    return Task(f"control-{factor + 1:03d}", [{**trial, "values": values}])


def _same_figures(base: Mapping[str, Any], control: Mapping[str, Any]) -> bool:
    before, after = base["figures"], control["figures"]
    return (
        control["status"] == "ok"
        and before.keys() == after.keys()
        and all(
            value == after[name]
            or (value is not None and after[name] is not None and math.isclose(value, after[name], **_EQUAL))
            for name, value in before.items()
        )
    )
