"""A rolling shutter on the moving cell: taken into account where it is known, an error where it is not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from line import figures_um

from scancell.cell.recording import Recording
from scancell.config.loading import load_setup
from scancell.errors import SensorError
from scancell.scanning.world import make_sensor, readout_time

FEWER = "scan.max_profiles=12"
ROLLING = ('sensor.detector.shutter="rolling"', "sensor.detector.row_readout_us=20")


@pytest.fixture(scope="module")
def line(planned):
    return planned("free_form", FEWER)


@pytest.fixture(scope="module")
def rolling():
    return load_setup(settings=ROLLING, ideal=True).sensor


def figures(line, recording: Recording, nominal, true, engine: str = "ray-traced") -> dict[str, float]:
    """Native models of the descriptions of the nominal and the true sensor."""
    described = replace(line.world, setup=replace(line.setup, sensor=true), estimated_sensor=nominal)
    points = line.sense(recording, engine, world=described)
    cloud = line.cloud(recording, points, normals=False)
    assert len(cloud) > 15_000
    return figures_um(line.signed(cloud))


@pytest.fixture(scope="module")
def unknown(line, rolling) -> dict[str, float]:
    """Figures of the moving cell where reconstruction takes the shutter for a global one."""
    return figures(line, line.drive(), line.setup.sensor, rolling)


def test_points_use_row_time(line, rolling, unknown) -> None:
    recording = line.drive()
    ideal = figures(line, recording, line.setup.sensor, line.setup.sensor)
    known = figures(line, recording, rolling, rolling)
    assert readout_time(make_sensor(rolling, 0)) == pytest.approx(20e-6 * 1023)
    assert known["rms"] < 1.2 * ideal["rms"]
    assert unknown["rms"] > 10 * ideal["rms"]


def test_unmodelled_shutter_error_grows_with_speed(line, rolling, unknown) -> None:
    recording = line.drive()
    slow = {n: 0.25 * v if "velocity" in n and "truth" in n else v for n, v in recording.columns.items()}
    slower = figures(line, replace(recording, columns=slow), line.setup.sensor, rolling)
    assert slower["rms"] == pytest.approx(0.25 * unknown["rms"], rel=0.15)


def test_geometric_engine_rejects_rolling_shutter(line, rolling) -> None:
    for nominal, true in ((rolling, rolling), (line.setup.sensor, rolling)):
        with pytest.raises(SensorError, match=r"sensor\.detector\.shutter"):
            figures(line, line.drive(), nominal, true, "geometric")


def test_truth_spans_all_rows(line) -> None:
    recording = line.drive()
    one, all_rows = recording.truth, recording.truth_for_rows(0.02)
    turned = [np.linalg.norm(np.diff(t.world_from_frame["table"], axis=1)[:, 0], axis=(1, 2)) for t in (one, all_rows)]
    moves = turned[0] > 1e-9
    assert moves.any()
    assert turned[1][moves] / turned[0][moves] == pytest.approx(1 + 0.02 / one.duration[moves], rel=1e-3)
    np.testing.assert_array_equal(one.duration, all_rows.duration)
