"""What an FMU says about itself."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import fmpy

from orchestrator.errors import CellError


@dataclass(frozen=True)
class FmuInfo:
    """Identity and variables of an FMU."""

    path: str
    name: str
    fmi_version: str
    token: str
    platforms: list[str]
    causalities: dict[str, int]
    step_s: float | None

    def lines(self) -> list[str]:
        """For people."""
        counts = ", ".join(f"{count} {causality}" for causality, count in self.causalities.items())
        return [
            f"{self.path}: {self.name}, FMI {self.fmi_version}",
            f"  token      {self.token}",
            f"  platforms  {', '.join(self.platforms)}",
            f"  variables  {counts}",
            f"  step       {'any' if self.step_s is None else f'{self.step_s:g} s by default, any accepted'}",
        ]

    def figures(self) -> dict[str, Any]:
        """For programs."""
        return dict(vars(self))


def describe_fmu(path: Path) -> FmuInfo:
    """Read the model description of an FMU.

    Raises
    ------
    CellError
        If the file is missing or no FMU.
    """
    if not path.is_file():
        raise CellError(f"{path}: no such file")
    try:
        description = fmpy.read_model_description(str(path), validate=False)
        platforms = fmpy.supported_platforms(str(path))
    except Exception as error:  # FMPy raises plain exceptions of many kinds
        raise CellError(f"{path}: not a readable FMU: {error}") from error
    experiment = description.defaultExperiment
    return FmuInfo(
        path=str(path),
        name=description.modelName,
        fmi_version=description.fmiVersion,
        token=description.guid,
        platforms=[str(platform) for platform in platforms],
        causalities=dict(Counter(str(variable.causality) for variable in description.modelVariables)),
        step_s=float(experiment.stepSize) if experiment is not None and experiment.stepSize else None,
    )
