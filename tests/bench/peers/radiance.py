"""Mitsuba 3 as a second opinion on brightness: the laser as a projector of light, the cameras as cameras.

Mitsuba projects a picture of the sheet from the laser's source. A projector's light spreads with distance, and so the
sheet compared is one whose width does too (waist in the source); everything else is the default sensor. Direct light
from a projector is not random: only the places of the samples within a pixel are.
"""

from __future__ import annotations

import importlib
import importlib.util
import json
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scancell import sensor as sensor_rt
from scancell.geometry import pose

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

# Near the mirror direction of a camera, where single scattering outweighs what Mitsuba's metal lacks: light that is
# reflected several times between microfacets.
_TURNED = pose.from_euler_xyz((0.0, 0.0, 0.110), (0.0, 0.23, 0.0))
_GROOVED_LIMIT = 0.01
_GROOVED: dict[str, scenes.Flat] = {
    "grooves across the laser line": scenes.Flat(_TURNED, grooves=(0.06, 0.15)),
    "grooves along the laser line": scenes.Flat(_TURNED, grooves=(0.15, 0.06)),
}
# A medium without refraction, which a connection to the projector could not cross in Mitsuba, in the few pixels in the
# middle of camera 1 that random walks permit.
_MEDIUM = sensor_rt.Material(0.4, "rough_dielectric", 0.5, 1.0, scattering=5e3)
_MEDIUM_SAMPLES = 1024
_MEDIUM_LIMIT, _MEDIUM_ROWS_PX = 0.02, 0.3

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
    for title, flat in _GROOVED.items():
        yield from _grooved_checks(mitsuba, title, flat, projector, description)
    yield from _medium_checks(mitsuba, description)
    yield _speed_check(mitsuba, projector, description)


def _grooved_checks(
    mitsuba: Any, title: str, flat: scenes.Flat, projector: dict[str, Any], description: dict[str, Any]
) -> Iterator[Check]:
    """Radiance of the stripe on grooved metal in the camera that sees its highlight."""
    electrons = own_electrons((flat,), make_sensor(_PROJECTIVE_SHEET))
    totals = electrons.sum((1, 2))
    number = int(np.argmax(totals))
    camera = description["cameras"][number]
    ours = electrons[number] / electrons_per_radiance(description, camera)
    theirs, _ = _render(mitsuba, [projector, *_surfaces(mitsuba, (flat,)), _camera(mitsuba, camera)], _SAMPLES)
    mine, other = ours.sum(0), theirs.sum(0)
    bright = other > 0.5 * other.max()
    gap = float(np.abs(mine[bright] / other[bright] - 1.0).max())
    yield Check(f"{title}: radiance of the highlight, {bright.sum()} columns, worst", gap, "", _GROOVED_LIMIT)


def _medium_checks(mitsuba: Any, description: dict[str, Any]) -> Iterator[Check]:
    """Light from below a surface: our random walks against those of Mitsuba, total and quantiles of the rows."""
    whole = description["cameras"][0]
    cut = {"width_px": 32, "height_px": 256, "cx_px": 15.5, "cy_px": 127.5}
    face = whole["height"] + whole["baseline"] / np.tan(whole["tilt"])  # in the middle of the image
    reach = np.array([0.03, 0.03, 0.03])
    block = scenes.Block(np.array([-0.03, -0.03, face]), np.array([0.03, 0.03, face]) + reach, _MEDIUM)
    paths = {"mode": "path", "samples_per_pixel": _MEDIUM_SAMPLES}
    narrow = description | {"cameras": [whole | cut], "render": description["render"] | paths}
    sensor = sensor_rt.Sensor(json.dumps(narrow))
    ours = own_electrons((block,), sensor)[0] / electrons_per_radiance(narrow, whole | cut)
    # In mm: Mitsuba's rays start a fixed distance above surfaces, which in metres is that of a free path.
    (cube,) = _surfaces(mitsuba, (block,))
    cube["interior"]["sigma_t"] *= 1e-3
    cube["to_world"] = _in_mm(mitsuba, cube["to_world"], scale=1e3)
    others = (_projector(mitsuba, description, 1e6), _camera(mitsuba, whole | cut))  # W/m² at 1 mm
    entries = [cube, *(other | {"to_world": _in_mm(mitsuba, other["to_world"])} for other in others)]
    theirs, _ = _render(mitsuba, entries, _MEDIUM_SAMPLES, "volpath")
    profiles = np.stack([ours.sum(1), theirs.sum(1)])
    totals = profiles.sum(1)
    label = "light below a surface"
    yield Check(f"{label}: of the whole image", abs(float(totals[0] / totals[1]) - 1.0), "", _MEDIUM_LIMIT)
    shares = np.cumsum(profiles, 1) / totals[:, None]
    quantiles = [np.interp((0.1, 0.3, 0.5, 0.7, 0.9), share, np.arange(len(share))) for share in shares]
    apart = float(np.abs(quantiles[0] - quantiles[1]).max())
    yield Check(f"{label}: rows at 10 to 90 % of the light, worst", apart, "px", _MEDIUM_ROWS_PX)


def _speed_check(mitsuba: Any, projector: dict[str, Any], description: dict[str, Any]) -> Check:
    surfaces = SCENES["70 k triangles behind a block"]
    bodies = _surfaces(mitsuba, surfaces)
    theirs = sum(
        _render(mitsuba, [projector, *bodies, _camera(mitsuba, camera)], 16)[1] for camera in description["cameras"]
    )
    ours = own_pair_seconds(surfaces)
    name = f"Mitsuba scalar, 16 samples ({theirs:.2f} s), over ours ({1e3 * ours:.1f} ms)"
    return Check(name, theirs / ours, "x", MITSUBA_SPEED, at_least=True)


def _in_mm(mitsuba: Any, pose_in_m: Any, scale: float = 1.0) -> Any:
    """A pose, and with `scale` the size of a body, in mm."""
    matrix = np.array(pose_in_m.matrix, float).reshape(4, 4)
    matrix[:3, :3] *= scale
    matrix[:3, 3] *= 1e3
    return mitsuba.ScalarTransform4f(matrix)


def _render(
    mitsuba: Any, entries: list[dict[str, Any]], samples: int, integrator: str = "direct"
) -> tuple[Array, float]:
    """Radiance (height, width), W/m²/sr, and the seconds that the rendering took."""
    contents = {f"entry{number}": entry for number, entry in enumerate(entries)}
    scene = mitsuba.load_dict({"type": "scene", "integrator": {"type": integrator}, **contents})
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


def _projector(mitsuba: Any, description: dict[str, Any], scale: float = 1.0) -> dict[str, Any]:
    """The laser, times `scale`. The unit of a projector's picture is measured on a white plane, not taken on trust."""
    picture, view = _sheet_picture(description)
    unit = _projector_unit(mitsuba)
    source = np.eye(4)
    source[2, 3] = description["laser"]["source_z"]
    return _projector_entry(mitsuba, scale * picture / unit, view, source)


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
        if surface.grooves is not None:
            along, across = surface.grooves
            metal = {"type": "roughconductor", "material": "none", "distribution": "ggx"}
            bsdf = {"type": "twosided", "inner": metal | {"alpha_u": along, "alpha_v": across}}
        half = surface.size / 2
        pose = surface.sensor_from_flat @ np.diag([half, half, 1.0, 1.0])
        return {"type": "rectangle", "to_world": mitsuba.ScalarTransform4f(pose), "bsdf": bsdf}
    if isinstance(surface, scenes.Block):
        place = np.diag([*(surface.upper - surface.lower) / 2, 1.0])
        place[:3, 3] = (surface.lower + surface.upper) / 2
        cube = {"type": "cube", "to_world": mitsuba.ScalarTransform4f(place)}
        if surface.medium is None:
            return cube | {"bsdf": bsdf}
        albedo = surface.medium.scattering_albedo
        medium = {"type": "homogeneous", "albedo": albedo, "sigma_t": surface.medium.scattering / albedo}
        return cube | {"bsdf": {"type": "null"}, "interior": medium}
    properties = mitsuba.Properties()
    properties["bsdf"] = mitsuba.load_dict(bsdf)
    properties["face_normals"] = True
    mesh = mitsuba.Mesh("part", len(surface.vertices), len(surface.faces), props=properties)
    parameters = mitsuba.traverse(mesh)
    parameters["vertex_positions"] = surface.vertices.astype(np.float32).ravel()
    parameters["faces"] = surface.faces.ravel()
    parameters.update()
    return mesh
