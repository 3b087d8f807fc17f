"""Poses, arm kinematics and meshes: pure functions on arrays, no devices."""

from scancell.geometry import pose as pose
