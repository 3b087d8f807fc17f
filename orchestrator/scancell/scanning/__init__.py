"""Execution of a scan: drive the cell, render its exposures, reconstruct the cloud."""
