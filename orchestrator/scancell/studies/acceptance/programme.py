"""What an acceptance test measures: artefacts, positions over the measuring range, scan modes, repeats."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, get_args

import numpy as np

from scancell.config.artefact import ArtefactDescription
from scancell.config.choices import ScanMode
from scancell.config.description import validate
from scancell.config.files import assets_dir, plain_data
from scancell.config.loading import Setup
from scancell.geometry.mesh import sample_surface
from scancell.geometry.shapes import ShapeGroup
from scancell.nominal.parts import shape_group

ALL_ROUND = "all round"
MODES: tuple[ScanMode, ...] = get_args(ScanMode)

_TURNED = ("sphere", "ball_bar", "cylinder")  # artefacts that are also scanned from all sides
_ALL_ROUND_PROFILES = 4  # times those of passes alone
_RANGE_MARGIN = 0.05  # of the measuring range, left free at both ends
_FULL_SIZE = 60.0  # mm: with a shorter measuring range artefacts are made smaller in proportion
_SEEN = 0.4  # cosine of the incidence up to which a surface counts for the depth of an artefact
_COARSE = 100e-6  # m
_SAMPLES = 4000


@dataclass(frozen=True)
class Programme:
    """Size of the test.

    Attributes
    ----------
    artefacts
        Names of shipped artefacts.
    positions
        Names of the positions of an artefact from the near to the far end of the measuring range.
    repeats
        Scans of each artefact at each position in each mode, with noise of their own.
    profiles
        Most profiles of a scan.
    points
        Points of a scan that are evaluated, evenly chosen.
    exposures, steps
        Of the sweeps over range, angles, reflectance and speed: exposures of a target, targets of a sweep.
    """

    artefacts: tuple[str, ...] = ("sphere", "ball_bar", "plane", "step", "cylinder", "cone")
    positions: tuple[str, ...] = ("near", "middle", "far")
    repeats: int = 20
    profiles: int = 200
    points: int = 20_000
    exposures: int = 10
    steps: int = 13


QUICK = Programme(positions=("near", "far"), repeats=2, profiles=60, points=5000, exposures=3, steps=5)


@dataclass(frozen=True)
class Station:
    """An artefact at a position of the measuring range, scanned in a mode.

    `standoff` is the distance along sensor Z to the top of the artefact, m.
    """

    artefact: str
    position: str
    standoff: float
    mode: ScanMode

    def setup(self, setup: Setup, profiles: int) -> Setup:
        """The descriptions with the views of this station: passes over the top, and for `ALL_ROUND` sweeps, too.

        `profiles` is the largest number of those of passes alone.
        """
        changes = {
            "mode": self.mode,
            "max_profiles": profiles * (_ALL_ROUND_PROFILES if self.position == ALL_ROUND else 1),
            "sweep.enabled": self.position == ALL_ROUND,
            "sweep.standoff_mm": 1e3 * self.standoff,
            "raster.enabled": True,
            "coverage.enabled": False,
            "pose": (),
            "path": (),
        }
        return Setup(setup.cell, setup.sensor, setup.scan.replace(changes))


def artefact_scale(setup: Setup) -> float:
    """Size of the artefacts in proportion to the shipped ones: those of short measuring ranges are smaller."""
    return min(1.0, (setup.sensor.range.far_mm - setup.sensor.range.near_mm) / _FULL_SIZE)


def scaled_artefact(name: str, scale: float) -> ShapeGroup:
    """A shipped artefact with all lengths multiplied by `scale`."""
    shipped = ArtefactDescription.from_toml(assets_dir() / "artefacts" / f"{name}.toml")
    if scale == 1.0:
        return shape_group(shipped)
    data = _scaled(plain_data(shipped), scale)
    return shape_group(validate(ArtefactDescription, data, f"{name}, {scale:.3g} times its size"))


def _scaled(data: Any, scale: float, is_length: bool = False) -> Any:
    if isinstance(data, dict):
        return {key: _scaled(value, scale, key.endswith("_mm")) for key, value in data.items()}
    if isinstance(data, list):
        return [_scaled(value, scale, is_length) for value in data]
    return data * scale if is_length else data


def stations(name: str, artefact: ShapeGroup, setup: Setup, programme: Programme) -> Iterator[Station]:
    """Positions of an artefact over the measuring range, and from all sides in the middle, each in both modes.

    The whole visible surface of the artefact stays inside the range; where it is too deep for that, the positions are
    the one in the middle.
    """
    near, far = 1e-3 * setup.sensor.range.near_mm, 1e-3 * setup.sensor.range.far_mm
    margin, depth = _RANGE_MARGIN * (far - near), _depth(artefact)
    first, last = near + margin, far - margin - depth
    middle = max(first, (near + far - depth) / 2)
    count = len(programme.positions)
    standoffs = np.linspace(first, last, count).tolist() if count > 1 else [middle]
    places = dict(zip(programme.positions, standoffs, strict=True)) if first < last else {"middle": middle}
    if name in _TURNED:
        places[ALL_ROUND] = middle
    for position, standoff in places.items():
        for mode in MODES:
            yield Station(name, position, standoff, mode)


def _depth(artefact: ShapeGroup) -> float:
    """Height, m, from the lowest visible measured surface to the top of the artefact, seen from above."""
    mesh = artefact.mesh(_COARSE)
    points, faces = sample_surface(mesh, _SAMPLES, 0)
    signed, _, number = artefact.nearest(points)
    measured = np.array([one.role == "measured" for one in artefact.shapes])
    seen = (mesh.normals[faces, 2] > _SEEN) & (signed > -2 * _COARSE) & measured[number]
    return float(mesh.bounds[1, 2] - points[seen, 2].min())
