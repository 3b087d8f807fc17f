"""The FMU in other importers: the same scenario in each, held against FMPy's trajectory, and other validators.

`libcosimpy`, `ecospy` and `fmutool` come from PyPI and run in an environment of their own (`ImporterTools.python`);
fmi-sim comes from crates.io, Maestro and VDMCheck2 from Maven Central. What is not there is installed into
``build/importers``; what cannot be installed is reported as missing.
"""

from __future__ import annotations

import csv
import json
import math
import os
import shutil
import subprocess
import sys
import tempfile
import xml.etree.ElementTree as ET
import zipfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal

import fmpy
import numpy as np
from fmpy.fmi2 import FMU2Slave
from fmpy.fmi3 import FMU3Slave
from fmpy.validation import validate_fmu
from numpy.typing import NDArray

from .attributes import misspelt_attributes
from .check import Check, PeerMissingError
from .importers_maestro import run_maestro

Array = NDArray[np.float64]
Value = float | int
PIP_PACKAGES = ("libcosimpy==0.0.6", "ecospy==0.7.2", "fmu-manipulation-toolbox==2.0")
FMI_SIM = ("fmi-sim", "0.7.0")
TOLERANCE = 1e-9
_HERE = Path(__file__).parent
_CLEAN_ROOT = _HERE.parents[1] / "fmu/clean_root.py"


@dataclass(frozen=True)
class Scenario:
    """Inputs and parameters set before initialisation, then equal steps; `outputs` are recorded after each."""

    fmu: str
    inputs: dict[str, Value]
    outputs: list[str]
    step: float = 0.016
    steps: int = 40


def servo_scenario(fmu: Path, start_deg: Sequence[float]) -> Scenario:
    """All joints and the table on the move at their speed limits, exposures by table angle, a cell not quite true."""
    inputs: dict[str, Value] = {"seed": 7, "as_built.tool.x": 1e-4, "as_built.table.rx": 1e-3}
    inputs |= {f"command.q[{i}]": math.radians(q + 2 + i) for i, q in enumerate(start_deg, start=1)}
    inputs |= {"command.mode": 1, "command.table": 1.5, "command.exposure": 0.002}
    inputs |= {"command.trigger.mode": 2, "command.trigger.angle": 0.05}
    outputs = [*(f"{group}.q[{i}]" for group in ("truth", "measured") for i in range(1, 7)), "truth.table"]
    for body in ("truth.sensor", "truth.part[1]", "trigger.truth.sensor"):
        outputs += [f"{body}.position[{i}]" for i in (1, 2, 3)] + [f"{body}.orientation[{i}]" for i in (1, 2, 3, 4)]
    return Scenario(str(fmu), inputs, [*outputs, "trigger.time", "trigger.measured.table"])


def run_fmpy(scenario: Scenario) -> Array:
    """The trajectory (steps, outputs) in FMPy."""
    description = fmpy.read_model_description(scenario.fmu)
    variables = {v.name: v for v in description.modelVariables}
    second = description.fmiVersion.startswith("2")
    folder = tempfile.mkdtemp()
    try:
        fmpy.extract(scenario.fmu, folder)
        slave = (FMU2Slave if second else FMU3Slave)(
            guid=description.guid, unzipDirectory=folder, modelIdentifier="RobotCell", instanceName="cell"
        )
        slave.instantiate()
        for name, value in scenario.inputs.items():
            kind = variables[name].type
            if kind == "Enumeration":
                kind = "Integer" if second else "Int64"
            getattr(slave, f"set{kind}")([variables[name].valueReference], [value])
        if second:
            slave.setupExperiment(startTime=0.0)
        slave.enterInitializationMode()
        slave.exitInitializationMode()
        references = [variables[name].valueReference for name in scenario.outputs]
        rows = []
        for k in range(scenario.steps):
            slave.doStep(k * scenario.step, scenario.step)
            rows.append((slave.getReal if second else slave.getFloat64)(references))
        slave.terminate()
        slave.freeInstance()
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    return np.array(rows)


def run_in_python(python: Path, importer: Literal["cosim", "ecos"], scenario: Scenario) -> Array:
    """The trajectory in libcosim or ecos, run by an interpreter that has the package."""
    with tempfile.TemporaryDirectory() as folder:
        request, answer = Path(folder) / "scenario.json", Path(folder) / "rows.json"
        request.write_text(json.dumps(asdict(scenario)))
        run_tool([python, _HERE / f"importers_{importer}.py", request, answer])
        return np.array(json.loads(answer.read_text()))


def run_fmi_sim(program: Path, scenario: Scenario) -> Array:
    """The trajectory in fmi-sim."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "rows.csv"
        values = [part for name, value in scenario.inputs.items() for part in ("--init-values", f"{name}={value!r}")]
        step, end = repr(scenario.step), repr(scenario.step * scenario.steps)
        command = [program, "-q", "--model", scenario.fmu, "-o", file, "co-simulation", "-s", "0", "-f", end]
        run_tool([*command, "--step", step, "--output-interval", step, *values])
        with file.open() as lines:
            rows = list(csv.DictReader(lines))[1:]
    return np.array([[float(row[name]) for name in scenario.outputs] for row in rows])


def run_tool(command: list[str | Path], folder: Path | None = None) -> str:
    result = subprocess.run([str(c) for c in command], cwd=folder, capture_output=True, text=True, check=False)
    if result.returncode:
        raise RuntimeError(f"{command[0]}: {(result.stdout + result.stderr)[-2000:]}")
    return result.stdout + result.stderr


class ImporterTools:
    """Installs the other importers and validators into a folder, each when it is first asked for."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder.absolute()  # the tools run in folders of their own

    def python(self) -> Path:
        """Interpreter with libcosimpy, ecospy and the FMU manipulation toolbox."""
        python = self._folder / "venv/bin/python"
        if not (self._folder / "venv/bin/fmutool").exists():
            self._install([sys.executable, "-m", "venv", self._folder / "venv"])
            self._install([python, "-m", "pip", "install", "-q", "--disable-pip-version-check", *PIP_PACKAGES])
        return python

    def fmutool(self) -> Path:
        """Checker of the FMU manipulation toolbox."""
        return self.python().parent / "fmutool"

    def fmi_sim(self) -> Path:
        """fmi-sim, compiled here."""
        program = self._folder / "cargo/bin/fmi-sim"
        if not program.exists():
            self._require("cargo", "apt-get install cargo libclang-dev")
            name, version = FMI_SIM
            self._install(["cargo", "install", "-q", name, "--version", version, "--root", self._folder / "cargo"])
        return program

    def maestro(self) -> Path:
        """Folder with Maestro's jars."""
        folder = self._folder / "maestro"
        if not folder.is_dir():
            self._require("mvn", "apt-get install maven default-jre-headless")
            shutil.copyfile(_HERE / "maestro.pom.xml", self._made() / "pom.xml")
            goal = "org.apache.maven.plugins:maven-dependency-plugin:3.6.1:copy-dependencies"
            options = ["-Dmdep.prependGroupId=true", f"-DoutputDirectory={folder}"]
            self._install(["mvn", "-q", "-B", "-f", self._folder / "pom.xml", goal, *options])
        return folder

    def vdmcheck(self) -> Path:
        """VDMCheck2's script."""
        script = self._folder / "vdmcheck-1.1.3/VDMCheck2.sh"
        if not script.exists():
            self._require("mvn", "apt-get install maven default-jre-headless")
            goal = "org.apache.maven.plugins:maven-dependency-plugin:3.6.1:unpack"
            artifact = "org.into-cps.vdmcheck.fmi2:vdmcheck2:1.1.3:zip:distribution-static"
            options = [f"-Dartifact={artifact}", f"-DoutputDirectory={self._made()}"]
            self._install(["mvn", "-q", "-B", goal, *options])
            script.chmod(0o755)
        return script

    def _made(self) -> Path:
        self._folder.mkdir(parents=True, exist_ok=True)
        return self._folder.resolve()

    def _require(self, program: str, remedy: str) -> None:
        if shutil.which(program) is None:
            raise PeerMissingError(f"{program} is not installed: {remedy}")

    def _install(self, command: list[str | Path]) -> None:
        try:
            run_tool(command, self._made())
        except (RuntimeError, OSError) as error:
            raise PeerMissingError(f"cannot be installed: {error}") from error


def validator_checks(tools: ImporterTools, fmus: dict[int, Path]) -> Iterator[Check]:
    """Findings of the validators; each must be none."""
    for version, fmu in fmus.items():
        yield Check(f"fmpy validate, FMI {version}: findings", len(validate_fmu(str(fmu))), "", 0)
        with zipfile.ZipFile(fmu) as archive:
            root = ET.fromstring(archive.read("modelDescription.xml"))
        yield Check(f"attributes unknown to FMI {version}", len(misspelt_attributes(root, version)), "", 0)
        said = run_tool([tools.fmutool(), "-input", fmu, "-check"])
        findings = sum(word in said for word in ("ERROR", "WARNING")) + ("seems to be compliant" not in said)
        yield Check(f"fmutool -check, FMI {version}: findings", findings, "", 0)
    said = run_tool([tools.vdmcheck(), fmus[2]], tools.vdmcheck().parent)
    yield Check("VDMCheck2, FMI 2: findings", float("No errors found" not in said), "", 0)


def clean_root_checks(fmus: dict[int, Path]) -> Iterator[Check]:
    """Greatest difference from the reference trajectory inside, with FMPy alone and no environment variables."""
    said = run_tool([sys.executable, _CLEAN_ROOT, *fmus.values()])
    for (version, fmu), line in zip(fmus.items(), said.strip().splitlines(), strict=True):
        if not line.startswith(f"{fmu.name}: "):
            raise RuntimeError(said)
        difference = float(line.rsplit(" ", 1)[1])
        yield Check(f"FMPy alone in an empty environment, FMI {version}, reference", difference, "", TOLERANCE)


def trajectory_checks(
    tools: ImporterTools, scenarios: dict[int, Scenario], of_integers: dict[int, Scenario]
) -> Iterator[Check]:
    """Greatest difference of each importer's trajectory from FMPy's.

    libcosim, ecos and Maestro do not know enumerations, or not those of FMI 3; fmi-sim does not set these: they get
    FMUs that describe integers (`of_integers`).
    """
    references = {version: run_fmpy(scenario) for version, scenario in scenarios.items()}
    importers: dict[str, tuple[list[Scenario], Callable[[Scenario], Array]]] = {
        "libcosimpy": ([of_integers[2]], lambda s: run_in_python(tools.python(), "cosim", s)),
        "ecospy": (list(of_integers.values()), lambda s: run_in_python(tools.python(), "ecos", s)),
        "fmi-sim": ([scenarios[2], of_integers[3]], lambda s: run_fmi_sim(tools.fmi_sim(), s)),
        "Maestro": (
            list(of_integers.values()),
            lambda s: run_maestro(tools.maestro(), s.fmu, s.inputs, s.outputs, s.step, s.steps),
        ),
    }
    yield Check("FMPy, FMI 3 against FMI 2", _difference(references[3], references[2]), "", TOLERANCE)
    for name, (given, run) in importers.items():
        for version, scenario in zip(scenarios, given, strict=False):
            try:
                rows = run(scenario)
            except PeerMissingError as missing:
                print(f"  skipped: {name}: {missing}")
                break
            yield Check(f"{name}, FMI {version}, against FMPy", _difference(rows, references[version]), "", TOLERANCE)


def _difference(rows: Array, reference: Array) -> float:
    return float(np.abs(rows - reference).max()) if rows.shape == reference.shape else math.inf


def importer_checks() -> Iterator[Check]:
    """Build the FMUs of the default cell, and have all importers and validators look at them."""
    from scancell.cell.fmu_file import FmiVersion, FmuOptions, build_fmu, cell_json  # noqa: PLC0415  (needs the native part)
    from scancell.config.loading import assets_dir, load_setup  # noqa: PLC0415
    from scancell.geometry.mesh import load_mesh  # noqa: PLC0415
    from scancell.nominal.cell import nominal_cell  # noqa: PLC0415

    tools = ImporterTools(Path(os.environ.get("SCANCELL_IMPORTERS", "build/importers")))
    setup = load_setup()
    nominal = nominal_cell(setup.cell, load_mesh(assets_dir() / "parts" / "free_form.stl"))
    description = cell_json(setup.cell, nominal, seed=0)
    versions: tuple[FmiVersion, ...] = (2, 3)
    with tempfile.TemporaryDirectory() as folder:
        fmus, scenarios, of_integers = {}, {}, {}
        for version in versions:
            fmus[version] = Path(folder) / f"RobotCell{version}.fmu"
            integers = Path(folder) / f"integers{version}.fmu"
            build_fmu(description, fmus[version], version)
            build_fmu(description, integers, version, FmuOptions(integers=True))
            scenarios[version] = servo_scenario(fmus[version], setup.cell.robot.home_deg)
            of_integers[version] = servo_scenario(integers, setup.cell.robot.home_deg)
        yield from clean_root_checks(fmus)
        yield from trajectory_checks(tools, scenarios, of_integers)
        yield from validator_checks(tools, fmus)
