"""Displacement of the stripe on curved surfaces: error of points on balls by radius, ray-traced without noise.

The light of a sheet of the standard deviation s falls beside its middle on lower parts of a convex surface. Seen from
the side it moves the centroid of the stripe in the image as a height of -3/2 s² / R does: -1/2 s² / R by the mean
height of the light, -s² / R because the slopes on both sides are seen under different angles.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import scancell

RADII_MM = (0.5, 1.0, 2.0, 5.0, 12.5)
DETECTORS = ("centre_of_gravity", "gaussian")
STANDOFF = 0.115  # m from the top of the ball
FOOT = 0.02  # m below the ball
_REACH = 2e-4  # m from the ball up to which points are its
_BALL = """
name = "ball"
[[shape]]
name = "ball"
kind = "sphere"
diameter_mm = {diameter}
pose = {{ z_mm = {height} }}
[[shape]]
name = "stem"
kind = "cylinder"
diameter_mm = {radius}
height_mm = 20
pose = {{ z_mm = 10 }}
role = "support"
"""

Array = NDArray[np.float64]


def ball_errors(radius_mm: float, detector: str, offsets: Array, folder: Path) -> tuple[Array, Array]:
    """Errors (n,) of points along the normal, m, and angles (n,) of these from the vertical, rad.

    `offsets` are those of the laser sheet from the middle, in radii.
    """
    radius, height = 1e-3 * radius_mm, 1e-3 * radius_mm + FOOT
    part = folder / f"ball_{radius_mm:g}.toml"
    part.write_text(_BALL.format(diameter=2 * radius_mm, height=1e3 * height, radius=radius_mm))
    errors, angles = [], []
    with scancell.Scanner(ideal=True, settings={"sensor.extraction.detector": detector}) as scanner:
        for offset in offsets:
            shot = scanner.shot(part, scancell.location(offset * radius, 0, height + radius + STANDOFF, rx=np.pi))
            points = shot.points_in_part - [0, 0, height]
            error = np.linalg.norm(points, axis=1) - radius
            own = np.abs(error) < _REACH
            errors.append(error[own])
            angles.append(np.arccos(np.clip(points[own, 2] / radius, -1, 1)))
    return np.concatenate(errors), np.concatenate(angles)


def predicted(radius_mm: float) -> float:
    """Displacement by curvature of the centroid of the light, m."""
    laser = scancell.Scanner().setup.sensor.laser
    off_waist = 1e-3 * laser.divergence_mrad * (1e3 * STANDOFF - laser.waist_z_mm)
    return float(-1.5e-3 * (laser.sheet_sigma_mm**2 + off_waist**2) / radius_mm)


def main() -> None:
    """Print a row for each radius and detector."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--radii", type=float, nargs="+", default=RADII_MM, help="radii of balls, mm")
    radii = parser.parse_args().radii
    print("| radius | −3/2 σ² / R | detector | mean up to 40° | 40 to 55° | 55 to 70° |\n|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        for radius in radii:
            for detector in DETECTORS:
                error, angle = ball_errors(radius, detector, np.linspace(-0.9, 0.9, 13), Path(folder))
                means = [
                    f"{1e6 * error[(angle >= np.radians(low)) & (angle < np.radians(high))].mean():+.2f} µm"
                    for low, high in ((0, 40), (40, 55), (55, 70))
                ]
                line = f"| {radius:g} mm | {1e6 * predicted(radius):+.2f} µm | `{detector}` | {' | '.join(means)} |"
                print(line.replace("-", "\N{MINUS SIGN}"), flush=True)


if __name__ == "__main__":
    main()
