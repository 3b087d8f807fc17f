"""Distances of the true bodies along whole scans of the sample cells, by python-fcl at the true poses of the FMU.

``PYTHONPATH=tests:. python -m bench.true_clearances`` plans and drives a scan of each cell, with deviations of its
arm, table, sensor and further axes, and prints contacts and the smallest distance.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray

from bench.plain_planner import Cell
from scancell import Scanner, assets_dir, load_part, load_setup, nominal_cell
from scancell.cell.instance import CellInstance
from scancell.geometry import pose
from scancell.nominal.cell import NominalCell, fmu_frame
from scancell.proximity.scene import arm_chain

Array = NDArray[np.float64]

STEP_US = 4000  # a quarter of the controller's cycle
_KEYS = (*(f"position[{i}]" for i in (1, 2, 3)), *(f"orientation[{i}]" for i in (1, 2, 3, 4)))
_BLOCK = 500
_BOUND = 0.2  # m: distances above it are not looked for
_ARM = {"dh[2].theta_deg": 0.03, "dh[4].alpha_deg": -0.02, "table.y_mm": -0.3}
_TOOL = {"tool.x_mm": 0.4, "tool.ry_deg": 0.1}
_BLIND = ("scan.sweep.enabled=false", "scan.raster.enabled=false")
_ACROSS = (  # both axes of the positioner move along it
    'scan.path=[{ speed_mm_s = 60, pitch_mm = 1, axis = ["tilt", "table"], waypoint = ['
    "{ x_mm = -20, y_mm = 0, z_mm = 45, azimuth_deg = 0, elevation_deg = 60 },"
    " { x_mm = 20, y_mm = 0, z_mm = 45, azimuth_deg = 40, elevation_deg = 80 }] }]"
)


@dataclass(frozen=True)
class Case:
    """A scan of a cell: name, files of cell and scan, settings, and deviations."""

    name: str
    cell: str
    settings: tuple[str, ...] = ()
    as_built: Mapping[str, float] = field(default_factory=dict)
    scan: str = "default"


CASES = (
    Case("track", "track", (), _ARM | _TOOL | {"axis.track.x_mm": 0.4, "axis.track.rz_deg": 0.05}),
    Case(
        "track, table 750 mm beside the arm, `[[axis]]` in steps of 200 mm",
        "track",
        ("cell.table.pose.y_mm=750", "scan.max_lost_share=1", 'scan.axis=[{ name = "track", step_mm = 200 }]'),
        _ARM | _TOOL | {"axis.track.x_mm": 0.4, "axis.track.rz_deg": 0.05},
    ),
    Case("tilt_turn", "tilt_turn", (), _ARM | _TOOL | {"axis.tilt.z_mm": -0.4, "axis.tilt.ry_deg": 0.05}),
    Case(
        "tilt_turn, path along which table and tilt move",
        "tilt_turn",
        (*_BLIND, _ACROSS),
        _ARM | _TOOL | {"axis.tilt.z_mm": -0.4, "axis.tilt.ry_deg": 0.05},
    ),
    Case("held_part", "held_part", (), _ARM | _TOOL | {"grasp.x_mm": 0.5, "grasp.rz_deg": 0.3}),
    Case("two_sensors", "two_sensors", (), _ARM | _TOOL | {"sensor[2].y_mm": 0.4, "sensor[2].rx_deg": 0.1}),
    Case("belt_post", "belt_post", (), _ARM | _TOOL, "belt_post"),
    Case("fixed_table", "fixed_table", ("scan.sweep.enabled=false",), _ARM | _TOOL),
)


@contextmanager
def true_poses(nominal: NominalCell, step_us: int = STEP_US) -> Iterator[list[Array]]:
    """True poses (bodies, 7), positions (m) and quaternions, of the bodies of all cells that are driven meanwhile.

    They are read from the FMU at the start and every `step_us` at most.
    """
    found: list[Array] = []
    frames = list(dict.fromkeys(body.moves_with for body in nominal.bodies if body.moves_with != "world"))
    rows = [(["world", *frames]).index(body.moves_with) for body in nominal.bodies]
    step_to = CellInstance.step_to

    def in_small_steps(cell: CellInstance, time_us: int) -> None:
        truth = cell.real_group(f"truth.{fmu_frame(frame)}.{key}" for frame in frames for key in _KEYS)

        def take() -> None:
            placed = cell.get(truth).reshape(-1, 7)
            found.append(np.vstack([[0, 0, 0, 1, 0, 0, 0], placed])[rows])

        if not found:
            take()
        while cell.time_us < time_us:
            step_to(cell, min(cell.time_us + step_us, time_us))
            take()

    with patch.object(CellInstance, "step_to", in_small_steps):
        yield found


def matrices(rows: Sequence[Array]) -> Array:
    """Poses (n, bodies, 4, 4) from rows (bodies, 7)."""
    given = np.array(rows)
    found = np.tile(np.eye(4), (*given.shape[:2], 1, 1))
    found[..., :3, :3] = pose.rotation_from_quaternion(given[..., 3:].reshape(-1, 4)).reshape(*given.shape[:2], 3, 3)
    found[..., :3, 3] = given[..., :3]
    return found


@dataclass(frozen=True)
class Found:
    """Contacts (pairs), and the smallest distance, m, with its pair."""

    contacts: tuple[str, ...]
    distance: float
    pair: str


def judged(nominal: NominalCell, poses: Array) -> Found:
    """Contacts of all pairs at poses (n, bodies, 4, 4), and the smallest distance but for two bodies of the arm.

    Bodies that touch at the first pose, by construction, are not compared. A distance is measured again where the
    corners of one body have moved by so much relative to the other that it may have become the smallest one.
    """
    cell, arm = Cell(nominal, poses[0]), arm_chain(nominal)
    contacts: list[str] = []
    smallest, of = _BOUND, ""
    for first in range(0, len(poses), _BLOCK):
        block = poses[first : first + _BLOCK]
        pairs = cell.within_reach(block, smallest)
        near = cell.near(block, pairs, smallest)
        for number in np.flatnonzero(near.any(0)).tolist():
            a, b = pairs[number]
            name = f"{cell.names[a]} - {cell.names[b]}"
            both = {cell.names[a], cell.names[b]}
            is_inner = both <= set(arm) or both == {"table", "table_base"}
            relative = pose.inverse(block[:, a]) @ block[:, b]
            at = np.einsum("nij,kj->nki", relative[:, :3, :3], cell.corners[b]) + relative[:, None, :3, 3]
            travel = np.append(0.0, np.linalg.norm(np.diff(at, axis=0), axis=-1).max(-1).cumsum())
            clear_until = -1.0
            for i in np.flatnonzero(near[:, number]).tolist():
                if travel[i] < clear_until:
                    continue
                distance = cell.distance(block[i], a, b) if not cell.hits(block[i], a, b) else 0.0
                if distance == 0.0:
                    contacts.append(name)
                    break
                if not is_inner and distance < smallest:
                    smallest, of = distance, name
                clear_until = travel[i] + 0.99 * (distance if is_inner else distance - smallest)
    return Found(tuple(dict.fromkeys(contacts)), smallest, of)


def run(case: Case, step_us: int = STEP_US) -> tuple[Found, NominalCell, Array]:
    """Judge the scan of a case: what was found, the nominal cell, and true poses (n, bodies, 4, 4)."""
    folder = assets_dir()
    part, scan = load_part(folder / "parts/free_form.stl"), folder / f"scans/{case.scan}.toml"
    setup = load_setup(folder / f"cells/{case.cell}.toml", scan=scan, settings=list(case.settings))
    with Scanner(setup=setup) as scanner:
        plan, nominal = scanner.plan(part), nominal_cell(setup.cell, part)
        with true_poses(nominal, step_us) as rows:
            scanner.scan(part, engine="geometric", plan=plan, as_built=dict(case.as_built), seed=1)
    poses = matrices(rows)
    return judged(nominal, poses), nominal, poses


def main() -> None:
    """Print the table of all cases, or of those whose name contains a word."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", default="", metavar="WORD")
    chosen = parser.parse_args().only
    print("| cell | scan, s | true poses | contacts | smallest distance, mm | of |")
    print("| --- | --- | --- | --- | --- | --- |", flush=True)
    for case in CASES:
        if chosen in case.name:
            found, _, poses = run(case)
            least = f"{1e3 * found.distance:.2f} | {found.pair}" if found.pair else f"more than {1e3 * _BOUND:.0f} |"
            contacts = ", ".join(found.contacts) or "0"
            print(
                f"| {case.name} | {1e-6 * STEP_US * (len(poses) - 1):.0f} | {len(poses)} | {contacts} | {least} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
