"""Acceptance test of a sensor in the simulated cell: artefacts over the measuring range, in both scan modes."""
