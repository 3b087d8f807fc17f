"""Typed descriptions of cell, sensor, scan, study and batch: read from TOML, checked, changed, written."""
