"""`PYTHONPATH=tests python -m bench.surface_sigma`: errors over stated standard deviations, for docs/light.md.

A plane of each material stands tilted at many heights in the measuring range, so that stripes fall on all sub-pixel
positions, on other pixels of the fixed patterns and on other grains of speckle. All points count that lie inside the
measuring range; none is left out by its error.

Where the brightness of a surface changes across the laser sheet, the light's centre is displaced from that of the
sheet. This displacement is predicted without noise: with the sheet turned by a small angle e, the stripe has the height
A(e) in the row r(e). A Gaussian sheet of the angular standard deviation s, whose image has the light A(e) G(e / s) per
row, has its centre of gravity displaced by s² (r' (ln A)' + 3/2 r'') rows, to second order in s.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from scancell import sensor as sensor_rt
from scancell.config.loading import assets_dir
from scancell.config.material import PRESETS, Material
from scancell.geometry import pose
from scancell.scanning.world import native_material

from .scenes import FAITHFUL_DETECTOR, make_sensor, sensor_description
from .table import replace_paragraphs

Array = NDArray[np.float64]
Place = tuple[NDArray[np.int64], ...]
Engine = Literal["ray-traced", "geometric"]

PAGE = Path(__file__).resolve().parents[2] / "docs/light.md"
REALISTIC = assets_dir() / "sensors/realistic/two_camera_probe.toml"
SENSORS: dict[str, tuple[Path | None, tuple[str, ...]]] = {
    "ideal": (None, ()),
    "realistic": (REALISTIC, ()),
    "realistic, sheet known": (REALISTIC, ("sensor.extraction.triangulation=sheet",)),
}
ENGINES: tuple[Engine, ...] = ("ray-traced", "geometric")
GROOVED = Material(0.7, "grooved_conductor", roughness=0.35, roughness_along=0.08, groove_axis=(1.0, 0.0, 0.0))
SURFACES: dict[str, Material] = {
    **{name.replace("_", " "): m for name, m in PRESETS.items() if m.scattering_per_mm is None},
    "grooves across the laser line": GROOVED,
    "grooves along the laser line": replace(GROOVED, groove_axis=(0.0, 1.0, 0.0)),
    "retro-reflective foil": Material(0.8, "retro_reflective", roughness=0.2),
}
TILT = np.radians([10.0, 8.0, 0.0])  # about X, Y and Z of the sensor
HEIGHTS = np.linspace(0.08, 0.16, 60)  # m
EXPOSURE = 5e-4  # s
_TURN_DEG = 0.05  # of the sheet, on either side: about two of its standard deviations
# Noise-free images whose numbers do not limit the prediction.
EXACT = (*FAITHFUL_DETECTOR, "sensor.detector.gain_dn_per_e=1.0", "sensor.speckle.contrast=0.0")


@dataclass(frozen=True)
class Points:
    """Points of one surface.

    Attributes
    ----------
    distance, stated
        (n,) signed distance from the plane, m, and its stated standard deviation. A point that is displaced by e along
        the unit vector d of the line on which it is uncertain has the distance e (d n) from a plane of the normal n.
    flags, intensity
        (n,) of the peaks; stripe height in digital numbers.
    row, place
        (n,) row in the image, px; and (3, n) exposure, camera and column.
    """

    distance: Array
    stated: Array
    flags: NDArray[np.uint32]
    intensity: Array
    row: Array
    place: Place

    def spread(self, displacement: Array | float = 0.0) -> float:
        """Standard deviation of error over stated one, about the truth or a known displacement (n,), m."""
        score = (self.distance - displacement) / self.stated
        return float(np.sqrt(np.mean(score**2))) if len(score) else float("nan")


def points_of(
    material: Material, sensor: sensor_rt.Sensor, engine: Engine, as_built: sensor_rt.Sensor | None = None
) -> Points:
    """The points of all heights."""
    scene = sensor_rt.Scene()
    scene.add_plane("plane", np.eye(4), (1.0, 1.0), native_material(material))
    planes = np.stack([pose.from_euler_xyz((0.0, 0.0, z), TILT) for z in HEIGHTS])
    count = len(planes)
    sensors = np.broadcast_to(np.eye(4), (count, 1, 4, 4))
    exposures = sensor_rt.Exposures(sensors, planes[:, None, None], np.full(count, EXPOSURE), np.arange(count))
    found = sensor_rt.scan(scene, sensor, exposures, engine, as_built=as_built).profiles
    normal = planes[0, :3, 2]
    return Points(
        distance=(found.points_in_sensor - planes[found.frame, :3, 3]) @ normal,
        stated=np.sqrt(np.einsum("i,nij,j->n", normal, found.covariance, normal)),
        flags=np.array(found.flags),
        intensity=np.array(found.intensity, float),
        row=np.array(found.row),
        place=tuple(np.array(index, np.int64) for index in (found.frame, found.camera, found.column)),
    )


def displacements(material: Material, path: Path | None, settings: tuple[str, ...], place: Place) -> Array:
    """Predicted displacements (n,) from the plane, m, of ray-traced points by exposure, camera and column.

    0 where the turned sheets give no point.
    """
    description = sensor_description((*settings, *EXACT), path)
    sensor = make_sensor((*settings, *EXACT), path)
    shape = (len(HEIGHTS), len(description["cameras"]), description["cameras"][0]["width_px"])
    height, distance, row = np.full((3, 3, *shape), np.nan)
    for side, turn in enumerate((-_TURN_DEG, 0.0, _TURN_DEG)):
        turned = make_sensor((*settings, *EXACT, f"sensor.laser.turn_y_deg={turn}"), path)
        found = points_of(material, sensor, "ray-traced", turned)
        height[side][found.place], distance[side][found.place] = found.intensity, found.distance
        row[side][found.place] = found.row
    step = np.radians(_TURN_DEG)
    travel, bend = (row[2] - row[0]) / (2.0 * step), np.diff(row, 2, axis=0)[0] / step**2
    rows = travel * np.log(height[2] / height[0]) / (2.0 * step) + 1.5 * bend
    slope = rows * (distance[2] - distance[0]) / (row[2] - row[0])
    laser, z = description["laser"], HEIGHTS[place[0]]
    width = np.hypot(laser["sheet_sigma"], laser["divergence"] * (z - laser["waist_z"])) / (z - laser["source_z"])
    return np.asarray(np.nan_to_num(width**2 * slope[place]))


def details(found: Points) -> Iterator[str]:
    """Lines of figures of the points of saturated and of other stripes, by height."""
    saturated = (found.flags & sensor_rt.PEAK_FLAGS["saturated"]) != 0
    edges = [0, 8, 16, 32, 64, 128, 256, np.inf]
    for name, chosen in (("not saturated", ~saturated), ("saturated", saturated)):
        for low, high in pairwise(edges):
            rows = chosen & (found.intensity >= low) & (found.intensity < high)
            if not rows.any():
                continue
            score = found.distance[rows] / found.stated[rows]
            yield (
                f"{name}, {low:g} to {high:g} DN: {len(score)} points, about truth {np.sqrt(np.mean(score**2)):.3f},"
                f" mean {score.mean():+.3f}, beyond 4: {np.mean(np.abs(score) > 4):.1e}"
            )


def cell_of(surface: str, name: str, engine: Engine, complete: int, with_details: bool) -> str:
    """Spread, in images also that about the predicted displacement, and share of points."""
    path, settings = SENSORS[name]
    found = points_of(SURFACES[surface], make_sensor(settings, path), engine)
    if with_details:
        print(f"{surface}, {name}, {engine}:", *details(found), sep="\n  ", flush=True)
    about = ""
    if engine == "ray-traced":
        about = f" ({found.spread(displacements(SURFACES[surface], path, settings, found.place)):.2f})"
    return f"{found.spread():.2f}{about}, {100 * len(found.distance) / complete:.0f} %"


def main() -> None:
    """Print the table, and write it into the page when it holds all surfaces."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--details", action="store_true", help="figures by saturation and height of the stripe")
    parser.add_argument("--surfaces", nargs="*", default=list(SURFACES))
    options = parser.parse_args()
    cases = [(name, engine) for name in SENSORS for engine in ENGINES]
    grey = Material(0.3)
    complete = {
        (name, engine): len(points_of(grey, make_sensor((*SENSORS[name][1], *EXACT), SENSORS[name][0]), engine).stated)
        for name, engine in cases
    }
    lines = ["| surface | " + " | ".join(f"{name}: {engine}" for name, engine in cases) + " |"]
    lines.append("|---" * (len(cases) + 1) + "|")
    for surface in options.surfaces:
        cells = [cell_of(surface, name, engine, complete[name, engine], options.details) for name, engine in cases]
        lines.append(f"| {surface} | {' | '.join(cells)} |")
        print(lines[-1], flush=True)
    if options.surfaces == list(SURFACES):
        replace_paragraphs(PAGE, {"| surface | ideal": lines})


if __name__ == "__main__":
    main()
