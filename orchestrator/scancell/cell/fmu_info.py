"""Version, token and variables of an FMU, from its model description."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import fmpy

from scancell.errors import CellError
from scancell.files import require_file


@dataclass(frozen=True)
class FmuVariable:
    """One variable; `size` is the number of elements of an array, `start` and `unit` are empty where there is none."""

    name: str
    type: str
    causality: str
    variability: str
    unit: str
    start: str
    description: str
    size: int = 1


@dataclass(frozen=True)
class FmuInfo:
    """Identity and variables of an FMU; `step_s` is the default communication step."""

    path: str
    name: str
    fmi_version: str
    token: str
    platforms: list[str]
    step_s: float | None
    variables: tuple[FmuVariable, ...]

    @property
    def causalities(self) -> dict[str, int]:
        """Number of variables of each causality."""
        return dict(Counter(variable.causality for variable in self.variables))

    def starting_with(self, prefix: str) -> list[FmuVariable]:
        """Variables whose name starts with `prefix`.

        Raises
        ------
        CellError
            If there is none.
        """
        found = [variable for variable in self.variables if variable.name.startswith(prefix)]
        if not found:
            groups = ", ".join(dict.fromkeys(group_of(variable.name) for variable in self.variables))
            raise CellError(f"no variable starts with '{prefix}'; groups of variables: {groups}", file=self.path)
        return found

    def lines(self, prefix: str = "") -> list[str]:
        """Text for the terminal: the FMU, then the variables that start with `prefix`, by causality and group."""
        counts = ", ".join(f"{count} {causality}" for causality, count in self.causalities.items())
        groups: dict[str, list[FmuVariable]] = {}
        for variable in self.starting_with(prefix):
            groups.setdefault(f"{variable.causality} {group_of(variable.name)}", []).append(variable)
        return [
            f"{self.path}: {self.name}, FMI {self.fmi_version}",
            f"  token      {self.token}",
            f"  platforms  {', '.join(self.platforms)}",
            f"  variables  {counts}",
            f"  step       {'any' if self.step_s is None else f'{self.step_s:g} s by default, any accepted'}",
            *(line for title, variables in groups.items() for line in _group_lines(title, variables)),
        ]

    def figures(self, prefix: str = "") -> dict[str, Any]:
        """The same for programs."""
        identity = {name: value for name, value in vars(self).items() if name != "variables"}
        variables = [asdict(variable) for variable in self.starting_with(prefix)]
        return {**identity, "causalities": self.causalities, "variables": variables}


def group_of(name: str) -> str:
    """Group of a variable: the first part of its name; ``cell`` for a name of one part."""
    return re.split(r"[.\[]", name)[0] if "." in name else "cell"


def unit_of(variable: Any) -> tuple[str, str]:
    """Unit and display unit of a variable as FMPy reads it; empty where there is none."""
    declared = variable.declaredType
    unit = variable.unit or (declared.unit if declared is not None else None)
    display = variable.displayUnit or (declared.displayUnit if declared is not None else None)
    return unit or "", display or ""


def _group_lines(title: str, variables: Iterable[FmuVariable]) -> list[str]:
    rows = [
        (
            variable.name + (f"[{variable.size}]" if variable.size > 1 else ""),
            variable.unit,
            f"= {variable.start}" if variable.start else "",
            variable.description,
        )
        for variable in variables
    ]
    widths = [max(len(row[column]) for row in rows) for column in range(3)]
    return ["", title] + [
        "  " + "  ".join([*(text.ljust(width) for text, width in zip(row, widths, strict=False)), row[3]])
        for row in rows
    ]


def _start(variable: Any) -> str:
    """Start value as text; an empty string that the user may set is shown in quotes."""
    settable = variable.causality in ("input", "parameter")
    return str(variable.start or "") or ('""' if variable.type == "String" and settable else "")


def _variable(variable: Any) -> FmuVariable:
    size = 1
    for dimension in variable.dimensions:
        size *= int(dimension.start)
    return FmuVariable(
        variable.name,
        variable.type,
        variable.causality,
        variable.variability or "",
        unit_of(variable)[0],
        _start(variable),
        variable.description or "",
        size,
    )


def describe_fmu(path: Path) -> FmuInfo:
    """Read the model description of an FMU.

    Raises
    ------
    CellError
        If the file is missing or no FMU.
    """
    if not path.is_dir():
        require_file(path, CellError)
    try:
        description = fmpy.read_model_description(str(path), validate=False)
        platforms = fmpy.supported_platforms(str(path))
    except Exception as error:  # FMPy raises plain exceptions of many kinds
        raise CellError(f"not a readable FMU: {error}", file=path) from error
    experiment = description.defaultExperiment
    return FmuInfo(
        path=str(path),
        name=description.modelName,
        fmi_version=description.fmiVersion,
        token=description.guid,
        platforms=[str(platform) for platform in platforms],
        step_s=float(experiment.stepSize) if experiment is not None and experiment.stepSize else None,
        variables=tuple(_variable(variable) for variable in description.modelVariables),
    )
