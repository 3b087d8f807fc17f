"""Speed of the sensor: images, stripes, laser rays, and what the size of the mesh costs."""

from __future__ import annotations

import gc
import os
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np

import sensor_rt

from .scenes import PART_TRIANGLES, make_sensor, part_on_table, turning_exposures
from .table import Row, Wanted
from .timing import Timing, measure

FRAMES = 32
PROFILES = 512
RAYS = 1024
LIMIT_PAIRS = 60.0
LIMIT_GEOMETRIC = 25_000.0
LIMIT_EXTRACTION_MS = 2.0
DENSE_STEPS = (10_000, 100_000, 1_000_000)


def _ray_traced(scene: sensor_rt.Scene, threads: int, moving: bool = True) -> Timing:
    sensor, exposures = make_sensor(), turning_exposures(FRAMES, moving=moving)
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
    still = _ray_traced(scene, min(2, cores), moving=False)
    name = "ray-traced, still, all threads"
    yield Row(name, FRAMES / still.best, "pairs/s", "limit on 2 threads", LIMIT_PAIRS, still.spread)


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
    traced = _ray_traced(scene, cores)
    peer = "our own ray-traced pairs/s"
    yield Row(name, rate, "profiles/s", peer, FRAMES / traced.best, traced.spread, "at least", 100.0)


def density_rows(largest: int) -> Iterator[Row]:
    """Time per profile and memory as the triangles of the part grow; the surface stays the same."""
    sensor, moving, many = make_sensor(), turning_exposures(16), turning_exposures(PROFILES)
    first: tuple[float, float] | None = None
    for triangles in (*(n for n in DENSE_STEPS if n < largest), largest):
        gc.collect()
        before = _resident_bytes()
        scene = part_on_table(triangles)
        traced = measure(partial(sensor_rt.scan, scene, sensor, moving), 3)
        memory = _resident_bytes() - before
        cast = measure(partial(sensor_rt.scan, scene, sensor, many, engine="geometric"), 3)
        figures = (1e3 * traced.best / 16, 1e6 * cast.best / PROFILES)
        first = first or figures
        size, least = f"{triangles:,} triangles", f"{DENSE_STEPS[0]:,} triangles"
        yield Row(f"ray-traced, {size}", figures[0], "ms/pair", least, first[0], traced.spread, "at most", 2.0)
        yield Row(f"geometric, {size}", figures[1], "us/profile", least, first[1], cast.spread, "at most", 2.0)
        yield Row(f"memory, {size}", memory / 1e6, "MB", "its vertices and indices", triangles * 24e-6)


def _resident_bytes() -> int:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE")
