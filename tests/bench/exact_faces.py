"""Ray-traced points on exact faces while the laser line narrows: ``PYTHONPATH=tests python -m bench.exact_faces``.

The light of a line of finite width displaces points on curved surfaces by an amount that falls with the square of the
width. Pixels and exposure shrink with the line, so that the stripe stays as wide in the images, and as bright. Errors
that belong to the faces would stay. The same scan of a mesh, and of the cylinder as an exact shape, tells what
triangles add; images that NumPy computes from the light on the cylinder tell what the displacement must be.
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import scancell
from scancell import Mesh, Scanner
from scancell import sensor as sensor_rt
from scancell.config.loading import load_setup
from scancell.config.sensor import sensor_json
from scancell.geometry import pose
from scancell.geometry.shapes import Cylinder
from scancell.reconstruction.cloud import Cloud

RADIUS, HEIGHT = 5e-3, 30e-3  # m, of the cylinder
TORUS = 25e-3, 6e-3  # m
FACTORS = (1, 2, 4, 8)  # of the line's width
CHORDS = (1e-8, 1e-7, 1e-6, 5e-6)  # m, of meshes
SETTINGS = {"cell.part.x_mm": 7.0, "scan.max_profiles": 150}
ALIKE = 0.2e-6  # m
_ROWS, _COLUMNS = 8, 2  # points of a pixel of the computed images
_DARK = 1e-9  # of the brightest pixel
_CHUNK = 64  # columns
_MARGIN = 20  # px
_SHAPE = """
name = "cylinder"
[[shape]]
name = "cylinder"
kind = "cylinder"
diameter_mm = 10
height_mm = 30
pose = { z_mm = 15 }
"""

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]


def narrowed(factor: float) -> dict[str, Any]:
    """Settings of the default cell with a line, pixels and an exposure that are so many times smaller; 16 bits."""
    found: dict[str, Any] = {
        "sensor.laser.sheet_sigma_mm": 0.055 / factor,
        "sensor.laser.divergence_mrad": 0.4 / factor,
        "sensor.laser.power_mw": 2.0 * factor**2,
        "sensor.render.rays_across_fan": round(1440 * factor),
        "sensor.detector.exposure_ms": 0.5 / factor,
        "sensor.detector.bit_depth": 16,
        "sensor.detector.gain_dn_per_e": 0.0225 * 256,
        "sensor.detector.black_level_dn": 4.0 * 256,
        "sensor.extraction.min_amplitude_dn": 4.0 * 256,
    }
    for number in (1, 2):
        camera = f"sensor.camera[{number}]"
        found |= {f"{camera}.width_px": round(1280 * factor), f"{camera}.height_px": round(1024 * factor)}
        found[f"{camera}.pixel_pitch_um"] = 5.0 / factor
    return found


def write_parts(folder: Path) -> dict[str, Path]:
    """STEP files of the cylinder and the torus that stand on the table, and the cylinder as an exact shape."""
    from OCP.BRepPrimAPI import BRepPrimAPI_MakeCylinder, BRepPrimAPI_MakeTorus  # noqa: PLC0415
    from OCP.gp import gp_Ax2, gp_Dir, gp_Pnt  # noqa: PLC0415
    from OCP.STEPControl import STEPControl_StepModelType, STEPControl_Writer  # noqa: PLC0415

    tube = gp_Ax2(gp_Pnt(0, 0, 1e3 * TORUS[1]), gp_Dir(0, 0, 1))
    made = {
        "cylinder": BRepPrimAPI_MakeCylinder(1e3 * RADIUS, 1e3 * HEIGHT).Shape(),
        "torus": BRepPrimAPI_MakeTorus(tube, *(1e3 * size for size in TORUS)).Shape(),
    }
    paths = {name: folder / f"{name}.step" for name in made}
    for name, shape in made.items():
        writer = STEPControl_Writer()
        writer.Transfer(shape, STEPControl_StepModelType.STEPControl_AsIs)
        writer.Write(str(paths[name]))
    paths["shape"] = folder / "shape.toml"
    paths["shape"].write_text(_SHAPE)
    return paths


@dataclass(frozen=True)
class Difference:
    """Distances between points of two clouds that have profile, camera and column in common, m."""

    distances: Array
    lacking: float  # share of the points of the first one that the second one has not

    def __str__(self) -> str:
        rms, largest = np.sqrt(np.mean(self.distances**2)), self.distances.max()
        beyond = 100 * np.mean(self.distances > ALIKE)
        lacking = 100 * self.lacking
        return f"{1e6 * rms:.3f} µm | {1e6 * largest:.2f} µm | {beyond:.2g} % | {lacking:.2g} %"


def difference(one: Cloud, other: Cloud) -> Difference:
    """Difference of two clouds of one plan."""

    def keys(cloud: Cloud) -> Array:
        return (cloud.profile.astype(np.int64) * 16 + cloud.camera) * 2**20 + cloud.column

    _, left, right = np.intersect1d(keys(one), keys(other), return_indices=True)
    apart = np.linalg.norm(one.points_in_part[left] - other.points_in_part[right], axis=1)
    return Difference(apart, 1 - len(left) / len(one))


def cylinder_error(points: Array) -> Array:
    """Distance (n,) of points (n, 3) in the frame of the part from the wall of the cylinder, m."""
    return np.hypot(points[:, 0], points[:, 1]) - RADIUS


def cylinder_image(
    sensor: sensor_rt.Sensor, number: int, laser: Mapping[str, float], part_from_sensor: Array, shown: Flags
) -> Array:
    """Light (height, width) that a camera sees of the wall of the cylinder, in any unit, without the ray tracer.

    The ray of each point of each pixel meets the cylinder in closed form; there the light of the sheet is its Gaussian
    by the cosine of incidence, and that of the fan falls with the distance. The wall is matt: brightness does not
    depend on the direction of view. Pixels far from those of `shown` (height, width) stay dark.
    """
    camera = sensor.cameras[number]
    source = part_from_sensor[:3, 3]

    def light(pixels: Array) -> Array:
        along = camera.view_rays(pixels) @ part_from_sensor[:3, :3].T
        origin = (part_from_sensor @ camera.sensor_from_camera)[:3, 3]
        a, b = (along[:, :2] ** 2).sum(1), along[:, :2] @ origin[:2]
        root = b**2 - a * (origin[:2] @ origin[:2] - RADIUS**2)
        t = (-b - np.sqrt(np.where(root > 0, root, np.nan))) / a
        hit = origin + t[:, None] * along
        normal = np.column_stack([hit[:, :2] / RADIUS, np.zeros(len(hit))])
        to_source = source - hit
        x, y, z = pose.transform_points(pose.inverse(part_from_sensor), hit).T
        variance = laser["sigma"] ** 2 + (laser["divergence"] * (z - laser["waist"])) ** 2
        cosine = np.einsum("ni,ni->n", normal, to_source) / np.linalg.norm(to_source, axis=1)
        found = np.exp(-(x**2) / variance / 2) / np.sqrt(variance) * np.maximum(cosine, 0.0) / np.hypot(y, z)
        return np.where((hit[:, 2] > 0) & (hit[:, 2] < HEIGHT), found, 0.0)

    image = np.zeros((camera.height_px, camera.width_px))
    inner = [(np.arange(n) + 0.5) / n - 0.5 for n in (_COLUMNS, _ROWS)]
    within = np.stack(np.meshgrid(*inner, indexing="ij"), -1).reshape(-1, 2)
    lowest, leftmost = np.argwhere(shown).min(0) - _MARGIN
    highest, rightmost = np.argwhere(shown).max(0) + _MARGIN
    rows = np.arange(max(lowest, 0), min(highest, camera.height_px))
    for first in range(max(leftmost, 0), min(rightmost, camera.width_px), _CHUNK):
        columns = np.arange(first, min(first + _CHUNK, camera.width_px))
        pixels = np.stack(np.meshgrid(columns, rows), -1).reshape(-1, 2).astype(float)
        with np.errstate(invalid="ignore"):
            coarse = np.nan_to_num(light(pixels)).reshape(len(rows), len(columns))
            lit = coarse > _DARK * coarse.max() if coarse.max() > 0 else np.zeros_like(coarse, bool)
            near = lit.copy()  # pixels beside lit ones have some light, too
            near[1:] |= lit[:-1]
            near[:-1] |= lit[1:]
            chosen = pixels[near.ravel()]
            fine = np.nan_to_num(light((chosen[:, None] + within).reshape(-1, 2))).reshape(-1, len(within))
        part = np.zeros_like(coarse)
        part[near] = fine.mean(1)
        image[np.ix_(rows, columns)] = part
    return image


def displacements(factor: float, turned: float) -> tuple[Array, Array]:
    """Errors (n,) of points on the cylinder, m: ray-traced with its exact wall, and of the computed images.

    The axis of the cylinder lies across the laser at 120 mm, `turned` from the laser line, rad.
    """
    described = load_setup(settings=narrowed(factor), ideal=True).sensor
    sensor = sensor_rt.Sensor(json.dumps(sensor_json(described, 0)))
    laser = {
        "sigma": 1e-3 * described.laser.sheet_sigma_mm,
        "divergence": 1e-3 * described.laser.divergence_mrad,
        "waist": 1e-3 * described.laser.waist_z_mm,
    }
    sensor_from_part = pose.from_euler_xyz([0.0, 0.0, 0.12 + RADIUS], [np.pi / 2, 0.0, 0.0])
    sensor_from_part = pose.from_euler_xyz([0, 0, 0], [0, 0, turned]) @ sensor_from_part
    sensor_from_part = sensor_from_part @ pose.translation([0, 0, -HEIGHT / 2])
    part_from_sensor = pose.inverse(sensor_from_part)
    scene = sensor_rt.Scene()
    scene.add_cylinder("part", pose.translation([0, 0, HEIGHT / 2]), RADIUS, HEIGHT, 0.5)
    duration, index = np.array([1e-3 * described.detector.exposure_ms]), np.array([0])
    still = sensor_rt.Exposures(np.eye(4)[None, None], sensor_from_part[None, None, None], duration, index)
    traced = sensor_rt.expected_electrons(scene, sensor, still)
    computed = np.stack(
        [cylinder_image(sensor, number, laser, part_from_sensor, traced[0, number] > 0) for number in (0, 1)]
    )[None]
    computed *= traced.max() / computed.max()
    errors = []
    for electrons in (traced, computed.astype(np.float32)):
        images = sensor_rt.expose(electrons, sensor, duration, index)
        profiles = sensor_rt.triangulate(sensor_rt.extract(images, sensor), sensor)
        points = pose.transform_points(part_from_sensor, profiles.points_in_sensor)
        keys = profiles.camera * 2**20 + profiles.column
        errors.append(dict(zip(keys.tolist(), cylinder_error(points), strict=True)))
    common = sorted(errors[0].keys() & errors[1].keys())
    return np.array([errors[0][key] for key in common]), np.array([errors[1][key] for key in common])


def _rms(errors: Array) -> float:
    return float(1e6 * np.sqrt(np.mean(errors**2)))


def main() -> None:
    """Print the three tables."""
    with tempfile.TemporaryDirectory() as folder:
        paths = write_parts(Path(folder))
        print("| width of the line | " + " | ".join(f"1/{factor}" for factor in FACTORS) + " |")
        for name in ("cylinder", "torus"):
            found = []
            for factor in FACTORS:
                with Scanner(ideal=True, settings=SETTINGS | narrowed(factor)) as scanner:
                    error = scanner.scan(paths[name]).deviation.distance
                found.append(f"{_rms(error):.3f}, {1e6 * np.quantile(np.abs(error), 0.999):.2f} µm")
            print(f"| {name} | {' | '.join(found)} |", flush=True)

        print("\n| width | cylinder | RMS from the STEP file's | largest | beyond 0.2 µm | without partner |")
        step = scancell.load_part(paths["cylinder"])
        middle = pose.translation([0.0, 0.0, HEIGHT / 2])
        others: dict[str, Path | Mesh] = {"exact shape": paths["shape"]}
        others |= {f"mesh, {1e6 * s:g} µm": Cylinder(RADIUS, HEIGHT).mesh(s).transformed(middle) for s in CHORDS}
        for factor in (1, 4):
            with Scanner(ideal=True, settings=SETTINGS | narrowed(factor)) as scanner:
                first = scanner.scan(step)
                for name, part in others.items():
                    cloud = scanner.scan(part, plan=first.plan).cloud
                    print(f"| 1/{factor} | {name} | {difference(first.cloud, cloud)} |", flush=True)

        print("\n| width | turned | displacement: mean, RMS | computed without ray tracing | RMS of the difference |")
        for factor in (1, 2):
            for turned in (0, 20, 60):
                traced, computed = displacements(factor, np.radians(turned))
                told = [f"{1e6 * one.mean():+.3f}, {_rms(one):.3f} µm" for one in (traced, computed)]
                print(f"| 1/{factor} | {turned}° | {' | '.join(told)} | {_rms(traced - computed):.4f} µm |", flush=True)


if __name__ == "__main__":
    main()
