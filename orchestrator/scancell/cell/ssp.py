"""Packs the FMUs of a cell and of its sequencer, their connections and parameters into an SSP archive.

System Structure and Parameterization, Modelica Association: 1.0 (2019), or 2.0, whose namespaces are the same, and
which adds elements that these packages do not need. Parameters are bound to components and
connections lie between components, because importers such as libcosim read no others.
"""

from __future__ import annotations

import io
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np

from scancell.cell.driver import SequenceStep
from scancell.cell.fmu_file import description_text, runtime_dir
from scancell.cell.fmu_info import unit_of
from scancell.cell.fmu_package import (
    FmuOptions,
    fmu_contents,
    read_description,
    sequencer_contents,
    write_archive,
)
from scancell.errors import DescriptionError
from scancell.files import atomic_write

_NAMESPACES = {
    "ssd": "http://ssp-standard.org/SSP1/SystemStructureDescription",
    "ssc": "http://ssp-standard.org/SSP1/SystemStructureCommon",
    "ssv": "http://ssp-standard.org/SSP1/SystemStructureParameterValues",
    "osp": "http://opensimulationplatform.com/SSP/OSPAnnotations",
}
_FMUS = {"cell": "resources/RobotCell.fmu", "sequencer": "resources/CellSequencer.fmu"}
_TYPES = ("Real", "Integer", "Boolean")  # of connectors: few importers connect strings
Variables = Mapping[str, Any]  # of FMPy, by name
SspVersion = Literal["1.0", "2.0"]


def build_ssp(
    description: Mapping[str, Any],
    steps: Sequence[SequenceStep],
    path: str | Path,
    *,
    stop_time: float,
    version: SspVersion = "1.0",
) -> None:
    """Write the package of a cell that executes a sequence to `path` atomically.

    Parameters
    ----------
    description
        Description of the cell, as `cell_json` makes it.
    steps
        Steps of the sequence, as `example_sequence` makes them.
    path
        File of the package.
    stop_time
        Stop time of the default experiment, s.
    version
        Of SSP.

    Raises
    ------
    CellError
        If the native part is missing or refuses the description, or the cell cannot make its reference trajectory.
    DescriptionError
        If the sequencer has no such parameter, `stop_time` is not positive, or `path` does not end in ``.ssp``, by
        which importers know packages.
    OutputError
        If the file cannot be written.
    """
    path = Path(path)
    if path.suffix != ".ssp":
        raise DescriptionError(key="out", value=str(path), expected="a file name that ends in .ssp")
    if not 0 < stop_time < np.inf:
        raise DescriptionError(key="stop_time", value=stop_time, expected="a positive number of seconds")
    runtime, text = runtime_dir(), description_text(description)
    fmus = {
        "cell": fmu_contents(runtime, text, 2, FmuOptions(integers=True)),
        "sequencer": sequencer_contents(runtime, text),
    }
    models = {name: read_description(contents["modelDescription.xml"]) for name, contents in fmus.items()}
    variables = {name: {v.name: v for v in model.modelVariables} for name, model in models.items()}
    cell_parameters = {
        name: v.start for name, v in variables["cell"].items() if v.causality == "parameter" and v.type != "String"
    }
    step_parameters = {f"step[{i}].{name}": value for i, step in enumerate(steps, 1) for name, value in step.items()}
    sequence = {"steps": len(steps), **step_parameters}
    contents = {
        "SystemStructure.ssd": _structure(version, models, variables, stop_time),
        "resources/cell.ssv": _parameters(version, "cell", cell_parameters, models, variables),
        "resources/sequencer.ssv": _parameters(version, "sequencer", sequence, models, variables),
    }
    for name, files in fmus.items():
        archive = io.BytesIO()
        write_archive(archive, files)
        contents[_FMUS[name]] = archive.getvalue()
    with atomic_write(path) as temporary:
        write_archive(temporary, contents)


def _structure(
    version: SspVersion, models: Mapping[str, Any], variables: Mapping[str, Variables], stop_time: float
) -> bytes:
    """The system structure description."""
    root = _root(version, "ssd:SystemStructureDescription", "RobotCell")
    system = _child(root, "ssd:System", name="RobotCell", description=models["cell"].description)
    elements, connections = _child(system, "ssd:Elements"), _child(system, "ssd:Connections")
    for name, other in (("cell", "sequencer"), ("sequencer", "cell")):
        component = _child(elements, "ssd:Component", name=name, source=_FMUS[name], implementation="CoSimulation")
        connectors = _child(component, "ssd:Connectors")
        for variable in variables[name].values():
            if variable.causality not in ("input", "output") or variable.type not in _TYPES:
                continue
            source = variables[other].get(variable.name)
            if variable.causality == "input":
                if source is None or source.causality != "output":
                    continue
                _child(
                    connections,
                    "ssd:Connection",
                    startElement=other,
                    startConnector=variable.name,
                    endElement=name,
                    endConnector=variable.name,
                )
            connector = _child(connectors, "ssd:Connector", name=variable.name, kind=variable.causality)
            _child(connector, f"ssc:{variable.type}", **_unit(variable))
        bindings = _child(component, "ssd:ParameterBindings")
        _child(bindings, "ssd:ParameterBinding", source=f"resources/{name}.ssv")
    _units(_child(root, "ssd:Units"), models["cell"])
    experiment = _child(root, "ssd:DefaultExperiment", startTime="0.0", stopTime=repr(float(stop_time)))
    # libcosim reads its step size here.
    annotation = _child(_child(experiment, "ssd:Annotations"), "ssc:Annotation", type="com.opensimulationplatform")
    step = models["cell"].defaultExperiment.stepSize
    _child(_child(annotation, "osp:Algorithm"), "osp:FixedStepAlgorithm", baseStepSize=step)
    return _bytes(root)


def _parameters(
    version: SspVersion,
    name: str,
    values: Mapping[str, Any],
    models: Mapping[str, Any],
    variables: Mapping[str, Variables],
) -> bytes:
    """A parameter set of a component."""
    root = _root(version, "ssv:ParameterSet", name)
    parameters = _child(root, "ssv:Parameters")
    for key, value in values.items():
        variable = variables[name].get(key)
        if variable is None or variable.causality != "parameter":
            raise DescriptionError(key=key, value=value, expected=f"a parameter of the FMU {_FMUS[name]}")
        parameter = _child(parameters, "ssv:Parameter", name=key)
        text = repr(float(value)) if variable.type == "Real" else str(int(value))
        _child(parameter, f"ssv:{variable.type}", value=text, **_unit(variable))
    _units(_child(root, "ssv:Units"), models["cell"])
    return _bytes(root)


def _unit(variable: Any) -> dict[str, str]:
    unit = unit_of(variable)[0]
    return {"unit": unit} if unit else {}


def _units(parent: ET.Element, model: Any) -> None:
    """The units of an FMU."""
    for unit in model.unitDefinitions:
        base = unit.baseUnit
        exponents = {name: str(getattr(base, name)) for name in ("kg", "m", "s", "A", "K", "mol", "cd", "rad")}
        used = {name: exponent for name, exponent in exponents.items() if exponent != "0"}
        _child(_child(parent, "ssc:Unit", name=unit.name), "ssc:BaseUnit", **used)


def _root(version: SspVersion, tag: str, name: str) -> ET.Element:
    root = ET.Element(_qualified(tag), version=version, name=name)
    root.set("license", "BSD-3-Clause")
    return root


def _child(parent: ET.Element, tag: str, **attributes: str) -> ET.Element:
    return ET.SubElement(parent, _qualified(tag), attributes)


def _qualified(tag: str) -> str:
    prefix, name = tag.split(":")
    return f"{{{_NAMESPACES[prefix]}}}{name}"


def _bytes(root: ET.Element) -> bytes:
    """The document; the prefixes of the namespaces are those of the standard, which libcosim requires."""
    for prefix, uri in _NAMESPACES.items():
        ET.register_namespace(prefix, uri)
    ET.indent(root)
    return bytes(ET.tostring(root, encoding="UTF-8", xml_declaration=True)) + b"\n"
