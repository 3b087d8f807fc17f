"""Exported programs of the sample parts' plans, executed by their readers in the cell and compared with the plans.

Run as ``PYTHONPATH=tests python -m bench.program_export``; the table is in docs/programs.md.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from scancell import Scanner, export_program
from scancell.arrays import Array
from scancell.config.loading import assets_dir
from scancell.nominal.cell import NominalCell
from scancell.planning.plan import Plan
from scancell.programs.program import ProgramRun, run_program
from scancell.scanning.pipeline import measured_motion

PARTS = ("free_form", "machined", "sphere_on_foot", "step_block")
ENDINGS: dict[Literal["v2", "urscript"], str] = {"v2": ".v2", "urscript": ".script"}
_FINER = 4
TABLE_RADIUS = 0.12  # m: an error of the table's angle counts as the way of its edge


@dataclass(frozen=True)
class Comparison:
    """Largest differences of an executed program from its plan, m, and what was executed."""

    stops: float
    path: float
    exposures: float
    number: int
    lines: int
    duration: float
    contacts: list[str]


def compare(scanner: Scanner, part: Path, plan: Plan, language: Literal["v2", "urscript"]) -> Comparison:
    """Export `plan`, run the program with the guard in an ideal cell, and compare."""
    text = export_program(plan, scanner, part, language)
    axes: list[Array] = []
    stops: list[Array] = []
    recordings = []
    with tempfile.TemporaryDirectory() as folder, scanner.session(part, guarded=True) as session:
        file = Path(folder) / f"scan{ENDINGS[language]}"
        file.write_text(text)

        def now() -> Array:
            return np.array([*session.joints, session.table_angle])

        session.cell.on_step(lambda: axes.append(now()))
        session.on_exposures = lambda recording, _cloud: recordings.append(recording)
        run: ProgramRun = run_program(
            file, session, "geometric", folder, lambda _line, _step: stops.append(now()), lambda _text: None
        )
        nominal = session.nominal
        exposed = np.concatenate([measured_motion(nominal, one).axes for one in recordings])
    planned = nominal.part_from_sensor(plan.axes)[:, :3, 3]
    taken = nominal.part_from_sensor(exposed)[:, :3, 3]
    same = len(planned) == len(taken)
    exposures = float(np.linalg.norm(planned - taken, axis=1).max()) if same else np.inf
    ends = np.array([segment.axes[-1] for segment in plan.program.segments])
    setpoints = np.concatenate([segment.axes for segment in plan.program.segments])
    finer = np.arange(0, len(setpoints) - 1 + 1e-9, 1 / _FINER)  # the tool's way between set-points is no straight line
    path = tool(nominal, np.transpose([np.interp(finer, np.arange(len(setpoints)), one) for one in setpoints.T]))
    return Comparison(
        float(max(away(nominal, end, np.array(stops)).min() for end in ends)),
        float(distances(tool(nominal, np.array(axes)), path).max()),
        exposures,
        len(taken),
        len(text.splitlines()),
        run.duration,
        run.contacts,
    )


def tool(nominal: NominalCell, axes: Array) -> Array:
    """Positions (n, 3) of the sensor in the world."""
    return np.asarray(nominal.world_from_sensor(axes)[:, :3, 3])


def away(nominal: NominalCell, end: Array, stops: Array) -> Array:
    """Distances (n,) of stops from an end of a segment: of the tool, and of the edge of the table."""
    of_tool = np.linalg.norm(tool(nominal, stops) - tool(nominal, end[None]), axis=1)
    return np.asarray(of_tool + TABLE_RADIUS * np.abs(stops[:, -1] - end[-1]))


def distances(points: Array, path: Array) -> Array:
    """Distances (n,) of points from the straight pieces between the points (m, 3) of a path."""
    start, way = path[:-1], np.diff(path, axis=0)
    length = np.maximum((way**2).sum(1), 1e-18)
    found = []
    for point in points:
        share = np.clip(((point - start) * way).sum(1) / length, 0.0, 1.0)
        found.append(np.linalg.norm(point - start - share[:, None] * way, axis=1).min())
    return np.array(found)


def main() -> None:
    """Print the table."""
    print("| part | language | lines | exposures | stop points | path | exposures' positions | duration | contacts |")
    print("|---|---|---|---|---|---|---|---|---|")
    for name in PARTS:
        part = assets_dir() / "parts" / f"{name}.stl"
        with Scanner(ideal=True) as scanner:
            plan = scanner.plan(part)
            for language in ENDINGS:
                one = compare(scanner, part, plan, language)
                figures = " | ".join(f"{1e3 * value:.4f} mm" for value in (one.stops, one.path, one.exposures))
                print(
                    f"| `{name}` | {language} | {one.lines} | {one.number} of {len(plan.axes)} | {figures} |"
                    f" {one.duration:.1f} s ({plan.program.duration:.1f}) | {len(one.contacts)} |",
                    flush=True,
                )


if __name__ == "__main__":
    main()
