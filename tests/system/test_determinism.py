"""The same seed gives the same bytes, at any thread count and every time; another seed gives others."""

from __future__ import annotations

import numpy as np
import pytest
from line import make_line, ply_sha256

FEWER = "scan.max_profiles=20"


@pytest.fixture(scope="module")
def line(planned):
    return planned("free_form", FEWER, ideal=False)


@pytest.mark.parametrize("engine", ["ray-traced", "geometric"])
def test_cloud_is_independent_of_threads(line, engine, tmp_path) -> None:
    recording = line.drive()
    sums = {
        threads: ply_sha256(line.cloud(recording, line.sense(recording, engine, threads)), tmp_path)
        for threads in (1, 3)
    }
    assert len(set(sums.values())) == 1, sums


def test_repeated_runs_give_equal_clouds(line, tmp_path) -> None:
    again = make_line("free_form", FEWER, ideal=False)
    first, second = line.drive(), again.drive()
    assert first is not second
    for name, values in first.columns.items():
        assert np.array_equal(values, second.columns[name]), name
    assert ply_sha256(line.scan("ray-traced"), tmp_path) == ply_sha256(again.scan("ray-traced"), tmp_path)


def test_seed_changes_cloud(line, tmp_path) -> None:
    other = make_line("free_form", FEWER, ideal=False, seed=1)
    assert ply_sha256(other.scan("ray-traced"), tmp_path) != ply_sha256(line.scan("ray-traced"), tmp_path)
