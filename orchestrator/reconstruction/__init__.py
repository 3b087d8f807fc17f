"""Profiles and measured joints to a point cloud, and point-cloud files."""

from orchestrator.reconstruction.cloud import Cloud
from orchestrator.reconstruction.cloud_files import read_ply, write_ply
from orchestrator.reconstruction.reconstruct import Envelope, PointsInSensor, ProfilePoints, Triggers, reconstruct

__all__ = ["Cloud", "Envelope", "PointsInSensor", "ProfilePoints", "Triggers", "read_ply", "reconstruct", "write_ply"]
