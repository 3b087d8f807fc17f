"""Runs a scenario in Maestro.

Maestro generates a program (MaBL) from a multi-model. It sets parameters from there, but inputs only from connections;
so the calls that set the inputs are put into the generated program, before initialisation.
"""

from __future__ import annotations

import csv
import json
import subprocess
import tempfile
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
from numpy.typing import NDArray

_PREFIX = "{cell}.c."


def run_maestro(
    jars: Path, fmu: str, inputs: dict[str, float | int], outputs: list[str], step: float, steps: int
) -> NDArray[np.float64]:
    """The trajectory (steps, outputs) in Maestro."""
    variables = {v.name: v for v in fmpy.read_model_description(fmu).modelVariables}
    third = fmpy.read_model_description(fmu).fmiVersion.startswith("3")
    fixed = {name: value for name, value in inputs.items() if variables[name].causality == "parameter"}
    free = {name: value for name, value in inputs.items() if name not in fixed}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "model.json").write_text(json.dumps(_multi_model(fmu, fixed, outputs, step, steps, third)))
        _maestro(jars, folder, "import", "-output=program", "sg1", "model.json")
        program = folder / "program/spec.mabl"
        program.write_text(_with_inputs(program.read_text(), free, variables, third))
        _maestro(jars, folder, "interpret", "-runtime=program/spec.runtime.json", "-output=result", "program/spec.mabl")
        with (folder / "result/outputs.csv").open() as lines:
            rows = list(csv.DictReader(lines))[1 : steps + 1]
    return np.array([[float(row[_PREFIX + output]) for output in outputs] for row in rows])


def _multi_model(
    fmu: str, fixed: dict[str, float | int], outputs: list[str], step: float, steps: int, third: bool
) -> dict[str, Any]:
    parameters: dict[str, Any] = {_PREFIX + name: value for name, value in fixed.items()}
    if third:  # real values as lists, and strings only from here
        parameters = {name: [value] if isinstance(value, float) else value for name, value in parameters.items()}
        parameters[_PREFIX + "cell.file"] = "cell.json"
    return {
        "fmus": {"{cell}": Path(fmu).resolve().as_uri()},
        # A multi-model without any connection is refused; this one leads to where it changes nothing that is recorded.
        "connections": {_PREFIX + "controller.limit": [_PREFIX + "command.segment"]},
        "parameters": parameters,
        "logVariables": {_PREFIX.rstrip("."): outputs},
        "algorithm": {"type": "fixed-step", "size": step},
        "startTime": 0,
        "endTime": step * (steps + 1),  # one too many, lest rounding lose the last
    }


def _with_inputs(program: str, inputs: dict[str, float | int], variables: dict[str, Any], third: bool) -> str:
    kinds = (
        {float: ("cFloat64io", "setFloat64", ", 1"), int: ("cInt32io", "setInt32", ", 1")}
        if third
        else {float: ("cRealIo", "setReal", ""), int: ("cIntIo", "setInteger", "")}
    )
    calls = []
    for name, value in inputs.items():
        array, function, count = kinds[type(value)]
        calls += [
            f"cUintVref[0] = {variables[name].valueReference};",
            f"{array}[0] = {value!r};",
            f"status = c.{function}(cUintVref, 1, {array}{count});",
        ]
    marker = "status = c.enterInitializationMode("
    if program.count(marker) != 1:
        raise RuntimeError("Maestro's program has changed")
    return program.replace(marker, "\n".join(calls) + "\n" + marker)


def _maestro(jars: Path, folder: Path, *arguments: str) -> None:
    command = ["java", "-cp", f"{jars.resolve()}/*", "org.intocps.maestro.Main", *arguments]
    result = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    if result.returncode:
        raise RuntimeError(f"maestro: {(result.stdout + result.stderr)[-2000:]}")
