"""Least-squares fits against the reference pairs of NIST: points and parameters to 20 digits, mm.

Positions that may slide along an axis or in a plane are compared as geometry: the distance of the reference point from
the fitted line, plane or axis. All fits of a cone see the same surface: its distance from the reference point.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from scancell.geometry import fits

FOLDER = Path(__file__).resolve().parents[1] / "golden" / "nist_l2"
LENGTH = 1e-8  # mm
ANGLE = 1e-9  # rad
PAIRS = sorted(path.stem for path in FOLDER.glob("*.ds"))


def read(name: str) -> tuple[np.ndarray, np.ndarray]:
    """Points (n, 3) and parameters of a pair, mm."""
    points = np.loadtxt(FOLDER / f"{name}.ds", skiprows=1)
    assert len(points) == int((FOLDER / f"{name}.ds").read_text().split(maxsplit=1)[0])
    return points, np.loadtxt(FOLDER / f"{name}.fit")


def angle_between(a: np.ndarray, b: np.ndarray) -> float:
    """Angle between lines of unit directions (3,), accurate for small angles."""
    return float(np.linalg.norm(np.cross(a, b)))


def distance_from_axis(point: np.ndarray, origin: np.ndarray, direction: np.ndarray) -> float:
    return float(np.linalg.norm(np.cross(point - origin, direction)))


def differences(name: str) -> tuple[list[float], list[float]]:
    """Differences of lengths, mm, and of angles, rad, between fit and reference."""
    points, reference = read(name)
    position, direction, sizes = reference[:3], reference[3:6], reference[6:]
    match name[:3]:
        case "lin":
            line = fits.fit_line(points)
            return [distance_from_axis(position, line.point, line.direction)], [
                angle_between(line.direction, direction)
            ]
        case "pla":
            plane = fits.fit_plane(points)
            return [float((position - plane.point) @ plane.normal)], [angle_between(plane.normal, direction)]
        case "cir":
            circle = fits.fit_circle(points)
            lengths = [*(circle.centre - position), 2 * circle.radius - sizes[0]]
            return lengths, [angle_between(circle.normal, direction)]
        case "sph":
            sphere = fits.fit_sphere(points)
            return [*(sphere.centre - position), 2 * sphere.radius - reference[3]], []
        case "cyl":
            cylinder = fits.fit_cylinder(points)
            off_axis = distance_from_axis(position, cylinder.point, cylinder.direction)
            return [off_axis, 2 * cylinder.radius - sizes[0]], [angle_between(cylinder.direction, direction)]
        case "con":
            cone = fits.fit_cone(points)
            assert cone.direction @ direction > 0
            along = (position - cone.point) @ cone.direction
            distance = cone.distance + along * np.sin(cone.half_angle)
            lengths = [distance_from_axis(position, cone.point, cone.direction), distance - sizes[0]]
            return lengths, [
                angle_between(cone.direction, direction),
                2 * cone.half_angle - np.radians(sizes[1]),
            ]
    raise AssertionError(name)


def test_every_element_has_reference_pairs() -> None:
    assert sorted(path.stem for path in FOLDER.glob("*.fit")) == PAIRS
    assert len(PAIRS) == 25
    assert {name[:3] for name in PAIRS} == {"lin", "pla", "cir", "sph", "cyl", "con"}


@pytest.mark.parametrize("name", PAIRS)
def test_fit_agrees_with_reference(name: str) -> None:
    lengths, angles = differences(name)
    assert np.abs(lengths).max() < LENGTH, lengths
    assert np.abs(angles).max(initial=0.0) < ANGLE, angles
