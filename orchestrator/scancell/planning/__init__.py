"""Scan planning: views and paths, kinematic constraints, collision-free trajectories and scan programs."""
