"""Runs a scenario in ecos; a program for an environment in which `ecospy` is installed.

Arguments: scenario (JSON), output (JSON: one row of values per step).
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

from ecospy import EcosLib, EcosSimulation, EcosSimulationStructure  # type: ignore[import-not-found]


def main() -> None:
    """Step through the scenario and write what was seen."""
    scenario = json.loads(Path(sys.argv[1]).read_text())
    EcosLib.set_log_level("warn")
    inputs = {f"cell::{name}": value for name, value in scenario["inputs"].items()}
    with EcosSimulationStructure() as structure:
        structure.add_model("cell", scenario["fmu"])
        structure.add_parameter_set("scenario", inputs)
        with EcosSimulation(step_size=scenario["step"], structure=structure) as simulation:
            simulation.init(parameter_set="scenario")
            rows = []
            for _ in range(scenario["steps"]):
                simulation.step()
                rows.append([simulation.get_real(f"cell::{name}") for name in scenario["outputs"]])
            simulation.terminate()
    Path(sys.argv[2]).write_text(json.dumps(rows))


if __name__ == "__main__":
    main()
