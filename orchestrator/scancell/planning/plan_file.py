"""Plans as JSON: written into every run folder and by `scancell plan --out`, read and checked again by `--plan`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from scancell.cell.program import Program, Segment, TriggerKind, TriggerRule
from scancell.cell.program_file import program_data
from scancell.config.description import Description, Finite, NonNegative, validate
from scancell.errors import DescriptionError
from scancell.files import atomic_write
from scancell.planning.plan import Plan

_Row = tuple[Finite, ...]
_UNITS = {"time": "s", "q": "rad", "table": "rad", "interval": "s, rad or m by kind"}


class _Trigger(Description):
    kind: TriggerKind
    interval: NonNegative


class _Points(Description):
    """Joints and table angle, with a further column `per_point` of as many rows."""

    per_point: ClassVar[str]

    q: tuple[_Row, ...]
    table: _Row

    @model_validator(mode="after")
    def _same_length(self) -> Self:
        numbers = {key: len(getattr(self, key)) for key in (self.per_point, "q", "table")}
        if len(set(numbers.values())) != 1:
            given = ", ".join(f"{number} {key}" for key, number in numbers.items())
            raise ValueError(f"{given}: expected as many of each")
        return self


class _Segment(_Points):
    per_point: ClassVar[str] = "time"

    id: Annotated[int, Field(ge=1)]
    name: str
    trigger: _Trigger
    trigger_from: NonNegative
    trigger_to: NonNegative
    time: Annotated[_Row, Field(min_length=2)]


class _Exposures(_Points):
    per_point: ClassVar[str] = "segment"

    segment: tuple[int, ...]


class _PlanFile(Description):
    format: Literal[2]
    units: dict[str, str]
    settle: NonNegative
    segments: Annotated[tuple[_Segment, ...], Field(min_length=1)]
    exposures: _Exposures

    @model_validator(mode="after")
    def _one_number_of_joints(self) -> Self:
        rows = [*(row for segment in self.segments for row in segment.q), *self.exposures.q]
        numbers = {len(row) for row in rows}
        if len(numbers) != 1:
            raise ValueError(f"q: rows of {sorted(numbers)} joints, expected one number of joints")
        return self


def plan_json(plan: Plan) -> dict[str, Any]:
    """A plan as plain data for JSON, SI units: segments with their set-points, exposures; without loss of precision."""
    return {
        **program_data(plan.program),
        "units": _UNITS,
        "exposures": {"segment": plan.segment.tolist(), "q": plan.q.tolist(), "table": plan.table.tolist()},
    }


def write_plan(file: Path, plan: Plan) -> None:
    """Write a plan (JSON), whole or not at all.

    Raises `OutputError` if the file cannot be written.
    """
    with atomic_write(file) as temporary:
        temporary.write_text(json.dumps(plan_json(plan)) + "\n", encoding="utf-8")


def read_plan(file: Path) -> Plan:
    """The plan of a file, not yet checked against a cell, see `planner.recheck`.

    Raises `DescriptionError` if the file cannot be read or holds no plan, naming key, value and what was expected.
    """
    if not file.is_file():
        raise DescriptionError("no such file", file=file)
    try:
        data = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise DescriptionError(f"cannot be read as JSON: {error}", file=file) from None
    read = validate(_PlanFile, data, str(file))
    segments = tuple(
        Segment(
            item.id,
            np.array(item.time),
            np.array(item.q),
            np.array(item.table),
            TriggerRule(item.trigger.kind, item.trigger.interval),
            item.trigger_from,
            item.trigger_to,
            item.name,
        )
        for item in read.segments
    )
    exposures = read.exposures
    return Plan(
        Program(segments, read.settle),
        np.array(exposures.segment, np.int64),
        np.array(exposures.q),
        np.array(exposures.table),
        None,
        (),
        source=str(file.absolute()),
    )
