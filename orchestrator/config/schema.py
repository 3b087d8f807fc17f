"""JSON Schemas of the description files, so that editors complete and check them."""

from __future__ import annotations

from typing import Any

from orchestrator.config.batch import BatchDescription
from orchestrator.config.cell import CellDescription, RobotDescription
from orchestrator.config.scan import ScanDescription
from orchestrator.config.sensor import SensorDescription
from orchestrator.config.study import StudyDescription

_DRAFT = "https://json-schema.org/draft/2020-12/schema"


def json_schemas() -> dict[str, dict[str, Any]]:
    """Schema by kind of file: ``cell``, ``robot``, ``sensor``, ``scan``, ``study``, ``batch``."""
    schemas = {
        "cell": CellDescription.model_json_schema(),
        "robot": RobotDescription.model_json_schema(),
        "sensor": SensorDescription.model_json_schema(),
        "scan": ScanDescription.model_json_schema(),
        "batch": BatchDescription.model_json_schema(),
        "study": StudyDescription.model_json_schema(),
    }
    # On disk a cell may name a robot file instead of holding the robot.
    robot = schemas["cell"]["properties"]["robot"]
    schemas["cell"]["properties"]["robot"] = {
        "anyOf": [robot, {"type": "string", "description": "path to a robot file"}]
    }
    return {kind: {"$schema": _DRAFT, **schema} for kind, schema in schemas.items()}
