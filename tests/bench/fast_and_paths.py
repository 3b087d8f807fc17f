"""`PYTHONPATH=tests python -m bench.fast_and_paths`: rows of stripes in the fast mode against those of path tracing.

Every sensor preset looks at every material preset: a plane that is tilted about two axes, and grooves of 80° whose
other wall is of the same material or a mirror, with light that is reflected up to twice. The table of docs/light.md
holds the mean difference of the extracted rows of the direct stripe, and its standard error from the scatter of the
columns.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scancell import sensor as sensor_rt
from scancell.config.loading import assets_dir, load_setup
from scancell.config.material import PRESETS, Material
from scancell.config.sensor import sensor_json
from scancell.geometry import pose

from .scenes import FAITHFUL_DETECTOR
from .table import replace_paragraphs

Array = NDArray[np.float64]
Rows = dict[tuple[int, int], float]

PAGE = Path(__file__).resolve().parents[2] / "docs/light.md"
_COLUMNS = 48  # of a camera, at its middle
_REACH = 16  # rows on either side of the stripe
_EXPOSURE = 5e-4  # s
_FRAMES = 8  # of the fast mode, whose reflected light varies
_BRIGHTEST = 5e3  # electrons in a pixel of direct light: no stripe is saturated
_LEAN = np.radians(65.0), np.radians(15.0)  # of wall and other wall from the direction of the laser
# Reflected light distorts stripes; the extraction rejects many of them, and here all are compared.
_LENIENT = {"max_asymmetry": 1.0, "max_residual": 1.0, "max_sigma_px": 8.0, "min_run_columns": 1}
# `tests/sensor_rt/test_subsurface.py` compares light below surfaces, whose random walks take minutes for an image.
_OPAQUE = {name: material for name, material in PRESETS.items() if material.scattering_per_mm is None}
_MIRROR = Material(0.95, "mirror", 0.0, 1.0)


def narrow(description: dict[str, Any], number: int, rows: tuple[int, int] | None, **render: Any) -> sensor_rt.Sensor:
    """The sensor with one of its cameras, its middle columns, and some of its rows."""
    camera = description["cameras"][number]
    left, (first, last) = (camera["width_px"] - _COLUMNS) // 2, rows or (0, camera["height_px"])
    cut = {"width_px": _COLUMNS, "height_px": last - first}
    cut |= {"cx_px": camera["cx_px"] - left, "cy_px": camera["cy_px"] - first}
    return sensor_rt.Sensor(
        json.dumps(description | {"cameras": [camera | cut], "render": description["render"] | render})
    )


def scene_of(material: Material, other: Material | None, middle: float, size: float, side: float) -> sensor_rt.Scene:
    """A tilted plane at the range `middle`, m, or a groove of walls of `size`, the other one on a side of the sheet."""
    scene = sensor_rt.Scene()

    def add(name: str, m: Material, place: Array, length: float) -> None:
        native = sensor_rt.Material(m.reflectance, m.model, m.roughness, m.refractive_index)
        scene.add_plane(name, place, (size, length), native)

    if other is None:
        add("plane", material, pose.from_euler_xyz((0, 0, middle), (0.3, 0.2, 0)), size)
        return scene
    # The sheet, x = 0, meets the material; the bottom of the groove is beside it.
    bottom = np.array([side * size / 12, 0, middle + size / 12])
    for name, m, towards, lean in (("wall", material, -side, _LEAN[0]), ("other", other, side, _LEAN[1])):
        middle_of_wall = bottom + size / 2 * np.array([towards * np.sin(lean), 0, -np.cos(lean)])
        add(name, m, pose.from_euler_xyz(middle_of_wall, (0, towards * (np.pi / 2 - lean), 0)), 4 * size)
    return scene


def still(bodies: int, frames: int) -> sensor_rt.Exposures:
    """Exposures without motion, with random numbers of their own."""
    poses = np.broadcast_to(np.eye(4), (frames, bodies, 1, 4, 4))
    sensors = np.broadcast_to(np.eye(4), (frames, 1, 4, 4))
    return sensor_rt.Exposures(sensors, poses, np.full(frames, _EXPOSURE), np.arange(frames))


def rows_of(scene: sensor_rt.Scene, bodies: int, sensor: sensor_rt.Sensor, frames: int) -> Array:
    """Mean extracted row (columns,) over the frames; NaN where a frame has none."""
    found = sensor_rt.scan(scene, sensor, still(bodies, frames)).profiles
    rows = np.full((frames, _COLUMNS), np.nan)
    rows[found.frame, found.column] = found.row
    return np.asarray(rows.mean(0))


def compare(name: str, material: Material, other: Material | None, samples: int) -> Array:
    """Differences (n,) of rows, px, in the columns of all cameras that see the stripe."""
    setup = load_setup(sensor=assets_dir() / "sensors" / f"{name}.toml", settings=FAITHFUL_DETECTOR)
    description = sensor_json(setup.sensor, seed=0)
    description["extraction"] |= {"peak": "brightest", "fusion": "none"} | _LENIENT
    near, far = setup.sensor.range.near_mm, setup.sensor.range.far_mm
    side = -description["cameras"][0]["side"]  # where the first camera sees the other wall
    scene = scene_of(material, other, 5e-4 * (near + far), 1e-3 * (far - near), side)
    bodies, bounces = (1, 0) if other is None else (2, 2)
    away = []
    for number in range(len(description["cameras"])):
        direct = sensor_rt.expected_electrons(scene, narrow(description, number, None), still(bodies, 1))[0, 0]
        if not direct.any():
            continue
        peak = direct.max(1).argmax()
        rows = int(max(0, peak - _REACH)), int(min(len(direct), peak + _REACH + 1))
        scaled = description["laser"] | {"power": description["laser"]["power"] * _BRIGHTEST / float(direct.max())}
        lit = description | {"laser": scaled}
        fast = rows_of(scene, bodies, narrow(lit, number, rows, bounces=bounces), _FRAMES)
        paths = narrow(lit, number, rows, bounces=bounces, mode="path", samples_per_pixel=samples)
        away.append(fast - rows_of(scene, bodies, paths, 1))
    found = np.concatenate(away)
    return found[np.isfinite(found)]


def main() -> None:
    """Print the table, and write it into the page."""
    names = sorted(file.stem for file in (assets_dir() / "sensors").glob("*.toml"))
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--samples", type=int, default=1024, help="of a pixel in path tracing")
    parser.add_argument("--sensors", nargs="*", default=names)
    options = parser.parse_args()
    lines = [f"| sensor | scene | {' | '.join(name.replace('_', ' ') for name in _OPAQUE)} |"]
    lines.append("| --- | --- |" + " --- |" * len(_OPAQUE))
    for name in options.sensors:
        for scene in ("plane", "groove", "mirror"):
            cells = []
            for material in _OPAQUE.values():
                other = {"plane": None, "groove": material, "mirror": _MIRROR}[scene]
                away = 1e3 * compare(name, material, other, options.samples)
                enough = len(away) >= _COLUMNS // 4
                error = away.std(ddof=1) / np.sqrt(len(away)) if enough else np.nan
                cells.append(f"{away.mean():+.1f} ± {error:.1f}" if enough else "")
            lines.append(f"| {name} | {scene} | {' | '.join(cells)} |")
            print(lines[-1], flush=True)
    if options.sensors == names:
        replace_paragraphs(PAGE, {"| sensor | scene |": lines})


if __name__ == "__main__":
    main()
