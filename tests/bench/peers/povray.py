"""POV-Ray as a second renderer of the sensor's images.

POV-Ray traces, shades by Lambert's law and casts shadows from a point light at the laser's source. What the light
lacks, the sheet's Gaussian profile and the fall of brightness along the fan, is a pigment of world coordinates; the
lens, cos⁴ and the electrons per watt come from `radiometry`. Nothing of ours is used but the description.

Conventions: POV-Ray's image plane spans `right` and `up`; the middle of pixel i of n lies at (i + 1/2)/n of it (checked
by `pixel_grid_offset` on every run), which is our integer pixel. Its anti-aliasing (method 1, no jitter) averages n x n
point samples, linear in brightness, as all gammas are 1; n = 8 for comparisons, because 4 x 4 samples see only four
heights of a stripe and move its centre by up to 0.05 px where facets meet. Lengths are in mm.
"""

from __future__ import annotations

import re
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from .check import PeerMissingError
from .radiometry import camera_axes, electrons_per_radiance
from .scenes import Ball, Block, Flat, Surface

Array = NDArray[np.float64]

_MM = 1e3
# 64 samples in every pixel that differs at all from a neighbour: darkness needs one.
FINE = ("+A0.00001", "+R8")
# 16 samples in every pixel, as many as ours where there is light.
EVERY_PIXEL = ("+A0.0", "+R4")
# What POV-Ray does when nothing more is said: 16 samples where neighbours differ by 0.3.
DEFAULT_THRESHOLD = ("+A0.3", "+R4")


@dataclass(frozen=True)
class Picture:
    """Grey values 0..1 (height, width) and the seconds that tracing them took."""

    grey: Array
    trace_seconds: float


def require_povray() -> None:
    """Raise `PeerMissingError` when the command is not there."""
    if shutil.which("povray") is None:
        raise PeerMissingError("POV-Ray is not installed: apt-get install povray")


def run(source: str, size: tuple[int, int], folder: Path, antialias: tuple[str, str] = FINE) -> Picture:
    """Render `source` as a linear 16-bit grey image of `size` (width, height) on all cores."""
    (folder / "scene.pov").write_text(source)
    command = ["povray", "+Iscene.pov", "+Oimage.png", f"+W{size[0]}", f"+H{size[1]}", *antialias, "+AM1", "-J"]
    command += ["+FN16", "-D", "-V", "-GA", "+GSstatistics.txt"]
    command += ["File_Gamma=1.0", "Antialias_Gamma=1.0", "Grayscale_Output=on"]
    result = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    if result.returncode:
        raise RuntimeError(f"povray: {result.stderr[-2000:]}")
    image = cv2.imread(str(folder / "image.png"), cv2.IMREAD_UNCHANGED)
    if image is None or image.dtype != np.uint16:
        raise RuntimeError("povray wrote no 16-bit image")
    grey = image if image.ndim == 2 else image[..., 0]
    found = re.search(r"Trace Time:.*\(([\d.]+) seconds\)", (folder / "statistics.txt").read_text())
    if found is None:
        raise RuntimeError("povray told no trace time")
    return Picture(np.asarray(grey, float) / 65535, float(found.group(1)))


def pixel_grid_offset(folder: Path) -> Array:
    """(2,) px by which POV-Ray's pixel grid is shifted (columns, rows) against the convention above."""
    offsets = []
    for axis, expression in ((1, "x+0.5"), (0, "0.5-y")):
        source = f"""#version 3.7;
global_settings {{ assumed_gamma 1.0 }}
camera {{ perspective location <0,0,0> direction <0,0,1> right <1,0,0> up <0,1,0> }}
plane {{ z, 1 pigment {{ function {{ {expression} }} color_map {{ [0 rgb 0] [1 rgb 1] }} }}
  finish {{ ambient 0 diffuse 0 emission 1 }} }}
"""
        grey = run(source, (64, 64), folder).grey.mean(1 - axis)
        offsets.append(float((64 * grey - 0.5 - np.arange(64)).mean()))
    return np.array(offsets)


def stripe_electrons(
    description: dict[str, Any],
    number: int,
    surfaces: tuple[Surface, ...],
    folder: Path,
    antialias: tuple[str, str] = FINE,
) -> tuple[Array, float]:
    """Electrons (height, width) that camera `number` collects, and POV-Ray's trace time."""
    camera, laser = description["cameras"][number], description["laser"]
    # Brightest where the sheet is thinnest and nearest; POV-Ray's numbers must stay below 1.
    scale = 0.95 * laser["sheet_sigma"] * (description["range"]["near"] - laser["source_z"]) * 0.9
    source = _HEADER + _light(laser, scale) + _camera(camera) + "\n".join(_shape(surface) for surface in surfaces)
    picture = run(source, (camera["width_px"], camera["height_px"]), folder, antialias)
    if picture.grey.max() >= 1.0:
        raise RuntimeError("the comparison image is overexposed")
    power_per_metre = laser["power"] / (2 * laser["fan_half_angle"]) / np.sqrt(2 * np.pi)
    radiance = picture.grey / scale * power_per_metre / np.pi
    return radiance * electrons_per_radiance(description, camera), picture.trace_seconds


_HEADER = "#version 3.7;\nglobal_settings { assumed_gamma 1.0 ambient_light 0 }\n"


def _vector(values: Any) -> str:
    return "<" + ",".join(f"{value:.12g}" for value in np.asarray(values, float)) + ">"


def _light(laser: dict[str, Any], scale: float) -> str:
    """Point light at the source; irradiance of the sheet as pigment: 1/(r sigma) exp(-x²/2 sigma²), times `scale`."""
    tangent = np.tan(laser["fan_half_angle"])
    source, waist = laser["source_z"] * _MM, laser["waist_z"] * _MM
    return f"""
#declare Sigma = function(z) {{
  sqrt({(laser["sheet_sigma"] * _MM) ** 2:.12g} + pow({laser["divergence"]:.12g} * (z - ({waist:.12g})), 2)) }}
#declare Sheet = function(x, y, z) {{ select({tangent:.12g} * (z - ({source:.12g})) - abs(y), 0,
  {scale * _MM**2:.12g} / (sqrt(y*y + pow(z - ({source:.12g}), 2)) * Sigma(z)) * exp(-0.5 * pow(x / Sigma(z), 2))) }}
light_source {{ <0, 0, {source:.12g}> rgb 1 }}
#default {{ texture {{
  pigment {{ function {{ Sheet(x, y, z) }} color_map {{ [0 rgb 0] [1 rgb 1] }} }} finish {{ ambient 0 diffuse 1 }} }} }}
"""


def _camera(camera: dict[str, Any]) -> str:
    """Pinhole camera; explicit vectors leave no room for POV-Ray's left-handed habits."""
    right, down, forward = camera_axes(camera).T
    width, height, focal = camera["width_px"], camera["height_px"], camera["focal_px"]
    off_axis = ((width - 1) / 2 - camera["cx_px"]) * right + ((height - 1) / 2 - camera["cy_px"]) * down
    centre = np.array([camera["side"] * camera["baseline"], 0.0, camera["height"]])
    return f"""
camera {{ perspective location {_vector(centre * _MM)} direction {_vector(forward + off_axis / focal)}
  right {_vector(right * width / focal)} up {_vector(-down * height / focal)} }}
"""


def _shape(surface: Surface) -> str:
    if isinstance(surface, Ball):
        return f"sphere {{ {_vector(surface.centre * _MM)}, {surface.radius * _MM:.12g} }}"
    if isinstance(surface, Block):
        return f"box {{ {_vector(surface.lower * _MM)}, {_vector(surface.upper * _MM)} }}"
    if isinstance(surface, Flat):
        normal = surface.sensor_from_flat[:3, 2]
        return f"plane {{ {_vector(normal)}, {normal @ surface.sensor_from_flat[:3, 3] * _MM:.12g} }}"
    vertices = ",".join(_vector(vertex) for vertex in surface.vertices * _MM)
    faces = ",".join(f"<{a},{b},{c}>" for a, b, c in surface.faces)
    return (
        f"mesh2 {{ vertex_vectors {{ {len(surface.vertices)}, {vertices} }}"
        f" face_indices {{ {len(surface.faces)}, {faces} }} }}"
    )
