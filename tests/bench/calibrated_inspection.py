"""Uncertainty by a calibration beside scans of cells with its errors.

``PYTHONPATH=tests python -m bench.calibrated_inspection PART...``: CAD files that state their tolerances. The cells
(geometric engine, noise off) have deviations whose covariance is exactly that of the calibration: one standard
deviation along each eigenvector, of either sign.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

import scancell
from scancell.arrays import Array

STD = {"tool.x": 1e-5, "tool.z": 1e-5, "tool.ry": 1e-4}  # m, rad
AS_BUILT = {"tool.x": ("tool.x_mm", 1e3), "tool.z": ("tool.z_mm", 1e3), "tool.ry": ("tool.ry_deg", 180 / np.pi)}
CORRELATION = np.array([[1.0, 0.3, -0.5], [0.3, 1.0, 0.2], [-0.5, 0.2, 1.0]])


def covariance() -> Array:
    """Covariance (k, k) of the deviations, SI."""
    std = np.array(list(STD.values()))
    return np.asarray(CORRELATION * np.outer(std, std))


def errors_of_calibration() -> Array:
    """(k, k) errors whose outer products add up to the covariance: along eigenvectors of the correlation.

    Zones are not linear in the errors, so that others would have other effects.
    """
    values, vectors = np.linalg.eigh(CORRELATION)
    return np.asarray((np.array(list(STD.values()))[:, None] * vectors * np.sqrt(values)).T)


def values_of(found: scancell.Inspection) -> Array:
    """Values of all characteristics, m or rad; NaN for one that is not evaluated."""
    return np.array([np.nan if one.measured is None else one.measured.raw for one in found.decisions])


def compared(file: Path, profiles: int) -> list[tuple[str, str, float, float]]:
    """Name, kind, stated and simulated uncertainty of each characteristic."""
    part = scancell.load_part(file)
    options: dict[str, Any] = {"engine": "geometric", "normals": False, "samples": False}
    with TemporaryDirectory() as name, scancell.Scanner(ideal=True, settings={"scan.max_profiles": profiles}) as cell:
        folder = Path(name)
        content = {"deviations": [{"name": one} for one in STD], "covariance_si": covariance().tolist()}
        (folder / "calibration.json").write_text(json.dumps(content))
        run = cell.scan(part, **options)
        run.save(folder / "run")
        stated = scancell.inspect(folder / "run", part, calibration=folder / "calibration.json")
        plain, squares = values_of(scancell.inspect(run, part)), np.zeros(len(stated.decisions))
        for column in errors_of_calibration():
            for sign in (1, -1):
                errors = zip(STD, sign * column, strict=True)
                as_built = {AS_BUILT[key][0]: AS_BUILT[key][1] * float(value) for key, value in errors}
                moved = cell.scan(part, as_built=as_built, plan=run.plan, **options)
                squares += (values_of(scancell.inspect(moved, part)) - plain) ** 2 / 2
    simulated = np.sqrt(squares).tolist()
    return [
        (one.description.name, one.description.kind, one.calibration, other)
        for one, other in zip(stated.decisions, simulated, strict=True)
    ]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("parts", type=Path, nargs="+")
    parser.add_argument("--profiles", type=int, default=120)
    options = parser.parse_args()
    print("| part | characteristic | by the calibration, um | simulated, um | ratio |\n|---|---|---|---|---|")
    for file in options.parts:
        for name, kind, stated, simulated in compared(file, options.profiles):
            unit = " (urad)" if kind == "angle" else ""
            ratio = stated / simulated if simulated else float("nan")
            row = f"| {file.stem} | {name}{unit} | {1e6 * stated:.3f} | {1e6 * simulated:.3f} | {ratio:.3f} |"
            print(row, flush=True)


if __name__ == "__main__":
    main()
