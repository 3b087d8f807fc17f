"""Drives the cell through a program and turns its exposures into a cloud."""
