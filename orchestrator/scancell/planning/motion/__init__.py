"""Collision-free motions and their timing."""
