"""Laser profile sensor: ray-traced camera images, stripe extraction, triangulation, and a geometric mode."""

from typing import Any

from scancell.sensor import _native
from scancell.sensor._native import (
    PEAK_FLAGS,
    PEAK_REJECTED,
    Camera,
    Exposures,
    Material,
    MeshSurface,
    Peaks,
    PoseSearch,
    Profiles,
    ScanResult,
    Scene,
    cast_rays,
    check_engine,
    closest_points,
    covered_samples,
    estimate_normals,
    expected_electrons,
    expose,
    extract,
    occluded,
    render,
    scan,
    tree_builds,
    triangulate,
    triangulate_pixels,
)

__all__ = [
    "PEAK_FLAGS",
    "PEAK_REJECTED",
    "Camera",
    "Exposures",
    "Material",
    "MeshSurface",
    "Peaks",
    "PoseSearch",
    "Profiles",
    "ScanResult",
    "Scene",
    "Sensor",
    "cast_rays",
    "check_engine",
    "closest_points",
    "covered_samples",
    "estimate_normals",
    "expected_electrons",
    "expose",
    "extract",
    "occluded",
    "render",
    "scan",
    "tree_builds",
    "triangulate",
    "triangulate_pixels",
]


class Sensor(_native.Sensor):
    """Sensor from its resolved JSON description: SI units, all keys present. It can be pickled and compared."""

    def __init__(self, json: str) -> None:
        super().__init__(json)
        self._json = json

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Sensor) and self._json == other._json

    def __hash__(self) -> int:
        return hash(self._json)

    def __reduce__(self) -> tuple[Any, ...]:
        return Sensor, (self._json,)
