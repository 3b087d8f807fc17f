"""Reconstruction of point clouds from profiles and measured joints, and point-cloud files."""

from scancell.reconstruction.cloud import Cloud
from scancell.reconstruction.cloud_files import read_ply, write_ply
from scancell.reconstruction.reconstruct import Envelope, PointsInSensor, ProfilePoints, Triggers, reconstruct

__all__ = ["Cloud", "Envelope", "PointsInSensor", "ProfilePoints", "Triggers", "read_ply", "reconstruct", "write_ply"]
