"""`PYTHONPATH=tests python -m bench.scene_memory N`: bytes that a scene with N triangles keeps after its first use."""

from __future__ import annotations

import os
import sys
from pathlib import Path

from scancell import sensor as sensor_rt

from .scenes import bumpy_part, make_sensor, turning_exposures


def resident_bytes() -> int:
    """Memory of this process."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


def main(triangles: int) -> None:
    """Print the growth over a scene with hardly any triangle."""
    sensor, exposures = make_sensor(), turning_exposures(2)
    used = []
    meshes = [bumpy_part(64), bumpy_part(triangles)]
    scenes = []
    for vertices, faces in meshes:
        scene = sensor_rt.Scene()
        scene.add_mesh("part", vertices, faces, 0.6)
        scene.add_cylinder("table", [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]], 0.12, 0.02, 0.3)
        sensor_rt.scan(scene, sensor, exposures)
        scenes.append(scene)
        used.append(resident_bytes())
    print(used[1] - used[0])


if __name__ == "__main__":
    main(int(sys.argv[1]))
