"""Images come from the true cell, points from measured joints and nominal geometry; nothing crosses."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from line import ply_sha256, rows

from scancell import sensor as sensor_rt
from scancell.cell.recording import INTEGER_COLUMNS, Recording, RecordLayout
from scancell.progress import NullProgress
from scancell.scanning.exposures import build_scene, exposures_from_truth, visible_bodies
from scancell.scanning.scan import Exposed, Scan
from scancell.scanning.world import make_sensors
from scancell.stopwatch import Stopwatch

FEWER = "scan.max_profiles=60"


@pytest.fixture(scope="module")
def line(planned):
    return planned("free_form", FEWER, ideal=False)


@pytest.mark.parametrize("engine", ["ray-traced", "geometric"])
def test_cloud_is_independent_of_truth_after_rendering(line, engine, tmp_path) -> None:
    recording = line.drive()
    points = line.sense(recording, engine)
    lost = recording.without_truth()
    assert all(np.isnan(lost.columns[name]).all() for name in RecordLayout().truth)
    assert ply_sha256(line.cloud(lost, points), tmp_path) == ply_sha256(line.cloud(recording, points), tmp_path)


class Untouchable:
    """Truth that nothing may read."""

    def __getattribute__(self, name: str) -> Any:
        raise AssertionError(f"the truth was asked for '{name}'")


@pytest.mark.parametrize("engine", ["ray-traced", "geometric"])
def test_reconstruction_reads_neither_the_true_cell_nor_the_true_sensor(line, engine, tmp_path) -> None:
    recording, watch = rows(line.drive(), slice(0, None, 4)), Stopwatch()
    scan = Scan(line.scanner.pipeline, line.world, engine, normals=False, samples=False)
    sensed, images = scan.sense(recording, NullProgress(), [])
    made = scan.of_profiles(Exposed(recording, sensed, images, ""), None, NullProgress(), watch).cloud
    truth: Any = Untouchable()
    blind = replace(line.world, true=truth, sensors=replace(line.sensors, true=truth))
    lost = Exposed(recording.without_truth(), sensed, images, "")
    again = replace(scan, world=blind).of_profiles(lost, None, NullProgress(), watch).cloud
    assert len(made) > 1000
    assert ply_sha256(again, tmp_path) == ply_sha256(made, tmp_path)


def test_cloud_depends_on_measured_values(line, tmp_path) -> None:
    recording = line.drive()
    points = line.sense(recording, "geometric")
    name = "trigger.measured.table"
    other = Recording({**recording.columns, name: recording.columns[name] + 1e-6})
    assert ply_sha256(line.cloud(other, points), tmp_path) != ply_sha256(line.cloud(recording, points), tmp_path)


@pytest.mark.parametrize("engine", ["ray-traced", "geometric"])
def test_as_built_sensor_affects_rendering_only(line, engine, tmp_path) -> None:
    """Images by the true sensor, everything after them by the nominal one: no truth is left to lose."""
    recording = rows(line.drive(), slice(0, None, 10))
    sensors = make_sensors(line.setup.sensor, ["sensor.laser.turn_y_deg=0.2"], line.seed)
    points = line.sense(recording, engine, sensors=sensors)
    cloud = ply_sha256(line.cloud(recording, points), tmp_path)
    assert ply_sha256(line.cloud(recording.without_truth(), points), tmp_path) == cloud
    assert ply_sha256(line.cloud(recording, line.sense(recording, engine)), tmp_path) != cloud


def images(line, recording: Recording) -> np.ndarray:
    bodies = visible_bodies(line.nominal)
    exposures = exposures_from_truth(recording.truth, recording.measured.index, bodies)
    return sensor_rt.render(build_scene(bodies), line.sensor, exposures)


@pytest.mark.parametrize(
    "word", ["tool.x_mm=0.1", "table.x_mm=0.2", "dh[3].theta_deg=0.05", "platter.x_mm=0.1", "trigger.latency_ms=1"]
)
def test_as_built_cell_affects_images_only(line, word) -> None:
    nominal, perturbed = line.drive(), line.drive(word)
    for name in (*INTEGER_COLUMNS, *RecordLayout().measured):
        if name != "trigger.index":
            assert np.array_equal(nominal.columns[name], perturbed.columns[name]), name
    moved = slice(0, None, 20)
    assert (images(line, rows(nominal, moved)) != images(line, rows(perturbed, moved))).any()
