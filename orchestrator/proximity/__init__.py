"""Clash checks and bounded distances between the bodies of the cell."""
