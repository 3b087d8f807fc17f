"""Run as a program: restores a serialized state in this new process and steps on.

Arguments: unpacked FMU, file with the state, time of the state in microseconds, output file.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from cell_fixture import CellFmu, all_reals, continue_motion


def main() -> None:
    folder, state_file, time_us, output = sys.argv[1:]
    cell = CellFmu(Path(folder))
    state = cell.deserialize(Path(state_file).read_bytes())
    cell.restore(state, int(time_us))
    continue_motion(cell)
    np.save(output, all_reals(cell))
    cell.free_state(state)
    cell.close()


if __name__ == "__main__":
    main()
