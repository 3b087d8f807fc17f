"""Images come from the true cell, points from measured joints and nominal geometry; nothing crosses."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from line import ply_sha256, rows

from scancell import sensor as sensor_rt
from scancell.cell.recording import INTEGER_COLUMNS, Recording, RecordLayout
from scancell.progress import NullProgress, Stopwatch
from scancell.scanning.scan import Scan
from scancell.scanning.sense import SensedProfiles
from scancell.scanning.world import World, build_scene, exposures_from_truth, visible_bodies

FEWER = "scan.max_profiles=60"
# Deviations of each axis, of the rest of the cell and of each part of the sensor.
OF_AXES = (*(f"dh[{joint}].theta_deg=0.05" for joint in range(1, 7)), "table.x_mm=0.2", "table.ry_deg=0.1")
OF_CELL = ("tool.x_mm=0.1", "platter.x_mm=0.1", "trigger.latency_ms=1")
OF_SENSOR = ("sensor.laser.turn_y_deg=0.2", "sensor.camera[1].tilt_deg=29.9", "sensor.camera[2].baseline_mm=60.1")


@pytest.fixture(scope="module")
def line(planned):
    return planned("free_form", FEWER, ideal=False)


@dataclass(frozen=True)
class Sensed:
    """A recording after rendering: nothing true is needed any more."""

    scan: Scan
    recording: Recording
    sensed: SensedProfiles

    def cloud(self, folder: Path, recording: Recording | None = None, world: World | None = None) -> str:
        """Checksum of the cloud, with another recording or in another world."""
        scan = replace(self.scan, world=world or self.scan.world)
        made = scan.of_profiles(recording or self.recording, self.sensed, None, NullProgress(), Stopwatch()).cloud
        assert len(made) > 1000
        return ply_sha256(made, folder)


@pytest.fixture(scope="module", params=["ray-traced", "geometric"])
def seen(request, line):
    scan = Scan(line.scanner.pipeline, line.world, request.param, samples=False)
    recording = rows(line.drive(), slice(0, None, 4))
    return Sensed(scan, recording, scan.sense(recording, NullProgress()))


def test_cloud_is_independent_of_truth_after_rendering(seen, tmp_path) -> None:
    lost = seen.recording.without_truth()
    assert all(np.isnan(lost.columns[name]).all() for name in RecordLayout().truth)
    assert seen.cloud(tmp_path, lost) == seen.cloud(tmp_path)


@pytest.mark.parametrize("frame", RecordLayout().frames)
def test_cloud_is_independent_of_the_true_poses_of_each_frame(seen, frame, tmp_path) -> None:
    """Rates included; the frames are moved by the axes of the arm, by the table and the belts."""
    begin = f"trigger.truth.{frame}."
    moved = {name: v + 0.1 for name, v in seen.recording.columns.items() if name.startswith(begin)}
    assert len(moved) == 13
    assert seen.cloud(tmp_path, Recording({**seen.recording.columns, **moved})) == seen.cloud(tmp_path)


@pytest.mark.parametrize("word", [*OF_AXES, *OF_CELL, *OF_SENSOR])
def test_cloud_is_independent_of_as_built_values_after_rendering(line, seen, word, tmp_path) -> None:
    """Rendered with a true value of one axis, of the cell or of the sensor, the profiles do not need it again."""
    recording = rows(line.drive(*({word} - set(OF_SENSOR))), slice(0, None, 4))
    scan = replace(seen.scan, world=replace(seen.scan.world, as_built=(word,)))
    built = Sensed(scan, recording, scan.sense(recording, NullProgress()))
    cloud = built.cloud(tmp_path)
    assert built.cloud(tmp_path, recording.without_truth(), seen.scan.world) == cloud
    assert seen.cloud(tmp_path) != cloud  # the images show it


class Untouchable:
    """Truth that nothing may read."""

    def __getattribute__(self, name: str) -> Any:
        raise AssertionError(f"the truth was asked for '{name}'")


def test_reconstruction_reads_neither_the_true_cell_nor_the_true_sensor(seen, tmp_path) -> None:
    truth: Any = Untouchable()
    blind = replace(seen.scan.world, true=truth)
    vars(blind).update(sensor_true=truth, sensor_true_description=truth)
    assert seen.cloud(tmp_path, seen.recording.without_truth(), blind) == seen.cloud(tmp_path)


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
    points = line.sense(recording, engine, world=replace(line.world, as_built=(OF_SENSOR[0],)))
    cloud = ply_sha256(line.cloud(recording, points), tmp_path)
    assert ply_sha256(line.cloud(recording.without_truth(), points), tmp_path) == cloud
    assert ply_sha256(line.cloud(recording, line.sense(recording, engine)), tmp_path) != cloud


def images(line, recording: Recording) -> np.ndarray:
    bodies = visible_bodies(line.nominal)
    exposures = exposures_from_truth(recording.truth, recording.measured.index, bodies)
    return sensor_rt.render(build_scene(bodies), line.sensor, exposures)


@pytest.mark.parametrize("word", [*OF_AXES, *OF_CELL])
def test_as_built_cell_affects_images_only(line, word) -> None:
    nominal, perturbed = line.drive(), line.drive(word)
    for name in (*INTEGER_COLUMNS, *RecordLayout().measured):
        if name != "trigger.index":
            assert np.array_equal(nominal.columns[name], perturbed.columns[name]), name
    moved = slice(0, None, 20)
    assert (images(line, rows(nominal, moved)) != images(line, rows(perturbed, moved))).any()
