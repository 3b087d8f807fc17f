"""Truth and readings of the shipped cells in a scripted scenario: to compare two versions of the native cell.

PYTHONPATH=tests python -m bench.cell_scenarios record before.npz
PYTHONPATH=tests python -m bench.cell_scenarios compare before.npz after.npz
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import scancell
from scancell.config.loading import assets_dir

Array = NDArray[np.float64]
CYCLE_US = 16_000
# As built, so that no deviation of the cell is left out; vibration too, but where parts change their supports.
AS_BUILT = {
    "as_built.tool.x": 1e-4,
    "as_built.table.rx": 1e-4,
    "as_built.dh[2].a": 2e-4,
    "as_built.trigger.jitter": 1e-5,
}
VIBRATION = {"as_built.vibration.flange.x": 1e-5, "as_built.vibration.flange.frequency": 23.0}
GROUPS = ("truth.", "measured.", "trigger.", "controller.", "conveyor")


def record(name: str, vibrating: bool) -> dict[str, Array]:
    """All outputs (steps,) by name in a scenario of 6 s: a move, a table turn with exposures, a line, a belt, jogs."""
    setup = scancell.load_setup(assets_dir() / "cells" / f"{name}.toml")
    nominal = scancell.nominal_cell(setup.cell, scancell.load_part(assets_dir() / "parts" / "step_block.stl"))
    description = scancell.cell_json(setup.cell, nominal, seed=3)
    parameters = AS_BUILT | (VIBRATION if vibrating else {})
    with tempfile.TemporaryDirectory() as folder:
        fmu = scancell.make_temporary_fmu(description, Path(folder) / "cell")
        with scancell.CellInstance(fmu, parameters=lambda _units: parameters) as cell:
            return _run(cell)


def _run(cell: scancell.CellInstance) -> dict[str, Array]:
    reals = [
        name
        for name, variable in cell._variables.items()
        if variable.causality == "output" and variable.type == "Real" and name.startswith(GROUPS)
        if not name.startswith("controller.ahead")
    ]
    group = cell.real_group(reals)
    rows: list[Array] = []

    def put(**values: float) -> None:
        for key, value in values.items():
            cell.set(cell.real_group([f"command.{key}"]), np.array([value]))

    def run(seconds: float) -> None:
        end = cell.time_us + round(seconds * 1e6)
        while cell.time_us < end:
            cell.step_to(min(end, cell.time_us + CYCLE_US))
            rows.append(cell.get(group).copy())

    axes = cell.axis_names("command.")
    home = cell.get(cell.real_group(cell.axis_names("measured."))).copy()
    moved = home + 0.15 * np.cos(np.arange(home.size))
    cell.set_integer("command.operation", 1)
    cell.set(cell.real_group(axes), moved)
    put(speed=0.5, exposure=0.001)
    cell.set_integer("command.mode", 2)
    cell.set_integer("command.start", 1)
    run(1.0)
    put(**{"trigger.angle": 0.02})
    cell.set_integer("command.trigger.mode", 2)
    moved[-1] += 1.0
    cell.set(cell.real_group(axes), moved)
    cell.set_integer("command.start", 2)
    if "command.conveyor[1].speed" in cell._variables:
        put(**{"conveyor[1].speed": 0.1})
    if "command.gripper.mode" in cell._variables:
        cell.set_integer("command.gripper.mode", 1)
        put(**{"gripper.width": 0.03})
    run(2.0)
    cell.set_integer("command.trigger.mode", 0)
    cell.set(cell.real_group(axes), home)
    cell.set_integer("command.mode", 1)
    run(1.5)
    cell.set_integer("command.mode", 0)
    cell.set_integer("command.operation", 0)
    run(0.3)
    cell.set_integer("command.mode", 4)
    put(**{"jog[1]": 0.5, "jog[2]": -0.3})
    run(0.6)
    cell.set_integer("command.mode", 5)
    put(**{"jog[1]": 0.0, "jog[2]": 0.5})
    run(0.6)
    return dict(zip(reals, np.array(rows).T, strict=True))


def compare(before: Path, after: Path) -> float:
    """Print the largest differences of each cell; return the largest one."""
    old, new = np.load(before), np.load(after)
    missing = set(old.files) - set(new.files)
    if missing:
        print(f"{len(missing)} outputs are missing, such as {sorted(missing)[0]}")
        return float("inf")
    differences = {key: float(np.abs(old[key] - new[key]).max()) for key in old.files}
    for cell in sorted({key.split("/")[0] for key in old.files}):
        own = {key: value for key, value in differences.items() if key.startswith(cell + "/")}
        worst = max(own, key=lambda key: own[key])
        print(f"{cell}: {len(own)} outputs, {old[worst].size} steps, largest difference {own[worst]:.3g} ({worst})")
    return max(differences.values())


if __name__ == "__main__":
    if sys.argv[1] == "compare":
        sys.exit(0 if compare(Path(sys.argv[2]), Path(sys.argv[3])) <= 1e-12 else 1)
    columns = {}
    for file in sorted((assets_dir() / "cells").glob("*.toml")):
        for vibrating in (False, True):
            run = f"{file.stem}{' vibrating' if vibrating else ''}"
            columns |= {f"{run}/{name}": column for name, column in record(file.stem, vibrating).items()}
    np.savez_compressed(sys.argv[2], **columns)
