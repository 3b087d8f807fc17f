"""A reference trajectory, simulated by the FMU itself when it was packed, for a check after import."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import fmpy
import numpy as np

from scancell.cell.instance import CellInstance

DURATION_S = 2.0
_TRIGGER_PERIOD_S = 0.05
_EXPOSURE_S = 0.002
_SWING = math.radians(4.0)  # amplitude of the joints
_TABLE_RATE = 0.8  # rad/s that the table reaches

FOLDER = "extra/org.fmi-standard.fmi-ls-ref"
INPUTS, OUTPUTS = "reference_inputs.csv", "reference_outputs.csv"
_DESCRIPTION = "Layered Standard providing information on related files included in an FMU."


@dataclass(frozen=True)
class Reference:
    """Inputs and outputs, a row per communication point: time, then the values of the names."""

    input_names: list[str]
    inputs: list[list[float | int]]
    output_names: list[str]
    outputs: list[list[float | int]]
    step_s: float

    def files(self) -> dict[str, str]:
        """Contents by path in the FMU."""
        return {
            f"{FOLDER}/fmi-ls-manifest.xml": _manifest(self.step_s),
            f"{FOLDER}/{INPUTS}": _csv(self.input_names, self.inputs),
            f"{FOLDER}/{OUTPUTS}": _csv(self.output_names, self.outputs),
        }


def _csv(names: Sequence[str], rows: Sequence[Sequence[float | int]]) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["time", *names])
    writer.writerows([[repr(value) for value in row] for row in rows])
    return text.getvalue()


def _manifest(step_s: float) -> str:
    """Manifest of related files by the layered standard, for FMI 2 and FMI 3."""
    what = f"inputs from start values on, set at each communication point ({step_s:g} s apart) before the step from it"
    then = "outputs at each communication point, before its inputs are set"
    related = [
        ("testcase", INPUTS, f"Reference trajectory: {what}"),
        ("result", OUTPUTS, f"Reference trajectory: {then}"),
    ]
    lines = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        '<fmiReferences xmlns:fmi-ls="http://fmi-standard.org/fmi-ls-manifest"',
        '    fmi-ls:fmi-ls-name="org.fmi-standard.fmi-ls-ref" fmi-ls:fmi-ls-version="1.0.0"',
        f'    fmi-ls:fmi-ls-description="{_DESCRIPTION}">',
    ]
    lines += [
        f'  <Related type="text/csv" source="{source}" role="{role}" description={quoteattr(text)}/>'
        for role, source, text in related
    ]
    return "\n".join([*lines, "</fmiReferences>", ""])


def _swing(time: float) -> float:
    """Out and back once, from rest to rest: 0 to 1 to 0."""
    return 0.5 * (1 - math.cos(2 * math.pi * time / DURATION_S))


def _set_points(start: Sequence[float], time: float) -> list[float]:
    """Joints swing out of their start and back, with growing amplitude from base to wrist; the table gathers speed."""
    joints = len(start) - 1
    angles = [q + (i + 1) / joints * _SWING * _swing(time) for i, q in enumerate(start[:joints])]
    return [*angles, start[joints] + 0.5 * _TABLE_RATE / DURATION_S * time * time]


def record_reference(fmu: Path) -> Reference:
    """Step an FMU without array variables through a motion of all axes with timed exposures.

    Raises
    ------
    CellError
        If the FMU reports an error.
    """
    description = fmpy.read_model_description(str(fmu), validate=False)
    step_us = round(float(description.defaultExperiment.stepSize) * 1e6)
    outputs = [v for v in description.modelVariables if v.causality == "output"]
    reals = [v.name for v in outputs if v.type in ("Real", "Float64")]
    integers = [v.name for v in outputs if v.type in ("Integer", "Int32", "Enumeration")]
    constant: dict[str, Any] = {"command.mode": 1, "command.trigger.mode": 1, "command.segment": 1}
    timing = {"command.trigger.period": _TRIGGER_PERIOD_S, "command.exposure": _EXPOSURE_S}
    with CellInstance(fmu) as cell:
        axes = cell.axis_names("command.")
        state, inputs = cell.real_group(reals), cell.real_group([*axes, *timing])
        encoders = cell.real_group(cell.axis_names("truth."))
        start = [float(value) for value in cell.get(encoders)]
        for name, value in constant.items():
            cell.set_integer(name, value)
        given: list[list[float | int]] = []
        seen: list[list[float | int]] = []
        while True:
            time = cell.time_us / 1e6
            values = [float(value) for value in cell.get(state)]
            seen.append([time, *values, *(cell.get_integer(name) for name in integers)])
            if time >= DURATION_S:
                break
            points = [*_set_points(start, time), *timing.values()]
            given.append([time, *constant.values(), *points])
            cell.set(inputs, np.array(points))
            cell.step_to(cell.time_us + step_us)
    return Reference([*constant, *axes, *timing], given, [*reals, *integers], seen, step_us / 1e6)
