"""Exercise 2: pick up the part in the middle of the table and put it down 40 mm further, turned by 90 degrees."""

from scancell import Robot, deg, location, mm

FINGERS = 45 * mm  # length: from between the pads' upper ends to the tips
TABLE = 100 * mm  # height
PART = location(
    450 * mm, 0, TABLE + 4 * mm + FINGERS, rx=180 * deg, rz=-90 * deg
)  # fingers along y, 4 mm above the table
GOAL = location(450 * mm, 40 * mm, TABLE + 4.2 * mm + FINGERS, rx=180 * deg)
OPEN = 65 * mm
FORCE = 30.0  # N


def main(robot: Robot) -> None:
    """Approach from above, grip, lift, put down, leave."""
    robot.set_tool("gripper")
    robot.set_speed(0.3)
    robot.open_gripper(OPEN)
    robot.approach(PART, 80 * mm)
    robot.move_line(PART)
    robot.close_gripper(FORCE)
    robot.depart(80 * mm)
    robot.approach(GOAL, 80 * mm)
    robot.move_line(GOAL)
    robot.open_gripper(OPEN)
    robot.depart(80 * mm)
