"""An exposure of a world at rest gives the same image bytes, whether it was taken in motion mode or after a stop."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from line import rows

from scancell import sensor as sensor_rt
from scancell.cell.recording import Recording
from scancell.scanning.world import build_scene, exposures_from_truth, visible_bodies

FEWER = "scan.max_profiles=60"
STOP = 'scan.mode="stop-and-look"'


def images(line, recording: Recording, still: bool = False) -> np.ndarray:
    """What the line makes of the recorded truth; `still` takes one pose per exposure, the one at its start."""
    bodies = visible_bodies(line.nominal)
    truth = recording.truth
    if still:
        truth = replace(truth, world_from_frame={k: v[:, :1] for k, v in truth.world_from_frame.items()})
    exposures = exposures_from_truth(truth, recording.measured.index, bodies)
    return sensor_rt.render(build_scene(bodies), line.sensor, exposures)


def at_rest(recording: Recording) -> Recording:
    return Recording({n: 0.0 * v if "velocity" in n and "truth" in n else v for n, v in recording.columns.items()})


@pytest.mark.parametrize("ideal", [True, False], ids=["ideal", "with noise"])
def test_modes_render_equal_images_without_motion(planned, ideal) -> None:
    line = planned("free_form", FEWER, ideal=ideal)
    recording = rows(line.drive(), slice(0, None, 12))
    moving, stopped = images(line, at_rest(recording)), images(line, at_rest(recording), still=True)
    assert moving.max() > 100
    assert moving.tobytes() == stopped.tobytes()
    assert images(line, recording).tobytes() != moving.tobytes()


@pytest.mark.parametrize("ideal", [True, False], ids=["ideal", "with noise"])
def test_stop_and_look_exposures_are_at_rest(planned, ideal) -> None:
    line = planned("free_form", FEWER, STOP, ideal=ideal)
    recording = rows(line.drive(), slice(0, None, 12))
    twists = np.array([v for n, v in recording.columns.items() if "velocity" in n])
    assert twists.shape[0] == 9 * 6
    assert np.abs(twists).max() < 1e-6
    assert images(line, at_rest(recording)).tobytes() == images(line, at_rest(recording), still=True).tobytes()


def test_latched_pose_is_at_mid_exposure(planned) -> None:
    """In motion the table turns during the exposure; what it said at the trigger is the middle of that turn."""
    line = planned("free_form", FEWER)
    recording = rows(line.drive(), line.drive().measured.rates[:, -1] > 0.1)
    ends = recording.truth.world_from_frame["table"]
    angle = np.arctan2(ends[..., 1, 0], ends[..., 0, 0])
    middle = np.angle(np.exp(1j * angle).mean(1))
    assert np.abs(np.angle(np.exp(1j * (recording.measured.table - middle)))).max() < 1e-9
    turned = np.angle(np.exp(1j * np.diff(angle, axis=1)))[:, 0]
    rate = np.radians(line.setup.scan.sweep.speed_deg_s)
    assert turned == pytest.approx(rate * recording.measured.exposure, rel=1e-3)
