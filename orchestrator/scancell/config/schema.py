"""JSON Schemas of the description files, for completion and checks in editors."""

from __future__ import annotations

from typing import Any

from scancell.config.artefact import ArtefactDescription
from scancell.config.cell import CellDescription
from scancell.config.description import Description
from scancell.config.inspection import InspectionDescription
from scancell.config.robot import RobotDescription
from scancell.config.scan import PathDescription, ScanDescription
from scancell.config.sensor import SensorDescription
from scancell.config.study import BatchDescription, StudyDescription
from scancell.config.table_format import FormatFileDescription, shipped_formats

_MODELS: dict[str, type[Description]] = {
    "cell": CellDescription,
    "robot": RobotDescription,
    "sensor": SensorDescription,
    "scan": ScanDescription,
    "path": PathDescription,
    "artefact": ArtefactDescription,
    "characteristics": InspectionDescription,
    "batch": BatchDescription,
    "study": StudyDescription,
    "format": FormatFileDescription,
}
_DRAFT = "https://json-schema.org/draft/2020-12/schema"


def json_schemas() -> dict[str, dict[str, Any]]:
    """Schemas by kind of file, such as ``cell`` and ``robot``."""
    schemas = {kind: model.model_json_schema() for kind, model in _MODELS.items()}
    for schema in schemas.values():
        for one in (schema, *schema["$defs"].values()):  # described by docstrings, whose examples are for Python
            one["description"] = one["description"].partition("\n\nExamples\n")[0]
    # A cell file may name a robot file instead of holding the robot.
    robot = schemas["cell"]["properties"]["robot"]
    schemas["cell"]["properties"]["robot"] = {
        "anyOf": [{"$ref": robot["$ref"]}, {"type": "string"}],
        "description": f"{robot['description']}, or the path of a robot file",
    }
    sensor = schemas["cell"]["$defs"]["FurtherSensorDescription"]["properties"]["sensor"]
    sensor["anyOf"].insert(1, {"type": "string"})
    sensor["description"] += "; a description, or the path of a sensor file"
    # A format is given whole, or by the changes of a shipped one.
    form = schemas["format"]["$defs"]["FormatDescription"]
    form["properties"]["preset"] = {
        "enum": [*shipped_formats()],
        "description": "shipped format whose keys are those of the table unless it changes them",
    }
    form["anyOf"] = [{"required": form.pop("required")}, {"required": ["preset"]}]
    return {kind: {"$schema": _DRAFT, **schema} for kind, schema in schemas.items()}
