"""Speed of the sensor: images, stripes, laser rays, and what the size of the mesh costs."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from functools import partial

import numpy as np

import sensor_rt

from .scenes import PART_TRIANGLES, make_sensor, part_on_table, turning_exposures
from .table import Row, Wanted
from .timing import Timing, measure

FRAMES = 32
PROFILES = 512
RAYS = 1024
LIMIT_PAIRS = 60.0
LIMIT_REFLECTED = 15.0
LIMIT_GEOMETRIC = 25_000.0
LIMIT_EXTRACTION_MS = 2.0
DENSE_STEPS = (10_000, 100_000, 1_000_000)


REFLECTED = ("sensor.render.bounces=2", "sensor.speckle.contrast=1.0")


def _ray_traced(scene: sensor_rt.Scene, threads: int, moving: bool = True, overrides: tuple[str, ...] = ()) -> Timing:
    sensor, exposures = make_sensor(overrides), turning_exposures(FRAMES, moving=moving)
    return measure(lambda: sensor_rt.scan(scene, sensor, exposures, threads=threads))


def image_rows() -> Iterator[Row]:
    """Pairs of images per second: rendered, made noisy, searched for the stripe, triangulated."""
    scene = part_on_table(PART_TRIANGLES)
    cores = len(os.sched_getaffinity(0))
    for threads in sorted({1, min(2, cores)}):
        timing = _ray_traced(scene, threads)
        wanted: Wanted = "at least" if threads == 2 else ""
        name = f"ray-traced, moving, {threads} thread{'s'[: threads - 1]}"
        yield Row(name, FRAMES / timing.best, "pairs/s", "limit on 2 threads", LIMIT_PAIRS, timing.spread, wanted)
        if threads == 1:
            name, peer = "ray-traced, moving, processor time", "two cores over the limit"
            yield Row(name, 1e3 * timing.processor / FRAMES, "ms/pair", peer, 2e3 / LIMIT_PAIRS, None, "at most")
    still = _ray_traced(scene, min(2, cores), moving=False)
    name = "ray-traced, still, all threads"
    yield Row(name, FRAMES / still.best, "pairs/s", "limit on 2 threads", LIMIT_PAIRS, still.spread)


def reflected_rows() -> Iterator[Row]:
    """The same pairs with light that is reflected up to twice between surfaces, and speckle."""
    timing = _ray_traced(part_on_table(PART_TRIANGLES), min(2, len(os.sched_getaffinity(0))), overrides=REFLECTED)
    name, peer = "two bounces and speckle", "limit on 2 threads"
    yield Row(name, FRAMES / timing.best, "pairs/s", peer, LIMIT_REFLECTED, timing.spread, "at least")
    cost, peer = 1e3 * timing.processor / FRAMES, "two cores over the limit"
    yield Row(f"{name}, processor time", cost, "ms/pair", peer, 2e3 / LIMIT_REFLECTED, None, "at most")


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
    timing = measure(lambda: sensor_rt.extract(noisy, sensor, threads=1))
    per_image = 1e3 * timing.best / images
    yield Row("peak extraction", per_image, "ms/image", "limit per core", LIMIT_EXTRACTION_MS, timing.spread, "at most")
    timing = measure(lambda: sensor_rt.expose(electrons, sensor, duration, index, threads=1))
    name = "detector, every pixel"
    yield Row(name, 1e3 * timing.best / images, "ms/image", "peak extraction", per_image, timing.spread)


def geometric_rows() -> Iterator[Row]:
    """Profiles per second without images: laser rays, and both cameras' view of each landing point."""
    scene, cores = part_on_table(PART_TRIANGLES), min(2, len(os.sched_getaffinity(0)))
    sensor, exposures = make_sensor([f"sensor.geometric.rays={RAYS}"]), turning_exposures(PROFILES)
    timing = measure(lambda: sensor_rt.scan(scene, sensor, exposures, engine="geometric", threads=cores))
    rate = PROFILES / timing.best
    name = f"geometric, {RAYS} rays, {cores} threads"
    yield Row(name, rate, "profiles/s", "limit on 2 threads", LIMIT_GEOMETRIC, timing.spread, "at least")
    single = measure(lambda: sensor_rt.scan(scene, sensor, exposures, engine="geometric", threads=1))
    cost, peer = 1e6 * single.processor / PROFILES, "two cores over the limit"
    yield Row("geometric, processor time", cost, "us/profile", peer, 2e6 / LIMIT_GEOMETRIC, None, "at most")
    traced = _ray_traced(scene, cores)
    peer = "our own ray-traced pairs/s"
    yield Row(name, rate, "profiles/s", peer, FRAMES / traced.best, traced.spread, "at least", 100.0)


def density_rows(largest: int) -> Iterator[Row]:
    """Processor time per profile and memory as the triangles of the part grow; the surface stays the same."""
    sensor, moving, many = make_sensor(), turning_exposures(16), turning_exposures(PROFILES)
    first: tuple[float, float] | None = None
    for triangles in (*(n for n in DENSE_STEPS if n < largest), largest):
        scene = part_on_table(triangles)
        traced = measure(partial(sensor_rt.scan, scene, sensor, moving), 3)
        cast = measure(partial(sensor_rt.scan, scene, sensor, many, engine="geometric"), 3)
        figures = (1e3 * traced.processor / 16, 1e6 * cast.processor / PROFILES)
        first = first or figures
        size, least = f"{triangles:,} triangles", f"{DENSE_STEPS[0]:,} triangles"
        yield Row(f"ray-traced, {size}", figures[0], "ms/pair", least, first[0], None, "at most", 2.0)
        yield Row(f"geometric, {size}", figures[1], "us/profile", least, first[1], None, "at most", 2.0)
    # In a process of its own: memory that was freed before would not be asked for again.
    command = [sys.executable, "-m", f"{__package__}.scene_memory", str(largest)]
    memory = int(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
    yield Row(f"memory, {largest:,} triangles", memory / 1e6, "MB", "its vertices and indices", largest * 24e-6)
