"""Speed of planning on the default cell: exact configuration maps of one branch, and the plan of the default scan."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator

import numpy as np

from scancell.config.files import assets_dir
from scancell.config.loading import load_setup
from scancell.config.scan import PathDescription
from scancell.geometry.mesh import load_mesh
from scancell.nominal.cell import nominal_cell
from scancell.planning.model import PlanningCell, SensorRange
from scancell.planning.options import scan_options
from scancell.planning.path_map.configuration_map import ConfigurationMap, StaticConstraints
from scancell.planning.planner import plan
from scancell.planning.views.sensor_paths import sensor_paths
from scancell.scanning.world import make_sensor

from .table import Row

MAPS = (((200, 360), 10.0), ((720, 2000), 180.0))  # poses and table angles, s
LIMIT_PLAN = 0.9  # s
_CYCLE = 0.016
_BRANCH = 0


def planning_rows() -> Iterator[Row]:
    """Maps and plans, each with what python-fcl's verification of the plan takes on top."""
    setup = load_setup()
    part = load_mesh(assets_dir() / "parts" / "free_form.stl")
    nominal = nominal_cell(setup.cell, part)
    range_ = SensorRange.of(make_sensor(setup.sensor, 0))
    yield from map_rows(PlanningCell(nominal, range_, _CYCLE))
    seconds = []
    for verify in (False, True):
        options = scan_options(setup.scan.replace(verify=verify), setup.sensor)
        # With a cell of its own each time: meshes are reduced again.
        seconds.append(min(_timed(lambda o=options: plan(PlanningCell(nominal, range_, _CYCLE), o)) for _ in range(4)))
    without, with_ = seconds
    yield Row("default plan, without verification", without, "s", "limit", LIMIT_PLAN, None, "at most")
    yield Row("its verification by python-fcl", with_ - without, "s", "default plan", without)


def map_rows(cell: PlanningCell) -> Iterator[Row]:
    """Exact maps along the shipped spiral, all cells."""
    (path,) = sensor_paths(PathDescription.default(), cell.nominal.part, cell.nominal.table_from_part)
    static = StaticConstraints((0.01, 0.1), cell.clearance_ranges(0.005, 0.05, 0.01))
    for (columns, rows), limit in MAPS:
        poses = path.at(np.linspace(0.0, path.length, columns))
        map_ = ConfigurationMap(cell, poses, path.length / path.speed / (columns - 1), _BRANCH, rows, static)
        start = time.process_time()
        seconds = _timed(map_.require_all)
        # Its work is shared evenly by the cores; other processes take time of the wall clock only.
        alone = (time.process_time() - start) / min(2, os.cpu_count() or 1)
        yield Row(
            f"exact map, {columns} x {rows} cells, 2 threads", alone, "s", "limit on 2 cores", limit, None, "at most",
            clock="processor", other=seconds,
        )  # fmt: skip


def _timed(work: Callable[[], object]) -> float:
    start = time.perf_counter()
    work()
    return time.perf_counter() - start
