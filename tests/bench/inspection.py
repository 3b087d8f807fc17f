"""False decisions and intervals of inspections: ``PYTHONPATH=tests python -m bench.inspection``.

Without ``--cell``, clouds are drawn: points with noise of their own and of each profile, in random poses. With it, the
part is scanned in a cell (geometric engine) whose tool deviates from the calibrated one by amounts that are drawn anew
for each measurement; their effect is known from a capability of other draws. The part is perfect, and the limits vary:
a size that exceeds its limit by so much is nonconforming, and must not be accepted more often than the rule permits.
One scan measures eight sizes; the bound counts that their errors are those of one cell.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from scipy.special import ndtri

from inspection_parts import cad_part, cloud_of
from scancell import Scanner
from scancell.arrays import Array
from scancell.config.inspection import InspectionDescription
from scancell.geometry import pose
from scancell.geometry.cad import CadMesh
from scancell.geometry.shapes import Box, PlacedShape, Ring, Sphere
from scancell.inspection.inspection import Decision, Inspection, inspect_part
from scancell.progress import NullProgress
from scancell.sensor import MeshSurface
from scancell.studies.capability import run_capability

SHIFTS = (-3.0, -2.0, -1.0, -0.5, 0.0, 0.5, 1.0, 2.0, 3.0)  # standard uncertainties from the truth to the limit
NOISE, COMMON = 3e-6, 1e-6  # m of drawn clouds: of each point, and of a profile
PROFILE = 25  # points of a drawn profile
SURE = 0.999
RISK = 0.05  # of a wrong verdict at the limit
GUARD = float(ndtri(1 - RISK))  # standard uncertainties of the guard band
TOOL = ("x_mm", "y_mm", "z_mm", "rx_deg", "ry_deg", "rz_deg")
DEVIATION = {"mm": 0.002, "deg": 0.001}  # standard deviations of the tool of the cell
FACES = (0, 1, 2, 3, 4, 6, 7, 9, 10)
SETTINGS = {
    "scan.max_profiles": 120,
    "scan.coverage.enabled": True,
    "scan.coverage.feature": [{"faces": FACES, "share": 0.7}],
}
FACTOR = """
[[factor]]
path = "as_built.tool.{}"
distribution = {{ kind = "normal", std = {} }}
"""
STUDY = 'name = "tool"\npart = "none"\ndesign = { kind = "latin_hypercube", trials = 2 }\n'


def part() -> CadMesh:
    """Block, ring and ball beside each other on the table."""
    return cad_part(
        [
            PlacedShape("block", Box(0.05, 0.03, 0.02), pose.from_euler_xyz([-0.02, 0.0, 0.01], [0.0, 0.0, 0.2])),
            PlacedShape("ring", Ring(8e-3, 12e-3, 0.012), pose.translation([0.024, 0.012, 0.006])),
            PlacedShape("ball", Sphere(0.008), pose.translation([0.02, -0.018, 0.008])),
        ]
    )


def description() -> InspectionDescription:
    """Sizes of all kinds, with limits that are not used."""
    limits = {"upper_mm": 1.0, "lower_mm": -1.0}
    sizes: list[dict[str, Any]] = [
        {"name": "bore", "kind": "diameter", "faces": (6,), **limits},
        {"name": "outside", "kind": "diameter", "faces": (9,), **limits},
        {"name": "ball", "kind": "radius", "faces": (10,), **limits},
        {"name": "length", "kind": "distance", "faces": (0,), "to": (1,), **limits},
        {"name": "width", "kind": "distance", "faces": (2,), "to": (3,), **limits},
        {"name": "step", "kind": "distance", "faces": (4,), "to": (7,), **limits},
        {"name": "ring to ball", "kind": "distance", "faces": (9,), "to": (10,), **limits},
        {"name": "corner", "kind": "angle", "faces": (0,), "to": (2,), "upper_deg": 1.0, "lower_deg": -1.0},
    ]
    return InspectionDescription.model_validate({"characteristic": sizes, "filter_mm": 0.0})


def drawn(count: int) -> Iterator[tuple[Decision, ...]]:
    """Decisions on drawn clouds."""
    nominal, described = part(), description()
    surface = MeshSurface(nominal.vertices, nominal.faces)
    for seed in range(count):
        random = np.random.default_rng(seed)
        points = cloud_of(nominal, 8000, seed, NOISE)
        profile = np.arange(len(points)) // PROFILE
        normals = nominal.normals[surface.signed_distances(points)[1]]
        points = points + COMMON * random.standard_normal(profile.max() + 1)[profile, None] * normals
        away = pose.from_euler_xyz(3e-5 * random.standard_normal(3), 2e-4 * random.standard_normal(3))
        moved = pose.transform_points(away, points)
        yield inspect_part(nominal, moved, described, profile=profile, align="none", effects={}).decisions


def scanned(count: int, draws: int) -> list[tuple[Decision, ...]]:
    """Decisions on scans in a cell whose tool deviates, with the effect that other draws have."""
    kept: list[Inspection] = []
    with TemporaryDirectory() as folder, Scanner(settings=SETTINGS) as scanner:
        file = Path(folder) / "factors.toml"
        file.write_text(STUDY + "".join(FACTOR.format(key, DEVIATION[key.partition("_")[2]]) for key in TOOL))
        options: dict[str, Any] = {"factors": file, "engine": "geometric", "as_built": (), "progress": NullProgress()}
        effects = run_capability(scanner, part(), description(), draws=draws, seed=1, **options).effects
        run_capability(scanner, part(), description(), draws=count, seed=2, each=kept.append, **options)
    return [tuple(replace(own, effect=effects[own.description.name]) for own in one.decisions) for one in kept]


def errors_of(found: Iterable[tuple[Decision, ...]]) -> tuple[Array, Array]:
    """Errors (n, k) of all characteristics in all measurements of the perfect part, and their uncertainties, m."""
    rows = [
        [
            (own.measured.value - own.effect.bias - own.measured.nominal, own.uncertainty)
            for own in decisions
            if own.measured is not None
        ]
        for decisions in found
    ]
    error, deviation = np.moveaxis(np.array(rows), -1, 0)
    return error, deviation


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--measurements", type=int, default=1000)
    parser.add_argument("--cell", action="store_true", help="scan in a cell")
    parser.add_argument("--draws", type=int, default=60, help="measurements of the capability")
    options = parser.parse_args()
    found = scanned(options.measurements, options.draws) if options.cell else drawn(options.measurements)
    error, deviation = errors_of(found)
    scores = error / deviation
    names = [one.name for one in description().characteristic]
    print("| characteristic | measurements | mean error, u | spread, u | in the 95 % interval |\n|---|---|---|---|---|")
    for name, own in zip([*names, "all"], [*scores.T, scores.ravel()], strict=True):
        print(f"| {name} | {len(own)} | {own.mean():+.3f} | {own.std():.3f} | {(np.abs(own) < 1.96).mean():.1%} |")
    print("\n| limit - truth, u | accepted | rejected | undecided | false | bound |\n|---|---|---|---|---|---|")
    for shift in SHIFTS:
        limit = shift * deviation.mean(0)  # the same in all measurements
        accepted, rejected = error <= limit - GUARD * deviation, error >= limit + GUARD * deviation
        false = accepted if shift < 0 else rejected
        # Sizes of one measurement share errors: what measurements differ by counts.
        bound = RISK + ndtri(SURE) * false.mean(1).std(ddof=1) / len(false) ** 0.5
        shares = (accepted.mean(), rejected.mean(), 1 - accepted.mean() - rejected.mean(), false.mean(), bound)
        print(f"| {shift:+.1f} | {' | '.join(f'{share:.2%}' for share in shares)} |")


if __name__ == "__main__":
    main()
