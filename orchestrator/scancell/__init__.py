"""Simulated robot cell that scans parts in 3D with a laser profile sensor.

>>> import scancell
>>> with scancell.Scanner() as scanner:
...     result = scanner.scan("part.stl", engine="geometric")
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from scancell.api import (
        batch,
        calibrate,
        calibrate_sensor,
        evaluate,
        extract,
        mesh,
        place,
        plan,
        render,
        scan,
        shot,
        study,
        survey,
    )
    from scancell.config.cell import CellDescription
    from scancell.config.loading import Setup
    from scancell.config.scan import ScanDescription
    from scancell.config.sensor import SensorDescription
    from scancell.errors import ScancellError
    from scancell.geometry.mesh import Mesh
    from scancell.reconstruction.cloud import Cloud
    from scancell.results import ScanResult, ShotResult
    from scancell.scanner import Scanner
    from scancell.scanning.survey import SurveyResult

# Imported when first used: `import scancell` stays fast.
_MODULE_OF = {
    "CellDescription": "config.cell",
    "Cloud": "reconstruction.cloud",
    "Mesh": "geometry.mesh",
    "ScanDescription": "config.scan",
    "ScanResult": "results",
    "ScancellError": "errors",
    "Scanner": "scanner",
    "SensorDescription": "config.sensor",
    "Setup": "config.loading",
    "ShotResult": "results",
    "SurveyResult": "scanning.survey",
    "acceptance": "api",
    "batch": "api",
    "calibrate": "api",
    "calibrate_sensor": "api",
    "evaluate": "api",
    "extract": "api",
    "mesh": "api",
    "place": "api",
    "plan": "api",
    "render": "api",
    "scan": "api",
    "shot": "api",
    "study": "api",
    "survey": "api",
}

__all__ = [
    "CellDescription",
    "Cloud",
    "Mesh",
    "ScanDescription",
    "ScanResult",
    "ScancellError",
    "Scanner",
    "SensorDescription",
    "Setup",
    "ShotResult",
    "SurveyResult",
    "acceptance",
    "batch",
    "calibrate",
    "calibrate_sensor",
    "evaluate",
    "extract",
    "mesh",
    "place",
    "plan",
    "render",
    "scan",
    "shot",
    "study",
    "survey",
]


def __getattr__(name: str) -> Any:
    if name not in _MODULE_OF:
        raise AttributeError(f"module 'scancell' has no attribute '{name}'")
    value = getattr(import_module(f"scancell.{_MODULE_OF[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
