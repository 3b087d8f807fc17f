"""Calibration of the cell from measured profiles: pure solvers from a problem to a result with its covariance."""
