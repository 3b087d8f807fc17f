"""Serialized states that continue exactly: the check, and the program that a new process runs.

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


def assert_continues_exactly(cell: CellFmu, motion: Callable[[CellFmu], None], scratch: Path, *others: CellFmu) -> None:
    """Assert that a motion (function of a module) from the serialized present state always ends in the same values.

    In the cell, in other instances of it and in a new process, all real variables are equal to the last bit.
    """
    state, time_us = cell.save(), cell.time_us
    motion(cell)
    expected = all_reals(cell)
    for instance in (cell, *others):
        instance.restore(instance.deserialize(cell.serialize(state)), time_us)
        motion(instance)
        np.testing.assert_array_equal(all_reals(instance), expected)
    np.testing.assert_array_equal(_continued_in_new_process(cell, state, time_us, motion, scratch), expected)
    cell.free_state(state)


def assert_restores_exactly(cell: CellFmu, motion: Callable[[CellFmu, int], None]) -> None:
    """Assert that twenty steps of a motion from the present state end in the same values after it is restored.

    All real variables are equal to the last bit; the cell is left in that state.
    """
    time_us, state = cell.time_us, cell.save()
    futures = []
    for _ in range(2):
        motion(cell, 20)
        futures.append(all_reals(cell))
        cell.restore(state, time_us)
    np.testing.assert_array_equal(*futures)
    cell.free_state(state)


def _continued_in_new_process(
    cell: CellFmu, state: Any, time_us: int, motion: Callable[[CellFmu], None], scratch: Path
) -> Array:
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
