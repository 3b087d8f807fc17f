"""Runs a package (SSP) in libcosim; a program for an environment in which `libcosimpy` is installed.

Arguments: request (JSON: package, component, real outputs, number of steps), output (JSON: one row per step).
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

from libcosimpy.CosimExecution import CosimExecution  # type: ignore[import-not-found]
from libcosimpy.CosimObserver import CosimObserver  # type: ignore[import-not-found]


def main() -> None:
    """Step with the size that the package states, and write what was seen."""
    request = json.loads(Path(sys.argv[1]).read_text())
    execution = CosimExecution.from_ssp_file(request["ssp"])
    observer = CosimObserver.create_last_value()
    execution.add_observer(observer)
    component = execution.slave_index_from_instance_name(request["component"])
    references = {v.name.decode(): v.reference for v in execution.slave_variables(component)}
    wanted = [references[name] for name in request["outputs"]]
    rows = []
    for _ in range(request["steps"]):
        if not execution.step():
            raise RuntimeError("libcosim could not step")
        rows.append(list(observer.last_real_values(component, wanted)))
    Path(sys.argv[2]).write_text(json.dumps(rows))


if __name__ == "__main__":
    main()
