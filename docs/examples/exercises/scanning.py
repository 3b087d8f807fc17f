"""Exercise 5: scan the top of the sphere and find its radius."""

import numpy as np

from scancell import Robot, deg, location, mm

START = location(432 * mm, 0, 260 * mm, rx=180 * deg)  # 90 mm above the top
LENGTH = 36 * mm
TOP = 60 * mm  # height in the part above which there is nothing but the sphere


def main(robot: Robot) -> None:
    """A straight pass, and a linear least-squares fit: |p|2 = 2 c p + (r2 - |c|2)."""
    robot.move_tool(START)
    robot.set_speed(0.2)
    cloud = robot.scan_line(START @ location(LENGTH, 0, 0), spacing=0.5 * mm)
    robot.save(cloud, "sphere.ply")
    points = cloud.points_in_part[cloud.points_in_part[:, 2] > TOP]
    unknown = np.linalg.lstsq(np.c_[2 * points, np.ones(len(points))], (points**2).sum(1), rcond=None)[0]
    centre = unknown[:3]
    radius = np.sqrt(unknown[3] + centre @ centre)
    print(f"radius {radius / mm:.3f} mm, centre at {np.round(centre / mm, 3)} mm, {len(points)} points")
