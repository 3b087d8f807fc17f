"""A planned scan, and its JSON: in every run folder, by `scancell plan --out`, read and checked again by `--plan`."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from scancell.arguments import checked_arguments
from scancell.cell.program import BeltRun, Program, Segment, TriggerKind, TriggerRule
from scancell.cell.program_file import program_data
from scancell.config.description import Description, Finite, NonNegative, validate
from scancell.files import atomic_write, read_json
from scancell.planning.path_map.path_planner import PlacedPath
from scancell.planning.views.coverage import CoverageReport
from scancell.values import Value

Array = NDArray[np.float64]

_Row = tuple[Finite, ...]
_UNITS = {"time": "s", "q": "rad", "table": "rad", "interval": "s, rad or m by kind"}


@dataclass(frozen=True, eq=False, repr=False)
class Plan(Value):
    """A program and its exposures.

    Attributes
    ----------
    program
        From home to home, checked for reach, joint limits and collisions.
    segment
        (m,) segment id of each exposure, in order of time.
    q, table
        (m, joints), (m,) planned joints and table angle of each exposure, rad.
    coverage
        Fraction of the part's surface that the views see, self-occlusion ignored; None for given poses.
    warnings
        Views that were omitted or replaced, and why.
    paths
        Sensor paths with the motions of the table that were found for them.
    report
        What coverage-driven views see; None for others.
    reduced
        Bodies whose meshes were reduced for the distance queries, and by how much: added to their clearances.
    source
        File that a saved plan was read from.

    Examples
    --------
    >>> plan = scancell.plan("part.stl")
    >>> f"{len(plan.q)} exposures, {plan.coverage:.0%} of the surface"
    '1299 exposures, 71% of the surface'
    >>> file = plan.save("plan.json")
    >>> bool(np.array_equal(scancell.Plan.load("plan.json").q, plan.q))
    True
    """

    program: Program
    segment: NDArray[np.int64]
    q: Array
    table: Array
    coverage: float | None
    warnings: tuple[str, ...]
    paths: tuple[PlacedPath, ...] = ()
    report: CoverageReport | None = None
    reduced: tuple[str, ...] = ()
    source: str = field(default="", compare=False)

    @checked_arguments
    def save(self, path: str | Path) -> Path:
        """Write program and exposures to the file `path` (JSON), for `load` and `Scanner.scan`.

        What else the plan holds is not kept.

        Raises
        ------
        OutputError
            If the file cannot be written.
        """
        with atomic_write(path) as temporary:
            temporary.write_text(json.dumps(plan_json(self)) + "\n", encoding="utf-8")
        return Path(path)

    @staticmethod
    @checked_arguments
    def load(path: str | Path) -> Plan:
        """The plan of the file `path`; `Scanner.scan` checks it again.

        Raises
        ------
        DescriptionError
            If the file cannot be read or holds no plan, naming key, value and what was expected.
        """
        file = Path(path)
        read = validate(_PlanFile, read_json(file), str(file))
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
                None if item.belt is None else BeltRun(**item.belt.model_dump()),
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


class _Trigger(Description):
    kind: TriggerKind
    interval: NonNegative


class _BeltRun(Description):
    conveyor: Annotated[int, Field(ge=1)]
    speed: Finite
    trigger_from: Finite
    trigger_to: Finite


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
    belt: _BeltRun | None = None
    time: Annotated[_Row, Field(min_length=2)]

    @model_validator(mode="after")
    def _belt_runs_where_it_triggers(self) -> Self:
        if (self.belt is None) == (self.trigger.kind == "belt_travel"):
            raise ValueError('expected belt where trigger.kind is "belt_travel", and nowhere else')
        if self.belt is not None and self.belt.speed * (self.belt.trigger_to - self.belt.trigger_from) <= 0.0:
            raise ValueError("belt: expected a speed that leads from trigger_from to trigger_to")
        return self


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
