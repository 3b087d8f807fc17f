"""Make the meshes of the cell and of the sample parts: binary STL in millimetres beside this script.

Run it without arguments. The same shapes give the same bytes. Needs manifold3d, which is a development dependency:
the meshes themselves are in the repository.
"""

from __future__ import annotations

import sys
from functools import partial
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))

import arms  # noqa: E402
import machines  # noqa: E402
import parts  # noqa: E402
from shapes import write_stl  # noqa: E402

SEVEN = "robots/seven_axis_urdf"

# Denavit-Hartenberg rows of arms with a spherical wrist, as in their files: a (mm), d (mm), alpha (deg).
BALL_WRISTS: dict[str, tuple[arms.Row, ...]] = {
    "irb1200": ((0, 399.1, -90), (-448, 0, 0), (-42, 0, 90), (0, 451, -90), (0, 0, 90), (0, 82, 0)),
    "kr6_r900": ((25, -400, 90), (455, 0, 0), (-35, 0, -90), (0, -420, 90), (0, 0, -90), (0, -80, 180)),
}

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
    "robots/ur5e/base.stl": arms.offset_base,
    "robots/ur5e/link1.stl": partial(arms.offset_link1, 162.5),
    "robots/ur5e/link2.stl": partial(arms.offset_link2, 425.0),
    "robots/ur5e/link3.stl": partial(arms.offset_link3, 392.2),
    "robots/ur5e/link4.stl": partial(arms.offset_link4, 133.3),
    "robots/ur5e/link5.stl": partial(arms.offset_link5, 99.7),
    "robots/ur5e/link6.stl": partial(arms.offset_link6, 99.6),
    **{f"robots/{name}/base.stl": partial(arms.ball_wrist_base, rows) for name, rows in BALL_WRISTS.items()},
    **{
        f"robots/{name}/link{k}.stl": partial(arms.ball_wrist_link, k, rows)
        for name, rows in BALL_WRISTS.items()
        for k in range(1, 7)
    },
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
