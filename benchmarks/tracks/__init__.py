"""Tracks of the benchmark by name."""

from __future__ import annotations

from benchmarks.track import Track
from benchmarks.tracks import hand_eye, planning, sensor, stripe, table

TRACKS: dict[str, Track] = {module.TRACK.name: module.TRACK for module in (stripe, hand_eye, table, sensor, planning)}
