"""Speed of the sensor: images, stripes, laser rays, and what the size of the mesh costs."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from functools import partial

import numpy as np

from scancell import sensor as sensor_rt

from .raw_embree import raw_times, turning_fans
from .scenes import PART_TRIANGLES, both_cameras, bumpy_part, make_sensor, part_on_table, turning_exposures
from .table import Row, processor_row
from .timing import Timing, measure, scaled

FRAMES = 32
PROFILES = 512
RAYS = 1024
LIMIT_PAIRS = 60.0
LIMIT_REFLECTED = 15.0
LIMIT_GEOMETRIC = 10_000.0
LIMIT_EXTRACTION_MS = 2.0
DENSE_STEPS = (10_000, 100_000, 1_000_000)
# Settings of a camera: point spread, and focus at both ends of the range, by the distance along the camera's axis.
LENSES = {
    "PSF 0.5 px": ("psf_sigma_px=0.5",),
    "PSF 1.0 px": ("psf_sigma_px=1.0",),
    "focus at 95 mm": ("focus_mm=95.0",),
    "focus at 173 mm": ("focus_mm=173.0",),
}
REFLECTED = ("sensor.render.bounces=2", "sensor.speckle.contrast=1.0")


def _ray_traced(scene: sensor_rt.Scene, threads: int, moving: bool = True, overrides: tuple[str, ...] = ()) -> Timing:
    sensor, exposures = make_sensor(overrides), turning_exposures(FRAMES, moving=moving)
    return measure(lambda: sensor_rt.scan(scene, sensor, exposures, threads=threads))


def _rate_row(name: str, timing: Timing, count: int, unit: str, limit: float, cores: int) -> Row:
    """What `cores` free cores do per second by the processor time it took, and what was done per second of wall time.

    The verdict is taken by processor time: the machine may be shared.
    """
    rate, peer = cores * count / timing.processor, f"limit on {cores} cores"
    return Row(name, rate, unit, peer, limit, timing.spread, "at least", 1.0, "processor", count / timing.best)


def image_rows() -> Iterator[Row]:
    """Pairs of images per second: rendered, made noisy, searched for the stripe, triangulated."""
    scene = part_on_table(PART_TRIANGLES)
    for moving, name in ((True, "ray-traced, moving, 2 threads"), (False, "ray-traced, still, 2 threads")):
        timing = _ray_traced(scene, 2, moving=moving)
        yield _rate_row(name, timing, FRAMES, "pairs/s", LIMIT_PAIRS, 2)


def reflected_rows() -> Iterator[Row]:
    """The same pairs with light that is reflected up to twice between surfaces, and speckle."""
    timing = _ray_traced(part_on_table(PART_TRIANGLES), 2, overrides=REFLECTED)
    yield _rate_row("two bounces and speckle, 2 threads", timing, FRAMES, "pairs/s", LIMIT_REFLECTED, 2)


def lens_rows() -> Iterator[Row]:
    """Lenses with point spread or defocus beside the same cameras as pinholes."""
    scene = part_on_table(PART_TRIANGLES)
    pinhole = scaled(_ray_traced(scene, 2), 1e3 / FRAMES)
    for name, settings in LENSES.items():
        timing = scaled(_ray_traced(scene, 2, overrides=both_cameras(*settings)), 1e3 / FRAMES)
        yield processor_row(f"lens, {name}", timing, "ms/pair", "pinholes", pinhole.processor, "at most", 1.25)


def station_rows() -> Iterator[Row]:
    """Time by station of the pipeline, on one thread; the ratio is the share of the whole."""
    scene, sensor, exposures = part_on_table(PART_TRIANGLES), make_sensor(), turning_exposures(FRAMES)
    runs = [sensor_rt.scan(scene, sensor, exposures, threads=1).timings for _ in range(3)]
    fastest = min(runs, key=lambda timings: sum(timings.values()))
    whole = sum(fastest.values())
    for station, seconds in fastest.items():
        if seconds > 0:
            yield Row(f"share: {station}", 1e3 * seconds / FRAMES, "ms/pair", "all stations", 1e3 * whole / FRAMES)


def single_station_rows() -> Iterator[Row]:
    """Detector and stripe search by themselves, per image on one core."""
    scene, sensor, exposures = part_on_table(PART_TRIANGLES), make_sensor(), turning_exposures(4)
    cameras = len(sensor.cameras)
    images = 4 * cameras
    electrons = sensor_rt.expected_electrons(scene, sensor, exposures)
    noisy = sensor_rt.render(scene, sensor, exposures)
    duration, index = np.full(4, 5e-4), np.arange(4)
    extraction = scaled(measure(lambda: sensor_rt.extract(noisy, sensor, threads=1)), 1e3 / images)
    yield processor_row("peak extraction", extraction, "ms/image", "limit per core", LIMIT_EXTRACTION_MS, "at most")
    detector = measure(lambda: sensor_rt.expose(electrons, sensor, duration, index, threads=1))
    per_image = scaled(detector, 1e3 / images)
    yield processor_row("detector, every pixel", per_image, "ms/image", "peak extraction", extraction.processor)


def geometric_rows() -> Iterator[Row]:
    """Profiles per second without images: laser rays, and both cameras' view of each landing point."""
    scene = part_on_table(PART_TRIANGLES)
    sensor, exposures = make_sensor([f"sensor.geometric.rays={RAYS}"]), turning_exposures(PROFILES)
    timing = measure(lambda: sensor_rt.scan(scene, sensor, exposures, engine="geometric", threads=2))
    name = f"geometric, {RAYS} rays, 2 threads"
    yield _rate_row(name, timing, PROFILES, "profiles/s", LIMIT_GEOMETRIC, 2)
    traced = _ray_traced(scene, 2)
    rate, peer = 2 * PROFILES / timing.processor, "our own ray-traced pairs/s"
    theirs = 2 * FRAMES / traced.processor
    wall = PROFILES / timing.best
    yield Row(name, rate, "profiles/s", peer, theirs, None, "at least", 100.0, "processor", wall)


def density_rows(largest: int) -> Iterator[Row]:
    """Time per profile and memory as the triangles of the part grow; the surface stays the same.

    Beside it stands what bare Embree takes for the rays of a profile: one from the laser and one from each camera per
    point.
    """
    sensor, moving, many = make_sensor(), turning_exposures(16), turning_exposures(PROFILES)
    fans = turning_fans(PROFILES)
    sizes = (*(n for n in DENSE_STEPS if n < largest), largest)
    first: dict[str, float] = {}
    for triangles in sizes:
        scene = part_on_table(triangles)
        traced = measure(partial(sensor_rt.scan, scene, sensor, moving), 3)
        cast = measure(partial(sensor_rt.scan, scene, sensor, many, engine="geometric"), 3)
        del scene
        yield _density_row("ray-traced", "ms/pair", triangles, scaled(traced, 1e3 / 16), first, True)
        yield _density_row("geometric", "us/profile", triangles, scaled(cast, 1e6 / PROFILES), first, False)
        raw = raw_times(*bumpy_part(triangles), fans, 3)
        if raw is not None:
            bare = Timing(raw.laser.best + raw.views.best, 0.0, raw.laser.processor + raw.views.processor)
            yield _density_row("bare Embree", "us/profile", triangles, scaled(bare, 1e6 / PROFILES), first, False)
    # In a process of its own: memory that was freed before would not be asked for again.
    command = [sys.executable, "-m", f"{__package__}.scene_memory", str(largest)]
    memory = int(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
    yield Row(f"memory, {largest:,} triangles", memory / 1e6, "MB", "its vertices and indices", largest * 24e-6)
    yield Row("memory per triangle", memory / largest, "B", "its vertices and indices", 24.0)


def _density_row(what: str, unit: str, triangles: int, timing: Timing, first: dict[str, float], limited: bool) -> Row:
    """Against the first size of the same name, which goes into `first`."""
    least = first.setdefault(what, timing.processor)
    name, peer = f"{what}, {triangles:,} triangles", f"{DENSE_STEPS[0]:,} triangles"
    return processor_row(name, timing, unit, peer, least, "at most" if limited else "", 2.0)
