"""A serialized state that goes on in a new process: the call, and the program that the new process runs.

Arguments of the program: unpacked FMU, file with the state, time of the state in microseconds, module and name of the
function that moves the cell, output file.
"""

from __future__ import annotations

import importlib
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from cell_fixture import Array, CellFmu, all_reals


def continued_in_new_process(
    cell: CellFmu, state: Any, time_us: int, motion: Callable[[CellFmu], None], scratch: Path
) -> Array:
    """Values of all real variables after a motion (function of a module) from a state of the cell, in a new process."""
    (scratch / "state").write_bytes(cell.serialize(state))
    folder, output = str(Path(cell.slave.unzipDirectory)), scratch / "reals.npy"
    command = [sys.executable, __file__, folder, str(scratch / "state"), str(time_us)]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}
    subprocess.run([*command, motion.__module__, motion.__name__, str(output)], check=True, env=environment)
    return np.asarray(np.load(output))


def main() -> None:
    folder, state_file, time_us, module, function, output = sys.argv[1:]
    motion = getattr(importlib.import_module(module), function)
    cell = CellFmu(Path(folder))
    state = cell.deserialize(Path(state_file).read_bytes())
    cell.restore(state, int(time_us))
    motion(cell)
    np.save(output, all_reals(cell))
    cell.free_state(state)
    cell.close()


if __name__ == "__main__":
    main()
