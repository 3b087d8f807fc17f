"""A planned scan, and its JSON: in every run folder, by `scancell plan --out`, read and checked again by `--plan`."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from scancell.arguments import checked_arguments
from scancell.arrays import Array
from scancell.cell.program import BeltRun, Program, Segment, TriggerKind, TriggerRule, program_data
from scancell.config.description import Description, validate
from scancell.errors import DescriptionError
from scancell.files import PLAN_VERSION, atomic_write, read_json, require_format_version
from scancell.planning.path_map.path_planner import PlacedPath
from scancell.planning.views.coverage import CoverageReport
from scancell.values import Value

_LARGEST = 1e6  # rad, s, m or m/s; that of angles is also the FMU's
_Value = Annotated[float, Field(ge=-_LARGEST, le=_LARGEST, allow_inf_nan=False)]
_Duration = Annotated[float, Field(ge=0.0, le=_LARGEST, allow_inf_nan=False)]
_Number = Annotated[int, Field(ge=1, le=2**31 - 1)]
_Row = tuple[_Value, ...]
_Joints = Annotated[_Row, Field(min_length=1)]
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
    axes
        (m, axes) planned joints, table angle and further axes of each exposure, rad or m.
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
    >>> f"{len(plan.axes)} exposures, {plan.coverage:.0%} of the surface"
    '1299 exposures, 71% of the surface'
    >>> file = plan.save("plan.json")
    >>> bool(np.array_equal(scancell.Plan.load("plan.json").axes, plan.axes))
    True
    """

    program: Program
    segment: NDArray[np.int64]
    axes: Array
    coverage: float | None
    warnings: tuple[str, ...]
    paths: tuple[PlacedPath, ...] = ()
    report: CoverageReport | None = None
    reduced: tuple[str, ...] = ()
    source: str = field(default="", compare=False)

    @property
    def q(self) -> Array:
        """Planned joints (m, joints) of each exposure, rad."""
        return self.axes[:, : len(self.program.start) - 1]

    @property
    def table(self) -> Array:
        """Planned table angle (m,) of each exposure, rad."""
        return np.asarray(self.axes[:, len(self.program.start) - 1])

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
        data = read_json(file)
        if isinstance(data, dict):
            require_format_version(data.get("format_version"), PLAN_VERSION, file)
        read = validate(_PlanFile, data, str(file))
        segments = tuple(
            Segment(
                item.id,
                np.array(item.time),
                item.axes,
                TriggerRule(item.trigger.kind, item.trigger.interval),
                item.trigger_from,
                item.trigger_to,
                item.name,
                None if item.belt is None else BeltRun(**item.belt.model_dump()),
                item.positions,
            )
            for item in read.segments
        )
        ids = np.array(read.exposures.segment, np.int64)
        exposures = np.hstack([read.exposures.axes, read.exposures.positions])
        return Plan(Program(segments, read.settle), ids, exposures, None, (), source=str(file.absolute()))

    def require_joints(self, joints: int) -> None:
        """Raises `DescriptionError` if the plan is for an arm with another number of joints."""
        for number, segment in enumerate(self.program.segments, 1):
            if segment.axes.shape[1] != joints + 1:
                raise DescriptionError(
                    f"has rows of {segment.axes.shape[1] - 1} joints",
                    file=self.source or None,
                    key=f"segments[{number}].q",
                    expected=f"{joints}, as the arm of the cell",
                )


class _Trigger(Description):
    kind: TriggerKind
    interval: _Duration


class _BeltRun(Description):
    conveyor: _Number
    speed: _Value
    trigger_from: _Value
    trigger_to: _Value


class _Points(Description):
    """Joints and table angle, with a further column `per_point` of as many rows."""

    per_point: ClassVar[str]

    q: tuple[_Joints, ...]
    table: _Row
    further: tuple[_Joints, ...] = ()

    @property
    def axes(self) -> Array:
        return np.column_stack([self.q, self.table])

    @property
    def positions(self) -> Array:
        """(n, k) of the further axes."""
        return np.array(self.further, float).reshape(len(self.q), -1)

    @model_validator(mode="after")
    def _same_length(self) -> Self:
        given_keys = (self.per_point, "q", "table", *(("further",) if self.further else ()))
        numbers = {key: len(getattr(self, key)) for key in given_keys}
        if len(set(numbers.values())) != 1:
            given = ", ".join(f"{number} {key}" for key, number in numbers.items())
            raise ValueError(f"{given}: expected as many of each")
        return self


class _Segment(_Points):
    per_point: ClassVar[str] = "time"

    id: _Number
    name: str
    trigger: _Trigger
    trigger_from: _Duration
    trigger_to: _Duration
    belt: _BeltRun | None = None
    time: Annotated[_Row, Field(min_length=2)]

    @model_validator(mode="after")
    def _time_rises(self) -> Self:
        if self.time[0] != 0.0:
            raise ValueError(f"time[1] = {self.time[0]:g}: expected 0, the start of the segment")
        for number, (before, after) in enumerate(pairwise(self.time), 2):
            if after <= before:
                raise ValueError(f"time[{number}] = {after:g}: expected more than time[{number - 1}] = {before:g}")
        return self

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
    format_version: int | None = None
    units: dict[str, str]
    settle: _Duration
    segments: Annotated[tuple[_Segment, ...], Field(min_length=1)]
    exposures: _Exposures

    @model_validator(mode="after")
    def _one_number_of_joints(self) -> Self:
        parts = [*self.segments, self.exposures]
        for key, given in (("q", [one.q for one in parts]), ("further", [one.further or ((),) for one in parts])):
            numbers = {len(row) for rows in given for row in rows}
            if len(numbers) > 1:
                what = "joints" if key == "q" else "further axes"
                raise ValueError(f"{key}: rows of {sorted(numbers)} {what}, expected one number of {what}")
        return self

    @model_validator(mode="after")
    def _segments_are_known_by_their_ids(self) -> Self:
        counts = Counter(segment.id for segment in self.segments)
        for number, count in counts.items():
            if count > 1:
                raise ValueError(f"segments: {count} of them have id = {number}: expected an id of its own for each")
        for row, segment in enumerate(self.exposures.segment, 1):
            if segment not in counts:
                raise ValueError(f"exposures.segment[{row}] = {segment}: expected the id of one of the segments")
        return self


def plan_json(plan: Plan) -> dict[str, Any]:
    """A plan as plain data for JSON, SI units: segments with their set-points, exposures; without loss of precision."""
    exposures = {"segment": plan.segment.tolist(), "q": plan.q.tolist(), "table": plan.table.tolist()}
    further = plan.axes[:, len(plan.program.start) :]
    return {
        "format_version": PLAN_VERSION,
        **program_data(plan.program),
        "units": _UNITS,
        "exposures": {**exposures, **({"further": further.tolist()} if further.size else {})},
    }
