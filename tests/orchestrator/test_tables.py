"""CSV files are identical to the output of the standard library's writer, across block boundaries."""

from __future__ import annotations

import csv
import io
from types import SimpleNamespace

import numpy as np

from scancell.output.tables import write_csv, write_profile_csv

RNG = np.random.default_rng(4)
WORDS = np.array(["plain", "", "a, b", 'say "so"', "two\nlines", "µ 100%d"])


def test_table_matches_standard_csv_writer(tmp_path):
    count = 70_001  # more than one block
    numbers = RNG.normal(0, 10.0 ** RNG.integers(-8, 5, count), count)
    holes = np.where(RNG.random(count) < 0.1, np.nan, numbers)
    whole = RNG.integers(-(10**12), 10**12, count)
    words = WORDS[RNG.integers(0, len(WORDS), count)]
    single = numbers.astype(np.float32)
    columns = {"a, b": numbers, "holes": holes, "whole": whole, "word": words, "single": single}
    write_csv(tmp_path / "table.csv", columns)
    expected = io.StringIO(newline="")
    writer = csv.writer(expected)
    writer.writerow(columns)
    for a, b, c, d, e in zip(*columns.values(), strict=True):
        writer.writerow([f"{a:.6f}", "" if np.isnan(b) else f"{b:.6f}", int(c), d, f"{e:.6f}"])
    assert (tmp_path / "table.csv").read_bytes().decode() == expected.getvalue()


def test_empty_table_has_header(tmp_path):
    write_csv(tmp_path / "table.csv", {"a": np.zeros(0), "b": np.zeros(0, int), "c": np.zeros(0, "U1")})
    assert (tmp_path / "table.csv").read_text() == "a,b,c\n"


def test_profile_csv_contains_sensor_and_part_frames(tmp_path):
    points = RNG.normal(size=(5, 3))
    profiles = SimpleNamespace(
        camera=np.arange(5, dtype=np.int32),
        column=np.arange(5) + 100,
        points_in_sensor=points,
        sigma=np.full(5, 2e-6, np.float32),
        intensity=np.full(5, 99.5, np.float32),
    )
    write_profile_csv(tmp_path / "profile.csv", profiles, np.linspace(0, 1, 5), points + 1.0)
    with (tmp_path / "profile.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    axes = [f"{axis}_{frame}_mm" for frame in ("sensor", "part") for axis in "xyz"]
    assert list(rows[0]) == ["camera", "column_px", "row_px", *axes, "sigma_mm", "intensity_dn"]
    assert [row["column_px"] for row in rows] == ["100", "101", "102", "103", "104"]
    read = np.array(
        [[float(row[f"{axis}_{frame}_mm"]) for axis in "xyz"] for row in rows for frame in ("sensor", "part")]
    )
    np.testing.assert_allclose(read[0::2], points * 1e3, atol=1e-6)
    np.testing.assert_allclose(read[1::2], points * 1e3 + 1e3, atol=1e-6)
    assert {row["sigma_mm"] for row in rows} == {"0.002000"}
