"""`PYTHONPATH=tests python -m bench.translucent`: points on translucent planes, for docs/light.md."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scancell import sensor as sensor_rt
from scancell.config.material import PRESETS, Material
from scancell.geometry import pose
from scancell.scanning.world import native_material

from .scenes import make_sensor
from .table import cpu_model, replace_paragraphs

Array = NDArray[np.float64]

PAGE = Path(__file__).resolve().parents[2] / "docs/light.md"
FACE, THICKNESS = 0.12, 0.06  # m: range of the plane, and thickness of the block
LENIENT = ("sensor.extraction.max_residual=0.3", "sensor.extraction.max_asymmetry=0.3")
FULL = 0.6  # of the digital range, of the brightest pixel
TILTS = (0.0, 30.0)  # deg about the laser line
MARBLE = PRESETS["marble"]
MEDIA: dict[str, tuple[Material, tuple[str, ...]]] = {
    "marble (2.19/mm)": (MARBLE, ()),
    "marble, speckle of contrast 0.6": (MARBLE, ("sensor.speckle.contrast=0.6",)),
    "1/mm": (replace(MARBLE, scattering_per_mm=1.0), ()),
    "5/mm": (replace(MARBLE, scattering_per_mm=5.0), ()),
    "20/mm": (replace(MARBLE, scattering_per_mm=20.0), ()),
    "opaque": (replace(MARBLE, scattering_per_mm=None), ()),
}


def still(duration: float) -> sensor_rt.Exposures:
    """An exposure without motion, s."""
    at_rest = np.broadcast_to(np.eye(4), (1, 1, 4, 4))
    return sensor_rt.Exposures(at_rest, at_rest[None], np.array([duration]), np.arange(1))


def row(name: str, material: Material, settings: tuple[str, ...], tilt_deg: float) -> str:
    """A row of the table."""
    scene = sensor_rt.Scene()
    tilt = np.radians(tilt_deg)
    middle = FACE + THICKNESS / 2 / np.cos(tilt)
    place = pose.from_euler_xyz((0, 0, middle), (0, tilt, 0))
    scene.add_box("block", place, np.array([0.2, 0.2, THICKNESS]), native_material(material))
    probe = make_sensor((*LENIENT, *settings))
    brightest = float(sensor_rt.expected_electrons(scene, probe, still(1e-3)).max())
    duration = FULL * 11_000.0 / brightest * 1e-3
    peaks = sensor_rt.extract(sensor_rt.render(scene, probe, still(duration)), probe)
    points = sensor_rt.triangulate(peaks, probe)
    below = np.asarray(points.points_in_sensor)[:, 2] - FACE  # in the plane X = 0, at any tilt
    one = np.asarray(points.camera) == 0
    noise = float(np.std(np.diff(below[one]))) / np.sqrt(2.0)
    values = (1e3 * duration, 100 * len(below) / len(peaks.row), 1e6 * below.mean(), 1e6 * noise)
    stated = 1e6 * float(np.mean(np.asarray(points.sigma)))
    cells = f"{values[0]:.2f} | {values[1]:.0f} | {values[2]:.1f} | {values[3]:.1f} | {stated:.1f}"
    return f"| {name} | {tilt_deg:.0f} | {cells} |"


def main() -> None:
    """Measure all media, and write the table."""
    lines = [
        "| medium | turned, ° | exposure, ms | found, % | below the surface, µm | noise, µm | stated, µm |",
        "|---|---|---|---|---|---|---|",
    ]
    for name, (material, settings) in MEDIA.items():
        for tilt in TILTS:
            lines.append(row(name, material, settings, tilt))
            print(lines[-1], flush=True)
    text = (
        "Points on a plane at 120 mm, default probe with wider limits of `max_residual` and `max_asymmetry` (0.3);",
        f"exposures for equally bright stripes ({cpu_model()}; `python -m bench.translucent`).",
    )
    replace_paragraphs(PAGE, {"| medium | turned": lines, "Points on a plane at 120 mm": text})


if __name__ == "__main__":
    main()
