"""Builds and drives the robot cell FMU."""
