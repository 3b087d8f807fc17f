"""Stripe centres and radiance of our images beside those of other renderers."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from scancell import sensor as sensor_rt

from ..scenes import FAITHFUL_DETECTOR, make_sensor, sensor_description, still_exposure
from ..timing import measure
from . import povray, scenes
from .check import Check
from .povray import Array

CENTRE_LIMIT_PX = 0.02
POVRAY_SPEED = 30.0
# The fast mode may err more in few columns, where an edge of light or of a facet crosses the stripe.
USUAL_SHARE = 0.995
# Columns that only one of two images yields a trusted peak for, of all: edges of shadows fall differently.
UNMATCHED_LIMIT = 0.01
_PAIRS = 32

SCENES: dict[str, tuple[scenes.Surface, ...]] = {
    "plane at 80 mm": (scenes.flat(0.080, 0.1, 0.0),),
    "plane at 160 mm": (scenes.flat(0.160, -0.1, 0.1),),
    "steep plane over the whole range": (scenes.flat(0.118, 1.19, 0.0),),
    "exact sphere before a plane": (scenes.small_ball(), scenes.flat(0.155, 0.0, 0.05)),
    "70 k triangles behind a block": (scenes.part(), scenes.shading_block()),
}


def povray_checks() -> Iterator[Check]:
    """Stripe centres in every scene and camera, then speed."""
    povray.require_povray()
    with tempfile.TemporaryDirectory(prefix="scancell-povray-") as name:
        folder = Path(name)
        offset = float(np.abs(povray.pixel_grid_offset(folder)).max())
        yield Check("pixel grid of POV-Ray against (i + 1/2)/n", offset, "px", 1e-3)
        for title, surfaces in SCENES.items():
            yield from _stripe_checks(title, surfaces, folder)
        yield from _speed_checks(SCENES["70 k triangles behind a block"], folder)


def own_electrons(surfaces: tuple[scenes.Surface, ...], sensor: sensor_rt.Sensor) -> Array:
    """Our electrons (cameras, height, width) over the default exposure."""
    exposure = still_exposure(len(surfaces), sensor.exposure)
    return np.asarray(sensor_rt.expected_electrons(scenes.build(surfaces), sensor, exposure)[0], float)


def _stripe_checks(title: str, surfaces: tuple[scenes.Surface, ...], folder: Path) -> Iterator[Check]:
    """Both programs with paths of 64 samples per pixel; then ours in its fast mode."""
    sensor, description = make_sensor(FAITHFUL_DETECTOR), sensor_description(FAITHFUL_DETECTOR)
    paths = ("sensor.render.mode=path", "sensor.render.samples_per_pixel=64")
    fine = own_electrons(surfaces, make_sensor((*FAITHFUL_DETECTOR, *paths)))
    ours = own_electrons(surfaces, sensor)
    theirs = np.stack([povray.stripe_electrons(description, k, surfaces, folder)[0] for k in range(len(ours))])
    rows = _trusted_rows(np.stack([fine, ours, theirs]), sensor)
    for camera in range(len(ours)):
        label = f"{title}, camera {camera + 1}"
        yield from _centre_checks(label, rows[:, camera])
        light = abs(theirs[camera].sum() / ours[camera].sum() - 1.0)
        yield Check(f"{label}: light of the whole image", float(light), "", 0.01)


def _centre_checks(label: str, rows: Array) -> Iterator[Check]:
    """Rows (3, width): ours by paths, ours in the fast mode, POV-Ray's."""
    fine, default = np.abs(rows[:2] - rows[2])
    both = np.isfinite(fine)
    span = f"rows {np.nanmin(rows[2]):.0f}-{np.nanmax(rows[2]):.0f}"
    yield Check(f"{label}: centres, {span}, largest", float(np.nanmax(fine)), "px", CENTRE_LIMIT_PX)
    usual = float(np.nanquantile(default, USUAL_SHARE))
    yield Check(f"{label}: centres, fast mode, {100 * USUAL_SHARE:g} %", usual, "px", CENTRE_LIMIT_PX)
    either = np.isfinite(rows[0]) | np.isfinite(rows[2])
    unmatched = float(1.0 - both.sum() / max(1, either.sum()))
    yield Check(f"{label}: columns trusted in one image only", unmatched, "", UNMATCHED_LIMIT)


def _trusted_rows(electrons: Array, sensor: sensor_rt.Sensor) -> Array:
    """Stripe rows (images, cameras, width) of images (images, cameras, height, width), NaN where none is trusted."""
    count = len(electrons)
    duration = np.full(count, sensor.exposure)
    images = sensor_rt.expose(electrons.astype(np.float32), sensor, duration, np.arange(count))
    peaks = sensor_rt.extract(images, sensor)
    trusted = (peaks.flags & sensor_rt.PEAK_REJECTED) == 0
    rows = np.full((count, electrons.shape[1], electrons.shape[3]), np.nan)
    rows[peaks.frame[trusted], peaks.camera[trusted], peaks.column[trusted]] = peaks.row[trusted]
    return rows


def own_pair_seconds(surfaces: tuple[scenes.Surface, ...]) -> float:
    """Our time for a pair of images of the default sensor, noise, stripe search and triangulation included."""
    sensor, scene = make_sensor(), scenes.build(surfaces)
    world_from_body = np.broadcast_to(np.eye(4), (_PAIRS, len(surfaces), 1, 4, 4))
    world_from_sensor = np.broadcast_to(np.eye(4), (_PAIRS, 1, 4, 4))
    duration = np.full(_PAIRS, sensor.exposure)
    exposures = sensor_rt.Exposures(world_from_sensor, world_from_body, duration, np.arange(_PAIRS))
    return measure(lambda: sensor_rt.scan(scene, sensor, exposures), 3).best / _PAIRS


def _speed_checks(surfaces: tuple[scenes.Surface, ...], folder: Path) -> Iterator[Check]:
    description = sensor_description()
    ours = own_pair_seconds(surfaces)
    for how, antialias in (
        ("16 samples in every pixel", povray.EVERY_PIXEL),
        ("anti-aliasing at its default threshold", povray.DEFAULT_THRESHOLD),
    ):
        theirs = sum(povray.stripe_electrons(description, k, surfaces, folder, antialias)[1] for k in range(2))
        name = f"POV-Ray's trace time ({theirs:.2f} s, {how}) over ours ({1e3 * ours:.1f} ms)"
        yield Check(name, theirs / ours, "x", POVRAY_SPEED, at_least=True)
