"""Cameras and laser sheet, from targets of known shape."""
