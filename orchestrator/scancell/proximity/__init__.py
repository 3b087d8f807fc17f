"""Collision checks and bounded distance queries between the bodies of the cell."""
