"""Typed descriptions of cell, sensor and scan, read from TOML."""

from orchestrator.config.cell import CellDescription
from orchestrator.config.loading import Setup, load_setup
from orchestrator.config.scan import ScanDescription
from orchestrator.config.sensor import SensorDescription

__all__ = ["CellDescription", "ScanDescription", "SensorDescription", "Setup", "load_setup"]
