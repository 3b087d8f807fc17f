"""Draws docs/pictures/naive_motion.png: a straight motion between two taught poses, and the planned one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.collections import PolyCollection
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from scancell.config.loading import assets_dir, load_setup
from scancell.geometry import pose
from scancell.geometry.mesh import load_mesh
from scancell.nominal.cell import nominal_cell
from scancell.nominal.parts import Body
from scancell.planning.model import PlanningCell, SensorRange
from scancell.planning.motion.connection import Connector
from scancell.scanning.world import make_sensor

Array = NDArray[np.float64]

CLEARANCE = 0.005  # m
PART = assets_dir() / "parts" / "sphere_on_foot.stl"
SHOWN = 0.06  # m: distances beyond are not computed
INSTANTS = 7


@dataclass(frozen=True)
class Motion:
    """Set-points (n, axes), rad, and at each the distance (n,), m, of the arm from all that is not the arm."""

    name: str
    points: Array
    distance: Array


def example() -> tuple[PlanningCell, Motion, Motion]:
    """The default cell with the sphere, and the naive and the planned motion from one side of it to the other."""
    setup = load_setup()
    sensor = make_sensor(setup.sensor, 0)
    cycle = setup.cell.world.controller_cycle_us * 1e-6
    cell = PlanningCell(nominal_cell(setup.cell, load_mesh(PART)), SensorRange.of(sensor), cycle)
    start, end = (taught(cell, side) for side in (1.0, -1.0))
    connector = Connector(cell, CLEARANCE)
    planned = connector.connect(start, end, "the other side")
    return cell, measured(cell, "straight", [connector.move(start, end)]), measured(cell, "planned", planned)


def taught(cell: PlanningCell, side: float) -> Array:
    """Joints and table angle with which the sensor looks at the sphere from beside it, 15 degrees above the level."""
    middle = cell.nominal.table_from_part @ np.array([0.0, 0.0, cell.nominal.part.bounds[1, 2] * 0.6, 1.0])
    tilt = np.radians(90.0 - 15.0)
    looking = pose.from_euler_xyz((0.0, 0.0, 0.0), (np.pi + side * tilt, 0.0, 0.0))
    table_from_sensor = pose.translation(middle[:3]) @ looking @ pose.translation((0.0, 0.0, -0.12))
    q = cell.ik(table_from_sensor[None], reference=cell.nominal.home)[0]
    return np.append(q[np.nanargmin(np.abs(q - cell.nominal.home).max(-1))], 0.0)


def measured(cell: PlanningCell, name: str, motions: Sequence[Array]) -> Motion:
    """The motions in one, with distances."""
    points = np.concatenate([motions[0], *(motion[1:] for motion in motions[1:])])
    on_arm = {body.name for body in cell.nominal.bodies if body.moves_with.startswith(("link", "sensor"))} | {"base"}
    around = [len(on_arm & set(pair)) == 1 for pair in cell.proximity.pairs]
    distance = cell.proximity.distances(cell.nominal.body_poses(points), SHOWN)
    return Motion(name, points, distance[:, around].min(1))


def main() -> None:
    """Plan, draw, and print the smallest distances."""
    cell, naive, planned = example()
    plt.style.use("scancell.plots")
    figure, axes = plt.subplots(1, 3, figsize=(12, 4), width_ratios=(1, 1, 1.1))
    for axis, motion, colour in ((axes[0], naive, "C3"), (axes[1], planned, "C2")):
        draw_side(axis, cell, motion, colour)
    for motion, colour in ((naive, "C3"), (planned, "C2")):
        times = np.arange(len(motion.points)) * cell.cycle
        axes[2].plot(times, 1e3 * motion.distance, color=colour, label=motion.name)
        print(f"{motion.name} motion: at least {1e3 * motion.distance.min():.1f} mm from part and table")
    axes[2].axhline(1e3 * CLEARANCE, color="grey", linestyle=":", label="clearance")
    axes[2].set(xlabel="time (s)", ylabel="distance of the arm from part and table (mm)", ylim=(-2, None))
    axes[2].set_title(f"at least {1e3 * naive.distance.min():.0f} mm and {1e3 * planned.distance.min():.1f} mm")
    axes[2].legend()
    figure.savefig("docs/pictures/naive_motion.png")


def draw_side(axis: plt.Axes, cell: PlanningCell, motion: Motion, colour: str) -> None:
    """Table and part as seen along world x, and the sensor's housing at several instants."""
    bodies = {body.name: body for body in cell.nominal.bodies}
    at_start = cell.nominal.frame_poses(motion.points[0])
    for name in ("table_base", "table", "part"):
        axis.add_collection(silhouette(bodies[name], at_start[bodies[name].moves_with], "lightgrey", 1.0))
    for k in np.linspace(0, len(motion.points) - 1, INSTANTS).round().astype(int):
        frames = cell.nominal.frame_poses(motion.points[k])
        hit = motion.distance[k] <= 0.0
        axis.add_collection(silhouette(bodies["sensor"], frames["sensor"], colour, 0.9 if hit else 0.25))
    path = cell.nominal.world_from_sensor(motion.points[:, :-1])[:, :3, 3]
    axis.plot(path[:, 1], path[:, 2], color="black", linewidth=1)
    axis.set(xlim=(-0.35, 0.35), ylim=(0.0, 0.6), aspect="equal", xlabel="world y (m)", ylabel="world z (m)")
    axis.set_title(f"{motion.name} motion of the sensor")


def silhouette(body: Body, world_from_frame: Array, colour: str, alpha: float) -> PolyCollection:
    """A body projected along world x: all faces, or the outline of the hull where it shows through."""
    corners = pose.transform_points(world_from_frame, body.mesh.vertices)[:, 1:]
    shown = list(corners[body.mesh.faces]) if alpha == 1.0 else [corners[ConvexHull(corners).vertices]]
    return PolyCollection(shown, facecolor=colour, edgecolor="none", alpha=alpha)


if __name__ == "__main__":
    main()
