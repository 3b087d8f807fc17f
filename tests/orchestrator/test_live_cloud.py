"""Colours of the cloud of a scan: histogram and limits."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest

from scancell.browser.panels.handles import colour_bar_html
from scancell.browser.scene.scene import LiveCloud
from scancell.errors import DescriptionError
from scancell.live.scan import LiveChunk


def chunk(seed: int, n: int = 400) -> LiveChunk:
    """Deviations of 10 µm (standard deviation), of two cameras."""
    rng = np.random.default_rng(seed)
    return LiveChunk(
        points_in_part=rng.normal(size=(n, 3)),
        intensity=rng.uniform(0, 250, n),
        quality=rng.uniform(0, 1, n),
        sigma=np.ones(n),
        camera=rng.integers(0, 2, n, dtype=np.int32),
        deviation=1e-5 * rng.normal(size=n),
        time=np.arange(n, dtype=float),
    )


@pytest.fixture
def cloud() -> LiveCloud:
    """A cloud of two chunks, whose scene keeps the colours that it was sent."""
    scene = SimpleNamespace(sent=[], add_points=lambda _points, colours, _size: scene.sent.append(colours), complete=0)
    scene.show_chunks = partial(setattr, scene, "complete")
    scene.clear_points = scene.sent.clear
    made = LiveCloud(scene)  # type: ignore[arg-type]
    made.scene = scene  # type: ignore[attr-defined]
    for seed in (1, 2):
        made.add(chunk(seed), 1e-3)
    return made


def test_histogram_counts_every_point_in_its_interval(cloud: LiveCloud) -> None:
    cloud.limit(-20.0, 20.0)
    bar = cloud.bar
    assert bar is not None
    assert bar.limits == (-20.0, 20.0)
    values = 1e6 * np.concatenate([chunk(seed).deviation for seed in (1, 2)])
    expected, _ = np.histogram(np.clip(values, -20, 20), len(bar.counts), (-20, 20))
    assert abs(bar.counts - expected).sum() <= 2  # at the edge of an interval
    assert bar.counts.sum() == cloud.count


def test_values_beyond_the_limits_have_the_outermost_colours(cloud: LiveCloud) -> None:
    cloud.limit(-1.0, 1.0)
    bar = cloud.bar
    assert bar is not None
    colours = np.concatenate(cloud.scene.sent)  # type: ignore[attr-defined]
    values = 1e6 * np.concatenate([chunk(seed).deviation for seed in (1, 2)])
    for beyond, colour in ((values > 1, bar.colours[-1]), (values < -1, bar.colours[0])):
        assert beyond.sum() > 100
        assert (colours[beyond] == colour.astype(np.uint8)).all()


def test_automatic_limits_are_those_of_the_first_chunk(cloud: LiveCloud) -> None:
    first = cloud.bar
    cloud.limit(-1.0, 1.0)
    cloud.limit()
    again = cloud.bar
    assert first is not None
    assert again is not None
    assert again.limits == first.limits
    np.testing.assert_array_equal(again.counts, first.counts)


def test_limits_in_wrong_order_are_rejected_and_the_old_ones_stay(cloud: LiveCloud) -> None:
    before = cloud.bar
    with pytest.raises(DescriptionError, match="limits"):
        cloud.limit(3.0, 3.0)
    assert before is not None
    assert cloud.bar is not None
    assert cloud.bar.limits == before.limits


def test_only_values_have_a_bar(cloud: LiveCloud) -> None:
    cloud.colour_by("camera")
    assert cloud.bar is None
    cloud.colour_by("intensity")
    assert cloud.bar is not None
    cloud.clear()
    assert cloud.bar is None


def test_too_many_points_are_thinned_evenly_and_memory_stays_bounded(cloud: LiveCloud) -> None:
    small = LiveCloud(cloud.scene, most=1000)  # type: ignore[attr-defined]
    for seed in range(40):
        small.add(chunk(seed), 1e-3)
        assert small.count <= 1000
    assert small.step == 16
    assert small.count == 40 * 400 // 16
    kept = np.concatenate([one.time for one in small._chunks])
    np.testing.assert_array_equal(kept, np.tile(np.arange(0.0, 400.0, 16.0), 40))
    assert all(one.time.base is None for one in small._chunks)  # no view, which would keep all points
    small.clear()
    small.add(chunk(1), 1e-3)
    assert (small.step, small.count) == (1, 400)


def test_chunks_are_shown_up_to_a_time_also_after_other_colours(cloud: LiveCloud) -> None:
    scene = cloud.scene  # type: ignore[attr-defined]
    later = chunk(3)
    cloud.add(replace(later, time=later.time + 400), 1e-3)
    cloud.show_until(398.0)
    assert scene.complete == 0
    cloud.show_until(399.0)
    assert scene.complete == 2
    cloud.show_until(799.0)
    assert scene.complete == 3
    cloud.show_until(0.0)
    cloud.colour_by("quality")
    assert scene.complete == 0


def test_bar_shows_limits_and_one_column_for_each_interval(cloud: LiveCloud) -> None:
    cloud.limit(-12.5, 40.0)
    bar = cloud.bar
    assert bar is not None
    shown = colour_bar_html(bar)
    assert ">-12.5<" in shown
    assert ">40<" in shown
    assert "deviation, µm" in shown
    assert shown.count("<rect") == 2 * len(bar.counts)
