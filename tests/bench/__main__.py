"""`PYTHONPATH=tests python -m bench`: every figure of speed in one run, as a table and as JSON."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from . import (
    cell_speed,
    guard_speed,
    planning_speed,
    proximity_speed,
    ray_speed,
    sensor_speed,
    workspace_speed,
)
from .table import Row, print_header, print_row, write_json


def sections(largest: int) -> dict[str, Callable[[], Iterator[Row]]]:
    """What can be measured, by the name that `--only` takes."""
    return {
        "images": sensor_speed.image_rows,
        "reflected": sensor_speed.reflected_rows,
        "lenses": sensor_speed.lens_rows,
        "stations": sensor_speed.station_rows,
        "extraction": sensor_speed.single_station_rows,
        "geometric": sensor_speed.geometric_rows,
        "rays": ray_speed.laser_ray_rows,
        "closest": ray_speed.closest_point_rows,
        "density": lambda: sensor_speed.density_rows(largest),
        "proximity": proximity_speed.proximity_rows,
        "planning": planning_speed.planning_rows,
        "guard": guard_speed.guard_rows,
        "fmu": cell_speed.cell_rows,
        "workspace": workspace_speed.workspace_rows,
    }


def main() -> None:
    """Measure, print, write."""
    names = list(sections(0))
    parser = argparse.ArgumentParser(prog="python -m bench", description=__doc__)
    parser.add_argument("--only", action="append", choices=names, help="measure this section only; may be repeated")
    parser.add_argument("--out", type=Path, default=Path("out/bench.json"))
    parser.add_argument("--largest", type=int, default=5_000_000, help="triangles of the densest part")
    options = parser.parse_args()
    start = time.perf_counter()
    rows: list[Row] = []
    print_header()
    for name, section in sections(options.largest).items():
        if options.only and name not in options.only:
            continue
        for row in section():
            print_row(row)
            rows.append(row)
    write_json(rows, options.out)
    missed = [row.name for row in rows if row.verdict == "missed"]
    print(f"{len(rows)} rows in {time.perf_counter() - start:.0f} s, written to {options.out}")
    if missed:
        print(f"missed: {', '.join(missed)}")


if __name__ == "__main__":
    main()
