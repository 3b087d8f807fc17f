"""Mitsuba 3 as a second opinion on brightness: the laser as a projector of light, the cameras as cameras.

Mitsuba projects a picture of the sheet from the laser's source. A projector's light spreads with distance, and so the
sheet compared is one whose width does too (waist in the source); everything else is the default sensor. Direct light
from a projector is not random: only the places of the samples within a pixel are.
"""

from __future__ import annotations

import importlib
import importlib.util
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..scenes import FAITHFUL_DETECTOR, make_sensor, sensor_description
from . import scenes
from .check import Check, PeerMissingError
from .radiometry import camera_axes, electrons_per_radiance
from .stripes import SCENES, own_electrons, own_pair_seconds

Array = NDArray[np.float64]

RADIANCE_LIMIT = 0.01
MITSUBA_SPEED = 150.0
_SPREAD = 5e-4
_PROJECTIVE_SHEET = (
    *FAITHFUL_DETECTOR,
    "sensor.laser.waist_z_mm=0.0",
    "sensor.laser.sheet_sigma_mm=1e-6",
    f"sensor.laser.divergence_mrad={1e3 * _SPREAD}",
    "sensor.render.samples_per_pixel=64",
)
# Texels per standard deviation of the sheet: linear interpolation then errs by 1/(8 · 16²) of the peak.
_TEXELS = 16
_REACH = 6.0
_SAMPLES = 64
# Columns darker than this share of the brightest lie at edges of light.
_BRIGHT = 0.05

_RADIANCE_SCENES: dict[str, tuple[scenes.Surface, ...]] = {
    "tilted plane": (scenes.flat(0.120, 0.3, 0.2),),
    "sphere": (scenes.Ball(np.array([0.001, 0.002, 0.15]), 0.035),),
}


def mitsuba_checks() -> Iterator[Check]:
    """Radiance summed over each column's stripe, then speed."""
    if importlib.util.find_spec("mitsuba") is None:
        raise PeerMissingError("Mitsuba is not installed: pip install mitsuba")
    mitsuba = importlib.import_module("mitsuba")
    mitsuba.set_variant("scalar_rgb")
    description = sensor_description(_PROJECTIVE_SHEET)
    projector = _projector(mitsuba, description)
    for title, surfaces in _RADIANCE_SCENES.items():
        electrons = own_electrons(surfaces, make_sensor(_PROJECTIVE_SHEET))
        for number, camera in enumerate(description["cameras"]):
            ours = electrons[number] / electrons_per_radiance(description, camera)
            theirs, _ = _render(mitsuba, [projector, *_surfaces(mitsuba, surfaces), _camera(mitsuba, camera)], _SAMPLES)
            mine, other = ours.sum(0), theirs.sum(0)
            bright = other > _BRIGHT * other.max()
            gap = np.abs(mine / np.where(bright, other, 1.0) - 1.0)[bright]
            label = f"{title}, camera {number + 1}: radiance"
            yield Check(f"{label} of the stripe, {bright.sum()} columns, worst", float(gap.max()), "", RADIANCE_LIMIT)
            whole = abs(float(mine.sum() / other.sum()) - 1.0)
            yield Check(f"{label} of the whole image", whole, "", RADIANCE_LIMIT)
    yield _speed_check(mitsuba, projector, description)


def _speed_check(mitsuba: Any, projector: dict[str, Any], description: dict[str, Any]) -> Check:
    surfaces = SCENES["70 k triangles behind a block"]
    bodies = _surfaces(mitsuba, surfaces)
    theirs = sum(
        _render(mitsuba, [projector, *bodies, _camera(mitsuba, camera)], 16)[1] for camera in description["cameras"]
    )
    ours = own_pair_seconds(surfaces)
    name = f"Mitsuba scalar, 16 samples ({theirs:.2f} s), over ours ({1e3 * ours:.1f} ms)"
    return Check(name, theirs / ours, "x", MITSUBA_SPEED, at_least=True)


def _render(mitsuba: Any, entries: list[dict[str, Any]], samples: int) -> tuple[Array, float]:
    """Radiance (height, width), W/m²/sr, and the seconds that the rendering took."""
    contents = {f"entry{number}": entry for number, entry in enumerate(entries)}
    scene = mitsuba.load_dict({"type": "scene", "integrator": {"type": "direct"}, **contents})
    start = time.perf_counter()
    image = np.array(mitsuba.render(scene, spp=samples, seed=1), float)[..., 0]
    return image, time.perf_counter() - start


def _sheet_picture(description: dict[str, Any]) -> tuple[Array, float]:
    """Irradiance at distance 1 m on a plane across the laser's axis, and the picture's full angle of view across x.

    Per steradian the sheet carries what `power / (2 fan_half_angle)` per radian of fan and a Gaussian of width
    `spread * z` make at the plane; the plane's tilt to the ray is part of it.
    """
    laser = description["laser"]
    texel = _SPREAD / _TEXELS
    across = texel * (np.arange(2 * round(_REACH * _TEXELS)) - round(_REACH * _TEXELS) + 0.5)
    half = int(np.tan(laser["fan_half_angle"]) / texel)
    along = texel * (np.arange(2 * half) - half + 0.5)[:, None]
    gauss = np.exp(-0.5 * (across / _SPREAD) ** 2) / (np.sqrt(2 * np.pi) * _SPREAD)
    per_metre = laser["power"] / (2 * laser["fan_half_angle"]) / np.hypot(along, 1.0)
    facing = 1.0 / np.sqrt(1.0 + across**2 + along**2)
    return per_metre * gauss * facing, 2 * np.degrees(np.arctan(len(across) / 2 * texel))


def _projector(mitsuba: Any, description: dict[str, Any]) -> dict[str, Any]:
    """The laser. The unit of a projector's picture is measured on a white plane instead of taken on trust."""
    picture, view = _sheet_picture(description)
    unit = _projector_unit(mitsuba)
    source = np.eye(4)
    source[2, 3] = description["laser"]["source_z"]
    return _projector_entry(mitsuba, picture / unit, view, source)


def _projector_entry(mitsuba: Any, picture: Array, view: float, sensor_from_source: Array) -> dict[str, Any]:
    bitmap = mitsuba.Bitmap(np.repeat(picture[..., None], 3, -1).astype(np.float32))
    texture = {"type": "bitmap", "bitmap": bitmap, "raw": True, "wrap_mode": "clamp"}
    pose = mitsuba.ScalarTransform4f(sensor_from_source)
    return {"type": "projector", "irradiance": texture, "fov": view, "fov_axis": "x", "to_world": pose}


def _projector_unit(mitsuba: Any) -> float:
    """Irradiance (W/m²) that a picture of ones makes at 1 m: pi times the radiance of a white plane there."""
    projector = _projector_entry(mitsuba, np.ones((16, 16)), 40.0, np.eye(4))
    plane = scenes.flat(1.0, 0.0, 0.0)
    view = {"side": 1, "tilt": 0.0, "baseline": 0.0, "height": 0.0, "width_px": 16, "height_px": 16}
    view |= {"focal_px": 200.0, "cx_px": 7.5, "cy_px": 7.5}
    image, _ = _render(mitsuba, [projector, *_surfaces(mitsuba, (plane,)), _camera(mitsuba, view)], 16)
    return float(np.pi * image.mean())


def _camera(mitsuba: Any, camera: dict[str, Any]) -> dict[str, Any]:
    """Pinhole camera; Mitsuba's local x points to the left of the image, y up."""
    width, height = camera["width_px"], camera["height_px"]
    if (camera["cx_px"], camera["cy_px"]) != ((width - 1) / 2, (height - 1) / 2):
        raise ValueError("this comparison wants a principal point in the middle of the image")
    pose = np.eye(4)
    pose[:3, :3] = camera_axes(camera) * [-1.0, -1.0, 1.0]
    pose[:3, 3] = camera["side"] * camera["baseline"], 0.0, camera["height"]
    film = {"type": "hdrfilm", "width": width, "height": height, "rfilter": {"type": "box"}}
    film |= {"pixel_format": "luminance", "component_format": "float32"}
    return {
        "type": "perspective",
        "fov": 2 * float(np.degrees(np.arctan(width / (2 * camera["focal_px"])))),
        "fov_axis": "x",
        "near_clip": 1e-3,
        "to_world": mitsuba.ScalarTransform4f(pose),
        "film": film,
        "sampler": {"type": "multijitter"},
    }


def _surfaces(mitsuba: Any, surfaces: tuple[scenes.Surface, ...]) -> list[dict[str, Any]]:
    white = {"type": "twosided", "inner": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 1.0}}}
    return [_surface(mitsuba, surface, white) for surface in surfaces]


def _surface(mitsuba: Any, surface: scenes.Surface, bsdf: dict[str, Any]) -> Any:
    if isinstance(surface, scenes.Ball):
        return {"type": "sphere", "center": surface.centre.tolist(), "radius": surface.radius, "bsdf": bsdf}
    if isinstance(surface, scenes.Flat):
        half = surface.size / 2
        pose = surface.sensor_from_flat @ np.diag([half, half, 1.0, 1.0])
        return {"type": "rectangle", "to_world": mitsuba.ScalarTransform4f(pose), "bsdf": bsdf}
    if isinstance(surface, scenes.Block):
        pose = np.diag([*(surface.upper - surface.lower) / 2, 1.0])
        pose[:3, 3] = (surface.lower + surface.upper) / 2
        return {"type": "cube", "to_world": mitsuba.ScalarTransform4f(pose), "bsdf": bsdf}
    properties = mitsuba.Properties()
    properties["bsdf"] = mitsuba.load_dict(bsdf)
    properties["face_normals"] = True
    mesh = mitsuba.Mesh("part", len(surface.vertices), len(surface.faces), props=properties)
    parameters = mitsuba.traverse(mesh)
    parameters["vertex_positions"] = surface.vertices.astype(np.float32).ravel()
    parameters["faces"] = surface.faces.ravel()
    parameters.update()
    return mesh
