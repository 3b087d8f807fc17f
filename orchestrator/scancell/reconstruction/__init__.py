"""Reconstruction of point clouds from profiles and measured joints, and point-cloud files."""
