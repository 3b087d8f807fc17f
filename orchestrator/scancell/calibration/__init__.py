"""Calibration of cell and sensor from measured points: problem, solution, report."""
