"""Spelling of the attributes in a model description: FMI versions differ, and no validator looks at all of them."""

from __future__ import annotations

import xml.etree.ElementTree as ET

# Those that this project writes, by element and version of the standard.
COMMON = {"name", "valueReference", "description", "causality", "variability", "initial"}
ATTRIBUTES: dict[int, dict[str, set[str]]] = {
    2: {
        "fmiModelDescription": {
            "fmiVersion", "modelName", "guid", "description", "version", "license", "generationTool",
            "variableNamingConvention", "copyright", "author",
        },
        "CoSimulation": {
            "modelIdentifier", "canHandleVariableCommunicationStepSize", "canGetAndSetFMUstate", "canSerializeFMUstate",
            "canNotUseMemoryManagementFunctions",
        },
        "ScalarVariable": COMMON,
        "Real": {"declaredType", "quantity", "unit", "displayUnit", "min", "max", "start"},
        "Integer": {"min", "max", "start"}, "Boolean": {"start"}, "String": {"start"},
        "Enumeration": {"declaredType", "start"}, "SimpleType": {"name"}, "Unknown": {"index", "dependencies"},
    },
    3: {
        "fmiModelDescription": {
            "fmiVersion", "modelName", "instantiationToken", "description", "version", "license", "generationTool",
            "variableNamingConvention", "copyright", "author",
        },
        "CoSimulation": {
            "modelIdentifier", "canHandleVariableCommunicationStepSize", "canGetAndSetFMUState", "canSerializeFMUState",
            "hasEventMode", "mightReturnEarlyFromDoStep", "canReturnEarlyAfterIntermediateUpdate",
            "providesIntermediateUpdate", "fixedInternalStepSize",
        },
        "Float64": {*COMMON, "declaredType", "min", "max", "start", "intermediateUpdate", "clocks"},
        "Int32": {*COMMON, "min", "max", "start", "clocks"},
        "Boolean": {*COMMON, "start"}, "String": COMMON, "Start": {"value"}, "Dimension": {"start"},
        "Clock": {*COMMON, "intervalVariability"}, "Enumeration": {*COMMON, "declaredType", "start"},
        "EnumerationType": {"name"},
        "Float64Type": {"name", "quantity", "unit", "displayUnit"},
        "Output": {"valueReference", "dependencies"}, "InitialUnknown": {"valueReference", "dependencies"},
    },
}  # fmt: skip
for known in ATTRIBUTES.values():
    known |= {
        "Unit": {"name"}, "BaseUnit": {"kg", "m", "s", "rad"}, "DisplayUnit": {"name", "factor"},
        "Item": {"name", "value", "description"},
        "Category": {"name", "description"}, "DefaultExperiment": {"startTime", "stopTime", "stepSize"},
    }  # fmt: skip


def misspelt_attributes(root: ET.Element, version: int) -> list[str]:
    """``element.attribute`` of whatever the version of the standard does not know."""
    known = ATTRIBUTES[version]
    return [f"{e.tag}.{name}" for e in root.iter() for name in e.attrib if name not in known.get(e.tag, set())]
