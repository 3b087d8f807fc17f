"""Poses, arm kinematics and meshes: pure functions on arrays, no devices."""
