"""Runs a scenario in libcosim; a program for an environment in which `libcosimpy` is installed.

Arguments: scenario (JSON), output (JSON: one row of values per step).
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

from libcosimpy.CosimExecution import CosimExecution  # type: ignore[import-not-found]
from libcosimpy.CosimObserver import CosimObserver  # type: ignore[import-not-found]
from libcosimpy.CosimSlave import CosimLocalSlave  # type: ignore[import-not-found]


def main() -> None:
    """Step through the scenario and write what was seen."""
    scenario = json.loads(Path(sys.argv[1]).read_text())
    execution = CosimExecution.from_step_size(round(scenario["step"] * 1e9))
    slave = execution.add_local_slave(CosimLocalSlave(scenario["fmu"], "cell"))
    observer = CosimObserver.create_last_value()
    execution.add_observer(observer)
    references = {v.name.decode(): v.reference for v in execution.slave_variables(slave)}
    for name, value in scenario["inputs"].items():
        if isinstance(value, int):
            execution.integer_initial_value(slave, references[name], value)
        else:
            execution.real_initial_value(slave, references[name], value)
    wanted = [references[name] for name in scenario["outputs"]]
    rows = []
    for _ in range(scenario["steps"]):
        if not execution.step():
            raise RuntimeError("libcosim could not step")
        rows.append(list(observer.last_real_values(slave, wanted)))
    Path(sys.argv[2]).write_text(json.dumps(rows))


if __name__ == "__main__":
    main()
