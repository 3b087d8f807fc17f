"""The guard of a described cell."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from scancell.arguments import checked_arguments
from scancell.config.cell import CellDescription, TableDescription
from scancell.config.loading import load_setup
from scancell.config.robot import JointDescription
from scancell.config.scan import ScanDescription
from scancell.geometry.mesh import Mesh
from scancell.guard.guard import Guard
from scancell.guard.parts import movable_parts
from scancell.guard.settings import GuardSettings
from scancell.nominal.cell import NominalCell, nominal_cell
from scancell.nominal.gripper import finger_travel_mesh
from scancell.nominal.parts import load_part
from scancell.planning.occupancy import with_occupied_space

_LEAST_NOISE = np.radians(0.005)
_SIGMAS = 5.0  # of the largest error of an angle


def settings_of(cell: CellDescription) -> GuardSettings:
    """The worst case of a described cell: its controller's cycle, its encoders, and the gears of its drives.

    A gear is twisted by at most the torque of its motor over its stiffness, and turns in its backlash; the encoder on
    the motor sees neither.
    """
    encoders: list[JointDescription | TableDescription] = [*cell.robot.joint, cell.table]
    sigma = [np.hypot(one.encoder_noise_deg, one.encoder_resolution_deg / np.sqrt(12)) for one in encoders]
    noise = max(_LEAST_NOISE, float(np.radians(max(sigma))))
    twist = np.zeros(len(encoders))
    if cell.robot.drive == "dynamic":
        drives = [joint.drive for joint in cell.robot.joint if joint.drive is not None]
        twist[:-1] = [
            drive.max_torque_n_m / drive.gear_stiffness_n_m_rad + np.radians(drive.backlash_deg) for drive in drives
        ]
    return GuardSettings(
        cycle=cell.world.controller_cycle,
        noise=noise,
        angle_error=tuple(float(error) for error in _SIGMAS * noise + twist),
        latency=1e-3 * max(one.encoder_latency_ms for one in encoders),
    )


@checked_arguments
def guard_of(
    cell: str | Path | CellDescription | None = None,
    part: str | Path | Mesh | None = None,
    scan: str | Path | ScanDescription | None = None,
    *,
    unit: str = "mm",
    settings: GuardSettings | None = None,
    max_age: float | None = None,
) -> Guard:
    """Make a guard of a cell's bodies, the part on its table, and the occupied space of a scan description.

    It considers fingers at all widths, and free parts that a belt or a gripper can move where the states place them
    (`GuardedCell`). Fingers may touch parts, and parts that can be moved may touch the table and belts.

    Parameters
    ----------
    cell, scan
        Descriptions or their files; None: the shipped default.
    part
        Mesh (m), mesh file or artefact; None: the table is empty.
    unit
        Of a mesh file: ``mm``, ``m`` or ``inch``.
    settings
        The worst case; None: that of the description.
    max_age
        Longest age of an answered state, s, in place of that of the settings.

    Raises
    ------
    ScancellError
        Naming what is wrong and what was expected.

    Examples
    --------
    A motion of joints and table to a pose of the sensor in the part:

    >>> guard = scancell.guard_of(part="part.stl")
    >>> home = np.radians([35, -60, 185, 0, 55, 0, 0])
    >>> clash = guard.check([home, [0.0, -0.73, 3.57, 0.0, 0.3, -3.14, 0.0]])
    >>> clash.body_a, clash.body_b
    ('sensor', 'part')
    """
    setup = load_setup(cell, None, scan)
    mesh = load_part(part, unit) if isinstance(part, str | Path) else part
    nominal = with_finger_travel(nominal_cell(setup.cell, mesh), setup.cell)
    nominal = with_occupied_space(nominal, setup.scan.occupied)
    settings = settings or settings_of(setup.cell)
    if max_age is not None:
        settings = replace(settings, max_age=max_age)
    movable = movable_parts(setup.cell)
    return Guard(nominal, setup.cell.robot, settings, touching(nominal, setup.cell), movable)


def with_finger_travel(nominal: NominalCell, cell: CellDescription) -> NominalCell:
    """The nominal cell with the space of the fingers at all widths, because they move independently of the axes."""
    gripper = cell.gripper
    if gripper is None:
        return nominal
    bodies = tuple(
        replace(body, mesh=finger_travel_mesh(gripper, body.mesh), patches=())
        if body.moves_with.startswith("finger[")
        else body
        for body in nominal.bodies
    )
    return replace(nominal, bodies=bodies)


def touching(nominal: NominalCell, cell: CellDescription) -> list[tuple[str, str]]:
    """Pairs that may touch: fingers and parts, and parts that can be moved and what they are put down on."""
    bodies = nominal.bodies
    fingers, parts = (
        [body.name for body in bodies if body.moves_with.startswith(frame)] for frame in ("finger[", "part")
    )
    frames = {"part" if number == 1 else f"part[{number}]" for number in movable_parts(cell)}
    moved = [body.name for body in bodies if body.moves_with in frames]
    supports = ["table", *(belt.name for belt in cell.conveyor)]
    return [(finger, part) for finger in fingers for part in parts] + [(one, on) for one in moved for on in supports]
