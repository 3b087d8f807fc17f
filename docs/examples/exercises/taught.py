"""Exercise 7: taught in the workspace, which opens it again."""

from scancell import Robot, deg, location, mm

above = (35 * deg, -60 * deg, 185 * deg, 0 * deg, 55 * deg, 0 * deg)
start = location(432 * mm, 0 * mm, 260 * mm, rx=180 * deg, ry=0 * deg, rz=0 * deg)
end = location(468 * mm, 0 * mm, 260 * mm, rx=180 * deg, ry=0 * deg, rz=0 * deg)


def main(robot: Robot) -> None:
    """Above the part, to the start of the scan, along it, and back."""
    robot.set_speed(0.3)
    robot.move_joints(above, table_angle=0 * deg)
    robot.move_line(start)
    robot.scan_line(end, spacing=0.5 * mm)
    robot.move_joints(above, table_angle=0 * deg)
