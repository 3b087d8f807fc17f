"""Make the meshes of the cell and of the sample parts: binary STL in millimetres beside this script.

Run it without arguments. The same shapes give the same bytes. Needs manifold3d, which is a development dependency:
the meshes themselves are in the repository.
"""

from __future__ import annotations

import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))

import arms  # noqa: E402
import machines  # noqa: E402
import parts  # noqa: E402
from shapes import write_stl  # noqa: E402

SEVEN = "robots/seven_axis_urdf"

MESHES = {
    "robots/six_axis/base.stl": machines.base,
    "robots/six_axis/link1.stl": machines.link1,
    "robots/six_axis/link2.stl": machines.link2,
    "robots/six_axis/link3.stl": machines.link3,
    "robots/six_axis/link4.stl": machines.link4,
    "robots/six_axis/link5.stl": machines.link5,
    "robots/six_axis/link6.stl": machines.link6,
    "robots/offset_wrist/base.stl": arms.offset_base,
    **{f"robots/offset_wrist/link{k}.stl": getattr(arms, f"offset_link{k}") for k in range(1, 7)},
    f"{SEVEN}/meshes/link0.stl": arms.seven_base,
    **{f"{SEVEN}/meshes/link{k}.stl": getattr(arms, f"seven_link{k}") for k in range(1, 8)},
    "tables/rotary_table.stl": machines.platter,
    "tables/table_base.stl": machines.table_base,
    "sensors/profile_probe.stl": machines.probe,
    "sensors/sensor_post.stl": machines.sensor_post,
    "tables/chuck.stl": machines.chuck,
    "parts/sphere_on_foot.stl": parts.sphere_on_foot,
    "parts/step_block.stl": parts.step_block,
    "parts/free_form.stl": parts.free_form,
    "parts/machined.stl": parts.machined,
}

if __name__ == "__main__":
    for name, make in MESHES.items():
        print(f"{name}: {write_stl(HERE / name, make())} faces")
    (HERE / SEVEN / "seven_axis.urdf").write_text(arms.seven_axis_urdf(HERE / SEVEN / "meshes"))
