"""Evaluation of clouds: deviation from the mesh, coverage, ground truth."""
