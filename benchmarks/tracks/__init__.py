"""Tracks of the benchmark: each module has its `TRACK`."""

from __future__ import annotations

from importlib import import_module

from benchmarks.track import Track

NAMES = ("stripe", "sensor", "hand_eye", "table", "planning", "acceptance")


def track_named(name: str) -> Track:
    """A track; the others, which need more packages, are not imported."""
    track: Track = import_module(f"benchmarks.tracks.{name}").TRACK
    return track
