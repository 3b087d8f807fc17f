"""Run as a program: steps an FMU with FMPy alone and compares it with the reference trajectory inside it.

``clean_root.py FMU...`` makes a virtual environment with nothing but FMPy, starts itself there with an environment of
no variables (no LD_LIBRARY_PATH, no PYTHONPATH), and reports the greatest difference for each FMU. ``--here`` does the
stepping in the interpreter that runs it. Needs the standard library, and FMPy for ``--here``.
"""

from __future__ import annotations

import argparse
import csv
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

TOLERANCE = 1e-9
_REFERENCE = "extra/org.fmi-standard.fmi-ls-ref/reference_{}.csv"


def read_rows(file: Path) -> tuple[list[str], list[list[float]]]:
    """Column names and rows of a table; the first column is the time."""
    with file.open() as lines:
        names, *rows = list(csv.reader(lines))
    return names[1:], [[float(value) for value in row] for row in rows]


def largest_difference(fmu: Path) -> float:
    """Repeat the reference trajectory; return the largest difference of any output."""
    import fmpy  # noqa: PLC0415
    from fmpy.fmi2 import FMU2Slave  # noqa: PLC0415
    from fmpy.fmi3 import FMU3Slave  # noqa: PLC0415

    description = fmpy.read_model_description(str(fmu))
    variables = {v.name: v for v in description.modelVariables}
    second = description.fmiVersion.startswith("2")
    with tempfile.TemporaryDirectory() as folder:
        fmpy.extract(str(fmu), folder)
        given, inputs = read_rows(Path(folder) / _REFERENCE.format("inputs"))
        seen, expected = read_rows(Path(folder) / _REFERENCE.format("outputs"))
        cell: Any = (FMU2Slave if second else FMU3Slave)(
            guid=description.guid, unzipDirectory=folder, modelIdentifier="RobotCell", instanceName="cell"
        )
        access = {
            "Real": (cell.getReal, cell.setReal), "Integer": (cell.getInteger, cell.setInteger),
            "Enumeration": (cell.getInteger, cell.setInteger),
        } if second else {
            "Float64": (cell.getFloat64, cell.setFloat64), "Int32": (cell.getInt32, cell.setInt32),
            "Enumeration": (cell.getInt64, cell.setInt64),
        }  # fmt: skip
        cell.instantiate()
        if second:
            cell.setupExperiment(startTime=0.0)
        cell.enterInitializationMode()
        cell.exitInitializationMode()
        worst = 0.0
        for k, row in enumerate(expected):
            for name, value in zip(seen, row[1:], strict=True):
                read, _ = access[variables[name].type]
                worst = max(worst, abs(read([variables[name].valueReference])[0] - value))
            if k < len(inputs):
                for name, value in zip(given, inputs[k][1:], strict=True):
                    _, write = access[variables[name].type]
                    whole = variables[name].type in ("Integer", "Int32", "Enumeration")
                    write([variables[name].valueReference], [int(value) if whole else value])
                cell.doStep(row[0], expected[k + 1][0] - row[0])
        cell.terminate()
        cell.freeInstance()
    return worst


def step_in_empty_environment(fmus: list[Path], package: str) -> str:
    """Output of this program in an environment with FMPy only."""
    with tempfile.TemporaryDirectory() as folder:
        python = Path(folder) / "venv/bin/python"
        subprocess.run([sys.executable, "-m", "venv", python.parents[1]], check=True)
        subprocess.run([python, "-m", "pip", "install", "-q", "--disable-pip-version-check", package], check=True)
        command = [python, "-I", Path(__file__).resolve(), "--here", *(fmu.resolve() for fmu in fmus)]
        done = subprocess.run(command, env={}, cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(done.stdout + done.stderr)
    return done.stdout


def main() -> int:
    parser = argparse.ArgumentParser(description="Step an FMU with FMPy alone and compare with the reference inside.")
    parser.add_argument("fmus", type=Path, nargs="+", metavar="FMU")
    parser.add_argument("--here", action="store_true", help="step in this interpreter")
    parser.add_argument("--fmpy", default="fmpy", help="what to install; a version may be named")
    options = parser.parse_args()
    if not options.here:
        print(step_in_empty_environment(options.fmus, options.fmpy), end="")
        return 0
    worst = 0.0
    for fmu in options.fmus:
        difference = largest_difference(fmu)
        print(f"{fmu.name}: greatest difference from the reference {difference:g}")
        worst = max(worst, difference)
    return 0 if worst <= TOLERANCE else 1


if __name__ == "__main__":
    sys.exit(main())
