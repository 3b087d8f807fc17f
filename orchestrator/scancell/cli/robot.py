"""`scancell robot`: robot files from other formats."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from scancell.cli.common import Outcome, command


@command("robot from-urdf")
def from_urdf(
    urdf: Annotated[Path, typer.Argument(help="URDF file of a serial arm of 4 to 8 joints")],
    tip: Annotated[str, typer.Option("--tip", help="link at the end of the arm, which carries the tool")],
    out: Annotated[Path, typer.Option("--out", help="robot file (TOML) to write; meshes go into a folder beside")],
    home: Annotated[
        str | None, typer.Option("--home", help="joint angles of the home position, deg, commas between them")
    ] = None,
    hold: Annotated[
        list[int] | None,
        typer.Option("--hold", help="joint that inverse kinematics holds: one for each beyond six; repeatable"),
    ] = None,
) -> Outcome:
    """Write the arm of a URDF file as a robot file: Denavit-Hartenberg rows, limits, masses and meshes."""
    import numpy as np  # noqa: PLC0415

    from scancell.config.urdf import RAMP_TIME, robot_from_urdf  # noqa: PLC0415
    from scancell.errors import DescriptionError  # noqa: PLC0415
    from scancell.geometry import pose  # noqa: PLC0415

    try:
        angles = [float(word) for word in (home or "").split(",") if word.strip()]
    except ValueError:
        raise DescriptionError(key="home", value=home, expected="angles with commas between them") from None
    made = robot_from_urdf(urdf, tip, out, angles, hold or ())
    lines = [
        f"{made.description.name}: {len(made.description.joint)} joints",
        f"  written to {out}",
        f"  accelerations are assumed: full speed in {RAMP_TIME:g} s (joint.max_acceleration_deg_s2)",
    ]
    warnings = list(made.warnings)
    remainder = made.flange_from_tip
    if np.abs(remainder - np.eye(4)).max() > 1e-9:
        x, y, z = 1e3 * remainder[:3, 3]
        rx, ry, rz = np.degrees(pose.euler_xyz_from_rotation(remainder[:3, :3]))
        warnings.append(
            f"link '{tip}' is not the flange of the file: its pose on the flange, to be put before the tool, is"
            f" x_mm = {x:.6f}, y_mm = {y:.6f}, z_mm = {z:.6f}, rx_deg = {rx:.6f}, ry_deg = {ry:.6f},"
            f" rz_deg = {rz:.6f}"
        )
    return Outcome(lines, {"joints": len(made.description.joint)}, [str(file) for file in made.files], warnings)
